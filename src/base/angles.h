// SPDX-License-Identifier: Apache-2.0
// Angles, and where cameras stand around an axis.
#pragma once

#include <numbers>
#include <vector>

#include "vdbcarve/geometry.h"

namespace vdbcarve {

inline constexpr double kRadians = std::numbers::pi / 180;  ///< to a degree

/// Where cameras stand around an axis through `middle`, rad, counterclockwise seen from the axis' end; 0: at x, or at y around x.
std::vector<double> azimuths_rad(const std::vector<Camera>& cameras, const Vec3d& middle, const Vec3d& axis);

/// How far such cameras went around, in the order given, rad, every step the shorter way.
double turned_rad(const std::vector<double>& azimuths_rad);

}  // namespace vdbcarve
