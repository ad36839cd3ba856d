// SPDX-License-Identifier: Apache-2.0
// The fair surface, one line of sight and one voxel at a time (docs/stages/fair.md says what it is).
//
// Distances are in voxels of the level at hand, negative inside, and end at +-kFairBand_vox. Positions are index coordinates, voxel centres at whole numbers.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/fair_motion.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

/// A line of sight is looked at every half voxel.
inline constexpr float kSightStep_vox = 0.5f;

/// An outside tile, where no place of the lattice nearer than `free` places (along every axis; 1: itself) is anything else. So lines of sight cross empty space
/// in few steps.
VDBCARVE_HD int32_t outside_tile(int free) { return free < 2 ? kOutsideTile : -1 - free; }
VDBCARVE_HD bool is_outside(int32_t number) { return number < 0 && number != kInsideTile; }
VDBCARVE_HD int free_places(int32_t number) { return number < kInsideTile ? -1 - number : 1; }

/// Values of leaves of 8^3 voxels, and a lattice that says where each leaf lies. Borrowed.
struct FairField {
    const int32_t* leaf_at;  ///< by place in the lattice, x leads: number of the leaf, kInsideTile, or outside_tile()
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
    const int i = floor_of(x), j = floor_of(y), k = floor_of(z);
    return {i, j, k, x - static_cast<float>(i), y - static_cast<float>(j), z - static_cast<float>(k)};
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
    // The axes along which the cell reaches into the next leaf.
    const int crosses = (i == 7 ? 4 : 0) | (j == 7 ? 2 : 0) | (k == 7 ? 1 : 0);
    int32_t leaves[8];
    leaves[0] = number;
    for (int n = 0; n < 8; ++n) {
        const int x = n >> 2, y = n >> 1 & 1, z = n & 1, leaf = n & crosses;
        if (n && n == leaf) leaves[n] = f.leaf(c.i + x, c.j + y, c.k + z);
        const int32_t m = leaves[leaf];
        v[n] = m < 0 ? FairField::tile(m) : f.values[static_cast<int64_t>(m) * 512 + (((i + x) & 7) << 6 | ((j + y) & 7) << 3 | ((k + z) & 7))];
    }
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

/// What becomes of a leaf inside the hull, at leaf coordinates (x, y, z): 0 where the coarser level's field needs it, or a tile.
VDBCARVE_HD int32_t carried_tile(const FairField& coarse, int x, int y, int z) {
    constexpr float kReach = 2.f;  // coarse voxels
    float least = kFairBand_vox, most = -kFairBand_vox;
    for (int a = -1; a <= 4; ++a)
        for (int b = -1; b <= 4; ++b)
            for (int c = -1; c <= 4; ++c) {
                const float v = coarse.at(4 * x + a, 4 * y + b, 4 * z + c);
                least = min_f(least, v);
                most = max_f(most, v);
            }
    return least < kReach && most > -kReach ? 0 : most < 0.f ? kInsideTile : kOutsideTile;
}
/// The field that a finer level's voxel begins with. What the coarser hull is too coarse for (thin parts) is as the finer one, whose value is `hull`, has it.
VDBCARVE_HD float carried_value(float hull, const FairField& coarse_hull, const FairField& coarse, int i, int j, int k) {
    const auto x = static_cast<float>(i), y = static_cast<float>(j), z = static_cast<float>(k);
    const float detail = min_f(0.f, hull - coarser_value(coarse_hull, x, y, z));
    return max_f(hull, clamp_f(coarser_value(coarse, x, y, z) + detail, -kFairBand_vox, kFairBand_vox));
}

/// Where depths see the surface on a level, and how sure they are. The level set that they carved has leaves and a lattice of its own. Borrowed.
struct FairDepths {
    FairField carved;
    const float* weight;  ///< of its leaves' voxels, 0..1
};

/// A voxel's value nearer to `target` by such a share of the way, and not below the hull.
VDBCARVE_HD float led_value(float value, float target, float share, float hull) { return max_f(value + share * (target - value), hull); }

/// How sure depths are in a coarser level's voxel: as in the surest of its 2^3, for most of them lie beyond the band that depths speak of.
VDBCARVE_HD float coarser_weight(const FairDepths& fine, int i, int j, int k) {
    float most = 0.f;
    for (int c = 0; c < 8; ++c) {
        const int64_t p = fine.carved.place(2 * i + (c >> 2), 2 * j + (c >> 1 & 1), 2 * k + (c & 1));
        if (p >= 0) most = max_f(most, fine.weight[p]);
    }
    return most;
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
    float sample_vox;  ///< size of a sample of the view, halfway through the lattice
    float most_vox;    ///< and where it leaves the lattice
};

/// The line of sight through a point of the picture, samples; false where it misses the lattice.
VDBCARVE_HD bool line_of_sight(const FairEye& e, const FairField& f, double x, double y, FairRay& ray) {
    const double my = (y - e.cy) * e.inverse_fy, mx = (x - e.cx - e.skew * my) * e.inverse_fx;
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
    ray.most_vox = static_cast<float>(inverse_f * (e.orthographic ? e.inverse_voxel : leave * inverse_length));
    return true;
}

VDBCARVE_HD FairCell sample_cell(const FairRay& r, int n) {
    const float t = (static_cast<float>(n) + 0.5f) * kSightStep_vox;
    return fair_cell(r.from[0] + t * r.along[0], r.from[1] + t * r.along[1], r.from[2] + t * r.along[2]);
}

/// The first sample beyond the leaf, or tile, that holds sample n's cell; `number`: of it. `step`: 1 or -1, the way.
VDBCARVE_HD int sample_beyond(const FairRay& r, const FairCell& c, int n, int32_t number, int step = 1) {
    const int corner[3] = {c.i & ~7, c.j & ~7, c.k & ~7}, more = 8 * (free_places(number) - 1);
    float leave = 1e30f;
    for (int a = 0; a < 3; ++a) {
        const bool far = (r.along[a] > 0.f) == (step > 0);
        const float at = static_cast<float>(far ? corner[a] + 8 + more : corner[a] - more) - r.from[a];
        if (r.along[a] != 0.f) leave = min_f(leave, static_cast<float>(step) * at * r.inverse[a]);
    }
    if (step > 0) {
        const int next = static_cast<int>(leave * (1.f / kSightStep_vox) + 0.5f);
        return next > n ? next : n + 1;
    }
    const int next = static_cast<int>(-leave * (1.f / kSightStep_vox) - 0.5f);
    return next < n ? next : n - 1;
}

/// A field along a line of sight. `number`: of the leaf, or tile, that holds sample n's cell c. Searches below read fields through such a look, so that a warp
/// can read ahead (cuda/fair_warp.cuh) and find the same.
struct FairLook {
    const FairField& field;
    const FairRay& ray;

    VDBCARVE_HD int32_t number(int, const FairCell& c) { return field.leaf(c.i, c.j, c.k); }
    VDBCARVE_HD float least(int, int32_t number) { return field.least_in(number); }
    VDBCARVE_HD float value(int, int32_t number, const FairCell& c) { return number < 0 ? FairField::tile(number) : value_in(field, number, c); }
};
/// A coarser level's field along a line of sight, in voxels of the level at hand.
struct FairCoarserLook {
    const FairField& coarser;
    const FairRay& ray;

    VDBCARVE_HD float value(int n) {
        if (!coarser.leaf_at) return kFairBand_vox;
        const float t = (static_cast<float>(n) + 0.5f) * kSightStep_vox;
        return coarser_value(coarser, ray.from[0] + t * ray.along[0], ray.from[1] + t * ray.along[1], ray.from[2] + t * ray.along[2]);
    }
};
/// Reads a sample when it is asked for.
struct FairOneByOne {
    using Look = FairLook;
    using CoarserLook = FairCoarserLook;
};

/// How many samples further the field can be lower by 1: it changes by less than 2 along a voxel, the hull, which holds distances, by less than 1.25.
inline constexpr float kFieldSamples = 1.f, kHullSamples = 1.6f;
/// The next sample that can be so much lower.
VDBCARVE_HD int sample_lower(int n, float by, float samples) {
    const int more = static_cast<int>(by * samples);
    return n + (more > 1 ? more : 1);
}

/// The least value on the way and the sample that has it; stops at the first that is `enough`. Nothing that is not below `most` counts.
template <class Look>
VDBCARVE_HD float least_below(Look& look, float samples, float most, float enough, int& at) {
    const FairRay& r = look.ray;
    float best = most;
    at = 0;
    for (int n = 0; n <= r.last;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = look.number(n, c);
        if (look.least(n, number) >= best) {
            n = sample_beyond(r, c, n, number);
            continue;
        }
        const float value = look.value(n, number, c);
        if (value < best) {
            best = value;
            at = n;
        }
        if (best <= enough) return best;
        n = sample_lower(n, value - best, samples);
    }
    return best;
}

/// The same without a bound, kFairBand_vox at most. `guess`: about what it will be; most of the way is passed over more quickly then.
template <class Look>
VDBCARVE_HD float least_on(Look& look, float samples, float guess, float enough, int& at) {
    const float most = min_f(guess + 1.f, kFairBand_vox), least = least_below(look, samples, most, enough, at);
    return least < most || most >= kFairBand_vox ? least : least_below(look, samples, kFairBand_vox, enough, at);
}
VDBCARVE_HD float least_on(const FairField& f, const FairRay& r, float samples, float guess, float enough, int& at) {
    FairLook look{f, r};
    return least_on(look, samples, guess, enough, at);
}

/// The sample of first..last, or last..first, that comes first on the way (step 1 or -1) and where the hull is at most `deep`; `last` + step: none.
template <class Look>
VDBCARVE_HD int first_deep(Look& hull, int first, int last, int step, float deep) {
    for (int n = first; step > 0 ? n <= last : n >= last;) {
        const FairCell c = sample_cell(hull.ray, n);
        const int32_t number = hull.number(n, c);
        if (hull.least(n, number) > deep) {
            n = sample_beyond(hull.ray, c, n, number, step);
            continue;
        }
        const float value = hull.value(n, number, c);
        if (value <= deep) return n;
        n += step * (sample_lower(n, value - deep, kHullSamples) - n);
    }
    return last + step;
}
/// A first and a last sample between which lies all of the line where the hull is at most `deep`: the surface lies above the hull, so it can reach `deep`
/// nowhere else. Lines graze the hull for long; a little more than needed is found sooner.
template <class Look>
VDBCARVE_HD void deep_span(Look& hull, float deep, int& first, int& last) {
    const int end = hull.ray.last;
    deep += 0.25f;
    first = first_deep(hull, 0, end, 1, deep);
    last = first > end ? -1 : first_deep(hull, end, first, -1, deep);
}

/// Where on a line of sight the surface would have to move least to fall to `deep`, or has: the search starts from sample `at`, which counts as such a place.
struct NearestPlace {
    float value;  ///< of the field there; beyond its band by the coarser level's
    int sample;
};
template <class Look, class CoarserLook>
VDBCARVE_HD NearestPlace nearest_place(Look& field, Look& hull, CoarserLook& coarser, int first, int last, float deep, int at) {
    const FairRay& r = field.ray;
    const auto value_at = [&](int32_t number, const FairCell& c, int n, float near) {
        return near < kFairBand_vox - 1e-3f ? near : max_f(kFairBand_vox, coarser.value(n)) + 0.01f * hull.value(n, number, c);
    };
    const FairCell start = sample_cell(r, at);
    const int32_t there = field.number(at, start);
    NearestPlace best{there < 0 ? 2 * FairField::tile(there) : value_at(there, start, at, field.value(at, there, start)), at};
    for (int n = first; n <= last && best.value > deep;) {
        const FairCell c = sample_cell(r, n);
        const int32_t number = field.number(n, c);
        if (number < 0 || hull.least(n, number) > deep || (best.value < kFairBand_vox && field.least(n, number) >= best.value)) {
            n = sample_beyond(r, c, n, number);
            continue;
        }
        const float near = field.value(n, number, c);
        if (best.value < kFairBand_vox && near >= best.value) {
            n = sample_lower(n, near - best.value, kFieldSamples);
            continue;
        }
        const float depth = hull.value(n, number, c);
        if (depth > deep) {
            n = sample_lower(n, depth - deep, kHullSamples);
            continue;
        }
        const float value = value_at(number, c, n, near);
        if (value < best.value) best = {value, n};
        ++n;
    }
    return best;
}

/// A line counts as met this little above its target, so that the last bit needs no round of its own.
inline constexpr float kFairSlack_vox = 0.02f;
/// Lines this far inside the contour, in samples, must meet the surface; those nearer to it, down to a sample outside, keep the contour.
inline constexpr float kFairMust_samples = -0.5f;
/// As deep as that is covered.
inline constexpr float kFairCovered_vox = -0.1f;
/// The contour is kept where the surface is at most so far from it.
inline constexpr float kFairNearContour_vox = 0.3f;

/// What a sample's line of sight asks of the field: to fall to `must` somewhere between its samples `first` and `last`, and to `keep` where the surface is
/// near.
struct FairLine {
    FairRay ray;
    float keep, must;     ///< keep <= must; must kFairBand_vox: it need not be met
    int32_t first, last;  ///< of the ray's samples
    int32_t met;          ///< where it last was met
    int32_t settled;      ///< what the hull allows is part of the above
    uint32_t view, sample;
};

/// The line of a sample `inside` samples inside the contour (negative), or outside it; within 1. False: it asks nothing, the hull is not there.
VDBCARVE_HD bool rim_line(const FairEye& e, const FairField& hull, int x, int y, float inside, FairLine& line) {
    if (!line_of_sight(e, hull, x + 0.5, y + 0.5, line.ray)) return false;
    // Never more than the mask says: with misses allowed, the hull reaches beyond some.
    const float most = inside * line.ray.sample_vox, enough = inside <= kFairMust_samples ? min_f(most, kFairCovered_vox) : most;
    const float least = least_on(hull, line.ray, kHullSamples, most, enough, line.met);
    line.keep = max_f(least, most) + kFairSlack_vox;
    if (line.keep >= kFairBand_vox) return false;
    line.must = kFairBand_vox;
    if (inside <= kFairMust_samples) {
        line.must = max_f(least, kFairCovered_vox) + kFairSlack_vox;
        line.keep = min_f(line.keep, line.must);
    }
    FairLook look{hull, line.ray};
    deep_span(look, line.must < kFairBand_vox ? line.must : line.keep, line.first, line.last);
    line.settled = 1;
    return true;
}

/// The line of a sample deeper inside; false: the field is `safe` deep on it, or deeper. Where no surface is near it must be covered and no more: between two
/// parts of the object the hull is deeper only far from either, where a surface would stand in the air.
VDBCARVE_HD bool near_line(const FairEye& e, const FairField& f, int x, int y, float safe, FairLine& line) {
    if (!line_of_sight(e, f, x + 0.5, y + 0.5, line.ray)) return false;
    line.keep = -line.ray.sample_vox;
    line.must = max_f(line.keep, kFairCovered_vox);
    line.first = 0;
    line.last = line.ray.last;
    line.settled = 0;
    const float enough = min_f(safe, line.keep);
    return least_on(f, line.ray, kFieldSamples, 0.f, enough, line.met) > enough;
}

/// Whether the field is `enough` deep somewhere on a line of sight. `there`: where it was on a line beside this one, and is on this one; that saves most of the
/// way and changes no answer, for every sample of leaves that reach so deep is looked at.
VDBCARVE_HD bool is_deep(const FairField& f, const FairRay& ray, float enough, int& there) {
    bool begun = false;
    for (int n = there <= ray.last ? there : 0; n <= ray.last;) {
        const FairCell c = sample_cell(ray, n);
        const int32_t number = f.leaf(c.i, c.j, c.k);
        const bool can = f.least_in(number) <= enough;
        if (can && (number < 0 || value_in(f, number, c) <= enough)) {
            there = n;
            return true;
        }
        n = !begun ? 0 : can ? n + 1 : sample_beyond(ray, c, n, number);
        begun = true;
    }
    return false;
}

/// Whether all lines through a square of samples meet the field because the one through its middle is so deep in it. Distances change by no more than one
/// voxel a voxel, so it must be deeper than the square's corners are away. `there`: is_deep().
VDBCARVE_HD bool covers_square(const FairEye& e, const FairField& f, int x, int y, int side, int& there) {
    constexpr float kDeep_vox = kFairBand_vox - 0.1f, kRest_vox = 0.35f;  // half of a step between samples, and to be covered
    const float half = 0.5f * static_cast<float>(side);
    FairRay ray;
    return line_of_sight(e, f, x + static_cast<double>(half), y + static_cast<double>(half), ray) &&
           (half - 0.5f) * 1.4143f * ray.most_vox + kRest_vox <= kDeep_vox && is_deep(f, ray, -kDeep_vox, there);
}

/// What a line still asks for: the field must fall to `target` at `place`; place.sample < 0: nothing.
struct FairOpen {
    NearestPlace place;
    float target;
};
/// Whether a line is met where it last was, or cannot be.
VDBCARVE_HD bool still_met(const FairField& f, const FairLine& line) {
    if (line.first > line.last) return true;
    const FairCell c = sample_cell(line.ray, line.met);
    const int32_t number = f.leaf(c.i, c.j, c.k);
    return (number < 0 ? FairField::tile(number) : value_in(f, number, c)) <= line.keep;
}
/// For lines that are not still_met().
template <class Reads = FairOneByOne>
VDBCARVE_HD FairOpen look_along(const FairField& f, const FairField& hull, const FairField& coarser, FairLine& line) {
    const FairOpen met{{0.f, -1}, 0.f};
    typename Reads::Look field_look{f, line.ray}, hull_look{hull, line.ray};
    typename Reads::CoarserLook coarser_look{coarser, line.ray};
    if (!line.settled) {  // what the hull allows is asked of the few that need it
        line.settled = 1;
        const float least = least_on(hull_look, kHullSamples, 0.f, line.keep, line.met);
        line.keep = max_f(least, line.keep) + kFairSlack_vox;
        line.must = max_f(least, line.must) + kFairSlack_vox;
        line.first = line.ray.last + 1;
        line.last = -1;
        if (line.keep >= kFairBand_vox) return met;
        deep_span(hull_look, line.must, line.first, line.last);
    }
    NearestPlace place = nearest_place(field_look, hull_look, coarser_look, line.first, line.last, line.keep, line.met);
    line.met = place.sample;
    if (place.value <= line.keep) return met;
    if (place.value <= kFairNearContour_vox || line.must <= line.keep) return {place, line.keep};
    if (line.must >= kFairBand_vox || place.value <= line.must) return met;
    place = nearest_place(field_look, hull_look, coarser_look, line.first, line.last, line.must, line.met);
    return place.value <= line.must ? met : FairOpen{place, line.must};
}

/// Where a line of sight pulls the surface, it pulls what lies around with it, so that no point of its own stands out: an ellipsoid of so many voxels across
/// and along the line.
struct FairDent {
    float along[3], across2, along2;  ///< the line's direction; 1 / half axis^2
    int reach[3];                     ///< voxels
};
VDBCARVE_HD FairDent dent_along(const FairRay& r, float along_vox) {
    constexpr float kAcross_vox = 2.45f;
    FairDent d{};
    d.across2 = 1.f / (kAcross_vox * kAcross_vox);
    d.along2 = 1.f / (along_vox * along_vox);
    for (int a = 0; a < 3; ++a) {
        const float share = r.along[a] * r.along[a];
        d.along[a] = r.along[a];
        d.reach[a] = static_cast<int>(std::sqrt(kAcross_vox * kAcross_vox * (1.f - share) + along_vox * along_vox * share));
    }
    return d;
}
/// The share of the fall at so many voxels from the place: a little more than 1 there, so that the place itself, between voxels, falls far enough.
VDBCARVE_HD float share_of_dent(const FairDent& d, float x, float y, float z) {
    const float t = (x * d.along[0] + y * d.along[1]) + z * d.along[2];
    const float far = 1.f - ((((x * x + y * y) + z * z) - t * t) * d.across2 + t * t * d.along2);
    return far <= 0.f ? 0.f : 1.4f * far * far;
}

/// What a line pulls. `to_the_hull`: the eight voxels around the place fall as far as the hull does.
struct FairPull {
    FairCell c;
    FairDent dent;
    float fall;
    int reach[3];
    int to_the_hull;

    /// The voxels around lie in columns along z.
    VDBCARVE_HD int columns() const { return (2 * reach[0] + 2) * (2 * reach[1] + 2); }
};
VDBCARVE_HD FairPull pull_of(const FairField& f, const FairLine& line, const FairOpen& open, float along_vox, bool to_the_hull) {
    FairPull p{};
    p.c = sample_cell(line.ray, open.place.sample);
    p.dent = dent_along(line.ray, along_vox);
    p.fall = max_f(value_in(f, f.leaf(p.c.i, p.c.j, p.c.k), p.c) - open.target, 0.f);
    for (int a = 0; a < 3; ++a) p.reach[a] = to_the_hull ? 0 : p.dent.reach[a];
    p.to_the_hull = to_the_hull;
    return p;
}
/// Calls lower(voxel, by) for what must fall in one column so that the line meets the field.
template <class Lower>
VDBCARVE_HD void lower_column(const FairField& f, const FairPull& p, int column, const Lower& lower) {
    constexpr float kMore_vox = 0.01f;  // so that rounding leaves nothing open
    const int across = 2 * p.reach[1] + 2, i = column / across - p.reach[0], j = column % across - p.reach[1];
    int32_t number = kOutsideTile;
    bool known = false;
    for (int k = -p.reach[2]; k <= p.reach[2] + 1; ++k) {
        known = known && ((p.c.k + k) & 7);
        const float share = share_of_dent(p.dent, static_cast<float>(i) - p.c.a, static_cast<float>(j) - p.c.b, static_cast<float>(k) - p.c.c);
        if (share <= 0.f) continue;
        if (!known) number = f.leaf(p.c.i + i, p.c.j + j, p.c.k + k);
        known = true;
        if (number < 0) continue;
        const bool corner = ((i | j | k) & ~1) == 0;
        lower(static_cast<int64_t>(number) * 512 + (((p.c.i + i) & 7) << 6 | ((p.c.j + j) & 7) << 3 | ((p.c.k + k) & 7)),
              p.to_the_hull ? 2.f * kFairBand_vox : share * p.fall + (corner ? kMore_vox : 0.f));
    }
}
/// Nothing falls as deep as the band's end: beside a voxel outside the band neither would be active, and meshes would have a hole there.
inline constexpr float kDeepestFall_vox = kFairBand_vox - 0.1f;
/// A voxel that falls by so much, not below the hull, and does not rise.
VDBCARVE_HD float fallen(float v, float by, float hull) { return min_f(v, max_f(max_f(v - by, hull), -kDeepestFall_vox)); }

}  // namespace vdbcarve::kernel
