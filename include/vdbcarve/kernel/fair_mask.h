// SPDX-License-Identifier: Apache-2.0
// Which samples of a view the fair surface asks, and how (docs/stages/fair.md).
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/fair.h"
#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

/// Side of the squares of samples that are asked at once.
inline constexpr int kFairSquare = 4;
/// Fourths of the lines, by where a sample lies in its square of 2 x 2.
inline constexpr int kFairShares = 4;

/// A view's distances to its contour over a window of the picture, and those to what it leaves out; borrowed.
struct FairMask {
    const int16_t* samples;  ///< null: the view has no mask
    const int16_t* ignored;  ///< null: nothing is left out
    int x0, y0, width, height;
    int ignored_x0, ignored_y0, ignored_width, ignored_height;

    /// Negative inside.
    VDBCARVE_HD float inside(int i, int j) const { return static_cast<float>(samples[static_cast<int64_t>(j) * width + i]) / kFieldUnits; }
    VDBCARVE_HD bool says_nothing(int i, int j) const {
        if (!ignored) return false;
        int x = x0 + i - ignored_x0, y = y0 + j - ignored_y0;
        x = x < 0 ? 0 : x >= ignored_width ? ignored_width - 1 : x;
        y = y < 0 ? 0 : y >= ignored_height ? ignored_height - 1 : y;
        return static_cast<float>(ignored[static_cast<int64_t>(y) * ignored_width + x]) / kFieldUnits > -0.5f;
    }
    /// Whether a sample must be covered.
    VDBCARVE_HD bool counts(int i, int j) const { return inside(i, j) <= kFairMust_samples && !says_nothing(i, j); }
    /// Whether a sample is one of the contour's, whose line must keep it.
    VDBCARVE_HD bool is_rim(int i, int j) const { return std::fabs(inside(i, j)) < 1.f && !says_nothing(i, j); }
    /// Whether some sample of a square lies deeper inside.
    VDBCARVE_HD bool asks(int i0, int j0, int side) const {
        for (int j = j0; j < j0 + side && j < height; ++j)
            for (int i = i0; i < i0 + side && i < width; ++i)
                if (inside(i, j) <= -1.f && !says_nothing(i, j)) return true;
        return false;
    }
};

/// Which fourth of the lines a sample's belongs to; 0 and 1 are the colours of a chessboard of which 2 and 3 are the other.
VDBCARVE_HD int share_of(int i, int j) { return ((i + j) & 1) << 1 | (i & 1); }

/// How lines are asked.
struct FairAsk {
    float safe_vox;  ///< so deep a line need not be asked again soon
    int all;         ///< every line, not every second
    int exact;       ///< samples are pixels, and count

    VDBCARVE_HD bool rim(int i, int j) const { return exact || share_of(i, j) < 2; }
    VDBCARVE_HD bool near(int i, int j) const { return (all && exact) || share_of(i, j) < (exact ? 1 : 2); }
};

/// The line of a sample of the rim; false: it asks nothing.
VDBCARVE_HD bool rim_line_of(const FairMask& m, const FairEye& e, const FairField& hull, const FairAsk& ask, int i, int j, FairLine& line) {
    return ask.rim(i, j) && m.is_rim(i, j) && rim_line(e, hull, m.x0 + i, m.y0 + j, m.inside(i, j), line);
}

/// Whether a square must be looked into: not where nothing is asked, nor where the field is so deep that all of it is covered. `there`: is_deep().
VDBCARVE_HD bool opens_square(const FairMask& m, const FairEye& e, const FairField& f, int i0, int j0, int side, int& there) {
    return m.asks(i0, j0, side) && (side == 1 || !covers_square(e, f, m.x0 + i0, m.y0 + j0, side, there));
}

/// The line of a sample that opens_square(); false: it is deep enough.
VDBCARVE_HD bool near_line_of(const FairMask& m, const FairEye& e, const FairField& f, const FairAsk& ask, int i, int j, int& there, FairLine& line) {
    if (!ask.near(i, j)) return false;
    const int x = m.x0 + i, y = m.y0 + j;
    // Where all are asked most are deep enough, and where is known from the one before.
    if (ask.all && line_of_sight(e, f, x + 0.5, y + 0.5, line.ray) && is_deep(f, line.ray, min_f(ask.safe_vox, -line.ray.sample_vox), there)) return false;
    return near_line(e, f, x, y, ask.safe_vox, line);
}

}  // namespace vdbcarve::kernel
