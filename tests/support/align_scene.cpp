// SPDX-License-Identifier: Apache-2.0
#include "support/align_scene.h"

#include <random>

namespace vdbcarve::test {
namespace {

Mat3d random_rotation(std::mt19937_64& random) {
    std::normal_distribution<double> normal;
    const Eigen::Quaterniond q(normal(random), normal(random), normal(random), normal(random));
    return q.normalized().toRotationMatrix();
}

}  // namespace

std::vector<Solid> lump(uint64_t seed) {
    std::mt19937_64 random(seed);
    const auto uniform = [&](double lo, double hi) { return std::uniform_real_distribution<double>(lo, hi)(random); };
    std::vector<Solid> out;
    for (int k = 0; k < 7; ++k) {
        Solid s;
        for (int a = 0; a < 3; ++a) s.size[a] = uniform(0.2, 0.5);
        s.world_from_solid.rotation = random_rotation(random);
        for (int a = 0; a < 3; ++a) s.world_from_solid.translation[a] = (a == 2 ? 0.8 : 0.6) * uniform(-1, 1);
        out.push_back(s);
    }
    Solid plate;
    plate.kind = Solid::Kind::Box;
    plate.size = Vec3d(0.6, 0.35, 0.15);
    plate.world_from_solid = {random_rotation(random), Vec3d(0.1, 0.05, -0.2)};
    out.push_back(plate);
    return out;
}

std::vector<Solid> round_object() {
    Solid a, b;
    a.size = Vec3d(0.5, 0.5, 0.6), a.world_from_solid.translation = Vec3d(0, 0, 0.3);
    b.size = Vec3d(0.8, 0.8, 0.5), b.world_from_solid.translation = Vec3d(0, 0, -0.4);
    return {a, b};
}

SyntheticSpec hand_held_orbit(uint64_t seed) {
    SyntheticSpec spec;
    spec.solids = lump(seed);
    spec.photos = false;
    spec.seed = seed;
    Rig& r = spec.rig;
    r.views = 36;
    r.elevation_deg = 0;
    r.fov_deg = 21;
    r.fill = 0.62;
    r.shake_angle_deg = 5;
    r.shake_look_at = 0.012;
    r.shake_roll_deg = 2;
    return spec;
}

SyntheticSpec small_orbit(uint64_t seed, int views) {
    SyntheticSpec spec = hand_held_orbit(seed);
    spec.rig.views = views;
    spec.rig.width_px = 480;
    spec.rig.height_px = 360;
    return spec;
}

Views without_cameras(const Views& views, double focal_factor) {
    Views out = views;
    out.posed = false;
    out.sittings = {Sitting{}};
    for (View& v : out.views) {
        v.sitting = "0";
        Intrinsics& k = v.camera.intrinsics;
        k.fx *= focal_factor;
        k.fy *= focal_factor;
        k.cx = 0.5 * k.width_px;
        k.cy = 0.5 * k.height_px;
        v.camera.camera_from_world = {};
    }
    return out;
}

}  // namespace vdbcarve::test
