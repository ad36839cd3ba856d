// SPDX-License-Identifier: Apache-2.0
// The arithmetic of carving: what one view says about one voxel, and about a whole node at once.
//
// Frames: `index` (voxel centres at integers), `camera` (OpenCV axes: x right, y down, z forward, in
// world units), `image` (pixels, the centre of the first pixel is (0.5, 0.5)).
// Sign everywhere: negative inside the object, positive outside, as in a level set.
// Every bound below is derived in docs/stages/derivations.md and has a property test.
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/host_device.h"
#include "vdbcarve/kernel/min_max.h"

namespace vdbcarve::kernel {

/// What a point outside a view's frame means.
enum class Outside : int {
    Unknown,    ///< the view says nothing there (default)
    Background  ///< the view carves there (the paper's rule)
};

inline constexpr int kFieldUnits = 64;  ///< a field's values are counted in 1/64 px
inline constexpr int kBlock_px = 8;     ///< side of a block of the coarse bound

/// Signed distance to a silhouette, sampled at pixel centres over a window of the image. Borrowed pointers.
/// Points outside the window are read at its nearest sample: the window leaves `reach` around the object, so
/// nothing changes out there, except on sides where it ends at the frame.
struct FieldView {
    /// Row-major, in 1/64 px, clamped to +-reach. Null: no field.
    const int16_t* samples;
    int width, height;  ///< of the window, at least 2 x 2
    float x0, y0;       ///< image position of the first sample's upper left corner
    float reach_px;     ///< values saturate here
    /// For every block of kBlock_px x kBlock_px samples a distance, whole px, that everything in the block is
    /// at least away from the other side; its sign is the side, 0 where both occur.
    const int16_t* blocks;
    int blocks_per_row;
    /// What lies beyond these image coordinates is background, the farther the more; +-1e30 at the frame's sides.
    float left, top, right, bottom;
};

struct Vec3 {
    float x, y, z;
};
VDBCARVE_HD float dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

/// From camera space to the image. Pixels are those of the field, which may be coarser than the photograph's
/// (DistanceOptions::scale).
struct Projection {
    /// Pixel = [fx skew; 0 fy] * (X/Z, Y/Z) + (cx, cy); orthographic: without the division by Z.
    float fx, skew, fy, cx, cy;
    /// Largest singular value of [fx skew; 0 fy], in pixels: no direction is magnified more.
    float sigma_max;
    int orthographic;
};

/// One view, ready to be asked. Trivially copyable; the pointers are borrowed.
struct CarveView : Projection {
    /// Row-major 3x4: camera-space point (world units) = matrix * (i, j, k, 1), index coordinates.
    double camera_from_index[12];
    float frame_width, frame_height;  ///< of the photograph's frame; need not be whole
    Outside outside;
    FieldView silhouette;
    /// Signed distance to the ignored region (positive inside it), or none when every pixel of the frame was seen.
    FieldView ignored;
};

/// |field(nearest sample of p) - bilinear field(q)| <= |p - q| + this, in pixels: half a pixel diagonal
/// on either side (2 * sqrt(1/2)), twice what a contour point set can exceed the contour polyline
/// by beyond the refined band (2 * 0.083), twice the rounding of a sample (2 / 128) and 1/64 px for floats.
inline constexpr double kFieldSlop_px = 1.4142136 + 2 * 0.083 + 2.0 / 64;
/// The frame's own distance is evaluated exactly; only rounding has to be covered.
inline constexpr double kFrameSlop_px = 1.0 / 64;
/// Nearer to the camera plane than this share of a voxel, a view is judged by depth alone.
inline constexpr float kNearPlane_vox = 1e-3f;

VDBCARVE_HD double max_d(double a, double b) { return a < b ? b : a; }
VDBCARVE_HD float clamp_f(float x, float lo, float hi) { return max_f(lo, min_f(x, hi)); }

/// The affine map from the voxels of one leaf to camera space: the leaf's origin is mapped in double,
/// so that far-away world origins cost nothing, and voxels inside it are reached by float steps.
/// Any driver that starts from the same leaf origin gets the same bits.
struct LeafToCamera {
    Vec3 origin, di, dj, dk;
};

VDBCARVE_HD LeafToCamera leaf_to_camera(const CarveView& view, int i0, int j0, int k0) {
    const double* m = view.camera_from_index;
    LeafToCamera out;
    out.origin = {static_cast<float>(m[0] * i0 + m[1] * j0 + m[2] * k0 + m[3]), static_cast<float>(m[4] * i0 + m[5] * j0 + m[6] * k0 + m[7]),
                  static_cast<float>(m[8] * i0 + m[9] * j0 + m[10] * k0 + m[11])};
    out.di = {static_cast<float>(m[0]), static_cast<float>(m[4]), static_cast<float>(m[8])};
    out.dj = {static_cast<float>(m[1]), static_cast<float>(m[5]), static_cast<float>(m[9])};
    out.dk = {static_cast<float>(m[2]), static_cast<float>(m[6]), static_cast<float>(m[10])};
    return out;
}

/// Camera-space position of voxel (i, j, k), each a whole number in 0..7, of the leaf.
VDBCARVE_HD Vec3 voxel_in_camera(const LeafToCamera& leaf, float fi, float fj, float fk) {
    return {(leaf.origin.x + fi * leaf.di.x + fj * leaf.dj.x) + fk * leaf.dk.x, (leaf.origin.y + fi * leaf.di.y + fj * leaf.dj.y) + fk * leaf.dk.y,
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

/// The four samples around an image point that was clamped into the window, in 1/64 px, and the weights.
struct Patch {
    float s00, s10, s01, s11, a, b;
};

/// Where a patch lies: index of its first sample, and the weights.
struct PatchPlace {
    int at;
    float a, b;
};

/// Windows have fewer than 2^31 samples.
VDBCARVE_HD PatchPlace patch_place(const FieldView& f, float u, float v) {
    const float x = clamp_f((u - f.x0) - 0.5f, 0.f, static_cast<float>(f.width - 1));
    const float y = clamp_f((v - f.y0) - 0.5f, 0.f, static_cast<float>(f.height - 1));
    const int ix0 = static_cast<int>(x), iy0 = static_cast<int>(y);
    const int ix = ix0 > f.width - 2 ? f.width - 2 : ix0, iy = iy0 > f.height - 2 ? f.height - 2 : iy0;
    return {iy * f.width + ix, x - static_cast<float>(ix), y - static_cast<float>(iy)};
}

/// Samples do not change while they are read: on the device they may come through the read-only path.
VDBCARVE_HD int16_t read_sample(const int16_t* p) {
#if defined(__CUDA_ARCH__)
    return __ldg(p);
#else
    return *p;
#endif
}

VDBCARVE_HD Patch fetch_patch(const FieldView& f, float u, float v) {
    const PatchPlace place = patch_place(f, u, v);
    const int16_t* p = f.samples + place.at;
    return {static_cast<float>(read_sample(p)),
            static_cast<float>(read_sample(p + 1)),
            static_cast<float>(read_sample(p + f.width)),
            static_cast<float>(read_sample(p + f.width + 1)),
            place.a,
            place.b};
}

/// The sample nearest to an image point, in 1/64 px.
VDBCARVE_HD int nearest_sample(const FieldView& f, float u, float v) {
    const float x = clamp_f(u - f.x0, 0.f, static_cast<float>(f.width) - 0.5f), y = clamp_f(v - f.y0, 0.f, static_cast<float>(f.height) - 0.5f);
    return f.samples[static_cast<int>(y) * f.width + static_cast<int>(x)];
}

/// Which way, and how far at least, an image point is from the contour: a bound for deciding whether it is farther
/// than `asked_px`. From the samples while they do not saturate, from the blocks beyond.
VDBCARVE_HD double distance_bound_px(const FieldView& f, float u, float v, double asked_px) {
    if (asked_px < f.reach_px) return nearest_sample(f, u, v) * (1.0 / kFieldUnits);
    const float x = clamp_f(u - f.x0, 0.f, static_cast<float>(f.width) - 0.5f), y = clamp_f(v - f.y0, 0.f, static_cast<float>(f.height) - 0.5f);
    const double block = f.blocks[static_cast<int>(y) / kBlock_px * f.blocks_per_row + static_cast<int>(x) / kBlock_px];
    const float dx = max_f(max_f(f.left - u, u - f.right), 0.f), dy = max_f(max_f(f.top - v, v - f.bottom), 0.f);
    if (dx == 0.f && dy == 0.f) return block;
    // Beyond a side where the window ends before the frame: its margin and the way from there.
    const double beyond = std::sqrt(static_cast<double>(dx) * dx + static_cast<double>(dy) * dy);
    return max_d(block, f.reach_px + beyond);
}

/// On the medial axis of a silhouette the gradient vanishes and says nothing; elsewhere it is about 1.
inline constexpr float kLeastGradient2 = 0.25f * kFieldUnits * kFieldUnits;

/// In 1/64 px.
VDBCARVE_HD float interpolate(const Patch& p) {
    const float top = p.s00 + p.a * (p.s10 - p.s00);
    const float bottom = p.s01 + p.a * (p.s11 - p.s01);
    return top + p.b * (bottom - top);
}

/// Distance in world units from a camera-space point to the cone over an image line whose distance and
/// unit normal in the image are given: v = s Z / sqrt(|a|^2 + (a.m)^2), a = A^T n, m = (X/Z, Y/Z).
VDBCARVE_HD float image_to_world_distance(const Projection& view, const PixelDistance& d, float mx, float my, float depth) {
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

VDBCARVE_HD Projected project(const Projection& view, const Vec3& point_camera) {
    Projected p;
    const float inverse_depth = view.orthographic ? 1.f : 1.f / point_camera.z;
    p.mx = point_camera.x * inverse_depth;
    p.my = point_camera.y * inverse_depth;
    p.u = view.fx * p.mx + view.skew * p.my + view.cx;
    p.v = view.fy * p.my + view.cy;
    return p;
}

/// True where a world distance of at least `band` follows from a pixel distance, whatever the normal.
VDBCARVE_HD bool beyond_band(const Projection& view, float distance_px, const Projected& p, float depth, float band) {
    if (view.orthographic) return distance_px >= band * view.sigma_max * 1.0001f;
    const float dz = distance_px * depth;
    const float reach = band * view.sigma_max * 1.0001f;
    return dz > 0.f && dz * dz >= reach * reach * (1.f + p.mx * p.mx + p.my * p.my);
}

/// The distance, world units, clamped to [-band, band], to the cone over the contour that a patch is a piece
/// of: image_to_world_distance of the interpolated field and its unit gradient, with one root and one division.
/// Straight-line code, so that a loop over voxels becomes vectors.
VDBCARVE_HD float patch_value(const Projection& view, const Patch& patch, float mx, float my, float depth, float band) {
    const float gx = (patch.s10 - patch.s00) + patch.b * ((patch.s11 - patch.s01) - (patch.s10 - patch.s00));
    const float gy = (patch.s01 - patch.s00) + patch.a * ((patch.s11 - patch.s10) - (patch.s01 - patch.s00));
    const float norm2 = gx * gx + gy * gy;
    const float ax = view.fx * gx, ay = view.skew * gx + view.fy * gy;
    const float am = ax * mx + ay * my, m2 = mx * mx + my * my;
    const bool flat = norm2 < kLeastGradient2;
    const float sigma2 = view.sigma_max * view.sigma_max;
    const float across = flat ? sigma2 : ax * ax + ay * ay;
    const float along = flat ? sigma2 * m2 : am * am;
    const float scale2 = view.orthographic ? across : across + along;
    const float root = std::sqrt((flat ? 1.f : norm2) / scale2);
    const float v = interpolate(patch) * (view.orthographic ? 1.f / kFieldUnits : depth * (1.f / kFieldUnits)) * root;
    return clamp_f(v, -band, band);
}

/// Signed distance to the silhouette cone alone: beyond the frame the border's pixels are taken to go on.
/// Needs depth > 0 (perspective).
VDBCARVE_HD float silhouette_value(const Projection& view, const FieldView& silhouette, const Projected& p, float depth, float band) {
    return patch_value(view, fetch_patch(silhouette, p.u, p.v), p.mx, p.my, depth, band);
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
    float value = silhouette_value(view, view.silhouette, p, depth, band);
    const PixelDistance frame = frame_distance(p.u, p.v, view.frame_width, view.frame_height);
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
    const PixelDistance frame = frame_distance(p.u, p.v, view.frame_width, view.frame_height);
    float value = image_to_world_distance(view, frame, p.mx, p.my, depth);
    if (view.ignored.samples) value = max_f(value, patch_value(view, fetch_patch(view.ignored, p.u, p.v), p.mx, p.my, depth, band));
    return clamp_f(value, -band, band);
}

/// The paper's binary question: does the nearest pixel show background? (+1 background, -1 object or
/// unknown.) `seen` tells whether the point has a pixel of its own that is not ignored.
struct BinaryAnswer {
    bool background;
    bool seen;
};

/// A point has a pixel of its own that is not ignored.
VDBCARVE_HD bool seen_at(const CarveView& view, const Vec3& point_camera, float near_depth) {
    if (!view.orthographic && point_camera.z <= near_depth) return false;
    const Projected p = project(view, point_camera);
    if (!(p.u >= 0.f && p.u < view.frame_width && p.v >= 0.f && p.v < view.frame_height)) return false;
    return !(view.ignored.samples && nearest_sample(view.ignored, p.u, p.v) > 0);
}

VDBCARVE_HD BinaryAnswer binary_answer(const CarveView& view, const Vec3& point_camera, float near_depth) {
    if (!view.orthographic && point_camera.z <= 0.f) return {true, false};
    // In the sliver between the camera plane and near_depth pixel coordinates overflow: no evidence.
    if (!view.orthographic && point_camera.z <= near_depth) return {view.outside == Outside::Background, false};
    const Projected p = project(view, point_camera);
    if (!(p.u >= 0.f && p.u < view.frame_width && p.v >= 0.f && p.v < view.frame_height)) return {view.outside == Outside::Background, false};
    return {nearest_sample(view.silhouette, p.u, p.v) > 0, !(view.ignored.samples && nearest_sample(view.ignored, p.u, p.v) > 0)};
}

// ------------------------------------------------------------------------------------ whole nodes

/// A ball that holds every voxel centre of a node.
struct NodeBall {
    double x, y, z;  ///< centre in camera space, world units
    double radius;   ///< world units
};

VDBCARVE_HD NodeBall node_ball(const CarveView& view, double ci, double cj, double ck, double radius) {
    const double* m = view.camera_from_index;
    return {m[0] * ci + m[1] * cj + m[2] * ck + m[3], m[4] * ci + m[5] * cj + m[6] * ck + m[7], m[8] * ci + m[9] * cj + m[10] * ck + m[11], radius};
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
    NodeAnswer hull;      ///< bounds view_value
    NodeAnswer unseen;    ///< bounds unseen_value (Out: unseen everywhere; In: well seen everywhere)
    float silhouette_px;  ///< the bound that decided, positive where background: which views to ask first
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
        if (ball.z + ball.radius <= -band) return {NodeAnswer::Out, NodeAnswer::Out, 0.f, false};
        // The camera plane or the near plane cuts the ball, or -depth itself is within the band.
        if (ball.z - ball.radius <= near_depth + band) return {NodeAnswer::Mixed, NodeAnswer::Mixed, 0.f, false};
        const double mx = ball.x / ball.z, my = ball.y / ball.z;
        u = view.fx * mx + view.skew * my + view.cx;
        v = view.fy * my + view.cy;
        const double spread = ball_spread(ball);
        spread_px = view.sigma_max * spread;
        const double m_max = std::sqrt(mx * mx + my * my) + spread;
        band_px = band * view.sigma_max * std::sqrt(1.0 + m_max * m_max) / (ball.z - ball.radius);
    }
    const double width = view.frame_width, height = view.frame_height;
    const double dx = u < 0 ? -u : (u > width ? u - width : 0.0);
    const double dy = v < 0 ? -v : (v > height ? v - height : 0.0);
    double frame_px;
    if (dx > 0 || dy > 0) {
        frame_px = std::sqrt(dx * dx + dy * dy);
    } else {
        const double x = u < width - u ? u : width - u, y = v < height - v ? v : height - v;
        frame_px = -(x < y ? x : y);
    }
    const double field_reach = spread_px + band_px + kFieldSlop_px;
    const double frame_reach = spread_px + band_px + kFrameSlop_px;
    // Where samples saturate within the band they do not show it (only near a camera; they are made to reach
    // farther), so nothing is decided.
    const bool band_shown = view.silhouette.samples && band_px + kFieldSlop_px < view.silhouette.reach_px;
    const double s_px = band_shown ? distance_bound_px(view.silhouette, static_cast<float>(u), static_cast<float>(v), field_reach) : 0.0;
    NodeAnswers out{NodeAnswer::Mixed, NodeAnswer::Mixed, static_cast<float>(s_px), false};
    // 1.001 covers what beyond_band adds against rounding.
    out.clear_of_frame = -frame_px > frame_reach * 1.001;
    if (view.outside == Outside::Unknown) {
        if (s_px > field_reach && -frame_px > frame_reach) out.hull = NodeAnswer::Out;
        else if (-s_px > field_reach || frame_px > frame_reach) out.hull = NodeAnswer::In;
    } else {
        if (s_px > field_reach || frame_px > frame_reach) out.hull = NodeAnswer::Out;
        else if (-s_px > field_reach && -frame_px > frame_reach) out.hull = NodeAnswer::In;
    }
    double ignored_px = -1e30;
    if (view.ignored.samples)
        ignored_px =
            band_px + kFieldSlop_px < view.ignored.reach_px ? distance_bound_px(view.ignored, static_cast<float>(u), static_cast<float>(v), field_reach) : 0.0;
    if (frame_px > frame_reach || ignored_px > field_reach) out.unseen = NodeAnswer::Out;
    else if (-frame_px > frame_reach && -ignored_px > field_reach) out.unseen = NodeAnswer::In;
    return out;
}

/// A cell of a leaf (4 x 4 x 4 voxels) as a view that is clear of its frame there sees it: node_answers in float, with a
/// looser bound of the ball's projection, padded against rounding. `ball_radius` in world units holds the cell's voxel centres.
struct CellProbe {
    float u, v;      ///< image of the cell's centre
    float reach_px;  ///< farther from the contour than this, all of the cell is
};

/// Radius of a cell's voxel centres around their middle, in voxels: sqrt(3) * 1.5, rounded up.
inline constexpr double kCellRadius_vox = 2.5980763 * (1 + 1e-6);

VDBCARVE_HD CellProbe cell_probe(const Projection& view, const Vec3& centre_camera, float ball_radius, float band) {
    const Projected p = project(view, centre_camera);
    const float m2 = p.mx * p.mx + p.my * p.my, nearest = 1.f / (centre_camera.z - ball_radius);
    const float spread = ball_radius * std::sqrt(1.f + m2) * nearest;
    const float m_max = std::sqrt(m2) + spread;
    const float world = view.orthographic ? ball_radius + band : spread + band * std::sqrt(1.f + m_max * m_max) * nearest;
    return {p.u, p.v, view.sigma_max * world * 1.0001f + static_cast<float>(kFieldSlop_px) + 0.01f};
}

VDBCARVE_HD NodeAnswer cell_answer(const FieldView& silhouette, const CellProbe& probe) {
    const float s_px = static_cast<float>(nearest_sample(silhouette, probe.u, probe.v)) * (1.f / kFieldUnits);
    if (probe.reach_px >= silhouette.reach_px) return NodeAnswer::Mixed;
    return s_px > probe.reach_px ? NodeAnswer::Out : (-s_px > probe.reach_px ? NodeAnswer::In : NodeAnswer::Mixed);
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
