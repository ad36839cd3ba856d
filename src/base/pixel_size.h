// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "vdbcarve/geometry.h"

namespace vdbcarve {

/// The side of a pixel on an object at `point` (world), world units: the upper median of the cameras that have it before them, sqrt(fx fy) where pixels are
/// not square. 0: none has.
double pixel_size_at(const std::vector<Camera>& cameras, const Vec3d& point);

}  // namespace vdbcarve
