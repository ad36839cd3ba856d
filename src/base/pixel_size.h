// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "vdbcarve/geometry.h"

namespace vdbcarve {

/// How much of an object at `point` (world) a pixel covers, world units: the median of the cameras that have it before them. 0: none has.
double pixel_size_at(const std::vector<Camera>& cameras, const Vec3d& point);

}  // namespace vdbcarve
