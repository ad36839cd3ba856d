// SPDX-License-Identifier: Apache-2.0
// Re-distancing a narrow band, one voxel at a time: magnitudes in voxels, signs kept apart.
//
// Voxels next to the surface take their distance from where the field crosses zero on the edges to their
// neighbours, as to a plane, and are frozen; the others solve |grad phi| = 1 by first-order upwind differences (Rouy and
// Tourin 1992; the quadratic of Sethian's fast marching), all at once, pass after pass. A pass carries the
// solution one voxel on, so a fixed number of passes serves the band, in any order and on any device.
#pragma once

#include <cmath>

#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

/// No voxel is nearer to the surface than this, in voxels: a value of zero would make faces without area.
inline constexpr float kLeastDistance = 1e-6f;

/// The larger magnitude of those neighbours on one axis that are on the other side of the surface; -1 when none is.
VDBCARVE_HD float opposite(float here, float before, float after) {
    const bool inside = here < 0.f;
    const float a = (before < 0.f) != inside ? std::fabs(before) : -1.f;
    const float b = (after < 0.f) != inside ? std::fabs(after) : -1.f;
    return max_f(a, b);
}

/// How much the field changes over one voxel along an axis: across the surface where a neighbour is there (`across`, see
/// opposite), otherwise by central difference, at most |here|, since the surface is more than a voxel away.
VDBCARVE_HD float slope(float here, float before, float after, float across) {
    const float size = std::fabs(here), central = 0.5f * std::fabs(after - before);
    const float quiet = min_f(size, central);
    return across < 0.f ? quiet : size + across;
}

/// Distance, in voxels, of a voxel with value `here` beside the surface to the plane that its slopes (per voxel) describe.
VDBCARVE_HD float plane_distance(float here, float slope_x, float slope_y, float slope_z) {
    const float d = std::fabs(here) / std::sqrt(slope_x * slope_x + slope_y * slope_y + slope_z * slope_z);
    return max_f(d, kLeastDistance);
}

/// The upwind solution of |grad phi| = 1 (phi >= 0, spacing 1) from the smaller neighbour on each axis.
VDBCARVE_HD float eikonal(float x, float y, float z) {
    // Sorted: a <= b <= c.
    const float low = min_f(x, y), high = max_f(x, y);
    const float a = min_f(low, z), mid = max_f(low, z);
    const float b = min_f(mid, high), c = max_f(mid, high);
    const float one = a + 1.f;
    const float ab = a - b, root2 = 2.f - ab * ab;
    const float two = 0.5f * ((a + b) + std::sqrt(max_f(root2, 0.f)));
    const float sum = (a + b) + c;
    // (a+b+c)^2 - 3 (a^2 + b^2 + c^2 - 1), from differences so that large values cancel early.
    const float ac = a - c, bc = b - c;
    const float root3 = 3.f - (ab * ab + ac * ac + bc * bc);
    const float three = (sum + std::sqrt(max_f(root3, 0.f))) * (1.f / 3.f);
    const float up_to_two = one <= b ? one : two;
    return up_to_two <= c ? up_to_two : three;
}

struct BandVoxel {
    float distance_vox;  ///< signed; at least the half-width where not active
    bool active;
};

/// A voxel of the band from its solved magnitude and its side, the surface moved outwards by `offset_vox`.
VDBCARVE_HD BandVoxel band_voxel(float magnitude_vox, bool inside, float offset_vox, float half_width_vox) {
    float d = inside ? -magnitude_vox : magnitude_vox;
    if (offset_vox != 0.f) {
        d -= offset_vox;
        if (std::fabs(d) < kLeastDistance) d = -kLeastDistance;
    }
    return {d, std::fabs(d) < half_width_vox};
}

/// A pass reaches one voxel on; along a space diagonal a distance of w takes sqrt(3) w steps.
VDBCARVE_HD int level_set_passes(int half_width_vox) { return static_cast<int>(std::ceil(std::sqrt(3.0) * half_width_vox)) + 1; }

}  // namespace vdbcarve::kernel
