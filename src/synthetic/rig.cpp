// SPDX-License-Identifier: Apache-2.0
#include "synthetic/rig.h"

#include <algorithm>
#include <cmath>

#include "synthetic/noise.h"

namespace vdbcarve::synth {

Camera look_at(const Vec3d& centre, const Vec3d& target, double roll_rad, const Intrinsics& k) {
    const Vec3d z = (target - centre).normalized();
    Vec3d up = Vec3d::UnitZ();
    if (std::abs(z.dot(up)) > 0.999) up = Vec3d::UnitY();
    const Vec3d x0 = z.cross(up).normalized(), y0 = z.cross(x0);
    const double c = std::cos(roll_rad), s = std::sin(roll_rad);
    Camera camera;
    camera.intrinsics = k;
    camera.camera_from_world.rotation.row(0) = (c * x0 + s * y0).transpose();
    camera.camera_from_world.rotation.row(1) = (-s * x0 + c * y0).transpose();
    camera.camera_from_world.rotation.row(2) = z.transpose();
    camera.camera_from_world.translation = -(camera.camera_from_world.rotation * centre);
    return camera;
}

std::vector<Direction> directions(const Rig& rig) {
    std::vector<Direction> out;
    const auto ring = [&](int views, double elevation_deg, double phase, double arc_deg) {
        for (int i = 0; i < views; ++i) {
            // Angular speed 1 + v cos: its integral keeps the ends of a turn where they were.
            const double turn = (i + phase) / views;
            const double at = turn + rig.speed_variation * std::sin(2 * kPi * turn) / (2 * kPi);
            out.push_back({rad(rig.start_deg) + rad(arc_deg) * at, rad(elevation_deg)});
        }
    };
    switch (rig.kind) {
        case Rig::Kind::Orbit:
            ring(rig.views, rig.elevation_deg, 0, rig.arc_deg);
            break;
        case Rig::Kind::Rings:
            for (size_t r = 0; r < rig.rings.size(); ++r) ring(rig.rings[r].views, rig.rings[r].elevation_deg, r % 2 ? 0.5 : 0, rig.arc_deg);
            break;
        case Rig::Kind::Dome:
            // Fibonacci points on the upper half sphere, spread evenly by area.
            for (int i = 0; i < rig.views; ++i) out.push_back({rad(rig.start_deg) + i * kPi * (3 - std::sqrt(5.0)), std::asin((i + 0.5) / rig.views * 0.97)});
            break;
    }
    return out;
}

std::vector<Hand> hands_of(size_t views, double film_rate_hz, uint64_t seed) {
    constexpr double kTremor_hz = 4;
    const double frames = film_rate_hz > 0 ? std::max(1.0, film_rate_hz / kTremor_hz) : 1;
    Dice dice(seed);
    std::vector<Hand> knots(static_cast<size_t>(static_cast<double>(views) / frames) + 2), out;
    for (Hand& h : knots)
        for (double& x : h) x = dice();
    for (size_t i = 0; i < views; ++i) {
        const double at = static_cast<double>(i) / frames;
        const auto before = static_cast<size_t>(at);
        const double share = 0.5 - 0.5 * std::cos(kPi * (at - static_cast<double>(before)));
        out.push_back({});
        for (size_t x = 0; x < 9; ++x) out.back()[x] = (1 - share) * knots[before][x] + share * knots[before + 1][x];
    }
    return out;
}

}  // namespace vdbcarve::synth
