// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/raster.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

struct ProjectedVertex {
    double u, v, z;
};

std::vector<ProjectedVertex> project_all(const Mesh& mesh, const Camera& camera) {
    const Intrinsics& k = camera.intrinsics;
    std::vector<ProjectedVertex> out(mesh.vertices.size());
    for (size_t i = 0; i < out.size(); ++i) {
        const auto& p = mesh.vertices[i];
        const Vec3d c = camera.camera_from_world * Vec3d(p[0], p[1], p[2]);
        const double mx = k.orthographic ? c.x() : c.x() / c.z(), my = k.orthographic ? c.y() : c.y() / c.z();
        out[i] = {k.fx * mx + k.skew * my + k.cx, k.fy * my + k.cy, c.z()};
    }
    return out;
}

/// A triangle in the image.
struct ProjectedTriangle {
    const ProjectedVertex &a, &b, &c;
    double inverse_area;

    /// Whether it covers a point, its edges included: neighbours leave nothing between them. Weights are barycentric, of the image.
    bool covers(double x, double y, std::array<double, 3>& w) const {
        constexpr double kEdge = -1e-9;  // rounding must not open a seam
        w[0] = ((b.u - x) * (c.v - y) - (b.v - y) * (c.u - x)) * inverse_area;
        w[1] = ((c.u - x) * (a.v - y) - (c.v - y) * (a.u - x)) * inverse_area;
        w[2] = 1 - w[0] - w[1];
        return w[0] >= kEdge && w[1] >= kEdge && w[2] >= kEdge;
    }
};

/// Calls visit(number, triangle, x0, y0, x1, y1) for every triangle before the camera, with the pixels (the last ones included) that may have points of it
/// within `reach` of their centres.
template <class Visit>
void for_each_triangle(const Mesh& mesh, const Camera& camera, const std::vector<ProjectedVertex>& vertices, double reach, const Visit& visit) {
    const Intrinsics& k = camera.intrinsics;
    for (size_t t = 0; t < mesh.triangles.size(); ++t) {
        const ProjectedVertex& a = vertices[mesh.triangles[t][0]];
        const ProjectedVertex& b = vertices[mesh.triangles[t][1]];
        const ProjectedVertex& c = vertices[mesh.triangles[t][2]];
        if (!k.orthographic && (a.z <= 0 || b.z <= 0 || c.z <= 0)) continue;
        const double x_low = std::min({a.u, b.u, c.u}) - reach, x_high = std::max({a.u, b.u, c.u}) + reach;
        const double y_low = std::min({a.v, b.v, c.v}) - reach, y_high = std::max({a.v, b.v, c.v}) + reach;
        if (x_high < 0 || y_high < 0 || x_low > k.width_px || y_low > k.height_px) continue;
        const int x0 = std::max(0, static_cast<int>(std::ceil(x_low - 0.5))), x1 = std::min(k.width_px - 1, static_cast<int>(std::floor(x_high - 0.5)));
        const int y0 = std::max(0, static_cast<int>(std::ceil(y_low - 0.5))), y1 = std::min(k.height_px - 1, static_cast<int>(std::floor(y_high - 0.5)));
        if (x0 > x1 || y0 > y1) continue;
        const double area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
        if (area != 0) visit(t, ProjectedTriangle{a, b, c, 1 / area}, x0, y0, x1, y1);
    }
}

/// Calls hit(x, y, triangle, w0, w1, w2) with image-space barycentric weights for every pixel centre that a triangle covers.
template <class Hit>
void for_each_covered(const Mesh& mesh, const Camera& camera, const std::vector<ProjectedVertex>& vertices, const Hit& hit) {
    for_each_triangle(mesh, camera, vertices, 0, [&](size_t t, const ProjectedTriangle& triangle, int x0, int y0, int x1, int y1) {
        std::array<double, 3> w;
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x)
                if (triangle.covers(x + 0.5, y + 0.5, w)) hit(x, y, t, w[0], w[1], w[2]);
    });
}

}  // namespace

Camera scaled(const Camera& camera, double factor) {
    Camera out = camera;
    Intrinsics& k = out.intrinsics;
    k.fx *= factor;
    k.fy *= factor;
    k.skew *= factor;
    k.cx *= factor;
    k.cy *= factor;
    k.width_px = std::max(1, static_cast<int>(std::lround(k.width_px * factor)));
    k.height_px = std::max(1, static_cast<int>(std::lround(k.height_px * factor)));
    return out;
}

Raster rasterize(const Mesh& mesh, const Camera& camera) {
    const Intrinsics& k = camera.intrinsics;
    Raster out{ImageF(k.width_px, k.height_px, 1, std::numeric_limits<float>::infinity()), Image<uint32_t>(k.width_px, k.height_px, 1, UINT32_MAX)};
    const auto vertices = project_all(mesh, camera);
    for_each_covered(mesh, camera, vertices, [&](int x, int y, size_t t, double w0, double w1, double w2) {
        const double za = vertices[mesh.triangles[t][0]].z, zb = vertices[mesh.triangles[t][1]].z, zc = vertices[mesh.triangles[t][2]].z;
        // 1/z is linear in the image of a perspective camera, z in that of an orthographic one.
        const double z = k.orthographic ? w0 * za + w1 * zb + w2 * zc : 1 / (w0 / za + w1 / zb + w2 / zc);
        float& depth = out.depth.at(x, y);
        if (static_cast<float>(z) < depth) {
            depth = static_cast<float>(z);
            out.face.at(x, y) = static_cast<uint32_t>(t);
        }
    });
    return out;
}

Image8 render_colors(const Mesh& mesh, const Camera& camera, const std::function<std::array<float, 3>(const Vec3d&)>& color_at) {
    if (mesh.colors.empty() && !color_at) throw UsageError("render: the mesh has no colours");
    const Intrinsics& k = camera.intrinsics;
    const auto vertices = project_all(mesh, camera);
    ImageF depth(k.width_px, k.height_px, 1, std::numeric_limits<float>::infinity());
    Image8 out(k.width_px, k.height_px, 4);
    for_each_covered(mesh, camera, vertices, [&](int x, int y, size_t t, double w0, double w1, double w2) {
        const auto& f = mesh.triangles[t];
        double w[3] = {w0, w1, w2}, z = 0;
        if (k.orthographic) {
            for (size_t c = 0; c < 3; ++c) z += w[c] * vertices[f[c]].z;
        } else {
            double sum = 0;
            for (size_t c = 0; c < 3; ++c) sum += w[c] /= vertices[f[c]].z;
            for (double& a : w) a /= sum;
            z = 1 / sum;
        }
        if (!(static_cast<float>(z) < depth.at(x, y))) return;
        depth.at(x, y) = static_cast<float>(z);
        std::array<float, 3> color{};
        if (color_at) {
            Vec3d p = Vec3d::Zero();
            for (size_t c = 0; c < 3; ++c) p += w[c] * Vec3d(mesh.vertices[f[c]][0], mesh.vertices[f[c]][1], mesh.vertices[f[c]][2]);
            color = color_at(p);
        } else {
            for (size_t i = 0; i < 3; ++i)
                for (size_t c = 0; c < 3; ++c) color[i] += static_cast<float>(w[c]) * mesh.colors[f[c]][i];
        }
        for (int i = 0; i < 3; ++i) out.at(x, y, i) = srgb8_from_linear(color[static_cast<size_t>(i)]);
        out.at(x, y, 3) = 255;
    });
    return out;
}

namespace {

Image8 hits(const Mesh& mesh, const Camera& camera, const std::vector<ProjectedVertex>& vertices) {
    Image8 out(camera.intrinsics.width_px, camera.intrinsics.height_px);
    for_each_covered(mesh, camera, vertices, [&](int x, int y, size_t, double, double, double) { out.at(x, y) = 255; });
    return out;
}

}  // namespace

Image8 silhouette_of(const Mesh& mesh, const Camera& camera) { return hits(mesh, camera, project_all(mesh, camera)); }

SoftSilhouette soft_silhouette_of(const Mesh& mesh, const Camera& camera) {
    constexpr int kSamples = 8;                ///< a side
    static_assert(kSamples * kSamples == 64);  // a bit each
    constexpr int kBlock_px = 8;
    const std::vector<ProjectedVertex> vertices = project_all(mesh, camera);
    SoftSilhouette out;
    out.hit = hits(mesh, camera, vertices);
    out.soft = out.hit;
    const Image8& hit = out.hit;
    Image<int32_t> contour_number(hit.width, hit.height, 1, -1);
    Image8 has_contour(hit.width / kBlock_px + 1, hit.height / kBlock_px + 1);  // of blocks: few triangles lie there
    std::vector<uint64_t> covered;
    for (int y = 0; y < hit.height; ++y)
        for (int x = 0; x < hit.width; ++x) {
            bool differs = false;
            for (int v = std::max(0, y - 1); v <= std::min(hit.height - 1, y + 1); ++v)
                for (int u = std::max(0, x - 1); u <= std::min(hit.width - 1, x + 1); ++u) differs = differs || hit.at(u, v) != hit.at(x, y);
            if (!differs) continue;
            contour_number.at(x, y) = static_cast<int32_t>(covered.size());
            has_contour.at(x / kBlock_px, y / kBlock_px) = 1;
            covered.push_back(0);
        }
    for_each_triangle(mesh, camera, vertices, 0.5, [&](size_t, const ProjectedTriangle& triangle, int x0, int y0, int x1, int y1) {
        bool near = false;
        for (int v = y0 / kBlock_px; v <= y1 / kBlock_px; ++v)
            for (int u = x0 / kBlock_px; u <= x1 / kBlock_px; ++u) near = near || has_contour.at(u, v);
        if (!near) return;
        std::array<double, 3> w;
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) {
                if (contour_number.at(x, y) < 0) continue;
                uint64_t& bits = covered[static_cast<size_t>(contour_number.at(x, y))];
                for (int s = 0; s < kSamples * kSamples; ++s)
                    if (!(bits >> s & 1) && triangle.covers(x + (s % kSamples + 0.5) / kSamples, y + (s / kSamples + 0.5) / kSamples, w))
                        bits |= uint64_t{1} << s;
            }
    });
    for (size_t n = 0; n < out.soft.data.size(); ++n) {
        if (contour_number.data[n] < 0) continue;
        const int rays = kSamples * kSamples, share = (std::popcount(covered[static_cast<size_t>(contour_number.data[n])]) * 255 + rays / 2) / rays;
        out.soft.data[n] = static_cast<uint8_t>(hit.data[n] ? std::max(share, 128) : std::min(share, 127));
    }
    return out;
}

Image8 coverage_of(const Mesh& mesh, const Camera& camera, int samples) {
    const Camera fine = scaled(camera, samples);
    const auto width = static_cast<size_t>(fine.intrinsics.width_px);
    std::vector<bool> covered(width * static_cast<size_t>(fine.intrinsics.height_px), false);
    for_each_covered(mesh, fine, project_all(mesh, fine),
                     [&](int x, int y, size_t, double, double, double) { covered[static_cast<size_t>(y) * width + static_cast<size_t>(x)] = true; });
    Image8 out(camera.intrinsics.width_px, camera.intrinsics.height_px);
    const int full = samples * samples;
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            int count = 0;
            for (int sy = 0; sy < samples; ++sy)
                for (int sx = 0; sx < samples; ++sx) count += covered[static_cast<size_t>(y * samples + sy) * width + static_cast<size_t>(x * samples + sx)];
            out.at(x, y) = static_cast<uint8_t>((count * 255 + full / 2) / full);
        }
    return out;
}

}  // namespace vdbcarve
