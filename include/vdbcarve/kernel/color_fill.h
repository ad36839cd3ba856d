// SPDX-License-Identifier: Apache-2.0
// Colour for the surface's voxels that no view sees: harmonic between those that have one.
//
// The contour's voxels and their neighbours among each other (faces, edges, corners) are a graph; on it the missing colours are to be the
// mean of their neighbours', the others staying what they are. Relaxation carries a colour one voxel a sweep, so it starts coarse: cells of
// 2, 4, 8 … voxels, known where one of their children is, until all are known; then from coarse to fine, every cell starting from its
// parent's colour and a fixed number of sweeps on each level (a cascadic multigrid, Bornemann and Deuflhard 1996).
#pragma once

#include "vdbcarve/kernel/color.h"

namespace vdbcarve::kernel {

inline constexpr int kMortonBits = 21, kMortonBias = 1 << (kMortonBits - 1);

VDBCARVE_HD uint64_t spread_bits(uint32_t v) {
    uint64_t x = v & 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffull;
    x = (x | x << 16) & 0x1f0000ff0000ffull;
    x = (x | x << 8) & 0x100f00f00f00f00full;
    x = (x | x << 4) & 0x10c30c30c30c30c3ull;
    return (x | x << 2) & 0x1249249249249249ull;
}

VDBCARVE_HD uint32_t gather_bits(uint64_t x) {
    x &= 0x1249249249249249ull;
    x = (x | x >> 2) & 0x10c30c30c30c30c3ull;
    x = (x | x >> 4) & 0x100f00f00f00f00full;
    x = (x | x >> 8) & 0x1f0000ff0000ffull;
    x = (x | x >> 16) & 0x1f00000000ffffull;
    return static_cast<uint32_t>(x | x >> 32) & 0x1fffff;
}

/// A cell's place along a Z-order curve (Morton 1966): the parent's is the same >> 3, so sorted cells have sorted parents.
VDBCARVE_HD uint64_t morton_key(uint32_t x, uint32_t y, uint32_t z) { return spread_bits(x) << 2 | spread_bits(y) << 1 | spread_bits(z); }
/// Of a voxel; coordinates within +-2^20.
VDBCARVE_HD uint64_t morton_of_voxel(int i, int j, int k) {
    return morton_key(static_cast<uint32_t>(i + kMortonBias), static_cast<uint32_t>(j + kMortonBias), static_cast<uint32_t>(k + kMortonBias));
}

/// Where a key stands among sorted ones, or -1; near the place `hint` first, where neighbours in space mostly are.
VDBCARVE_HD int32_t find_key(const uint64_t* keys, int32_t count, uint64_t key, int32_t hint) {
    constexpr int32_t kNear = 48;
    int32_t low = hint - kNear < 0 ? 0 : hint - kNear, high = hint + kNear > count ? count : hint + kNear;
    if (key < keys[low]) {
        high = low;
        low = 0;
    } else if (key > keys[high - 1]) {
        low = high;
        high = count;
    }
    while (low < high) {
        const int32_t middle = low + (high - low) / 2;
        if (keys[middle] < key) low = middle + 1;
        else high = middle;
    }
    return low < count && keys[low] == key ? low : -1;
}

inline constexpr int kFillNeighbours = 26;
inline constexpr int kFillSweeps = 24;  ///< on every level
inline constexpr float kFillDamping = 0.85f;

/// The n-th neighbouring cell's number, or -1.
VDBCARVE_HD int32_t fill_neighbour(const uint64_t* keys, int32_t count, int32_t cell, int n) {
    const uint64_t key = keys[cell];
    const int at = n < 13 ? n : n + 1;  // 13 is the cell itself
    const int64_t x = static_cast<int64_t>(gather_bits(key >> 2)) + at / 9 - 1, y = static_cast<int64_t>(gather_bits(key >> 1)) + at / 3 % 3 - 1,
                  z = static_cast<int64_t>(gather_bits(key)) + at % 3 - 1;
    if (x < 0 || y < 0 || z < 0) return -1;
    return find_key(keys, count, morton_key(static_cast<uint32_t>(x), static_cast<uint32_t>(y), static_cast<uint32_t>(z)), cell);
}

/// 1 / squared distance to the n-th neighbour.
VDBCARVE_HD float fill_weight(int n) {
    const int at = n < 13 ? n : n + 1;
    const int faces = (at / 9 != 1) + (at / 3 % 3 != 1) + (at % 3 != 1);
    return faces == 1 ? 1.f : (faces == 2 ? 0.5f : 1.f / 3);
}

/// A parent's colour from its children first <= c < last: the mean of the known ones. False where none is.
VDBCARVE_HD bool parent_color(const Rgb* colors, const uint8_t* known, int32_t first, int32_t last, Rgb& out) {
    RgbMean mean;
    for (int32_t c = first; c < last; ++c)
        if (known[c]) mean.add(colors[c], 1.f);
    if (!(mean.weight > 0.f)) return false;
    out = mean.value();
    return true;
}

/// One sweep's new colour of a cell, from its neighbours in order.
class Relaxation {
  public:
    VDBCARVE_HD explicit Relaxation(const Rgb& own) : own_(own) {}
    /// The n-th neighbour, as of fill_neighbour.
    VDBCARVE_HD void add(const Rgb& color, int n) {
        const float w = fill_weight(n);
        sum_ = plus(sum_, w, minus(color, own_));
        weight_ += w;
    }
    VDBCARVE_HD Rgb value() const { return weight_ > 0.f ? plus(own_, kFillDamping / weight_, sum_) : own_; }

  private:
    Rgb own_, sum_{0.f, 0.f, 0.f};
    float weight_ = 0.f;
};

}  // namespace vdbcarve::kernel
