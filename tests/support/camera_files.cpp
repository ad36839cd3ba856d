// SPDX-License-Identifier: Apache-2.0
#include "camera_files.h"

#include <fstream>
#include <iomanip>
#include <nlohmann/json.hpp>
#include <sstream>

namespace vdbcarve::test {

std::string middlebury_text(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << views.views.size() << "\n";
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const Rigid3& t = v.camera.camera_from_world;
        out << v.name << " " << k.fx << " " << k.skew << " " << k.cx - 0.5 << " 0 " << k.fy << " " << k.cy - 0.5 << " 0 0 1";
        for (int i = 0; i < 9; ++i) out << " " << t.rotation(i / 3, i % 3);
        for (int i = 0; i < 3; ++i) out << " " << t.translation[i];
        out << "\n";
    }
    return out.str();
}

std::string transforms_text(const Views& views) {
    nlohmann::json j;
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const Mat3d& r = v.camera.camera_from_world.rotation;
        const Vec3d c = -r.transpose() * v.camera.camera_from_world.translation;
        nlohmann::json m = nlohmann::json::array();
        // OpenGL: columns are right, up, backward.
        for (int i = 0; i < 3; ++i) m.push_back({r(0, i), -r(1, i), -r(2, i), c[i]});
        m.push_back({0.0, 0.0, 0.0, 1.0});
        j["frames"].push_back({{"file_path", "images/" + v.name}, {"transform_matrix", m}, {"fl_x", k.fx}, {"fl_y", k.fy}, {"cx", k.cx}, {"cy", k.cy}, {"w", k.width_px}, {"h", k.height_px}});
    }
    return j.dump();
}

std::string projection_text(const View& view, double factor) {
    const Intrinsics& k = view.camera.intrinsics;
    Mat3d a;
    a << k.fx, k.skew, k.cx - 0.5, 0, k.fy, k.cy - 0.5, 0, 0, 1;
    Mat34d p;
    p << view.camera.camera_from_world.rotation, view.camera.camera_from_world.translation;
    p = factor * a * p;
    std::ostringstream out;
    out << std::setprecision(17);
    for (int r = 0; r < 3; ++r) out << p(r, 0) << " " << p(r, 1) << " " << p(r, 2) << " " << p(r, 3) << "\n";
    return out.str();
}

void write_colmap_text(const std::filesystem::path& folder, const Views& views) {
    std::ofstream cameras(folder / "cameras.txt"), images(folder / "images.txt");
    cameras << std::setprecision(17) << "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
    images << std::setprecision(17) << "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n";
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Camera& c = views.views[i].camera;
        const Intrinsics& k = c.intrinsics;
        const Eigen::Quaterniond q(c.camera_from_world.rotation);
        const Vec3d& t = c.camera_from_world.translation;
        cameras << i + 5 << " PINHOLE " << k.width_px << " " << k.height_px << " " << k.fx << " " << k.fy << " " << k.cx << " " << k.cy << "\n";
        images << i + 1 << " " << q.w() << " " << q.x() << " " << q.y() << " " << q.z() << " " << t[0] << " " << t[1] << " " << t[2] << " " << i + 5 << " " << views.views[i].name << "\n"
               << (i % 2 ? "" : "1.5 2.5 -1 3.5 4.5 17") << "\n";
    }
}

void write_colmap_binary(const std::filesystem::path& folder, const Views& views) {
    std::ofstream cameras(folder / "cameras.bin", std::ios::binary), images(folder / "images.bin", std::ios::binary);
    const auto put = [](std::ofstream& out, auto value) { out.write(reinterpret_cast<const char*>(&value), sizeof value); };
    put(cameras, static_cast<uint64_t>(views.views.size()));
    put(images, static_cast<uint64_t>(views.views.size()));
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Camera& c = views.views[i].camera;
        const Intrinsics& k = c.intrinsics;
        const Eigen::Quaterniond q(c.camera_from_world.rotation);
        put(cameras, static_cast<uint32_t>(i + 5));
        put(cameras, int32_t{1});  // PINHOLE
        put(cameras, static_cast<uint64_t>(k.width_px));
        put(cameras, static_cast<uint64_t>(k.height_px));
        for (double p : {k.fx, k.fy, k.cx, k.cy}) put(cameras, p);
        put(images, static_cast<uint32_t>(i + 1));
        for (double x : {q.w(), q.x(), q.y(), q.z(), c.camera_from_world.translation[0], c.camera_from_world.translation[1], c.camera_from_world.translation[2]}) put(images, x);
        put(images, static_cast<uint32_t>(i + 5));
        images << views.views[i].name << '\0';
        const uint64_t points = i % 3;
        put(images, points);
        for (uint64_t n = 0; n < points; ++n) {
            put(images, 1.5);
            put(images, 2.5);
            put(images, int64_t{-1});
        }
    }
}

}  // namespace vdbcarve::test
