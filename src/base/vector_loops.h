// SPDX-License-Identifier: Apache-2.0
// The loops that take the time, compiled once for each instruction set and chosen at run time.
//
// All sets run the same operations in the same order, without fused multiply-add: same bits. The environment
// variable VDBCARVE_SIMD (generic, avx2 or avx512) picks a lesser set than the machine has, for tests.
#pragma once

#include <cstdint>
#include <vector>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/distance.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/kernel/stereo.h"

namespace vdbcarve {

inline constexpr int kLeafVoxels = 512;
/// A leaf is asked in 8 cells of 4 x 4 x 4 voxels, cell c = ci << 2 | cj << 1 | ck. Arrays of a leaf's values are in
/// cell order: value of voxel (i, j, k) of a cell at cell * 64 + (i << 4 | j << 2 | k).
inline constexpr int kLeafCells = 8, kCellVoxels = 64;

/// Index in cell order of a voxel given by its index in the leaf (i << 6 | j << 3 | k).
inline int cell_order(int at) {
    const int i = at >> 6, j = (at >> 3) & 7, k = at & 7;
    return (i >> 2 << 2 | j >> 2 << 1 | k >> 2) << 6 | (i & 3) << 4 | (j & 3) << 2 | (k & 3);
}

/// What a view says of a leaf's cells, as bit masks.
struct CellAnswers {
    unsigned out;    ///< at least +band at every voxel
    unsigned mixed;  ///< evaluated; cells in neither mask are at most -band everywhere
    unsigned full;   ///< evaluated, and `values` is now at least +band at every voxel
};

struct WindowDistance {
    const uint8_t* coverage;  ///< first pixel of the window
    int64_t stride;           ///< pixels between rows of the mask
    int width, height;        ///< of the window
    int reach;                ///< distances saturate here; 1/64 px, at most 64 * kMaxReach_px
    int offset;               ///< 1/64 px, taken off every value
    int clamp;                ///< then values are clamped to plus and minus this; 1/64 px
    int16_t* out;             ///< width * height
    int32_t* scratch;         ///< window_scratch(width, height) values
};

inline constexpr int kFilterHalo = 8 + 2 * kernel::kMostFilterWidth, kFilterHaloVoxels = kFilterHalo * kFilterHalo * kFilterHalo;

struct VectorLoops {
    const char* name;
    /// values (cell order) = max(values, kernel::silhouette_value) at all voxels of those cells in `alive` that the view may
    /// matter for. The leaf is clear of the frame's border for that view. `ball_radius` is that of a cell's voxel centres,
    /// world units.
    CellAnswers (*raise_leaf)(const kernel::CarveView& view, const int origin[3], unsigned alive, float ball_radius, float band, float* values);
    /// Signed distance of a window of a mask, kernel/distance.h.
    void (*window_distance)(const WindowDistance& job);
    /// kernel::plane_distance of a leaf's voxels beside the surface, made negative: they are fixed; band_vox for the others.
    /// `halo` is 10 x 10 x 10 raw values, the leaf at 1..8 (edges and corners unused, but initialised).
    void (*measure_leaf)(const float* halo, float band_vox, float* out);
    /// One pass of kernel::eikonal over a leaf, from a halo of such distances. 0 when nothing changed.
    int (*redistance_leaf)(const float* halo, float band_vox, float* out);
    /// A Gaussian along all three axes: `halo` is 16^3 values, the leaf at 4..11, weight[n] that of values n away.
    void (*blur_leaf)(const float* halo, const float weight[5], float* out);
    /// kernel::straightened of a leaf, from a halo of 10 x 10 x 10 values; `hull` and `out` are the leaf's.
    void (*straighten_leaf)(const float* halo, const float* hull, float* out);
    /// One pass of a filter over a leaf (kernel/filter.h). `halo` is kFilterHalo^3 values, the leaf from kMostFilterWidth on; what the pass
    /// does not reach may be anything.
    void (*filter_leaf)(const kernel::FilterPass& pass, const float* halo, float band_vox, float* out);
    /// kernel::first_plane of a row of pixels; kernel::better_plane of every second one, those where x + y is even (color 0) or odd; kernel::likelihood.
    void (*first_planes)(const kernel::StereoReference& reference, int y, kernel::StereoBest* planes);
    void (*better_planes)(const kernel::StereoReference& reference, int y, int pass, int color, kernel::StereoBest* planes);
    void (*likelihoods)(const kernel::StereoReference& reference, const kernel::StereoTrustRule& rule, int y, const kernel::StereoBest* planes, float* out);
};

inline size_t window_scratch(int width, int height) {
    return static_cast<size_t>(width + 144) * static_cast<size_t>(height + 8) * 4 + 2 * kernel::kMaxReach_px + 128;
}

/// The widest set that the machine has, or what VDBCARVE_SIMD asks for.
const VectorLoops& vector_loops();
/// All sets that this machine can run, least first.
std::vector<const VectorLoops*> all_vector_loops();

}  // namespace vdbcarve
