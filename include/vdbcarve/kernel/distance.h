// SPDX-License-Identifier: Apache-2.0
// Exact Euclidean distance to a silhouette's contour, up to a reach, on integers.
//
// The contour of a soft mask crosses the lattice of pixel centres on edges between two neighbouring
// centres, one with mask >= 1/2 and one below. Crossings on vertical edges have an integer column,
// those on horizontal edges an integer row, so each family splits into a distance along its line and a
// minimum across lines, and the smaller of the two squared distances is the exact squared distance to the
// whole set. Coordinates are counted in 1/64 px: finer than an 8-bit mask can tell, and squares within
// kMaxReach_px fit into 32 bits.
// Within kRefine_px of the contour the straight pieces between crossings (marching squares) are used too.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

inline constexpr int kSubpixel = 64;  ///< units of a pixel
inline constexpr int kRefine_px = 3;  ///< pieces of contour are measured this far out
/// Distances saturate here at the latest: the sum of two squares in 1/64 px stays below 2^31, a value fits int16.
inline constexpr int kMaxReach_px = 500;

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

/// A straight piece of contour, in 1/64 px, ready to be measured from many places.
struct Segment {
    float ax, ay, ux, uy, inverse_length2;
};

VDBCARVE_HD Segment make_segment(int ax, int ay, int bx, int by) {
    const float ux = static_cast<float>(bx - ax), uy = static_cast<float>(by - ay);
    const float length2 = ux * ux + uy * uy;
    return {static_cast<float>(ax), static_cast<float>(ay), ux, uy, length2 > 0.f ? 1.f / length2 : 0.f};
}

/// Squared distance, rounded, from a point to a segment; all coordinates in 1/64 px. Never below 1: the contour
/// passes no pixel centre.
VDBCARVE_HD int32_t segment_distance2(const Segment& s, float px, float py) {
    const float wx = px - s.ax, wy = py - s.ay;
    float t = (s.ux * wx + s.uy * wy) * s.inverse_length2;
    t = t < 0.f ? 0.f : t;
    t = t > 1.f ? 1.f : t;
    const float dx = wx - t * s.ux, dy = wy - t * s.uy;
    const int32_t d2 = static_cast<int32_t>(dx * dx + dy * dy + 0.5f);
    return d2 < 1 ? 1 : d2;
}

/// Rounded root of a squared distance, both in units of 1/64 px.
VDBCARVE_HD int32_t root_of(int32_t distance2) { return static_cast<int32_t>(std::sqrt(static_cast<float>(distance2)) + 0.5f); }

/// The contour's straight pieces in one marching-squares cell, corners in the order (0,0) (1,0) (1,1) (0,1).
/// Points are in 1/64 px from the first corner. Returns 0, 1 or 2 pieces. In the ambiguous cell the two
/// object corners stay apart, which separates the corners by side like every other cell.
struct ContourPieces {
    int count;
    int ax[2], ay[2], bx[2], by[2];
};

VDBCARVE_HD ContourPieces contour_pieces(uint8_t m00, uint8_t m10, uint8_t m11, uint8_t m01) {
    ContourPieces out{};
    const int mask = (is_object(m00) ? 1 : 0) | (is_object(m10) ? 2 : 0) | (is_object(m11) ? 4 : 0) | (is_object(m01) ? 8 : 0);
    if (mask == 0 || mask == 15) return out;
    // Crossing points on the four edges: 0 top, 1 right, 2 bottom, 3 left.
    int x[4] = {0, kSubpixel, 0, 0}, y[4] = {0, 0, kSubpixel, 0};
    const bool has[4] = {((mask ^ (mask >> 1)) & 1) != 0, (((mask >> 1) ^ (mask >> 2)) & 1) != 0, (((mask >> 3) ^ (mask >> 2)) & 1) != 0,
                         ((mask ^ (mask >> 3)) & 1) != 0};
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
            if (first < 0) first = e;
            else add(first, e);
        }
    }
    return out;
}

/// FieldView::blocks of a block that is `distance_px` away from the nearest block of the other side: the contour is at most a pixel
/// from a centre on either side of it, and the offset moves it towards the background.
VDBCARVE_HD int block_bound(int distance_px, bool inside, double offset_px) {
    const double away = std::floor((inside ? distance_px + offset_px : distance_px - offset_px) - 1);
    const int bound = static_cast<int>(away < 0.0 ? 0.0 : (away > 32000.0 ? 32000.0 : away));
    return inside ? -bound : bound;
}

}  // namespace vdbcarve::kernel
