// SPDX-License-Identifier: Apache-2.0
// The fair surface, one line of sight and one voxel at a time (src/fair/fair.md says what it is).
//
// Distances are in voxels of the level at hand, negative inside, and end at +-kFairBand_vox. Positions are index coordinates, voxel centres at whole numbers.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

inline constexpr float kFairBand_vox = 3.f;
/// Voxels on either side that a step of motion looks at.
inline constexpr int kFairReach = 4;
/// A line of sight is looked at every half voxel.
inline constexpr float kSightStep_vox = 0.5f;

/// Values of leaves of 8^3 voxels, and a lattice that says where each leaf lies. Borrowed.
struct FairField {
    const int32_t* leaf_at;  ///< by place in the lattice, x leads: number of the leaf, or kOutsideTile, kInsideTile
    int lo[3], size[3];      ///< of the lattice, leaves
    const float* values;     ///< 512 a leaf, i << 6 | j << 3 | k
    const float* least;      ///< of every leaf, the least value that a point of its cells can have

    /// Number of the leaf that holds a voxel, or a tile.
    VDBCARVE_HD int32_t leaf(int i, int j, int k) const {
        const int x = (i >> 3) - lo[0], y = (j >> 3) - lo[1], z = (k >> 3) - lo[2];
        if (x < 0 || y < 0 || z < 0 || x >= size[0] || y >= size[1] || z >= size[2]) return kOutsideTile;
        return leaf_at[(static_cast<int64_t>(x) * size[1] + y) * size[2] + z];
    }
    VDBCARVE_HD static float tile(int32_t number) { return number == kInsideTile ? -kFairBand_vox : kFairBand_vox; }
    /// Where a voxel's value lies; negative: a tile.
    VDBCARVE_HD int64_t place(int i, int j, int k) const {
        const int32_t n = leaf(i, j, k);
        return n < 0 ? n : static_cast<int64_t>(n) * 512 + ((i & 7) << 6 | (j & 7) << 3 | (k & 7));
    }
    VDBCARVE_HD float at(int i, int j, int k) const {
        const int64_t p = place(i, j, k);
        return p < 0 ? tile(static_cast<int32_t>(p)) : values[p];
    }
    /// The least that a point in a leaf's cells, or in a tile's, can have.
    VDBCARVE_HD float least_in(int32_t number) const { return number < 0 ? tile(number) : least[number]; }
};

/// A point between the eight voxels around it.
struct FairCell {
    int i, j, k;
    float a, b, c;
};

VDBCARVE_HD FairCell fair_cell(float x, float y, float z) {
    const float fi = std::floor(x), fj = std::floor(y), fk = std::floor(z);
    return {static_cast<int>(fi), static_cast<int>(fj), static_cast<int>(fk), x - fi, y - fj, z - fk};
}

/// The eight values around, of which number n is (n >> 2, n >> 1 & 1, n & 1) voxels away from the first. `number`: of the leaf that holds the first.
VDBCARVE_HD void cell_values(const FairField& f, int32_t number, const FairCell& c, float v[8]) {
    const int i = c.i & 7, j = c.j & 7, k = c.k & 7;
    if (number >= 0 && i < 7 && j < 7 && k < 7) {
        const float* p = f.values + static_cast<int64_t>(number) * 512 + (i << 6 | j << 3 | k);
        v[0] = p[0];
        v[1] = p[1];
        v[2] = p[8];
        v[3] = p[9];
        v[4] = p[64];
        v[5] = p[65];
        v[6] = p[72];
        v[7] = p[73];
        return;
    }
    for (int n = 0; n < 8; ++n) v[n] = f.at(c.i + (n >> 2), c.j + (n >> 1 & 1), c.k + (n & 1));
}

VDBCARVE_HD float trilinear(const float v[8], const FairCell& c) {
    const float a0 = 1.f - c.a, b0 = 1.f - c.b, c0 = 1.f - c.c;
    const float low = b0 * (c0 * v[0] + c.c * v[1]) + c.b * (c0 * v[2] + c.c * v[3]);
    const float high = b0 * (c0 * v[4] + c.c * v[5]) + c.b * (c0 * v[6] + c.c * v[7]);
    return a0 * low + c.a * high;
}

VDBCARVE_HD float value_in(const FairField& f, int32_t number, const FairCell& c) {
    float v[8];
    cell_values(f, number, c, v);
    return trilinear(v, c);
}

/// A coarser level's field at a finer level's point, in the finer level's voxels: one coarse voxel is 2^3 fine ones.
VDBCARVE_HD float coarser_value(const FairField& coarse, float x, float y, float z) {
    const FairCell c = fair_cell((x - 0.5f) * 0.5f, (y - 0.5f) * 0.5f, (z - 0.5f) * 0.5f);
    return 2.f * value_in(coarse, coarse.leaf(c.i, c.j, c.k), c);
}

/// A view's camera in index coordinates. Pixels are samples of its distance field.
struct FairEye {
    double centre[3];
    double axes[3][3];  ///< index direction = axes * camera direction; rotation alone
    double fx, fy, skew, cx, cy;
    double inverse_fx, inverse_fy;
    double inverse_voxel;  ///< 1 / world units: of an orthographic camera's scale
    int orthographic;
};

/// A line of sight within the lattice.
struct FairRay {
    float from[3], along[3];  ///< where it enters; unit
    float inverse[3];
    int last;          ///< of its samples, at from + (n + 1/2) * kSightStep_vox * along
    float sample_vox;  ///< size of a sample of the view, halfway
};

/// The line of sight through the middle of sample (x, y); false where it misses the lattice.
VDBCARVE_HD bool line_of_sight(const FairEye& e, const FairField& f, int x, int y, FairRay& ray) {
    const double my = (y + 0.5 - e.cy) * e.inverse_fy, mx = (x + 0.5 - e.cx - e.skew * my) * e.inverse_fx;
    double from[3], along[3], length2 = 0;
    for (int a = 0; a < 3; ++a) {
        const double across = e.axes[a][0] * mx + e.axes[a][1] * my;
        from[a] = e.orthographic ? e.centre[a] + across * e.inverse_voxel : e.centre[a];
        along[a] = e.orthographic ? e.axes[a][2] : across + e.axes[a][2];
        length2 += along[a] * along[a];
    }
    const double inverse_length = 1 / std::sqrt(length2);
    double enter = e.orthographic ? -1e30 : 0.0, leave = 1e30;
    for (int a = 0; a < 3; ++a) {
        along[a] *= inverse_length;
        const double low = 8.0 * f.lo[a], high = 8.0 * (f.lo[a] + f.size[a]) - 1;
        ray.along[a] = static_cast<float>(along[a]);
        ray.inverse[a] = 0.f;
        if (along[a] == 0) {
            if (from[a] < low || from[a] > high) return false;
            continue;
        }
        const double inverse = 1 / along[a], p = (low - from[a]) * inverse, q = (high - from[a]) * inverse;
        const double first = p < q ? p : q, second = p < q ? q : p;
        if (first > enter) enter = first;
        if (second < leave) leave = second;
        ray.inverse[a] = static_cast<float>(inverse);
    }
    if (!(enter < leave)) return false;
    for (int a = 0; a < 3; ++a) ray.from[a] = static_cast<float>(from[a] + enter * along[a]);
    ray.last = static_cast<int>((leave - enter) / static_cast<double>(kSightStep_vox) - 0.5);
    const double inverse_f = e.inverse_fx < e.inverse_fy ? e.inverse_fx : e.inverse_fy;
    ray.sample_vox = static_cast<float>(inverse_f * (e.orthographic ? e.inverse_voxel : 0.5 * (enter + leave) * inverse_length));
    return true;
}

VDBCARVE_HD FairCell sample_cell(const FairRay& r, int n) {
    const float t = (static_cast<float>(n) + 0.5f) * kSightStep_vox;
    return fair_cell(r.from[0] + t * r.along[0], r.from[1] + t * r.along[1], r.from[2] + t * r.along[2]);
}

/// The first sample beyond the leaf, or tile, that holds sample n's cell.
VDBCARVE_HD int sample_beyond(const FairRay& r, const FairCell& c, int n) {
    const int corner[3] = {c.i & ~7, c.j & ~7, c.k & ~7};
    float leave = 1e30f;
    for (int a = 0; a < 3; ++a)
        if (r.along[a] != 0.f) leave = min_f(leave, (static_cast<float>(r.along[a] > 0.f ? corner[a] + 8 : corner[a]) - r.from[a]) * r.inverse[a]);
    const int next = static_cast<int>(leave * (1.f / kSightStep_vox) + 0.5f);
    return next > n ? next : n + 1;
}

/// Whether a sample of first..last is at or below `enough`.
VDBCARVE_HD bool reaches(const FairField& f, const FairRay& r, int first, int last, float enough) {
    for (int n = first; n <= last;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = f.leaf(c.i, c.j, c.k);
        if (f.least_in(number) > enough) {
            n = sample_beyond(r, c, n);
            continue;
        }
        if (number < 0 || value_in(f, number, c) <= enough) return true;
        ++n;
    }
    return false;
}

/// The least value on the way, kFairBand_vox at most; stops at the first that is `enough`.
VDBCARVE_HD float least_on(const FairField& f, const FairRay& r, float enough) {
    float best = kFairBand_vox;
    for (int n = 0; n <= r.last;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = f.leaf(c.i, c.j, c.k);
        if (f.least_in(number) >= best) {
            n = sample_beyond(r, c, n);
            continue;
        }
        best = min_f(best, number < 0 ? FairField::tile(number) : value_in(f, number, c));
        if (best <= enough) return best;
        ++n;
    }
    return best;
}

/// First and last sample where the hull is at most `deep`: the surface lies above the hull, so it can reach `deep` nowhere else.
VDBCARVE_HD void deep_span(const FairField& hull, const FairRay& r, float deep, int& first, int& last) {
    first = r.last + 1;
    last = -1;
    for (int n = 0; n <= r.last;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = hull.leaf(c.i, c.j, c.k);
        if (hull.least_in(number) > deep) {
            n = sample_beyond(r, c, n);
            continue;
        }
        const int next = number < 0 ? sample_beyond(r, c, n) : n + 1;
        if (number < 0 || value_in(hull, number, c) <= deep) {
            if (first > n) first = n;
            last = next - 1 < r.last ? next - 1 : r.last;
        }
        n = next;
    }
}

/// Where on a line of sight the surface would have to move least to reach it.
struct NearestPlace {
    float value = 1e9f;  ///< of the field there; beyond its band by the coarser level's
    int sample = -1;     ///< none: the hull is nowhere so deep
};
VDBCARVE_HD NearestPlace nearest_place(const FairField& f, const FairField& hull, const FairField& coarser, const FairRay& r, int first, int last, float deep) {
    NearestPlace best;
    for (int n = first; n <= last;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = f.leaf(c.i, c.j, c.k);
        if (number < 0 || hull.least[number] > deep || (best.value < kFairBand_vox && f.least[number] >= best.value)) {
            n = sample_beyond(r, c, n);
            continue;
        }
        const float depth = value_in(hull, number, c);
        if (depth <= deep) {
            float value = value_in(f, number, c);
            if (value >= kFairBand_vox - 1e-3f) {
                const float t = (static_cast<float>(n) + 0.5f) * kSightStep_vox;
                const float far = coarser.leaf_at ? coarser_value(coarser, r.from[0] + t * r.along[0], r.from[1] + t * r.along[1], r.from[2] + t * r.along[2])
                                                  : kFairBand_vox;
                value = max_f(kFairBand_vox, far) + 0.01f * depth;
            }
            if (value < best.value) best = {value, n};
        }
        ++n;
    }
    return best;
}

/// The field over its slope, so that it stays nearly a distance, kept to the band and above the hull.
template <class At>
VDBCARVE_HD float straightened(const At& at, float hull) {
    const float gx = 0.5f * (at(1, 0, 0) - at(-1, 0, 0)), gy = 0.5f * (at(0, 1, 0) - at(0, -1, 0)), gz = 0.5f * (at(0, 0, 1) - at(0, 0, -1));
    const float slope = std::sqrt((gx * gx + gy * gy) + gz * gz);
    return max_f(clamp_f(at(0, 0, 0) / max_f(slope, 0.3f), -kFairBand_vox, kFairBand_vox), hull);
}

/// Where a line of sight pulls the surface, it pulls what lies around with it, so that no point of its own stands out: the share of the fall at so many voxels
/// from the place. A little more than 1 there, so that the place itself, between voxels, falls far enough.
inline constexpr int kDentReach = 2;
VDBCARVE_HD float dent(float x, float y, float z) {
    const float far = 1.f - ((x * x + y * y) + z * z) * (1.f / 6);
    return far <= 0.f ? 0.f : 1.4f * far * far;
}

}  // namespace vdbcarve::kernel
