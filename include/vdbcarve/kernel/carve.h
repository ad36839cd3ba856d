// SPDX-License-Identifier: Apache-2.0
// The arithmetic of carving: what one view says about one voxel, and about a whole node at once.
//
// Frames: `index` (voxel centres at integers), `camera` (OpenCV axes: x right, y down, z forward, in
// world units), `image` (pixels, the centre of the first pixel is (0.5, 0.5)).
// Sign everywhere: negative inside the object, positive outside, as in a level set.
// Every bound below is derived in src/derivations.md and has a property test.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

/// What a point outside a view's frame means.
enum class Outside : int {
    Unknown,    ///< the view says nothing there (default)
    Background  ///< the view carves there (the paper's rule)
};

/// One view, ready to be asked. Trivially copyable; the pointers are borrowed.
struct CarveView {
    /// Row-major 3x4: camera-space point (world units) = matrix * (i, j, k, 1), index coordinates.
    double camera_from_index[12];
    /// Pixel = [fx skew; 0 fy] * (X/Z, Y/Z) + (cx, cy); orthographic: without the division by Z.
    float fx, skew, fy, cx, cy;
    /// Largest singular value of [fx skew; 0 fy], in pixels: no direction is magnified more.
    float sigma_max;
    int width_px, height_px;
    int orthographic;
    Outside outside;
    /// Signed distance to the silhouette at every pixel centre, row-major, in pixels.
    const float* silhouette_px;
    /// Signed distance to the seen region at pixel centres (positive where the pixel is to be
    /// ignored), or null when every pixel of the frame was seen.
    const float* ignored_px;
};

/// |field(nearest pixel of p) - bilinear field(q)| <= |p - q| + this, in pixels: half a pixel diagonal
/// on either side (2 * sqrt(1/2)), twice what a contour point set can exceed the contour polyline
/// by beyond the refined band (2 * 0.083), and 1/64 px for float rounding.
inline constexpr double kFieldSlop_px = 1.4142136 + 2 * 0.083 + 1.0 / 64;
/// The frame's own distance is evaluated exactly; only rounding has to be covered.
inline constexpr double kFrameSlop_px = 1.0 / 64;
/// Nearer to the camera plane than this share of a voxel, a view is judged by depth alone.
inline constexpr float kNearPlane_vox = 1e-3f;

VDBCARVE_HD float min_f(float a, float b) { return b < a ? b : a; }
VDBCARVE_HD float max_f(float a, float b) { return a < b ? b : a; }
VDBCARVE_HD float clamp_f(float x, float lo, float hi) { return max_f(lo, min_f(x, hi)); }

struct Vec3 {
    float x, y, z;
};

/// The affine map from the voxels of one leaf to camera space: the leaf's origin is mapped in double,
/// so that far-away world origins cost nothing, and voxels inside it are reached by float steps.
/// Any driver that starts from the same leaf origin gets the same bits.
struct LeafToCamera {
    Vec3 origin, di, dj, dk;
};

VDBCARVE_HD LeafToCamera leaf_to_camera(const CarveView& view, int i0, int j0, int k0) {
    const double* m = view.camera_from_index;
    LeafToCamera out;
    out.origin = {static_cast<float>(m[0] * i0 + m[1] * j0 + m[2] * k0 + m[3]),
                  static_cast<float>(m[4] * i0 + m[5] * j0 + m[6] * k0 + m[7]),
                  static_cast<float>(m[8] * i0 + m[9] * j0 + m[10] * k0 + m[11])};
    out.di = {static_cast<float>(m[0]), static_cast<float>(m[4]), static_cast<float>(m[8])};
    out.dj = {static_cast<float>(m[1]), static_cast<float>(m[5]), static_cast<float>(m[9])};
    out.dk = {static_cast<float>(m[2]), static_cast<float>(m[6]), static_cast<float>(m[10])};
    return out;
}

/// Camera-space position of voxel (i, j, k), each in 0..7, of the leaf.
VDBCARVE_HD Vec3 voxel_in_camera(const LeafToCamera& leaf, int i, int j, int k) {
    const float fi = static_cast<float>(i), fj = static_cast<float>(j), fk = static_cast<float>(k);
    return {(leaf.origin.x + fi * leaf.di.x + fj * leaf.dj.x) + fk * leaf.dk.x,
            (leaf.origin.y + fi * leaf.di.y + fj * leaf.dj.y) + fk * leaf.dk.y,
            (leaf.origin.z + fi * leaf.di.z + fj * leaf.dj.z) + fk * leaf.dk.z};
}

struct PixelDistance {
    float value_px;
    float nx, ny;  ///< unit gradient in the image, or (0, 0) where it is not defined
};

/// Signed distance from an image point to the frame's border, positive outside.
VDBCARVE_HD PixelDistance frame_distance(float u, float v, float width, float height) {
    const float dx = u < 0.f ? u : (u > width ? u - width : 0.f);
    const float dy = v < 0.f ? v : (v > height ? v - height : 0.f);
    if (dx != 0.f || dy != 0.f) {
        // Scaled by the larger side: near the camera plane u and v may be too large to square.
        const float ax = std::fabs(dx), ay = std::fabs(dy);
        const float big = max_f(ax, ay), small = min_f(ax, ay);
        const float ratio = small / big;
        const float d = big * std::sqrt(1.f + ratio * ratio);
        return {d, dx / d, dy / d};
    }
    const float left = u, right = width - u, top = v, bottom = height - v;
    const float x = min_f(left, right), y = min_f(top, bottom);
    if (x <= y) return {-x, left <= right ? -1.f : 1.f, 0.f};
    return {-y, 0.f, top <= bottom ? -1.f : 1.f};
}

/// The four texels around an image point that was clamped into the frame, and the weights.
struct Patch {
    float s00, s10, s01, s11, a, b;
};

/// Images have fewer than 2^31 pixels.
VDBCARVE_HD Patch fetch_patch(const float* field, int width, int height, float u, float v) {
    const float x = clamp_f(u - 0.5f, 0.f, static_cast<float>(width - 1));
    const float y = clamp_f(v - 0.5f, 0.f, static_cast<float>(height - 1));
    const int ix0 = static_cast<int>(x), iy0 = static_cast<int>(y);
    const int ix = ix0 > width - 2 ? width - 2 : ix0, iy = iy0 > height - 2 ? height - 2 : iy0;
    const float* p = field + (iy * width + ix);
    return {p[0], p[1], p[width], p[width + 1], x - static_cast<float>(ix), y - static_cast<float>(iy)};
}

/// On the medial axis of a silhouette the gradient vanishes and says nothing; elsewhere it is about 1.
inline constexpr float kLeastGradient2 = 0.25f;

VDBCARVE_HD float interpolate(const Patch& p) {
    const float top = p.s00 + p.a * (p.s10 - p.s00);
    const float bottom = p.s01 + p.a * (p.s11 - p.s01);
    return top + p.b * (bottom - top);
}

VDBCARVE_HD PixelDistance distance_with_normal(const Patch& p) {
    const float gx = (p.s10 - p.s00) + p.b * ((p.s11 - p.s01) - (p.s10 - p.s00));
    const float gy = (p.s01 - p.s00) + p.a * ((p.s11 - p.s10) - (p.s01 - p.s00));
    const float norm2 = gx * gx + gy * gy;
    if (norm2 < kLeastGradient2) return {interpolate(p), 0.f, 0.f};
    const float inv = 1.f / std::sqrt(norm2);
    return {interpolate(p), gx * inv, gy * inv};
}

/// Distance in world units from a camera-space point to the cone over an image line whose distance and
/// unit normal in the image are given: v = s Z / sqrt(|a|^2 + (a.m)^2), a = A^T n, m = (X/Z, Y/Z).
VDBCARVE_HD float image_to_world_distance(const CarveView& view, const PixelDistance& d, float mx, float my,
                                          float depth) {
    if (d.nx == 0.f && d.ny == 0.f) {
        if (view.orthographic) return d.value_px / view.sigma_max;
        return d.value_px * depth / (view.sigma_max * std::sqrt(1.f + mx * mx + my * my));
    }
    const float ax = view.fx * d.nx;
    const float ay = view.skew * d.nx + view.fy * d.ny;
    const float a2 = ax * ax + ay * ay;
    if (view.orthographic) return d.value_px / std::sqrt(a2);
    const float am = ax * mx + ay * my;
    return d.value_px * depth / std::sqrt(a2 + am * am);
}

/// Where a camera-space point falls in the image.
struct Projected {
    float mx, my;  ///< normalised image coordinates
    float u, v;    ///< pixels
};

VDBCARVE_HD Projected project(const CarveView& view, const Vec3& point_camera) {
    Projected p;
    if (view.orthographic) {
        p.mx = point_camera.x;
        p.my = point_camera.y;
    } else {
        const float inverse_depth = 1.f / point_camera.z;
        p.mx = point_camera.x * inverse_depth;
        p.my = point_camera.y * inverse_depth;
    }
    p.u = view.fx * p.mx + view.skew * p.my + view.cx;
    p.v = view.fy * p.my + view.cy;
    return p;
}

/// True where a world distance of at least `band` follows from a pixel distance, whatever the normal.
VDBCARVE_HD bool beyond_band(const CarveView& view, float distance_px, const Projected& p, float depth, float band) {
    if (view.orthographic) return distance_px >= band * view.sigma_max * 1.0001f;
    const float dz = distance_px * depth;
    const float reach = band * view.sigma_max * 1.0001f;
    return dz > 0.f && dz * dz >= reach * reach * (1.f + p.mx * p.mx + p.my * p.my);
}

/// The distance, world units, clamped to [-band, band], to the cone over the silhouette that a patch is a piece
/// of. Straight-line code, so that a loop over voxels becomes vectors; the same as image_to_world_distance of the
/// interpolated field and its unit gradient.
VDBCARVE_HD float patch_value(const CarveView& view, const Patch& patch, const Projected& p, float depth, float band) {
    const float gx = (patch.s10 - patch.s00) + patch.b * ((patch.s11 - patch.s01) - (patch.s10 - patch.s00));
    const float gy = (patch.s01 - patch.s00) + patch.a * ((patch.s11 - patch.s10) - (patch.s01 - patch.s00));
    const float norm2 = gx * gx + gy * gy;
    const bool no_normal = norm2 < kLeastGradient2;
    const float inv = 1.f / std::sqrt(no_normal ? 1.f : norm2);
    const float nx = gx * inv, ny = gy * inv;
    const float ax = view.fx * nx, ay = view.skew * nx + view.fy * ny;
    const float a2 = no_normal ? view.sigma_max * view.sigma_max : ax * ax + ay * ay;
    const float am2_seen = (ax * p.mx + ay * p.my) * (ax * p.mx + ay * p.my);
    const float am2 = no_normal ? a2 * (p.mx * p.mx + p.my * p.my) : am2_seen;
    const float scale2 = view.orthographic ? a2 : a2 + am2;
    const float v = interpolate(patch) * (view.orthographic ? 1.f : depth) / std::sqrt(scale2);
    return clamp_f(v, -band, band);
}

/// Signed distance to the silhouette cone alone: beyond the frame the border's pixels are taken to go on.
/// Needs depth > 0 (perspective).
VDBCARVE_HD float silhouette_value(const CarveView& view, const Projected& p, float depth, float band) {
    return patch_value(view, fetch_patch(view.silhouette_px, view.width_px, view.height_px, p.u, p.v), p, depth, band);
}

/// What one view says about one point: the signed distance, in world units, to the region that the view
/// shows to be background, clamped to [-band, band]; positive inside that region.
/// With Outside::Unknown the region is "background and in frame", with Outside::Background it is
/// "background or out of frame"; what lies behind the camera belongs to it in both, because the object
/// is in front of every camera. Built from min and max of Lipschitz functions, so it is continuous
/// across the frame's border and the camera plane, and its sign is exact.
VDBCARVE_HD float view_value(const CarveView& view, const Vec3& point_camera, float near_depth, float band) {
    const float depth = point_camera.z;
    if (!view.orthographic && depth <= near_depth) return clamp_f(-depth, -band, band);
    const Projected p = project(view, point_camera);
    float value = silhouette_value(view, p, depth, band);
    const PixelDistance frame = frame_distance(p.u, p.v, static_cast<float>(view.width_px), static_cast<float>(view.height_px));
    if (!beyond_band(view, -frame.value_px, p, depth, band)) {
        const float frame_world = image_to_world_distance(view, frame, p.mx, p.my, depth);
        value = view.outside == Outside::Unknown ? min_f(value, -frame_world) : max_f(value, frame_world);
    }
    if (!view.orthographic) value = max_f(value, -depth);
    return clamp_f(value, -band, band);
}

/// Signed distance, in world units, to the region that the view has in frame and not ignored: positive
/// where the point is unseen. Clamped to [-band, band].
VDBCARVE_HD float unseen_value(const CarveView& view, const Vec3& point_camera, float near_depth, float band) {
    const float depth = point_camera.z;
    if (!view.orthographic && depth <= near_depth) return band;
    const Projected p = project(view, point_camera);
    PixelDistance d = frame_distance(p.u, p.v, static_cast<float>(view.width_px), static_cast<float>(view.height_px));
    float value = image_to_world_distance(view, d, p.mx, p.my, depth);
    if (view.ignored_px) {
        d = distance_with_normal(fetch_patch(view.ignored_px, view.width_px, view.height_px, p.u, p.v));
        value = max_f(value, image_to_world_distance(view, d, p.mx, p.my, depth));
    }
    return clamp_f(value, -band, band);
}

/// The paper's binary question: does the nearest pixel show background? (+1 background, -1 object or
/// unknown.) `seen` tells whether the point has a pixel of its own that is not ignored.
struct BinaryAnswer {
    bool background;
    bool seen;
};

VDBCARVE_HD BinaryAnswer binary_answer(const CarveView& view, const Vec3& point_camera, float near_depth) {
    if (!view.orthographic && point_camera.z <= 0.f) return {true, false};
    // In the sliver between the camera plane and near_depth pixel coordinates overflow: no evidence.
    if (!view.orthographic && point_camera.z <= near_depth) return {view.outside == Outside::Background, false};
    const Projected p = project(view, point_camera);
    const float width = static_cast<float>(view.width_px), height = static_cast<float>(view.height_px);
    if (!(p.u >= 0.f && p.u < width && p.v >= 0.f && p.v < height))
        return {view.outside == Outside::Background, false};
    const int64_t at = static_cast<int64_t>(static_cast<int>(p.v)) * view.width_px + static_cast<int>(p.u);
    return {view.silhouette_px[at] > 0.f, !(view.ignored_px && view.ignored_px[at] > 0.f)};
}

// ------------------------------------------------------------------------------------ whole nodes

/// A ball that holds every voxel centre of a node.
struct NodeBall {
    double x, y, z;      ///< centre in camera space, world units
    double radius;       ///< world units
};

VDBCARVE_HD NodeBall node_ball(const CarveView& view, double ci, double cj, double ck, double radius) {
    const double* m = view.camera_from_index;
    return {m[0] * ci + m[1] * cj + m[2] * ck + m[3], m[4] * ci + m[5] * cj + m[6] * ck + m[7],
            m[8] * ci + m[9] * cj + m[10] * ck + m[11], radius};
}

/// Radius in the normalised image (before A) within which every point of the ball projects around
/// the projection of its centre: rho L^2 / (Z (Z q - r rho)), valid for Z > rho.
VDBCARVE_HD double ball_spread(const NodeBall& ball) {
    const double r2 = ball.x * ball.x + ball.y * ball.y;
    const double l2 = r2 + ball.z * ball.z;
    const double q = std::sqrt(l2 - ball.radius * ball.radius);
    return ball.radius * l2 / (ball.z * (ball.z * q - std::sqrt(r2) * ball.radius));
}

enum class NodeAnswer : int {
    Mixed,  ///< the voxels must be asked one by one
    Out,    ///< the view's value is at least +band at every voxel of the node
    In      ///< the view's value is at most -band at every voxel: it can be dropped below this node
};

struct NodeAnswers {
    NodeAnswer hull;    ///< bounds view_value
    NodeAnswer unseen;  ///< bounds unseen_value (Out: unseen everywhere; In: well seen everywhere)
    /// The whole node lies so deep in frame and so far before the camera that view_value is silhouette_value.
    bool clear_of_frame;
};

/// Bounds view_value and unseen_value over a node. `band` in world units (0 for occupancy).
VDBCARVE_HD NodeAnswers node_answers(const CarveView& view, const NodeBall& ball, double near_depth, double band) {
    double u, v, spread_px, band_px;
    if (view.orthographic) {
        u = view.fx * ball.x + view.skew * ball.y + view.cx;
        v = view.fy * ball.y + view.cy;
        spread_px = view.sigma_max * ball.radius;
        band_px = view.sigma_max * band;
    } else {
        if (ball.z + ball.radius <= -band) return {NodeAnswer::Out, NodeAnswer::Out, false};
        // The camera plane or the near plane cuts the ball, or -depth itself is within the band.
        if (ball.z - ball.radius <= near_depth + band) return {NodeAnswer::Mixed, NodeAnswer::Mixed, false};
        const double mx = ball.x / ball.z, my = ball.y / ball.z;
        u = view.fx * mx + view.skew * my + view.cx;
        v = view.fy * my + view.cy;
        const double spread = ball_spread(ball);
        spread_px = view.sigma_max * spread;
        const double m_max = std::sqrt(mx * mx + my * my) + spread;
        band_px = band * view.sigma_max * std::sqrt(1.0 + m_max * m_max) / (ball.z - ball.radius);
    }
    const double width = view.width_px, height = view.height_px;
    const double dx = u < 0 ? -u : (u > width ? u - width : 0.0);
    const double dy = v < 0 ? -v : (v > height ? v - height : 0.0);
    double frame_px;
    if (dx > 0 || dy > 0) {
        frame_px = std::sqrt(dx * dx + dy * dy);
    } else {
        const double x = u < width - u ? u : width - u, y = v < height - v ? v : height - v;
        frame_px = -(x < y ? x : y);
    }
    const double cu = u < 0.5 ? 0.5 : (u > width - 0.5 ? width - 0.5 : u);
    const double cv = v < 0.5 ? 0.5 : (v > height - 0.5 ? height - 0.5 : v);
    const int64_t at = static_cast<int64_t>(static_cast<int>(cv)) * view.width_px + static_cast<int>(cu);
    const double s_px = view.silhouette_px[at];

    const double field_reach = spread_px + band_px + kFieldSlop_px;
    const double frame_reach = spread_px + band_px + kFrameSlop_px;
    NodeAnswers out{NodeAnswer::Mixed, NodeAnswer::Mixed, false};
    // 1.001 covers what beyond_band adds against rounding.
    out.clear_of_frame = -frame_px > frame_reach * 1.001;
    if (view.outside == Outside::Unknown) {
        if (s_px > field_reach && -frame_px > frame_reach)
            out.hull = NodeAnswer::Out;
        else if (-s_px > field_reach || frame_px > frame_reach)
            out.hull = NodeAnswer::In;
    } else {
        if (s_px > field_reach || frame_px > frame_reach)
            out.hull = NodeAnswer::Out;
        else if (-s_px > field_reach && -frame_px > frame_reach)
            out.hull = NodeAnswer::In;
    }
    const double ignored_px = view.ignored_px ? view.ignored_px[at] : -1e30;
    if (frame_px > frame_reach || ignored_px > field_reach)
        out.unseen = NodeAnswer::Out;
    else if (-frame_px > frame_reach && -ignored_px > field_reach)
        out.unseen = NodeAnswer::In;
    return out;
}

/// Signed distance to an axis-aligned box, world units, positive outside.
VDBCARVE_HD double box_distance(const double p[3], const double lo[3], const double hi[3]) {
    double outside2 = 0, inside = -1e300;
    for (int a = 0; a < 3; ++a) {
        const double below = lo[a] - p[a], above = p[a] - hi[a];
        const double d = below > above ? below : above;
        if (d > 0) outside2 += d * d;
        if (d > inside) inside = d;
    }
    return outside2 > 0 ? std::sqrt(outside2) : inside;
}

}  // namespace vdbcarve::kernel
