// SPDX-License-Identifier: Apache-2.0
// A textured ball with a dent that silhouettes do not show, photographed by rays: every depth is known.
#pragma once

#include <openvdb/openvdb.h>

#include <cmath>
#include <numbers>
#include <optional>

#include "vdbcarve/carve.h"
#include "vdbcarve/color.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::test {

/// The unit ball without a smaller one at its top.
struct DentedBall {
    Vec3d dent{0, 0, 1.05};
    double dent_radius = 0.75;

    bool inside(const Vec3d& x) const { return x.norm() < 1 && (x - dent).norm() > dent_radius; }
    double volume() const {
        // Less the lens that both balls share.
        const double d = dent.norm(), r = dent_radius, a = (1 - r * r + d * d) / (2 * d), h = 1 - a, g = r - (d - a);
        const auto cap = [](double radius, double height) { return std::numbers::pi * height * height * (3 * radius - height) / 3; };
        return 4.0 / 3 * std::numbers::pi - cap(1, h) - cap(r, g);
    }
    /// The way along a ray to the first surface.
    std::optional<double> hit(const Camera::Ray& ray) const {
        const auto cross = [&](const Vec3d& centre, double radius) -> std::optional<std::pair<double, double>> {
            const Vec3d o = ray.origin - centre;
            const double b = o.dot(ray.direction), c = o.squaredNorm() - radius * radius, root2 = b * b - c;
            if (root2 < 0) return std::nullopt;
            return std::pair{-b - std::sqrt(root2), -b + std::sqrt(root2)};
        };
        const auto ball = cross(Vec3d::Zero(), 1), hole = cross(dent, dent_radius);
        if (!ball) return std::nullopt;
        if (hole && hole->first < ball->first && hole->second > ball->first) {
            if (hole->second < ball->second) return hole->second;
            return std::nullopt;
        }
        return ball->first;
    }
    /// 0..1, of places: noise on a lattice, in three sizes.
    static double texture(const Vec3d& x) {
        double out = 0;
        for (const double size : {0.2, 0.09, 0.04}) {
            const Vec3d p = x / size;
            const Vec3d base(std::floor(p.x()), std::floor(p.y()), std::floor(p.z())), f = p - base;
            for (int corner = 0; corner < 8; ++corner) {
                double w = 1;
                uint32_t h = 2166136261u;
                for (int a = 0; a < 3; ++a) {
                    const int bit = corner >> a & 1;
                    w *= bit ? f[a] : 1 - f[a];
                    h = (h ^ static_cast<uint32_t>(static_cast<int>(base[a]) + bit + 1000)) * 16777619u;
                    h ^= h >> 13;
                }
                out += w * static_cast<double>(h * 2654435761u >> 8) / 16777216.0 / 3;
            }
        }
        return out;
    }
};

/// Views from all around, looking down into the dent from some; photographs grey in RGB, masks exact to a 1/16 of a pixel.
struct DentedScene {
    std::vector<Camera> cameras;
    std::vector<Mask> masks;
    std::vector<Photo> photos;
    std::vector<ColorInput> inputs;
    openvdb::FloatGrid::Ptr hull;  ///< its level set

    /// `contrast` of the texture; 0: none.
    explicit DentedScene(double contrast, int views = 24, int width = 160, int resolution = 64, bool orthographic = false) {
        openvdb::initialize();
        const DentedBall ball;
        const int height = width * 3 / 4;
        for (int v = 0; v < views; ++v) {
            const double azimuth = 2 * std::numbers::pi * v / (views / 2), elevation = (v < views / 2 ? 12.0 : 48.0) * std::numbers::pi / 180;
            const Vec3d from = Vec3d(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation), std::sin(elevation)) * 6.0;
            Camera c;
            Mat3d& r = c.camera_from_world.rotation;
            r.row(2) = -from.normalized().transpose();
            r.row(0) = Vec3d(-std::sin(azimuth), std::cos(azimuth), 0).transpose();
            r.row(1) = Vec3d(r.row(2).transpose()).cross(Vec3d(r.row(0).transpose())).transpose();
            c.camera_from_world.translation = -(r * from);
            Intrinsics& k = c.intrinsics;
            k.fx = k.fy = orthographic ? 0.4 * height : 2.3 * height;
            k.cx = 0.5 * width + 0.3;
            k.cy = 0.5 * height - 0.2;
            k.width_px = width;
            k.height_px = height;
            k.orthographic = orthographic;
            cameras.push_back(c);
            Mask mask;
            mask.coverage = Image8(width, height);
            Photo photo;
            photo.pixels8 = Image8(width, height, 3);
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x) {
                    double shade = 0;
                    int hits = 0;
                    for (int n = 0; n < 16; ++n) {
                        const Camera::Ray ray = c.ray(Vec2d(x + (n % 4 + 0.5) / 4, y + (n / 4 + 0.5) / 4));
                        if (const auto t = ball.hit(ray)) {
                            ++hits;
                            shade += 0.5 + contrast * (DentedBall::texture(ray.origin + *t * ray.direction) - 0.5);
                        }
                    }
                    mask.coverage.at(x, y) = static_cast<uint8_t>(std::lround(255.0 * hits / 16));
                    for (int ch = 0; ch < 3; ++ch) photo.pixels8.at(x, y, ch) = hits ? static_cast<uint8_t>(std::lround(255 * shade / hits)) : 0;
                }
            masks.push_back(std::move(mask));
            photos.push_back(std::move(photo));
        }
        std::vector<MaskView> views_of;
        for (int v = 0; v < views; ++v) {
            const auto n = static_cast<size_t>(v);
            inputs.push_back({"view " + std::to_string(v), cameras[n], view_of(masks[n]), view_of(photos[n]), true});
            views_of.push_back(view_of(masks[n]));
        }
        Progress quiet;
        const std::vector<DistanceField> fields = distance_fields(views_of, {}, quiet);
        std::vector<CarveInput> carved;
        for (size_t v = 0; v < fields.size(); ++v) carved.push_back({inputs[v].name, cameras[v], &fields[v]});
        CarveOptions o;
        o.bounds_world = Box3d(Vec3d(-1.15, -1.15, -1.15), Vec3d(1.15, 1.15, 1.15));
        o.lattice.voxel_size = 2.3 / resolution;
        hull = level_set(carve(carved, o, quiet).hull, {}, quiet);
    }
    DentedScene(const DentedScene&) = delete;
};

}  // namespace vdbcarve::test
