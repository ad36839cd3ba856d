// SPDX-License-Identifier: Apache-2.0
// Exact Euclidean distance to a silhouette's contour, on integers.
//
// The contour of a soft mask crosses the lattice of pixel centres on edges between two neighbouring
// centres, one with mask >= 1/2 and one below. Crossings on vertical edges have an integer column,
// those on horizontal edges an integer row, so each family goes through one separable exact transform
// (Meijster, Roerdink, Hesselink 2000, with parabolas of integer height) and the smaller of the two
// squared distances is the exact squared distance to the whole set. Coordinates are counted in 1/64 px:
// finer than an 8-bit mask can tell, and squares of a 65536 px image fit into 64 bits.
// Within kRefine_px of the contour the straight pieces between crossings (marching squares) are used too.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

inline constexpr int kSubpixel = 64;      ///< units of a pixel
inline constexpr int kRefine_px = 3;      ///< pieces of contour are measured this far out
inline constexpr int32_t kNoSite = 1 << 28;  ///< "no crossing in this line", in 1/64 px

VDBCARVE_HD bool is_object(uint8_t coverage) { return coverage >= 128; }

/// Where the mask crosses 1/2 between two neighbouring centres of different sides, from the first, in
/// 1/64 px: 1..63, so that no pixel centre lies on the contour and the sign is never in doubt.
VDBCARVE_HD int crossing(uint8_t first, uint8_t second) {
    const int numerator = kSubpixel * (255 - 2 * first);
    const int denominator = 2 * (static_cast<int>(second) - first);
    // Both have the same sign: rounded quotient of magnitudes.
    const int n = numerator < 0 ? -numerator : numerator, d = denominator < 0 ? -denominator : denominator;
    const int t = (2 * n + d) / (2 * d);
    return t < 1 ? 1 : (t > kSubpixel - 1 ? kSubpixel - 1 : t);
}

/// Floor of a quotient of integers below 2^52 in magnitude, denominator positive: the correctly rounded
/// double quotient cannot reach the next integer, so one division replaces a slow 64-bit one.
VDBCARVE_HD int64_t floor_divide(int64_t numerator, int64_t denominator) {
    const auto towards_zero = static_cast<int64_t>(static_cast<double>(numerator) / static_cast<double>(denominator));
    return towards_zero * denominator > numerator ? towards_zero - 1 : towards_zero;
}

/// First column at which the parabola of `right` is strictly lower than that of `left` (left < right), minus one.
VDBCARVE_HD int64_t parabola_switch(int left, int64_t left_height2, int right, int64_t right_height2) {
    const int64_t unit2 = static_cast<int64_t>(kSubpixel) * kSubpixel;
    const int64_t l = left, r = right;
    return floor_divide(unit2 * (r * r - l * l) + right_height2 - left_height2, 2 * unit2 * (r - l));
}

/// Squared distance, in px^2, from a point to a segment; all coordinates in 1/64 px.
VDBCARVE_HD double segment_distance2_px(int px, int py, int ax, int ay, int bx, int by) {
    const double ux = bx - ax, uy = by - ay, wx = px - ax, wy = py - ay;
    const double length2 = ux * ux + uy * uy;
    double t = length2 > 0 ? (ux * wx + uy * wy) / length2 : 0.0;
    t = t < 0 ? 0 : (t > 1 ? 1 : t);
    const double dx = wx - t * ux, dy = wy - t * uy;
    return (dx * dx + dy * dy) * (1.0 / (static_cast<double>(kSubpixel) * kSubpixel));
}

/// The contour's straight pieces in one marching-squares cell, corners in the order (0,0) (1,0) (1,1) (0,1).
/// Points are in 1/64 px from the first corner. Returns 0, 1 or 2 pieces. In the ambiguous cell the two
/// object corners stay apart, which separates the corners by side like every other cell.
struct ContourPieces {
    int count;
    int ax[2], ay[2], bx[2], by[2];
};

VDBCARVE_HD ContourPieces contour_pieces(uint8_t m00, uint8_t m10, uint8_t m11, uint8_t m01) {
    ContourPieces out{};
    const int mask = (is_object(m00) ? 1 : 0) | (is_object(m10) ? 2 : 0) | (is_object(m11) ? 4 : 0) |
                     (is_object(m01) ? 8 : 0);
    if (mask == 0 || mask == 15) return out;
    // Crossing points on the four edges: 0 top, 1 right, 2 bottom, 3 left.
    int x[4] = {0, kSubpixel, 0, 0}, y[4] = {0, 0, kSubpixel, 0};
    const bool has[4] = {((mask ^ (mask >> 1)) & 1) != 0, (((mask >> 1) ^ (mask >> 2)) & 1) != 0,
                         (((mask >> 3) ^ (mask >> 2)) & 1) != 0, ((mask ^ (mask >> 3)) & 1) != 0};
    if (has[0]) x[0] = crossing(m00, m10);
    if (has[1]) y[1] = crossing(m10, m11);
    if (has[2]) x[2] = crossing(m01, m11);
    if (has[3]) y[3] = crossing(m00, m01);
    const auto add = [&](int a, int b) {
        out.ax[out.count] = x[a];
        out.ay[out.count] = y[a];
        out.bx[out.count] = x[b];
        out.by[out.count] = y[b];
        ++out.count;
    };
    if (mask == 5) {  // object at (0,0) and (1,1)
        add(0, 3);
        add(1, 2);
    } else if (mask == 10) {  // object at (1,0) and (0,1)
        add(0, 1);
        add(2, 3);
    } else {
        int first = -1;
        for (int e = 0; e < 4; ++e) {
            if (!has[e]) continue;
            if (first < 0)
                first = e;
            else
                add(first, e);
        }
    }
    return out;
}

}  // namespace vdbcarve::kernel
