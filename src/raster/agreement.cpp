// SPDX-License-Identifier: Apache-2.0
// How far a result's silhouettes agree with the masks, in numbers and as a picture.
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "image/image_io.h"
#include "base/statistics.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {

namespace {

/// Contours farther apart than this are as bad as can be.
constexpr int kContourReach_px = 100;

/// Left, top, right, bottom (the last ones outside) of what is object in either, with a border of two pixels where the image has one.
std::array<int, 4> window_of(ImageView<uint8_t> a, ImageView<uint8_t> b) {
    std::array<int, 4> box{a.width, a.height, 0, 0};
    for (int y = 0; y < a.height; ++y)
        for (int x = 0; x < a.width; ++x)
            if (a.at(x, y) >= 128 || b.at(x, y) >= 128) box = {std::min(box[0], x), std::min(box[1], y), std::max(box[2], x + 1), std::max(box[3], y + 1)};
    if (box[2] == 0) return {0, 0, a.width, a.height};
    return {std::max(0, box[0] - 2), std::max(0, box[1] - 2), std::min(a.width, box[2] + 2), std::min(a.height, box[3] + 2)};
}

Image8 cropped(ImageView<uint8_t> image, const std::array<int, 4>& box) {
    if (image.empty()) return {};
    Image8 out(box[2] - box[0], box[3] - box[1]);
    for (int y = 0; y < out.height; ++y)
        std::copy_n(&image.at(box[0], box[1] + y), out.width, out.data.data() + static_cast<size_t>(y) * static_cast<size_t>(out.width));
    return out;
}

/// `soft`: `hit`, with the contour where it runs within pixels.
SilhouetteAgreement compare_whole(ImageView<uint8_t> hit, ImageView<uint8_t> soft, const MaskView& mask) {
    SilhouetteAgreement out;
    const int width = hit.width, height = hit.height;
    size_t both = 0, either = 0;
    const auto ignored = [&](int x, int y) { return !mask.ignore.empty() && mask.ignore.at(x, y) != 0; };
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            if (ignored(x, y)) continue;
            const bool a = hit.at(x, y) >= 128, b = mask.coverage.at(x, y) >= 128;
            both += a && b;
            either += a || b;
            out.missed_px += b && !a;
            out.extra_px += a && !b;
        }
    out.iou = either ? static_cast<double>(both) / static_cast<double>(either) : 1.0;
    if (out.missed_px > 0) {
        Image8 missed(width, height);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                if (!ignored(x, y) && mask.coverage.at(x, y) >= 128 && hit.at(x, y) < 128) missed.at(x, y) = 255;
        const io::Component blob = io::largest_component(missed);
        out.largest_missed_blob_px = blob.pixels;
        out.missed_blob = blob.box;
        // A skeleton counts as lost where nothing is hit beside it; only there it is made, which costs most.
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                if (!missed.at(x, y)) continue;
                bool near = false;
                for (int v = std::max(0, y - 1); v <= std::min(height - 1, y + 1); ++v)
                    for (int u = std::max(0, x - 1); u <= std::min(width - 1, x + 1); ++u) near = near || hit.at(u, v) >= 128 || ignored(u, v);
                if (near) missed.at(x, y) = 0;
            }
        out.thin_lost = io::skeleton_near(mask.coverage, missed);
        out.thin_length_lost_px = out.thin_lost.size();
    }
    if (both == 0) return out;
    // Where either contour runs, the two signed distances differ by the contours' displacement there.
    const ImageF sa = signed_distance(soft, kContourReach_px), sb = signed_distance(mask.coverage, kContourReach_px);
    std::vector<float> apart;
    for (int y = 1; y + 1 < height; ++y)
        for (int x = 1; x + 1 < width; ++x) {
            if (ignored(x, y)) continue;
            const auto on_contour = [&](const ImageF& s) {
                return s.at(x, y) < 0 && (s.at(x - 1, y) >= 0 || s.at(x + 1, y) >= 0 || s.at(x, y - 1) >= 0 || s.at(x, y + 1) >= 0);
            };
            if (on_contour(sa) || on_contour(sb)) apart.push_back(std::fabs(sa.at(x, y) - sb.at(x, y)));
        }
    out.contour_p95_px = percentile(apart, 0.95);
    out.contour_p99_px = percentile(apart, 0.99);
    return out;
}

/// `soft`: `hit`, with the contour where it runs within pixels.
SilhouetteAgreement compare(ImageView<uint8_t> hit, ImageView<uint8_t> soft, const MaskView& mask) {
    // Beside both silhouettes there is nothing to compare, and photographs are mostly that.
    const std::array<int, 4> box = window_of(hit, mask.coverage);
    const Image8 coverage = cropped(mask.coverage, box), ignore = cropped(mask.ignore, box);
    SilhouetteAgreement out = compare_whole(cropped(hit, box), cropped(soft, box), {coverage, ignore});
    if (out.missed_px > 0)
        for (size_t side = 0; side < 4; ++side) out.missed_blob[side] += box[side % 2];
    // Nothing in common: as far apart as the picture is wide.
    if (out.iou == 0) out.contour_p95_px = out.contour_p99_px = std::hypot(hit.width, hit.height);
    for (auto& p : out.thin_lost) p = {p[0] + box[0], p[1] + box[1]};
    return out;
}

}  // namespace

SilhouetteAgreement compare_silhouettes(ImageView<uint8_t> hit, const MaskView& mask) { return compare(hit, hit, mask); }

SilhouetteAgreement compare_silhouettes(const Mesh& mesh, const Camera& camera, const MaskView& mask, bool within_pixels) {
    if (!within_pixels) return compare_silhouettes(silhouette_of(mesh, camera), mask);
    const SoftSilhouette seen = soft_silhouette_of(mesh, camera);
    return compare(seen.hit, seen.soft, mask);
}

Image8 mask_overlay(ImageView<uint8_t> photo, const Mask& mask) {
    constexpr int kMostWidth = 1024;
    const Image8& m = mask.coverage;
    const int width = std::min(m.width, kMostWidth), height = std::max(1, static_cast<int>(std::lround(static_cast<double>(m.height) * width / m.width)));
    const Image8 small_photo = photo.empty() ? Image8() : io::downscale(photo, width, height), small = io::downscale(m, width, height),
                 ignore = mask.ignore.empty() ? Image8() : io::downscale(mask.ignore, width, height);
    Image8 out(width, height, 3);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const bool object = small.at(x, y) >= 128, ignored = !ignore.empty() && ignore.at(x, y) >= 128;
            const auto on = [&](int u, int v) { return u >= 0 && v >= 0 && u < width && v < height && small.at(u, v) >= 128; };
            const bool edge = object && !(on(x - 1, y) && on(x + 1, y) && on(x, y - 1) && on(x, y + 1));
            for (int c = 0; c < 3; ++c) {
                double v = small_photo.empty() ? (object ? 200 : 60) : small_photo.at(x, y, small_photo.channels >= 3 ? c : 0);
                if (!object) v = 0.45 * v + (c == 0 ? 100 : 0);
                if (ignored) v = 0.5 * v + (c == 2 ? 127 : 0);
                if (edge) v = c == 1 ? 255 : 0;
                out.at(x, y, c) = static_cast<uint8_t>(std::clamp(v, 0.0, 255.0));
            }
        }
    return out;
}

Image8 preview_sheet(const Mesh& mesh, const std::vector<PreviewView>& views) {
    constexpr int kTileWidth = 320;
    std::vector<Image8> tiles(views.size());
    tbb::parallel_for(size_t{0}, views.size(), [&](size_t i) {
        const PreviewView& view = views[i];
        const Camera camera = scaled(view.camera, static_cast<double>(kTileWidth) / view.camera.intrinsics.width_px);
        const int width = camera.intrinsics.width_px, height = camera.intrinsics.height_px;
        const Image8 mask = io::downscale(view.mask, width, height);
        const Image8 photo = view.photo.empty() ? Image8() : io::downscale(view.photo, width, height);
        const Raster raster = rasterize(mesh, camera);
        Image8& tile = tiles[i] = Image8(width, height, 3);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                double rgb[3] = {0, 0, 0};
                if (!photo.empty())
                    for (int c = 0; c < 3; ++c) rgb[c] = 0.35 * photo.at(x, y, photo.channels >= 3 ? c : 0);
                const uint32_t t = raster.face.at(x, y);
                const bool hit = t != UINT32_MAX, object = mask.at(x, y) >= 128;
                if (hit) {
                    Vec3d p[3];
                    for (size_t c = 0; c < 3; ++c) {
                        const auto& v = mesh.vertices[mesh.triangles[t][c]];
                        p[c] = Vec3d(v[0], v[1], v[2]);
                    }
                    const Vec3d n = (p[1] - p[0]).cross(p[2] - p[0]).normalized();
                    // A lamp above the camera's left shoulder.
                    const Vec3d lamp = camera.camera_from_world.rotation.transpose() * Vec3d(-0.4, -0.6, -0.8).normalized();
                    const double light = 40 + 200 * std::max(0.0, n.dot(lamp));
                    for (double& c : rgb) c = light;
                }
                if (hit && !object) {
                    rgb[0] = 40, rgb[1] = 90, rgb[2] = 255;
                }
                if (!hit && object) {
                    rgb[0] = 255, rgb[1] = 40, rgb[2] = 30;
                }
                for (int c = 0; c < 3; ++c) tile.at(x, y, c) = static_cast<uint8_t>(std::clamp(rgb[c], 0.0, 255.0));
            }
        const double shrink = static_cast<double>(width) / view.mask.width;
        const auto dot = [&](double x, double y, int r, int g, int b) {
            const int u = static_cast<int>(x * shrink), v = static_cast<int>(y * shrink);
            if (u < 0 || v < 0 || u >= width || v >= height) return;
            tile.at(u, v, 0) = static_cast<uint8_t>(r);
            tile.at(u, v, 1) = static_cast<uint8_t>(g);
            tile.at(u, v, 2) = static_cast<uint8_t>(b);
        };
        for (const auto& [x, y] : view.thin_lost) dot(x + 0.5, y + 0.5, 255, 230, 40);
        for (const Vec3d& p : view.cut_world)
            if (const auto pixel = view.camera.project(p)) dot(pixel->x(), pixel->y(), 0, 230, 255);
        const auto& [bx0, by0, bx1, by1] = view.missed_blob;
        if (bx1 > bx0 + 4 || by1 > by0 + 4) {
            const double pad = 3 / shrink;
            for (double x = bx0 - pad; x <= bx1 + pad; x += 0.5 / shrink) {
                dot(x, by0 - pad, 255, 150, 0);
                dot(x, by1 + pad, 255, 150, 0);
            }
            for (double y = by0 - pad; y <= by1 + pad; y += 0.5 / shrink) {
                dot(bx0 - pad, y, 255, 150, 0);
                dot(bx1 + pad, y, 255, 150, 0);
            }
        }
    });
    int tile_height = 1;
    for (const Image8& t : tiles) tile_height = std::max(tile_height, t.height);
    const int columns = views.size() <= 4 ? static_cast<int>(views.size()) : 4;
    const int rows = columns ? (static_cast<int>(views.size()) + columns - 1) / columns : 0;
    Image8 sheet(std::max(1, columns * (kTileWidth + 4)), std::max(1, rows * (tile_height + 4)), 3, 24);
    for (size_t i = 0; i < tiles.size(); ++i) {
        const int ox = static_cast<int>(i) % columns * (kTileWidth + 4) + 2, oy = static_cast<int>(i) / columns * (tile_height + 4) + 2;
        for (int y = 0; y < tiles[i].height; ++y)
            for (int x = 0; x < tiles[i].width; ++x)
                for (int c = 0; c < 3; ++c) sheet.at(ox + x, oy + y, c) = tiles[i].at(x, y, c);
    }
    return sheet;
}

}  // namespace vdbcarve
