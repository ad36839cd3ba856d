// SPDX-License-Identifier: Apache-2.0
// Photographs of a synthetic object: light, room, table, lamps and sensor.
#pragma once

#include <algorithm>
#include <cmath>

#include "synthetic/object.h"
#include "synthetic/rig.h"

namespace vdbcarve::synth {

/// Where light and room stand: their frame is the camera's for a turntable, the object's otherwise.
struct Room {
    Mat3d room_from_scene;
    Vec3d up_scene;  ///< the table's normal

    Vec3d key() const { return room_from_scene.transpose() * Vec3d(0.5, -0.6, 0.9).normalized(); }
    Vec3d fill() const { return room_from_scene.transpose() * Vec3d(-0.8, 0.3, 0.2).normalized(); }
    /// Light that a matt white surface sends back.
    double diffuse(const Vec3d& normal, const PhotoLook& look) const {
        if (look.flat) return 1;
        return 0.22 + 0.75 * std::max(0.0, normal.dot(key())) + 0.25 * std::max(0.0, normal.dot(fill()));
    }
};

Room room_of(const Rig& rig, double azimuth_rad, const Mat3d& side_from_scene);

/// How the lamps of one photograph differ from what they are meant to be.
struct Lamps {
    Vec3d gain = Vec3d::Ones();
    double across = 0;  ///< more light at the right border than in the middle, as a share; as much less at the left one

    /// Of photograph i of n.
    static Lamps wandering(double drift, size_t i, size_t n, double exposure) {
        Lamps out;
        const double passed = 2 * kPi * static_cast<double>(i) / static_cast<double>(n);
        for (int c = 0; c < 3; ++c) out.gain[c] = exposure * (1 + drift * std::sin(1.3 * passed + 0.4 * c + 0.5));
        out.across = 0.5 * drift * std::sin(0.7 * passed + 2);
        return out;
    }
};

/// Without `surface` a clean plate: the object and its shadow are not there.
Image8 photograph(const Object& object, const Camera& camera, const Image8& coverage, const Object::Surface* surface, const PhotoLook& look, const Room& place,
                  const Lamps& lamps);

void add_sensor_noise(Image8& photo, double sigma, uint64_t seed);

}  // namespace vdbcarve::synth
