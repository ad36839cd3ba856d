// SPDX-License-Identifier: Apache-2.0
// Re-distancing a narrow band, one voxel at a time: magnitudes in voxels, signs kept apart.
//
// Voxels next to the surface take their distance from where the field crosses zero on the edges to their
// neighbours and are frozen; the others solve |grad phi| = 1 by first-order upwind differences (Rouy and
// Tourin 1992; the quadratic of Sethian's fast marching), all at once, pass after pass. A pass carries the
// solution one voxel on, so a fixed number of passes serves the band, in any order and on any device.
#pragma once

#include <cmath>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

/// No crossing in that direction.
inline constexpr float kNoCrossing = 1e9f;
/// No voxel is nearer to the surface than this, in voxels: a value of zero would make faces without area.
inline constexpr float kLeastDistance = 1e-6f;

/// Distance, in voxels, along an edge from a voxel with value `here` to the zero crossing before its neighbour;
/// kNoCrossing where both are on one side.
VDBCARVE_HD float crossing_distance(float here, float neighbour) {
    // One is negative, so the sum is positive (a denormal at least).
    const float a = std::fabs(here), b = std::fabs(neighbour);
    const float along = a / (a + b);
    return (here < 0.f) == (neighbour < 0.f) ? kNoCrossing : along;
}

/// Distance to the plane that crosses the three axes at these distances (the nearer of both directions each;
/// kNoCrossing: it does not). kNoCrossing when it crosses none.
VDBCARVE_HD float plane_distance(float dx, float dy, float dz) {
    dx = dx < kLeastDistance ? kLeastDistance : dx;
    dy = dy < kLeastDistance ? kLeastDistance : dy;
    dz = dz < kLeastDistance ? kLeastDistance : dz;
    const float nearest = dx < dy ? (dx < dz ? dx : dz) : (dy < dz ? dy : dz);
    const float d = 1.f / std::sqrt(1.f / (dx * dx) + 1.f / (dy * dy) + 1.f / (dz * dz));
    const float kept = d < kLeastDistance ? kLeastDistance : d;
    return nearest < kNoCrossing ? kept : kNoCrossing;
}

/// The upwind solution of |grad phi| = 1 (phi >= 0, spacing 1) from the smaller neighbour on each axis.
VDBCARVE_HD float eikonal(float x, float y, float z) {
    // Sorted: a <= b <= c.
    const float low = x < y ? x : y, high = x < y ? y : x;
    const float a = low < z ? low : z, mid = low < z ? z : low;
    const float b = mid < high ? mid : high, c = mid < high ? high : mid;
    const float one = a + 1.f;
    const float ab = a - b, root2 = 2.f - ab * ab;
    const float two = 0.5f * ((a + b) + std::sqrt(root2 > 0.f ? root2 : 0.f));
    const float sum = (a + b) + c;
    // (a+b+c)^2 - 3 (a^2 + b^2 + c^2 - 1), from differences so that large values cancel early.
    const float ac = a - c, bc = b - c;
    const float root3 = 3.f - (ab * ab + ac * ac + bc * bc);
    const float three = (sum + std::sqrt(root3 > 0.f ? root3 : 0.f)) * (1.f / 3.f);
    const float up_to_two = one <= b ? one : two;
    return up_to_two <= c ? up_to_two : three;
}

}  // namespace vdbcarve::kernel
