// SPDX-License-Identifier: Apache-2.0
// How the fair surface moves, one voxel at a time (src/fair/fair.md says what it is). Distances are in voxels, negative inside.
#pragma once

#include <cmath>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

inline constexpr float kFairBand_vox = 3.f;
/// Voxels on either side that a step of motion looks at.
inline constexpr int kFairReach = 4;

/// The field over its slope, so that it stays nearly a distance, kept to the band and above the hull.
template <class At>
VDBCARVE_HD float straightened(const At& at, float hull) {
    const float gx = 0.5f * (at(1, 0, 0) - at(-1, 0, 0)), gy = 0.5f * (at(0, 1, 0) - at(0, -1, 0)), gz = 0.5f * (at(0, 0, 1) - at(0, 0, -1));
    const float slope = std::sqrt((gx * gx + gy * gy) + gz * gz);
    return max_f(clamp_f(at(0, 0, 0) / max_f(slope, 0.3f), -kFairBand_vox, kFairBand_vox), hull);
}

}  // namespace vdbcarve::kernel
