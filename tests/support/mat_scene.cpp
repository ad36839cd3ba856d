// SPDX-License-Identifier: Apache-2.0
#include "support/mat_scene.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <fstream>

#include "image/image_io.h"

namespace vdbcarve::test {

MatPhotos photograph(const MatShoot& s) {
    double dots = 60 / 0.0254;
    const double margin_m = 0.015;
    const Image8 board = draw_board(s.mat, margin_m, dots);
    const double width = s.mat.width_m(), height = s.mat.height_m();
    MatPhotos out;
    out.views.views.resize(static_cast<size_t>(s.views));
    out.photos.resize(out.views.views.size());
    out.masks.resize(out.views.views.size());
    for (size_t i = 0; i < out.views.views.size(); ++i) {
        View& v = out.views.views[i];
        v.name = (i < 10 ? "0" : "") + std::to_string(i) + ".png";
        Camera& c = v.camera;
        c.intrinsics.fx = c.intrinsics.fy = s.focal_px;
        c.intrinsics.width_px = s.width_px, c.intrinsics.height_px = s.height_px;
        c.intrinsics.cx = 0.5 * s.width_px + 4.2, c.intrinsics.cy = 0.5 * s.height_px - 3.1;
        if (s.k1 != 0) v.lens = {Lens::Model::SimpleRadial, {s.k1}};
        const double azimuth = 2 * 3.14159265358979 * static_cast<double>(i) / s.views + 0.1, elevation = 0.45 + 0.35 * static_cast<double>(i % 3),
                     distance = 0.5 + 0.03 * static_cast<double>(i % 2);
        const Vec3d centre = distance * Vec3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        const Vec3d z = (Vec3d(0, 0, 0.02) - centre).normalized(), x = z.cross(Vec3d::UnitZ()).normalized(), y = z.cross(x);
        c.camera_from_world.rotation << x.transpose(), y.transpose(), z.transpose();
        c.camera_from_world.translation = -(c.camera_from_world.rotation * centre);
    }
    tbb::parallel_for(size_t{0}, out.photos.size(), [&](size_t i) {
        const Camera& c = out.views.views[i].camera;
        out.photos[i] = Image8(s.width_px, s.height_px);
        out.masks[i] = Image8(s.width_px, s.height_px);
        const Vec3d eye = c.centre_world(), ball(0, 0, s.ball_height_m);
        for (int v = 0; v < s.height_px; ++v)
            for (int u = 0; u < s.width_px; ++u) {
                double light = 0, covered = 0;
                for (int k = 0; k < s.samples * s.samples; ++k) {
                    const double px = u + (k % s.samples + 0.5) / s.samples, py = v + (static_cast<double>(k / s.samples) + 0.5) / s.samples;
                    // The ray of a distorted pixel: the radius before distortion by Newton's method.
                    const Vec2d seen((px - c.intrinsics.cx) / s.focal_px, (py - c.intrinsics.cy) / s.focal_px);
                    double share = 1;
                    for (int n = 0; n < 4 && s.k1 != 0; ++n) {
                        const double r2 = seen.squaredNorm();
                        share -= (share * (1 + s.k1 * share * share * r2) - 1) / (1 + 3 * s.k1 * share * share * r2);
                    }
                    const Vec3d along = (c.camera_from_world.rotation.transpose() * Vec3d(share * seen.x(), share * seen.y(), 1)).normalized();
                    if (s.ball_radius_m > 0) {
                        const Vec3d to = ball - eye;
                        const double middle = to.dot(along), off2 = to.squaredNorm() - middle * middle;
                        if (off2 < s.ball_radius_m * s.ball_radius_m) {
                            const double t = middle - std::sqrt(s.ball_radius_m * s.ball_radius_m - off2);
                            if ((eye + t * along).z() > 0) {
                                covered += 1, light += 90;
                                continue;
                            }
                        }
                    }
                    if (along.z() >= 0) {
                        light += 150;
                        continue;
                    }
                    double t = -eye.z() / along.z();
                    for (int n = 0; n < 12 && s.curl; ++n) {
                        const Vec3d at = eye + t * along;
                        t = (s.curl(at.x(), at.y()) - eye.z()) / along.z();
                    }
                    const Vec3d at = eye + t * along;
                    const double x = (at.x() + 0.5 * width + margin_m) * dots, y = (0.5 * height - at.y() + margin_m) * dots;
                    light += x >= 0 && y >= 0 && x < board.width && y < board.height ? 20 + 0.8 * board.at(static_cast<int>(x), static_cast<int>(y)) : 150;
                }
                const double all = s.samples * s.samples;
                out.photos[i].at(u, v) = static_cast<uint8_t>(std::lround(light / all));
                out.masks[i].at(u, v) = static_cast<uint8_t>(std::lround(255 * covered / all));
            }
    });
    return out;
}

Views write_photos(const MatPhotos& p, const std::filesystem::path& folder) {
    std::filesystem::create_directories(folder / "images");
    const auto write = [](const std::filesystem::path& file, const Image8& image) {
        const auto png = io::encode_png(image.view());
        std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(png.data()), static_cast<std::streamsize>(png.size()));
    };
    bool ball = false;
    for (const Image8& m : p.masks)
        for (uint8_t x : m.data) ball |= x > 0;
    if (ball) std::filesystem::create_directories(folder / "masks");
    for (size_t i = 0; i < p.photos.size(); ++i) {
        write(folder / "images" / p.views.views[i].name, p.photos[i]);
        if (ball) write(folder / "masks" / p.views.views[i].name, p.masks[i]);
    }
    Progress quiet;
    ViewsOptions options;
    options.scene = folder;
    options.allow_unposed = true;
    return load_views(options, quiet);
}

}  // namespace vdbcarve::test
