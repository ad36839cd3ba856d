// SPDX-License-Identifier: Apache-2.0
// The arithmetic of colouring: which voxels, seen by which views, and what becomes of the colours they show.
//
// Frames: `index` (voxel centres at integers), points and eyes counted from a base near the surface (ColorBase), image pixels with the first pixel's centre at
// (0.5, 0.5). Colours are linear light. Means are written as c0 + sum w (c - c0) / sum w: equal colours give exactly that colour.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/ray.h"
#include "vdbcarve/kernel/rgb.h"

namespace vdbcarve::kernel {

/// A weighted mean about its first term.
struct RgbMean {
    Rgb first{}, sum{};
    float weight = 0.f;

    VDBCARVE_HD void add(const Rgb& c, float w) {
        if (weight == 0.f) first = c;
        sum = plus(sum, w, minus(c, first));
        weight += w;
    }
    /// Needs a term.
    VDBCARVE_HD Rgb value() const { return {first.r + sum.r / weight, first.g + sum.g / weight, first.b + sum.b / weight}; }
};

// ------------------------------------------------------------------------------------ the surface's voxels

/// A point on the surface and its outward unit normal, voxels from the base.
struct SurfacePoint {
    float x, y, z, nx, ny, nz;
};

/// True for the contour of the volume, the shell one voxel thick inside the surface: voxels inside with a face neighbour outside.
template <class Value>
VDBCARVE_HD bool is_contour(const Value& value, float here, int i, int j, int k) {
    if (!(here < 0.f)) return false;
    return value(i - 1, j, k) >= 0.f || value(i + 1, j, k) >= 0.f || value(i, j - 1, k) >= 0.f || value(i, j + 1, k) >= 0.f || value(i, j, k - 1) >= 0.f ||
           value(i, j, k + 1) >= 0.f;
}

/// Outward unit normal from central differences of the level set; where they cancel, (0, 0, 0).
template <class Value>
VDBCARVE_HD Vec3 field_normal(const Value& value, int i, int j, int k) {
    const float x = value(i + 1, j, k) - value(i - 1, j, k), y = value(i, j + 1, k) - value(i, j - 1, k), z = value(i, j, k + 1) - value(i, j, k - 1);
    const float size2 = x * x + y * y + z * z;
    if (!(size2 > 0.f)) return {0.f, 0.f, 0.f};
    const float inverse = 1.f / std::sqrt(size2);
    return {x * inverse, y * inverse, z * inverse};
}

/// The paper's normal of a binary model: its gradient in a window of `radius` voxels on every side, weighted by a Gaussian
/// (weights[d2], d2 the squared distance in voxels). The gradient of a step is summed by parts: every voxel outside pulls towards itself.
template <class Value>
VDBCARVE_HD Vec3 windowed_normal(const Value& value, int i, int j, int k, int radius, const float* weights) {
    float x = 0.f, y = 0.f, z = 0.f;
    for (int a = -radius; a <= radius; ++a)
        for (int b = -radius; b <= radius; ++b)
            for (int c = -radius; c <= radius; ++c) {
                const float w = value(i + a, j + b, k + c) < 0.f ? -weights[a * a + b * b + c * c] : weights[a * a + b * b + c * c];
                x += w * static_cast<float>(a);
                y += w * static_cast<float>(b);
                z += w * static_cast<float>(c);
            }
    const float size2 = x * x + y * y + z * z;
    if (!(size2 > 0.f)) return {0.f, 0.f, 0.f};
    const float inverse = 1.f / std::sqrt(size2);
    return {x * inverse, y * inverse, z * inverse};
}

/// How normals are found.
struct NormalRule {
    int radius_vox;        ///< 0: field_normal
    const float* weights;  ///< of windowed_normal
};

/// The surface point nearest to a contour voxel.
template <class Value>
VDBCARVE_HD SurfacePoint surface_point(const Value& value, float here, float voxel_size, int i, int j, int k, const NormalRule& rule, const ColorBase& base) {
    const Vec3 n = rule.radius_vox > 0 ? windowed_normal(value, i, j, k, rule.radius_vox, rule.weights) : field_normal(value, i, j, k);
    const float out = -here / voxel_size;
    return {static_cast<float>(i - base.i) + out * n.x, static_cast<float>(j - base.j) + out * n.y, static_cast<float>(k - base.k) + out * n.z, n.x, n.y, n.z};
}

// ------------------------------------------------------------------------------------ views

/// One photograph with its camera. Trivially copyable; pointers are borrowed.
struct ColorView : Projection {
    /// Row-major 3x4: camera-space point (world units) = matrix * (i, j, k, 1), voxels from the base.
    double camera_from_index[12];
    Vec3 eye;                ///< camera centre, voxels from the base; orthographic: unit direction towards the camera
    float width, height;     ///< of the photograph, px
    float near_depth;        ///< world units
    float voxel_px;          ///< pixels across a voxel at depth 1 (perspective) or anywhere (orthographic)
    FieldView silhouette;    ///< of the object without what is ignored, one sample a pixel
    const uint8_t* texels8;  ///< sRGB, interleaved; or
    const uint16_t* texels16;
    int channels;         ///< 1, 3 or 4
    const float* linear;  ///< linear light of every value a texel can have
    float gain[3];
};

inline constexpr float kLeastCosine = 0.1f;     ///< more grazing views are not asked
inline constexpr float kEdgeMargin_px = 3.f;    ///< nearer to a silhouette's edge, inside it, no sample is taken
inline constexpr float kFullMargin_px = 10.f;   ///< from here on the edge costs no weight
inline constexpr int kMarginReach_px = 12;      ///< of the silhouettes' distance fields
inline constexpr float kSightStart_vox = 2.f;   ///< lines of sight begin so far out, along the normal
inline constexpr float kSightBlock_vox = 0.5f;  ///< and end at voxels nearer to the surface than this
inline constexpr int kMaxTaps = 4;

/// How views are chosen.
struct ColorRule {
    int best;            ///< 1: the paper's, one view, the one most in front; 0: blend
    int test_occlusion;  ///< 0: the paper's fault
    int skip_upright;    ///< 1: listing 4.2's first lines: faces that look straight up or down stay without colour
    Vec3 up;
    SightBox box;
};

/// Listing 4.2 skips normals along the vertical axis; with real-valued normals, within 2.6 degrees of it.
inline constexpr float kUprightCosine = 0.999f;

/// What a view could say about a point if nothing stands between.
struct Sight {
    float weight;  ///< 0: nothing
    float cosine;  ///< between normal and line of sight
    float u, v;    ///< image position
    int taps;      ///< samples a side that cover a voxel
};

VDBCARVE_HD Vec3 towards_eye(const ColorView& view, const SurfacePoint& p, float& distance) {
    if (view.orthographic) {
        distance = 1e30f;
        return view.eye;
    }
    const float x = view.eye.x - p.x, y = view.eye.y - p.y, z = view.eye.z - p.z;
    distance = std::sqrt(x * x + y * y + z * z);
    const float inverse = 1.f / distance;
    return {x * inverse, y * inverse, z * inverse};
}

VDBCARVE_HD Sight sight_of(const ColorView& view, const SurfacePoint& p, int best) {
    Sight out{0.f, 0.f, 0.f, 0.f, 1};
    // Most views are on the other side: no root for those.
    if (!view.orthographic) {
        const float x = view.eye.x - p.x, y = view.eye.y - p.y, z = view.eye.z - p.z;
        if (!(x * p.nx + y * p.ny + z * p.nz > 0.f)) return out;
    }
    float distance;
    const Vec3 d = towards_eye(view, p, distance);
    out.cosine = d.x * p.nx + d.y * p.ny + d.z * p.nz;
    if (!(out.cosine > kLeastCosine)) return out;
    const double* m = view.camera_from_index;
    const Vec3 c{static_cast<float>(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3]), static_cast<float>(m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7]),
                 static_cast<float>(m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11])};
    if (!view.orthographic && !(c.z > view.near_depth)) return out;
    const Projected at = project(view, c);
    out.u = at.u;
    out.v = at.v;
    // All texels of the finest sample must be in the picture.
    if (!(at.u >= 0.5f && at.v >= 0.5f && at.u <= view.width - 0.5f && at.v <= view.height - 0.5f)) return out;
    const float pixels = view.orthographic ? view.voxel_px : view.voxel_px / c.z;
    const float margin = interpolate(fetch_patch(view.silhouette, at.u, at.v)) * (-1.f / kFieldUnits);
    if (!(margin >= kEdgeMargin_px)) return out;
    // The sample farthest out must keep the margin too.
    const int covering = static_cast<int>(pixels + 0.5f), fitting = static_cast<int>((margin - kEdgeMargin_px) * 1.4142135f) + 1;
    const int taps = covering < fitting ? covering : fitting;
    out.taps = taps < 1 ? 1 : (taps > kMaxTaps ? kMaxTaps : taps);
    if (best) {
        out.weight = out.cosine;
        return out;
    }
    const float t = min_f(margin * (1.f / kFullMargin_px), 1.f), c2 = out.cosine * out.cosine;
    out.weight = c2 * c2 * (t * t * (3.f - 2.f * t)) * pixels;
    return out;
}

VDBCARVE_HD bool is_visible(SightCells& cells, const ColorView& view, const SurfacePoint& p, const ColorRule& rule) {
    const SurfacePoint start{p.x + kSightStart_vox * p.nx, p.y + kSightStart_vox * p.ny, p.z + kSightStart_vox * p.nz, p.nx, p.ny, p.nz};
    float distance;
    const Vec3 d = towards_eye(view, start, distance);
    return !is_blocked(cells, rule.box, {start.x, start.y, start.z}, d, distance);
}

VDBCARVE_HD Rgb texel(const ColorView& view, int x, int y) {
    const int64_t at = (static_cast<int64_t>(y) * static_cast<int64_t>(view.width) + x) * view.channels;
    const int green = view.channels < 3 ? 0 : 1, blue = view.channels < 3 ? 0 : 2;
    if (view.texels16) return {view.linear[view.texels16[at]], view.linear[view.texels16[at + green]], view.linear[view.texels16[at + blue]]};
    return {view.linear[view.texels8[at]], view.linear[view.texels8[at + green]], view.linear[view.texels8[at + blue]]};
}

/// Bilinear in linear light, no gain; positions are clamped to the picture.
VDBCARVE_HD Rgb sample_bilinear(const ColorView& view, float u, float v) {
    const float x = clamp_f(u - 0.5f, 0.f, view.width - 1.f), y = clamp_f(v - 0.5f, 0.f, view.height - 1.f);
    const int w = static_cast<int>(view.width), h = static_cast<int>(view.height);
    int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
    x0 = x0 > w - 2 ? w - 2 : x0;
    y0 = y0 > h - 2 ? h - 2 : y0;
    const float a = x - static_cast<float>(x0), b = y - static_cast<float>(y0);
    const Rgb c00 = texel(view, x0, y0), c10 = texel(view, x0 + 1, y0), c01 = texel(view, x0, y0 + 1), c11 = texel(view, x0 + 1, y0 + 1);
    const Rgb top = plus(c00, a, minus(c10, c00)), bottom = plus(c01, a, minus(c11, c01));
    return plus(top, b, minus(bottom, top));
}

/// The mean over a voxel's footprint: taps x taps bilinear samples, a pixel apart.
VDBCARVE_HD Rgb sample_photo(const ColorView& view, const Sight& sight) {
    if (sight.taps == 1) return sample_bilinear(view, sight.u, sight.v);
    const float first = -0.5f * static_cast<float>(sight.taps - 1);
    RgbMean mean;
    for (int j = 0; j < sight.taps; ++j)
        for (int i = 0; i < sight.taps; ++i)
            mean.add(sample_bilinear(view, sight.u + (first + static_cast<float>(i)), sight.v + (first + static_cast<float>(j))), 1.f);
    return mean.value();
}

// ------------------------------------------------------------------------------------ choosing

/// What one view shows of a point, gain applied.
struct Candidate {
    float weight;
    int view;
    Rgb color;
};

/// So many views are kept for a point, the weightiest that see it: enough for outliers to stand out among them.
inline constexpr int kCandidates = 6;

/// Weight decides, of equal ones the first view.
VDBCARVE_HD bool comes_before(float weight_a, int view_a, float weight_b, int view_b) {
    return weight_a > weight_b || (weight_a == weight_b && view_a < view_b);
}

VDBCARVE_HD int kept_candidates(const ColorRule& rule) { return rule.best ? 1 : kCandidates; }

/// Adds the views first <= i < last (views[0] is view `first`) to a point's candidates: afterwards `found` holds the weightiest
/// that see it, in order, whatever the batches were. Lines of sight are followed in order of weight, only while they can matter.
VDBCARVE_HD int find_views(SightCells& cells, const ColorView* views, int first, int last, const ColorRule& rule, const SurfacePoint& p, Candidate* found,
                           int count) {
    if (p.nx == 0.f && p.ny == 0.f && p.nz == 0.f) return count;
    if (rule.skip_upright) {
        const float upright = std::fabs(p.nx * rule.up.x + p.ny * rule.up.y + p.nz * rule.up.z);
        if (upright > kUprightCosine) return count;
    }
    constexpr int kAtOnce = 8;
    const int keep = kept_candidates(rule);
    float weights[kAtOnce];
    int numbers[kAtOnce];
    float taken_weight = 1e30f;
    int taken_view = -1;
    for (;;) {
        int n = 0;
        for (int i = first; i < last; ++i) {
            const float w = sight_of(views[i - first], p, rule.best).weight;
            if (!(w > 0.f) || !comes_before(taken_weight, taken_view, w, i)) continue;
            if (count == keep && !comes_before(w, i, found[keep - 1].weight, found[keep - 1].view)) continue;
            if (n == kAtOnce && !comes_before(w, i, weights[n - 1], numbers[n - 1])) continue;
            int at = n < kAtOnce ? n++ : n - 1;
            for (; at > 0 && comes_before(w, i, weights[at - 1], numbers[at - 1]); --at) {
                weights[at] = weights[at - 1];
                numbers[at] = numbers[at - 1];
            }
            weights[at] = w;
            numbers[at] = i;
        }
        for (int c = 0; c < n; ++c) {
            if (count == keep && !comes_before(weights[c], numbers[c], found[keep - 1].weight, found[keep - 1].view)) return count;
            const ColorView& view = views[numbers[c] - first];
            if (rule.test_occlusion && !is_visible(cells, view, p, rule)) continue;
            const Rgb seen = sample_photo(view, sight_of(view, p, rule.best));
            int at = count < keep ? count++ : keep - 1;
            for (; at > 0 && comes_before(weights[c], numbers[c], found[at - 1].weight, found[at - 1].view); --at) found[at] = found[at - 1];
            found[at] = {weights[c], numbers[c], {seen.r * view.gain[0], seen.g * view.gain[1], seen.b * view.gain[2]}};
        }
        if (n < kAtOnce) return count;
        taken_weight = weights[n - 1];
        taken_view = numbers[n - 1];
    }
}

/// What becomes of a point.
struct PointColor {
    Rgb color;
    float confidence;  ///< how squarely the best of its views looks at it (cosine); 0: none does
    int views;         ///< so many were blended
};

inline constexpr int kBlended = 3;
inline constexpr float kOutlierMads = 3.f * 1.4826f;      ///< a normal distribution's deviation is 1.4826 MAD
inline constexpr float kLeastOutlier = 0.02f;             ///< share of the median that is never an outlier
inline constexpr float kWidestBlendCosine = 0.76604444f;  ///< 40 degrees between the views' lines of sight

/// Where half the weight is below; `values` is sorted along the way. At most kCandidates.
VDBCARVE_HD float weighted_median(float* values, float* weights, int n) {
    float total = 0.f;
    for (int i = 1; i < n; ++i)
        for (int at = i; at > 0 && values[at] < values[at - 1]; --at) {
            const float v = values[at], w = weights[at];
            values[at] = values[at - 1];
            weights[at] = weights[at - 1];
            values[at - 1] = v;
            weights[at - 1] = w;
        }
    for (int i = 0; i < n; ++i) total += weights[i];
    float sum = 0.f;
    for (int i = 0; i < n; ++i) {
        sum += weights[i];
        if (sum + sum >= total) return values[i];
    }
    return values[n - 1];
}

/// Blends a point's candidates: those far from their weighted median (highlights, what a hull in front of its object shows) are left
/// out, and views from far apart, between which colours slide where the hull is not the object.
/// views[i] is view i.
VDBCARVE_HD PointColor decide_color(const ColorView* views, const ColorRule& rule, const SurfacePoint& p, const Candidate* found, int count) {
    PointColor out{{0.f, 0.f, 0.f}, 0.f, 0};
    if (count == 0) return out;
    float median = 0.f, limit = 1e30f;
    if (count > 2) {
        float values[kCandidates], weights[kCandidates];
        for (int i = 0; i < count; ++i) {
            values[i] = luminance(found[i].color);
            weights[i] = found[i].weight;
        }
        median = weighted_median(values, weights, count);
        for (int i = 0; i < count; ++i) {
            values[i] = std::fabs(luminance(found[i].color) - median);
            weights[i] = found[i].weight;
        }
        limit = kOutlierMads * weighted_median(values, weights, count) + kLeastOutlier * median;
    }
    RgbMean mean;
    Vec3 lead{0.f, 0.f, 0.f};
    for (int i = 0; i < count && out.views < kBlended; ++i) {
        if (std::fabs(luminance(found[i].color) - median) > limit) continue;
        float distance;
        const Vec3 d = towards_eye(views[found[i].view], p, distance);
        if (out.views == 0) lead = d;
        else if (d.x * lead.x + d.y * lead.y + d.z * lead.z < kWidestBlendCosine) continue;
        mean.add(found[i].color, rule.best ? 1.f : found[i].weight);
        out.confidence = max_f(out.confidence, d.x * p.nx + d.y * p.ny + d.z * p.nz);
        ++out.views;
    }
    out.color = mean.value();
    return out;
}

inline constexpr float kDarkest = 0.002f, kBrightest = 0.9f;  ///< linear light beyond which a sensor's answer bends

VDBCARVE_HD Observation observe(SightCells& cells, const ColorView& view, const SurfacePoint& p, const ColorRule& rule) {
    const Observation none{{0.f, 0.f, 0.f}, 0.f};
    const Sight sight = sight_of(view, p, 0);
    if (!(sight.weight > 0.f) || !is_visible(cells, view, p, rule)) return none;
    const Rgb c = sample_photo(view, sight);
    const float low = min_f(c.r, min_f(c.g, c.b)), high = max_f(c.r, max_f(c.g, c.b));
    if (low < kDarkest || high > kBrightest) return none;
    return {c, sight.weight};
}

// ------------------------------------------------------------------------------------ spreading over the band

/// Number of a voxel's layer: 0 for the contour, one more for every step away from it; kNoLayer: without colour so far.
inline constexpr uint8_t kNoLayer = 255;

/// The colour that a voxel takes over from its face neighbours of the layer before, weighted by how much nearer to the surface each
/// of them leads: grad phi . grad color = 0, upwind (what OpenVDB's sdfToExt solves), one layer at a time, so that order does not matter.
/// neighbour(face, value, color) is true where there is such a neighbour.
template <class Neighbour>
VDBCARVE_HD bool spread_color(float here, float least_weight, const Neighbour& neighbour, Rgb& out) {
    RgbMean mean;
    for (int face = 0; face < 6; ++face) {
        float value;
        Rgb color;
        if (!neighbour(face, value, color)) continue;
        mean.add(color, max_f(std::fabs(value - here), least_weight));
    }
    if (!(mean.weight > 0.f)) return false;
    out = mean.value();
    return true;
}

inline constexpr float kLeastSpread_vox = 1e-3f;

/// Trilinear between the eight voxels around an index position, of those that have a colour. read(i, j, k, color) is true
/// where one has. False where none has.
template <class Read>
VDBCARVE_HD bool interpolate_color(const Read& read, double x, double y, double z, Rgb& out) {
    const double fx = std::floor(x), fy = std::floor(y), fz = std::floor(z);
    const float a = static_cast<float>(x - fx), b = static_cast<float>(y - fy), c = static_cast<float>(z - fz);
    const int i = static_cast<int>(fx), j = static_cast<int>(fy), k = static_cast<int>(fz);
    RgbMean mean;
#pragma unroll 1
    for (int corner = 0; corner < 8; ++corner) {
        const int di = corner >> 2, dj = corner >> 1 & 1, dk = corner & 1;
        const float w = ((di ? a : 1.f - a) * (dj ? b : 1.f - b)) * (dk ? c : 1.f - c);
        Rgb color;
        if (w > 0.f && read(i + di, j + dj, k + dk, color)) mean.add(color, w);
    }
    if (!(mean.weight > 0.f)) return false;
    out = mean.value();
    return true;
}

}  // namespace vdbcarve::kernel
