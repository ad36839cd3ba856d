// SPDX-License-Identifier: Apache-2.0
// Where the cameras of a synthetic scene stand, and how a hand holds them.
#pragma once

#include <array>
#include <numbers>
#include <vector>

#include "vdbcarve/synthetic.h"

namespace vdbcarve::synth {

constexpr double kPi = std::numbers::pi;

constexpr double rad(double deg) { return deg * kPi / 180; }

Camera look_at(const Vec3d& centre, const Vec3d& target, double roll_rad, const Intrinsics& k);

struct Direction {
    double azimuth_rad, elevation_rad;
};

std::vector<Direction> directions(const Rig& rig);

/// How a hand is off, -1..1: azimuth, elevation, place and aim along x, y, z, roll.
using Hand = std::array<double, 9>;

/// New for every photograph; of a video, new four times a second and smooth between.
std::vector<Hand> hands_of(size_t views, double film_rate_hz, uint64_t seed);

}  // namespace vdbcarve::synth
