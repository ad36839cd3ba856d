// SPDX-License-Identifier: Apache-2.0
// The arithmetic of depth by photo-consistency, a pixel at a time: how well a plane through a pixel explains what other views show, and
// how better planes are found.
//
// PatchMatch stereo (Bleyer, Rhemann and Rother 2011) with the red-black order of Galliani, Lasinger and Schindler 2015 ("Gipuma"), scored by bilaterally
// weighted normalised cross-correlation (Schoenberger et al. 2016), searched only where the visual hull leaves room.
//
// Frames: image pixels of the working size, the first pixel's centre at (0.5, 0.5); camera space, z forward. A plane is written by `s`, the inverse depth 1/z
// for a perspective reference and z for an orthographic one: over a plane s is linear in pixel coordinates, whichever it is, so that the way into another
// picture is one projective map. Only +, -, *, /, sqrt: both backends give the same bits.
#pragma once

#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

inline constexpr int kMostStereoPairs = 8;
inline constexpr int kWindowSide = 5, kWindowStep_px = 2, kWindowSamples = kWindowSide * kWindowSide;  ///< 25 samples of 9 x 9 pixels
inline constexpr float kNoCost = 2.f;                                                                  ///< nothing is known; 1 - ZNCC is at most 2
inline constexpr float kLeastStereoCosine = 0.15f;                                                     ///< between a plane's normal and the line of sight
inline constexpr float kLeastVariance = 1e-6f;  ///< of a window, so that flat ones compare as unlike instead of by their noise

/// A view at the working size. Borrowed.
struct StereoImage {
    const float* grey;  ///< row-major, sRGB-coded, 0..1
    int width, height;
};

/// From a reference picture into another: image point ~ from_pixel (u, v, 1) + s along.
struct StereoPair {
    float from_pixel[9];
    float along[3];
    float depth[4];  ///< its depth, times what makes the point homogeneous: depth[0..2] (u, v, 1) + s depth[3]
    float turn[9];   ///< rotation of camera axes into the other's
    int view;
};

/// s over the pixels around: s + su du + sv dv.
struct StereoPlane {
    float s, su, sv;
};

/// The reference's lens.
struct StereoLens {
    float fx, fy, skew, cx, cy;
    bool orthographic;
};

// ------------------------------------------------------------------------------------ planes

/// The line of sight of an image point, at depth 1 (not of unit length); orthographic: (0, 0, 1).
VDBCARVE_HD Vec3 stereo_ray(const StereoLens& lens, float u, float v) {
    if (lens.orthographic) return {0.f, 0.f, 1.f};
    const float y = (v - lens.cy) / lens.fy;
    return {(u - lens.cx - lens.skew * y) / lens.fx, y, 1.f};
}

/// Unit normal, towards the camera, of a plane at an image point.
VDBCARVE_HD Vec3 plane_normal(const StereoLens& lens, const StereoPlane& plane, float u, float v) {
    const float x = lens.fx * plane.su, y = lens.fy * plane.sv + lens.skew * plane.su;
    Vec3 n;
    if (lens.orthographic) {
        n = {x, y, -1.f};
    } else {
        const Vec3 r = stereo_ray(lens, u, v);
        n = {-x, -y, x * r.x + y * r.y - plane.s};
    }
    const float inverse = 1.f / std::sqrt(dot(n, n));
    return {n.x * inverse, n.y * inverse, n.z * inverse};
}

/// Cosine between the normal and the way back to the camera.
VDBCARVE_HD float sight_cosine(const StereoLens& lens, const Vec3& normal, float u, float v) {
    const Vec3 r = stereo_ray(lens, u, v);
    return -dot(normal, r) / std::sqrt(dot(r, r));
}

/// The plane of that normal (sight_cosine above 0) at s.
VDBCARVE_HD StereoPlane plane_of_normal(const StereoLens& lens, const Vec3& n, float s, float u, float v) {
    if (lens.orthographic) {
        const float su = -n.x / (lens.fx * n.z);
        return {s, su, (-n.y / n.z - lens.skew * su) / lens.fy};
    }
    const float f = s / dot(n, stereo_ray(lens, u, v));
    const float su = f * n.x / lens.fx;
    return {s, su, (f * n.y - lens.skew * su) / lens.fy};
}

/// What a plane says at a pixel so many beside its own.
VDBCARVE_HD StereoPlane moved(const StereoPlane& p, float du, float dv) { return {p.s + du * p.su + dv * p.sv, p.su, p.sv}; }

VDBCARVE_HD float depth_of(const StereoLens& lens, float s) { return lens.orthographic ? s : 1.f / s; }

// ------------------------------------------------------------------------------------ a view and those it is compared with

/// What the hull says of a line of sight.
struct HullSight {
    float front, back;  ///< s; 0: there is no hull
    Vec3 normal;        ///< towards the camera, camera space
};

/// A plane and what it costs.
struct StereoBest {
    StereoPlane plane;
    float cost;
};

/// Everything about one reference view. Borrowed.
struct StereoReference {
    StereoImage image;
    StereoLens lens;
    int view, pairs;
    StereoPair pair[kMostStereoPairs];
    StereoImage other[kMostStereoPairs];
    const HullSight* hull;       ///< of every pixel; front 0 also where the pixel is not of the object
    const StereoBest* coarse;    ///< planes found at half the working size, to begin with; null: there are none
    const float* coarse_likely;  ///< of these, 0: not to be trusted
    int coarse_width, coarse_height;
    float margin;  ///< the search begins so much before the hull, world units
};

/// Between which s the search goes at a pixel of the object.
struct StereoRange {
    float lo, hi;
};
VDBCARVE_HD StereoRange range_of(const StereoReference& r, int at) {
    const float front = r.hull[at].front, back = r.hull[at].back;
    const float first = r.lens.orthographic ? front - r.margin : front / max_f(1.f - r.margin * front, 0.1f);
    return {min_f(first, back), max_f(first, back)};
}

/// The pixel of half the working size that a pixel lies in; -1: there is none.
VDBCARVE_HD int coarse_pixel(const StereoReference& r, int x, int y) {
    return r.coarse && x / 2 < r.coarse_width && y / 2 < r.coarse_height ? y / 2 * r.coarse_width + x / 2 : -1;
}

// ------------------------------------------------------------------------------------ likeness

/// A reference window: what it shows, less its mean, times the weights; their sum is 1.
struct StereoWindow {
    float weight[kWindowSamples];
    float weighted[kWindowSamples];
    float mean, variance;
};

/// The pixels around (x, y) that are the object's, weighted by how near and how like its middle they are. (1 + d^2)^-2 stands for Gaussians: no library
/// function that differs between machines.
VDBCARVE_HD StereoWindow window_at(const StereoReference& r, int x, int y) {
    constexpr int kReach = (kWindowSide - 1) / 2;
    constexpr float kLike = 1.f / 0.12f, kNear = 1.f / 6.f;  // of brightness; of pixels
    StereoWindow w;
    const float middle = r.image.grey[y * r.image.width + x];
    float sum = 0.f, mean = 0.f;
    float value[kWindowSamples];
    for (int n = 0; n < kWindowSamples; ++n) {
        const int du = (n % kWindowSide - kReach) * kWindowStep_px, dv = (n / kWindowSide - kReach) * kWindowStep_px;
        const int i = x + du, j = y + dv;
        w.weight[n] = 0.f;
        value[n] = 0.f;
        if (i < 0 || j < 0 || i >= r.image.width || j >= r.image.height || r.hull[j * r.image.width + i].front == 0.f) continue;
        value[n] = r.image.grey[j * r.image.width + i] - middle;
        const float like = value[n] * kLike, a = 1.f / (1.f + like * like), b = 1.f / (1.f + static_cast<float>(du * du + dv * dv) * (kNear * kNear));
        w.weight[n] = (a * a) * (b * b);
        sum += w.weight[n];
        mean += w.weight[n] * value[n];
    }
    const float inverse = 1.f / sum;  // the middle itself weighs 1
    mean *= inverse;
    w.variance = 0.f;
    for (int n = 0; n < kWindowSamples; ++n) {
        w.weight[n] *= inverse;
        w.weighted[n] = w.weight[n] * (value[n] - mean);
        w.variance += w.weighted[n] * (value[n] - mean);
    }
    w.mean = middle + mean;
    return w;
}

#if !defined(__CUDA_ARCH__)
/// Steps to a window's samples.
constexpr float kAcross[kWindowSamples] = {-2, -1, 0, 1, 2, -2, -1, 0, 1, 2, -2, -1, 0, 1, 2, -2, -1, 0, 1, 2, -2, -1, 0, 1, 2};
constexpr float kDown[kWindowSamples] = {-2, -2, -2, -2, -2, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2};
#endif

/// 1 - ZNCC of the window and what another view shows of the same plane; kNoCost where that is not all in the picture.
VDBCARVE_HD float pair_cost(const StereoPair& pair, const StereoImage& other, const StereoWindow& w, const StereoPlane& plane, float u, float v) {
    constexpr float kStep = static_cast<float>(kWindowStep_px);
    const float* m = pair.from_pixel;
    float at[3], across[3], down[3];
    for (int a = 0; a < 3; ++a) {
        at[a] = m[3 * a] * u + m[3 * a + 1] * v + m[3 * a + 2] + plane.s * pair.along[a];
        across[a] = kStep * (m[3 * a] + plane.su * pair.along[a]);
        down[a] = kStep * (m[3 * a + 1] + plane.sv * pair.along[a]);
    }
    float mean = 0.f, square = 0.f, product = 0.f;
    const float width = static_cast<float>(other.width - 1), height = static_cast<float>(other.height - 1);
#if defined(__CUDA_ARCH__)
    constexpr int kReach = (kWindowSide - 1) / 2;
    for (int n = 0; n < kWindowSamples; ++n) {
        const float fi = static_cast<float>(n % kWindowSide - kReach), fj = static_cast<float>(n / kWindowSide - kReach);
        const float z = at[2] + fi * across[2] + fj * down[2];
        const float inverse = 1.f / z;
        const float x = (at[0] + fi * across[0] + fj * down[0]) * inverse - 0.5f, y = (at[1] + fi * across[1] + fj * down[1]) * inverse - 0.5f;
        if (!(z > 0.f && x >= 0.f && y >= 0.f && x < width && y < height)) return kNoCost;
        const int xi = static_cast<int>(x), yi = static_cast<int>(y);
        const float a = x - static_cast<float>(xi), b = y - static_cast<float>(yi);
        const float* p = other.grey + yi * other.width + xi;
        const float top = p[0] + a * (p[1] - p[0]), bottom = p[other.width] + a * (p[other.width + 1] - p[other.width]);
        const float value = top + b * (bottom - top) - w.mean;
        const float weighted = w.weight[n] * value;
        mean += weighted;
        square += weighted * value;
        product += w.weighted[n] * value;
    }
#else
    // The same in loops that become vectors; the sums stay in order.
    float xs[kWindowSamples], ys[kWindowSamples], values[kWindowSamples];
    int outside = 0;
    for (int n = 0; n < kWindowSamples; ++n) {
        const float fi = kAcross[n], fj = kDown[n];
        const float z = at[2] + fi * across[2] + fj * down[2];
        const float inverse = 1.f / z;
        const float x = (at[0] + fi * across[0] + fj * down[0]) * inverse - 0.5f, y = (at[1] + fi * across[1] + fj * down[1]) * inverse - 0.5f;
        outside |= static_cast<int>(!(z > 0.f)) | static_cast<int>(!(x >= 0.f)) | static_cast<int>(!(y >= 0.f)) | static_cast<int>(!(x < width)) |
                   static_cast<int>(!(y < height));
        xs[n] = x;
        ys[n] = y;
    }
    if (outside) return kNoCost;
    const float* const grey = other.grey;
    const int stride = other.width;
    for (int n = 0; n < kWindowSamples; ++n) {
        const int xi = static_cast<int>(xs[n]), yi = static_cast<int>(ys[n]);
        const float a = xs[n] - static_cast<float>(xi), b = ys[n] - static_cast<float>(yi);
        const int first = yi * stride + xi;
        const float top = grey[first] + a * (grey[first + 1] - grey[first]),
                    bottom = grey[first + stride] + a * (grey[first + stride + 1] - grey[first + stride]);
        values[n] = top + b * (bottom - top) - w.mean;
    }
    for (int n = 0; n < kWindowSamples; ++n) {
        const float weighted = w.weight[n] * values[n];
        mean += weighted;
        square += weighted * values[n];
        product += w.weighted[n] * values[n];
    }
#endif
    const float variance = max_f(square - mean * mean, 0.f);
    return 1.f - product / std::sqrt((w.variance + kLeastVariance) * (variance + kLeastVariance));
}

/// Mean of the better half of the views' costs (at least two): the others do not see the place, or see it badly. Views are no longer asked once it cannot be
/// less than `enough`, and that is returned.
VDBCARVE_HD float plane_cost(const StereoReference& r, const StereoWindow& w, const StereoPlane& plane, float u, float v, float enough) {
    float cost[kMostStereoPairs];
    const int half = r.pairs < 4 ? (r.pairs < 2 ? r.pairs : 2) : r.pairs / 2;
    for (int p = 0; p < r.pairs; ++p) {
        const float c = pair_cost(r.pair[p], r.other[p], w, plane, u, v);
        int at = p;
        for (; at > 0 && cost[at - 1] > c; --at) cost[at] = cost[at - 1];
        cost[at] = c;
        // Those that are still to come may cost nothing.
        float least = 0.f;
        for (int n = 0; n < half - (r.pairs - 1 - p); ++n) least += cost[n];
        if (least >= enough * static_cast<float>(half)) return enough;
    }
    float sum = 0.f;
    for (int p = 0; p < half; ++p) sum += cost[p];
    return sum / static_cast<float>(half);
}

// ------------------------------------------------------------------------------------ search

/// Numbers that depend on nothing but what they are asked for (Jarzynski and Olano 2020, pcg).
VDBCARVE_HD uint32_t scrambled(uint32_t x) {
    x = x * 747796405u + 2891336453u;
    const uint32_t word = ((x >> ((x >> 28u) + 4u)) ^ x) * 277803737u;
    return (word >> 22u) ^ word;
}
struct StereoDice {
    uint32_t state;
};
VDBCARVE_HD StereoDice dice_of(int view, int pixel, int pass) {
    return {scrambled(static_cast<uint32_t>(pixel) ^ scrambled(static_cast<uint32_t>(view) * 64u + static_cast<uint32_t>(pass)))};
}
/// -1 to 1.
VDBCARVE_HD float thrown(StereoDice& dice) {
    dice.state = scrambled(dice.state);
    return static_cast<float>(dice.state >> 8) * (2.f / 16777216.f) - 1.f;
}

/// Takes the candidate where it is possible and better.
VDBCARVE_HD void try_plane(const StereoReference& r, const StereoWindow& w, const StereoRange& range, const StereoPlane& plane, float u, float v,
                           StereoBest& best) {
    if (!(plane.s >= range.lo && plane.s <= range.hi)) return;
    if (!(sight_cosine(r.lens, plane_normal(r.lens, plane, u, v), u, v) >= kLeastStereoCosine)) return;
    const float cost = plane_cost(r, w, plane, u, v, best.cost);
    if (cost < best.cost) best = {plane, cost};
}

VDBCARVE_HD Vec3 tilted(const Vec3& n, StereoDice& dice, float by) {
    const Vec3 m{n.x + by * thrown(dice), n.y + by * thrown(dice), n.z + by * thrown(dice)};
    const float inverse = 1.f / std::sqrt(max_f(dot(m, m), 1e-12f));
    return {m.x * inverse, m.y * inverse, m.z * inverse};
}

inline constexpr int kFirstTries = 6;
inline constexpr float kGoodCost = 1.f;  ///< less than that a window and what it is compared with have something in common

/// A pixel's first plane: the one that half the working size found, the hull's own, or, where the former is no good, one behind the hull.
VDBCARVE_HD StereoBest first_plane(const StereoReference& r, int x, int y) {
    const int at = y * r.image.width + x;
    StereoBest best{{0.f, 0.f, 0.f}, kNoCost};
    if (r.hull[at].front == 0.f) return best;
    const float u = static_cast<float>(x) + 0.5f, v = static_cast<float>(y) + 0.5f;
    const StereoWindow w = window_at(r, x, y);
    const StereoRange range = range_of(r, at);
    StereoDice dice = dice_of(r.view, at, 0);
    if (const int c = coarse_pixel(r, x, y); c >= 0) {
        const StereoBest& found = r.coarse[c];
        const StereoPlane p = moved(found.plane, x % 2 ? 0.25f : -0.25f, y % 2 ? 0.25f : -0.25f);
        if (found.cost < kNoCost) try_plane(r, w, range, {p.s, 0.5f * p.su, 0.5f * p.sv}, u, v, best);
    }
    const int tries = best.cost < kGoodCost ? 1 : kFirstTries;
    for (int n = 0; n < tries; ++n) {
        // Most surfaces are near the hull: squares of even numbers lie towards it.
        const float deep = 0.5f + 0.5f * thrown(dice);
        const float s = n == 0 ? r.hull[at].front : r.hull[at].front + deep * deep * (r.hull[at].back - r.hull[at].front);
        const Vec3 normal = n == 0 ? r.hull[at].normal : tilted(r.hull[at].normal, dice, 0.5f);
        if (!(sight_cosine(r.lens, normal, u, v) >= kLeastStereoCosine)) {
            const Vec3 ray = stereo_ray(r.lens, u, v);
            const float back = -1.f / std::sqrt(dot(ray, ray));
            try_plane(r, w, range, plane_of_normal(r.lens, {ray.x * back, ray.y * back, ray.z * back}, s, u, v), u, v, best);
        } else {
            try_plane(r, w, range, plane_of_normal(r.lens, normal, s, u, v), u, v, best);
        }
    }
    return best;
}

/// One pass over a pixel: planes of pixels of the other colour of a chessboard, of each of four ways the one that costs least where it is (Xu and Tao 2019,
/// ACMH), then changes at random, halved from pass to pass. `planes` are those of all pixels.
VDBCARVE_HD StereoBest better_plane(const StereoReference& r, const StereoBest* planes, int x, int y, int pass) {
    const int width = r.image.width, at = y * width + x;
    StereoBest best = planes[at];
    if (r.hull[at].front == 0.f) return best;
    const float u = static_cast<float>(x) + 0.5f, v = static_cast<float>(y) + 0.5f;
    const StereoWindow w = window_at(r, x, y);
    const StereoRange range = range_of(r, at);
    for (int way = 0; way < 4; ++way) {
        int from = -1, du = 0, dv = 0;
        float least = kNoCost;
        for (int step = 1; step < 8; step += 2) {
            const int side = way & 1 ? step : -step, i = way & 2 ? x : x + side, j = way & 2 ? y + side : y;
            if (i < 0 || j < 0 || i >= width || j >= r.image.height || r.hull[j * width + i].front == 0.f || !(planes[j * width + i].cost < least)) continue;
            from = j * width + i;
            least = planes[from].cost;
            du = x - i;
            dv = y - j;
        }
        if (from >= 0) try_plane(r, w, range, moved(planes[from].plane, static_cast<float>(du), static_cast<float>(dv)), u, v, best);
    }
    StereoDice dice = dice_of(r.view, at, pass + 1);
    float reach = 1.f;
    for (int n = 0; n < pass; ++n) reach *= 0.5f;
    for (int n = 0; n < 3; ++n) {
        if (best.cost >= kNoCost) break;
        const Vec3 normal = plane_normal(r.lens, best.plane, u, v);
        // Depth alone, tilt alone, both a little.
        const float by = n == 2 ? 0.25f * reach : reach;
        const float s = n == 1 ? best.plane.s : best.plane.s + 0.25f * by * thrown(dice) * (range.hi - range.lo);
        const Vec3 turned = n == 0 ? normal : tilted(normal, dice, 0.5f * by);
        if (sight_cosine(r.lens, turned, u, v) >= kLeastStereoCosine) try_plane(r, w, range, plane_of_normal(r.lens, turned, s, u, v), u, v, best);
    }
    return best;
}

// ------------------------------------------------------------------------------------ trust

/// What a depth has to show for itself. Pixels are of the working size.
struct StereoTrustRule {
    float most_cost, least_variance, least_margin;
    int agreeing;
    float agreement_px, normal_cosine;
};

/// Whether another place on the line of sight, at least three pixels away in some view, is as good but for less than the margin: repeated patterns and blank
/// walls have such rivals.
VDBCARVE_HD bool has_rival(const StereoReference& r, const StereoWindow& w, const StereoBest& best, float least_margin, int x, int y) {
    constexpr int kRivals = 24;
    constexpr float kApart_px = 3.f;
    const float u = static_cast<float>(x) + 0.5f, v = static_cast<float>(y) + 0.5f;
    const StereoRange range = range_of(r, y * r.image.width + x);
    const Vec3 normal = plane_normal(r.lens, best.plane, u, v);
    const float enough = best.cost + least_margin;
    for (int n = 0; n < kRivals; ++n) {
        const float s = range.lo + (static_cast<float>(n) + 0.5f) / kRivals * (range.hi - range.lo);
        float apart = 0.f;
        for (int p = 0; p < r.pairs; ++p) {
            const float* m = r.pair[p].from_pixel;
            const float* t = r.pair[p].along;
            float at[2][3];
            for (int k = 0; k < 2; ++k)
                for (int a = 0; a < 3; ++a) at[k][a] = m[3 * a] * u + m[3 * a + 1] * v + m[3 * a + 2] + (k ? s : best.plane.s) * t[a];
            const float dx = at[0][0] / at[0][2] - at[1][0] / at[1][2], dy = at[0][1] / at[0][2] - at[1][1] / at[1][2];
            apart = max_f(apart, dx * dx + dy * dy);
        }
        if (!(apart > kApart_px * kApart_px)) continue;
        if (plane_cost(r, w, plane_of_normal(r.lens, normal, s, u, v), u, v, enough) < enough) return true;
    }
    return false;
}

/// How likely the best plane is the surface, by what its own view and those it was compared with show; 0: not to be trusted.
VDBCARVE_HD float likelihood(const StereoReference& r, const StereoBest& best, const StereoTrustRule& rule, int x, int y) {
    if (r.hull[y * r.image.width + x].front == 0.f || !(best.cost < rule.most_cost)) return 0.f;
    const StereoWindow w = window_at(r, x, y);
    if (!(w.variance >= rule.least_variance)) return 0.f;
    // Half the working size has looked for rivals already.
    const int c = coarse_pixel(r, x, y);
    return !(c >= 0 && r.coarse_likely[c] > 0.f) && has_rival(r, w, best, rule.least_margin, x, y) ? 0.f : 1.f - best.cost;
}

/// Depths of another view, to agree with.
struct StereoDepths {
    const StereoBest* planes;
    const float* likely;  ///< 0: not to be asked
    StereoLens lens;
    int width, height;
};

/// Whether another view's depth and normal say the same of a reference pixel's place.
VDBCARVE_HD bool agrees(const StereoReference& r, const StereoPair& pair, const StereoDepths& other, const StereoPlane& plane, const Vec3& normal,
                        const StereoTrustRule& rule, float u, float v) {
    const float* m = pair.from_pixel;
    float at[3];
    for (int a = 0; a < 3; ++a) at[a] = m[3 * a] * u + m[3 * a + 1] * v + m[3 * a + 2] + plane.s * pair.along[a];
    if (!(at[2] > 0.f)) return false;
    const float x = at[0] / at[2], y = at[1] / at[2];
    if (!(x >= 0.f && y >= 0.f && x < static_cast<float>(other.width) && y < static_cast<float>(other.height))) return false;
    const int i = static_cast<int>(x), j = static_cast<int>(y), n = j * other.width + i;
    if (!(other.likely[n] > 0.f)) return false;
    const float there = (pair.depth[0] * u + pair.depth[1] * v + pair.depth[2] + plane.s * pair.depth[3]) / (r.lens.orthographic ? 1.f : plane.s);
    const float ou = static_cast<float>(i) + 0.5f, ov = static_cast<float>(j) + 0.5f;
    const float found = depth_of(other.lens, moved(other.planes[n].plane, x - ou, y - ov).s);
    // How far the place would move in the other picture if the reference's depth were wrong by the difference.
    const float inverse = 1.f / at[2];
    const float dx = (pair.along[0] - x * pair.along[2]) * inverse, dy = (pair.along[1] - y * pair.along[2]) * inverse;
    const float deeper = found - there, shortened = 1.f + plane.s * deeper;
    if (!r.lens.orthographic && !(shortened > 0.f)) return false;  // before the reference's camera
    const float ds = r.lens.orthographic ? deeper : plane.s * plane.s * deeper / shortened;
    if (!((dx * dx + dy * dy) * (ds * ds) <= rule.agreement_px * rule.agreement_px)) return false;
    const Vec3 o = plane_normal(other.lens, other.planes[n].plane, ou, ov);
    const float* t = pair.turn;
    const Vec3 turned{t[0] * normal.x + t[1] * normal.y + t[2] * normal.z, t[3] * normal.x + t[4] * normal.y + t[5] * normal.z,
                      t[6] * normal.x + t[7] * normal.y + t[8] * normal.z};
    return dot(o, turned) >= rule.normal_cosine;
}

/// A pixel's likelihood where enough other views agree, else 0. `depths` are those of all views.
VDBCARVE_HD float agreed_likelihood(const StereoReference& r, const StereoDepths* depths, const StereoTrustRule& rule, int x, int y) {
    const StereoDepths& own = depths[r.view];
    const int n = y * own.width + x;
    if (!(own.likely[n] > 0.f)) return 0.f;
    const float u = static_cast<float>(x) + 0.5f, v = static_cast<float>(y) + 0.5f;
    const Vec3 normal = plane_normal(r.lens, own.planes[n].plane, u, v);
    int agreeing = 0;
    for (int p = 0; p < r.pairs; ++p)
        if (depths[r.pair[p].view].planes) agreeing += agrees(r, r.pair[p], depths[r.pair[p].view], own.planes[n].plane, normal, rule, u, v);
    return agreeing >= rule.agreeing ? own.likely[n] : 0.f;
}

// ------------------------------------------------------------------------------------ fusion

/// A view's trusted depths, for voxels. Borrowed.
struct FusionView {
    float pixel_from_index[12];  ///< homogeneous, voxels from the base
    float depth_from_index[4];   ///< voxels
    const StereoBest* planes;
    const float* confidence;  ///< 0: nothing is known
    StereoLens lens;
    int width, height;
    float per_voxel;  ///< 1 / voxel size
    float weight;     ///< of all its depths
};

/// What depths say of a place; distances in voxels, outwards.
struct Fused {
    float sum = 0.f, weight = 0.f;  ///< of distances, cut at the truncation
    float nearest_weight = 0.f;     ///< of those within it
    int views = 0;
};

/// Adds what one view says of the voxel (i, j, k) from the base: its distance to the plane seen there, at most the truncation; nothing where it lies deeper
/// behind it than `reach_vox`. That reaches farther than the truncation, so that a view that sees through a thin part does not outvote those that see its
/// surface.
VDBCARVE_HD void fuse_view(const FusionView& f, float i, float j, float k, float reach_vox, float truncation_vox, Fused& out) {
    const float* m = f.pixel_from_index;
    const float w = m[8] * i + m[9] * j + m[10] * k + m[11];
    if (!(w > 0.f)) return;
    const float inverse = 1.f / w;
    const float u = (m[0] * i + m[1] * j + m[2] * k + m[3]) * inverse, v = (m[4] * i + m[5] * j + m[6] * k + m[7]) * inverse;
    if (!(u >= 0.f && v >= 0.f && u < static_cast<float>(f.width) && v < static_cast<float>(f.height))) return;
    const int x = static_cast<int>(u), y = static_cast<int>(v), n = y * f.width + x;
    const float confidence = f.confidence[n];
    if (!(confidence > 0.f)) return;
    const float du = u - (static_cast<float>(x) + 0.5f), dv = v - (static_cast<float>(y) + 0.5f);
    const StereoPlane plane = f.planes[n].plane, here = moved(plane, du, dv);
    const Vec3 normal = plane_normal(f.lens, plane, u - du, v - dv), ray = stereo_ray(f.lens, u, v);
    const float z = f.depth_from_index[0] * i + f.depth_from_index[1] * j + f.depth_from_index[2] * k + f.depth_from_index[3];
    const float distance = (depth_of(f.lens, here.s) * f.per_voxel - z) * -dot(normal, ray);
    if (!(distance >= -reach_vox)) return;
    const float weight = f.weight * confidence * sight_cosine(f.lens, normal, u, v);
    if (!(weight > 0.f)) return;
    out.sum += weight * min_f(distance, truncation_vox);
    out.weight += weight;
    if (distance < truncation_vox) out.nearest_weight += weight;
    ++out.views;
}

/// How depths and the hull share a voxel; lengths in voxels but for `voxel` and `band`, in world units.
struct FusionRule {
    float voxel, band;
    float reach, truncation;  ///< of fuse_view
    float full_weight;        ///< from which on depths count as much as the hull; from half of it on they begin to
    float hull_margin;        ///< by which they have to say more near the hull
};

struct FusedVoxel {
    float value, confidence;  ///< world units; 0..1
};

/// A voxel of the hull's inside, `before`, and what the depths leave of it.
VDBCARVE_HD FusedVoxel carved_voxel(const FusionRule& rule, const Fused& depths, float before) {
    FusedVoxel out{before, 0.f};
    if (depths.views < 2) return out;
    const float trust = min_f(max_f(2.f * depths.weight / rule.full_weight - 1.f, 0.f), 1.f);
    out.confidence = min_f(1.f, 0.5f * depths.nearest_weight / rule.full_weight);
    const float near_hull = min_f(max_f(1.f + before / rule.band, 0.f), 1.f);
    const float distance = (trust * (depths.sum / depths.weight) - (1.f - trust) * rule.truncation - rule.hull_margin * near_hull) * rule.voxel;
    if (distance > before) out.value = min_f(max_f(distance, -rule.band), rule.band);
    return out;
}

}  // namespace vdbcarve::kernel
