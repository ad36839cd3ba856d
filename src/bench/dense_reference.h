// SPDX-License-Identifier: Apache-2.0
// The dense method of the paper, for the benchmark.
#pragma once

#include <cstdint>

namespace vdbcarve {

inline constexpr int kMaxDenseViews = 256;

/// Byte masks (0 background), all of one size, and 3x4 matrices from index coordinates to homogeneous pixels.
struct DenseViews {
    int count, width, height;
    const uint8_t* const* masks;
    const float (*pixel_from_index)[12];
};

struct DenseGrid {
    int i0, j0, k0;  ///< index of the first voxel
    int ni, nj, nk;
};

/// Fills rows j_first <= j < j_last of slice i (0..ni-1) of a volume of ni x nj x nk bytes: 1 where every view shows object.
using DenseRows = void (*)(const DenseViews& views, const DenseGrid& grid, int i, int j_first, int j_last, uint8_t* volume);

}  // namespace vdbcarve
