// SPDX-License-Identifier: Apache-2.0
// Filters of a level set's band, one voxel at a time, from the values around it. All distances are in voxels, negative inside.
//
// T is float, or on the CPU a vector of neighbouring voxels; `at(i, j, k)` reads the value so many voxels away.
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

/// No filter looks farther than this, in voxels.
inline constexpr int kMostFilterWidth = 4;

/// One pass over the band: reads one set of values, writes another. Longer filters are several passes.
struct FilterPass {
    enum Kind : int { Median, MeanCurvature, MeanOfSix, Box, Least, EdgePreserving } kind;
    int width;  ///< voxels; of MeanCurvature and MeanOfSix 1
    int axis;   ///< of Box and Least, which go along one
};

/// A value of the level set in voxels. What lies at the band's end, or beyond, is exactly there: a quotient may be a digit short.
VDBCARVE_HD float in_voxels(float value, float voxel, float band, float band_vox) {
    return value >= band ? band_vox : value <= -band ? -band_vox : value / voxel;
}

/// What stands in for a leaf that is not there.
inline constexpr int32_t kOutsideTile = -1, kInsideTile = -2;

/// A voxel at a leaf's border beside a tile stays on the tile's side, however far a filter wants to move the surface: beyond, nothing could follow.
VDBCARVE_HD float beside_tile(float value, int32_t tile) {
    const bool inside = tile == kInsideTile;
    if (tile >= 0 || (value < 0.f) == inside) return value;
    return inside ? -1e-6f : 1e-6f;
}
/// Which of a leaf's surroundings, 0..26, lies beyond each face: -x +x -y +y -z +z.
VDBCARVE_HD int beyond_face(int face) {
    const int step = face % 2 ? 1 : -1;
    return 13 + step * (face / 2 == 0 ? 9 : face / 2 == 1 ? 3 : 1);
}

/// How far a pass looks along an axis, voxels.
VDBCARVE_HD int pass_reach(const FilterPass& pass, int axis) {
    if (pass.kind == FilterPass::Box || pass.kind == FilterPass::Least) return axis == pass.axis ? pass.width : 0;
    return pass.kind == FilterPass::EdgePreserving ? pass.width + 1 : pass.width;
}

template <class T>
VDBCARVE_HD T lesser(T a, T b) {
    if constexpr (std::is_same_v<T, float>) return min_f(a, b);
    else return b < a ? b : a;
}
template <class T>
VDBCARVE_HD T greater(T a, T b) {
    if constexpr (std::is_same_v<T, float>) return max_f(a, b);
    else return a < b ? b : a;
}
template <class T>
VDBCARVE_HD T root(T x) {
    if constexpr (std::is_same_v<T, float>) {
        return std::sqrt(x);
    } else {
        for (unsigned n = 0; n < sizeof(T) / sizeof(float); ++n) x[n] = std::sqrt(x[n]);
        return x;
    }
}
template <class T>
VDBCARVE_HD T magnitude(T x) {
    if constexpr (std::is_same_v<T, float>) return std::fabs(x);
    else return x < 0.f ? -x : x;
}

/// Moves the least of n values to the front and the greatest to the end.
template <int n, class T>
VDBCARVE_HD void extremes_to_ends(T* w) {
    const auto order = [w](int a, int b) {
        const T low = lesser(w[a], w[b]), high = greater(w[a], w[b]);
        w[a] = low;
        w[b] = high;
    };
    for (int i = 0; i < n / 2; ++i) order(i, n - 1 - i);
    for (int i = 1; i <= (n - 1) / 2; ++i) order(0, i);
    for (int i = n / 2; i < n - 1; ++i) order(i, n - 1);
}

/// With more than half of `kCount` values held, neither the least nor the greatest of them is the median: both go, the next
/// value comes, until three are left.
template <int kSize, int kNext, int kCount, class T, class Get>
VDBCARVE_HD T median_of_rest(T* held, const Get& get) {
    extremes_to_ends<kSize>(held);
    if constexpr (kNext == kCount) {
        return held[1];
    } else {
        held[0] = get(kNext);
        return median_of_rest<kSize - 1, kNext + 1, kCount, T>(held, get);
    }
}

/// Median of the (2 w + 1)^3 values around.
template <int kWidth, class T, class At>
VDBCARVE_HD T median_around(const At& at) {
    constexpr int kSide = 2 * kWidth + 1, kCount = kSide * kSide * kSide, kHeld = kCount / 2 + 2;
    const auto get = [&at](int n) { return at(n / (kSide * kSide) - kWidth, n / kSide % kSide - kWidth, n % kSide - kWidth); };
    T held[kHeld];
    for (int n = 0; n < kHeld; ++n) held[n] = get(n);
    return median_of_rest<kHeld, kHeld, kCount, T>(held, get);
}

/// A step of dt = 1/6 of the Laplacian: the mean of the six face neighbours.
template <class T, class At>
VDBCARVE_HD T mean_of_six(const At& at) {
    return (((at(-1, 0, 0) + at(1, 0, 0)) + (at(0, -1, 0) + at(0, 1, 0))) + (at(0, 0, -1) + at(0, 0, 1))) * (1.f / 6);
}

/// A step of dt = 1/6 of motion by mean curvature: phi_t = div(grad phi / |grad phi|) |grad phi| (Osher and Sethian 1988). Where
/// |grad phi| = 1 along straight lines it is the Laplacian's step.
template <class T, class At>
VDBCARVE_HD T mean_curvature_step(const At& at) {
    const T here = at(0, 0, 0);
    const T x0 = at(-1, 0, 0), x1 = at(1, 0, 0), y0 = at(0, -1, 0), y1 = at(0, 1, 0), z0 = at(0, 0, -1), z1 = at(0, 0, 1);
    const T gx = (x1 - x0) * 0.5f, gy = (y1 - y0) * 0.5f, gz = (z1 - z0) * 0.5f;
    const T xx = (x1 + x0) - (here + here), yy = (y1 + y0) - (here + here), zz = (z1 + z0) - (here + here);
    const T xy = ((at(1, 1, 0) + at(-1, -1, 0)) - (at(1, -1, 0) + at(-1, 1, 0))) * 0.25f;
    const T yz = ((at(0, 1, 1) + at(0, -1, -1)) - (at(0, 1, -1) + at(0, -1, 1))) * 0.25f;
    const T zx = ((at(1, 0, 1) + at(-1, 0, -1)) - (at(-1, 0, 1) + at(1, 0, -1))) * 0.25f;
    const T gx2 = gx * gx, gy2 = gy * gy, gz2 = gz * gz;
    const T straight = (gx2 * (yy + zz) + gy2 * (xx + zz)) + gz2 * (xx + yy);
    const T mixed = (gx * gy * xy + gy * gz * yz) + gz * gx * zx;
    const T slope2 = (gx2 + gy2) + gz2;
    const T least = slope2 - slope2 + 1e-12f;
    return here + (straight - (mixed + mixed)) / greater(slope2, least) * (1.f / 6);
}

/// Mean of 2 w + 1 values in a row; along all three axes, four times over, it is nearly a Gaussian (variance 4 w (w + 1) / 3).
/// `line(n)` reads the n-th value away.
template <class T, class Line>
VDBCARVE_HD T box_along(const Line& line, int width) {
    T sum = line(0);
    for (int n = 1; n <= width; ++n) sum = sum + (line(-n) + line(n));
    return sum * (1.f / static_cast<float>(2 * width + 1));
}

template <class T, class Line>
VDBCARVE_HD T least_along(const Line& line, int width) {
    T least = line(0);
    for (int n = 1; n <= width; ++n) least = lesser(least, lesser(line(-n), line(n)));
    return least;
}

/// Direction in which the distance grows; of length 1, or less where the band's end flattens everything.
template <class T>
struct BandNormal {
    T x, y, z;
};
template <class T, class At>
VDBCARVE_HD BandNormal<T> band_normal(const At& at) {
    const T gx = at(1, 0, 0) - at(-1, 0, 0), gy = at(0, 1, 0) - at(0, -1, 0), gz = at(0, 0, 1) - at(0, 0, -1);
    const T size2 = (gx * gx + gy * gy) + gz * gz;
    const T least = size2 - size2 + 1e-12f;
    const T size = root(greater(size2, least));
    return {gx / size, gy / size, gz / size};
}

/// Normals that differ by more than 40 degrees (cosine) tell nothing of each other's surface.
inline constexpr float kLeastSameSide = 0.76604444f;

/// The edge-preserving filter, a bilateral filter of the band: neighbours count by distance and by how well their normals agree
/// with the voxel's own, so that faces are smoothed and the edges between them are not. What a neighbour at offset d says of the distance here is its
/// own less the step along the mean of both normals, phi(y) - (n(x) + n(y)) . d / 2: exact on planes whatever the neighbours' share, and to second
/// order on spheres, so that round parts do not shrink. Tomasi and Manduchi 1998 for the weights; the prediction in the place of the plain mean
/// is what keeps volume. `normal(i, j, k)` reads normals; voxels at the band's end neither count nor change.
template <class T, class At, class Normal>
VDBCARVE_HD T edge_preserving(const At& at, const Normal& normal, int width, float band_vox) {
    const T here = at(0, 0, 0);
    const BandNormal<T> mine = normal(0, 0, 0);
    const T zero = here - here;
    T sum = here, weights = zero + 1.f;
    const float reach2 = static_cast<float>(3 * width * width + 2);
    for (int i = -width; i <= width; ++i)
        for (int j = -width; j <= width; ++j)
            for (int k = -width; k <= width; ++k) {
                if (i == 0 && j == 0 && k == 0) continue;
                const float fi = static_cast<float>(i), fj = static_cast<float>(j), fk = static_cast<float>(k);
                const float near = 1.f - ((fi * fi + fj * fj) + fk * fk) / reach2;
                const BandNormal<T> other = normal(i, j, k);
                const T value = at(i, j, k);
                const T agree = (mine.x * other.x + mine.y * other.y) + mine.z * other.z;
                const T same = greater((agree - kLeastSameSide) * (1.f / (1.f - kLeastSameSide)), zero);
                const T step = ((mine.x + other.x) * fi + (mine.y + other.y) * fj) + (mine.z + other.z) * fk;
                const T w = magnitude(value) < band_vox ? same * same * (near * near) : zero;
                sum = sum + w * (value - step * 0.5f);
                weights = weights + w;
            }
    return magnitude(here) < band_vox ? sum / weights : here;
}

/// How much of a filter's change a voxel takes: nothing where the object around it is thinner than `thickness` (`deepest`: the least value
/// near it), all where it is thicker by 1 1/2 voxels.
VDBCARVE_HD float change_share(float deepest, float thickness) {
    const float t = (-deepest - 0.5f * thickness) * (1.f / 0.75f);
    const float s = min_f(max_f(t, 0.f), 1.f);
    return s * s * (3.f - 2.f * s);
}
/// How far to look for the deepest voxel.
VDBCARVE_HD int thin_reach(float thickness) { return static_cast<int>(std::ceil(0.5f * thickness + 0.75f)); }

/// A voxel's volume is counted in units of its 2^-20, so that sums are whole numbers and no order matters.
inline constexpr int64_t kVolumeUnits = int64_t{1} << 20;

/// The part of a voxel that is inside, as if the surface were a plane across an axis.
VDBCARVE_HD int32_t filled_units(float distance_vox) {
    const float part = min_f(max_f(0.5f - distance_vox, 0.f), 1.f);
    return static_cast<int32_t>(part * static_cast<float>(kVolumeUnits) + 0.5f);
}

}  // namespace vdbcarve::kernel
