// SPDX-License-Identifier: Apache-2.0
// How the fair surface moves, one voxel at a time (docs/stages/fair.md says what it is). Distances are in voxels, negative inside.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/level_set.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

inline constexpr float kFairBand_vox = 3.f;
/// Voxels on either side that a step of motion looks at.
inline constexpr int kFairReach = 4;

/// Of a Gaussian, by distance.
struct FairBlur {
    float weight[kFairReach + 1];
};
/// A Gaussian along one axis; at(n): the value n voxels on.
template <class At>
VDBCARVE_HD float blurred(const float weight[kFairReach + 1], const At& at) {
    return (((weight[0] * at(0) + weight[1] * (at(-1) + at(1))) + weight[2] * (at(-2) + at(2))) + weight[3] * (at(-3) + at(3))) + weight[4] * (at(-4) + at(4));
}
/// What a blur took away put back: `twice` is the blurred value, blurred again.
VDBCARVE_HD float put_back(float once, float twice) { return once + (once - twice); }

/// The field over its slope, so that it stays nearly a distance, kept to the band and above the hull.
template <class At>
VDBCARVE_HD float straightened(const At& at, float hull) {
    const float gx = 0.5f * (at(1, 0, 0) - at(-1, 0, 0)), gy = 0.5f * (at(0, 1, 0) - at(0, -1, 0)), gz = 0.5f * (at(0, 0, 1) - at(0, 0, -1));
    const float slope = std::sqrt((gx * gx + gy * gy) + gz * gz);
    return max_f(clamp_f(at(0, 0, 0) / max_f(slope, 0.3f), -kFairBand_vox, kFairBand_vox), hull);
}

/// Between contours the hull stands out of a round object by as much as a surface that is stretched between them lies too deep. The nearer the two are, the
/// more of the way the surface goes back to the hull, whose ridges go when it is smoothed next; where they are `far` or more apart nothing is round, and it
/// stays.
VDBCARVE_HD float eased(float value, float hull, float far) {
    const float known = clamp_f(hull + kFairBand_vox, 0.f, 1.f);  // how deep the hull is beyond its band is not
    const float apart = value - hull, part = apart / far, rest = 1.f - part * part;
    return rest > 0.f ? value - known * (rest * rest) * apart : value;
}

/// The mean of 2^3 voxels, given their sum, in voxels twice as wide.
VDBCARVE_HD float coarser_hull(float sum) { return sum == 0.f ? kLeastDistance : sum * (1.f / 16); }

/// The share of a voxel that lies inside in 2^-25, in which it is a whole number: sums of any order are equal.
inline constexpr double kFairVolumeUnits = 1 << 25;
VDBCARVE_HD uint64_t fair_volume_units(float v) { return static_cast<uint64_t>(clamp_f(0.5f - v, 0.f, 1.f) * static_cast<float>(1 << 25)); }

/// A value of the finished level set, still in voxels.
VDBCARVE_HD float off_zero(float v) { return std::fabs(v) < kLeastDistance ? -kLeastDistance : v; }

}  // namespace vdbcarve::kernel
