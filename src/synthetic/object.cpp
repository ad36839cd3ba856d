// SPDX-License-Identifier: Apache-2.0
#include "synthetic/object.h"

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "synthetic/noise.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve::synth {

Vec3d albedo(const Vec3d& p, Pattern pattern) {
    const Vec3d clay(0.62, 0.30, 0.16), glaze(0.12, 0.36, 0.45);
    if (pattern == Pattern::Plain) return 0.8 * clay;
    if (pattern == Pattern::Checks) {
        constexpr double kSide = 0.12, kEdge = 0.3;  // of a check, of the radius; blurred over that much of it, so that pictures do not alias
        double sign = 1;
        for (int a = 0; a < 3; ++a) sign *= std::clamp(std::sin(std::numbers::pi * (p[a] / kSide + 0.5)) / kEdge, -1.0, 1.0);
        return 0.5 * ((1 + sign) * clay + (1 - sign) * glaze);
    }
    const double n = 0.6 * noise(5 * p) + 0.3 * noise(11 * p) + 0.1 * noise(23 * p);
    const double vein = std::pow(std::abs(std::sin(6 * p.x() + 4 * p.z() + 9 * n)), 4);
    return (1 - vein) * (clay * (0.6 + 0.6 * n)) + vein * glaze;
}

Object::Object(const SyntheticSpec& spec) : spec_(spec) {
    Box3d box;
    if (spec.solids.empty()) {
        for (const auto& v : spec.mesh.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    } else {
        for (const Solid& s : spec.solids) {
            box.extend((s.world_from_solid.translation - Vec3d::Constant(s.reach())).eval());
            box.extend((s.world_from_solid.translation + Vec3d::Constant(s.reach())).eval());
        }
    }
    if (box.isEmpty()) throw InputError("synth: " + spec.name + " has neither solids nor a mesh");
    centre_ = box.center();
    if (spec.solids.empty()) {
        for (const auto& v : spec.mesh.vertices) radius_ = std::max(radius_, (Vec3d(v[0], v[1], v[2]) - centre_).norm());
        if (spec.photos && spec.look.table) {
            tree_.emplace(spec.mesh);
        }
    } else {
        // The balls around solids are generous; what counts is where the union really ends.
        truth_ = mesh_of_solids(box);
        Box3d tight;
        for (const auto& v : truth_.vertices) tight.extend(Vec3d(v[0], v[1], v[2]));
        centre_ = tight.center();
        for (const auto& v : truth_.vertices) radius_ = std::max(radius_, (Vec3d(v[0], v[1], v[2]) - centre_).norm());
    }
}

Image8 Object::coverage(const Camera& camera, const Surface& surface) const {
    if (spec_.solids.empty()) return coverage_of(spec_.mesh, camera, 16);
    // Traced rays cost a hundred times a closed form; 8 x 8 of them still tell 1/64 of a pixel.
    const bool closed_form =
        std::all_of(spec_.solids.begin(), spec_.solids.end(), [](const Solid& s) { return s.kind == Solid::Kind::Ellipsoid || s.kind == Solid::Kind::Box; });
    const int samples = closed_form ? 16 : 8;
    const int width = camera.intrinsics.width_px, height = camera.intrinsics.height_px;
    const auto centre_hits = [&](int x, int y) {
        x = std::clamp(x, 0, width - 1);
        y = std::clamp(y, 0, height - 1);
        return surface[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)].has_value();
    };
    Image8 out(width, height);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            // Pixels that agree with all their neighbours are whole (contours curve over many pixels);
            // the border of the image has no neighbours beyond and is always counted.
            const bool here = centre_hits(x, y);
            bool whole = x > 0 && y > 0 && x < width - 1 && y < height - 1;
            for (int j = -1; j <= 1; ++j)
                for (int i = -1; i <= 1; ++i) whole = whole && centre_hits(x + i, y + j) == here;
            if (whole) {
                out.at(x, y) = here ? 255 : 0;
                continue;
            }
            int count = 0;
            for (int j = 0; j < samples; ++j)
                for (int i = 0; i < samples; ++i) count += hit(camera.ray({x + (i + 0.5) / samples, y + (j + 0.5) / samples})).has_value();
            out.at(x, y) = static_cast<uint8_t>((count * 255 + samples * samples / 2) / (samples * samples));
        }
    return out;
}

Object::Surface Object::surface(const Camera& camera, bool with_normals) const {
    const Intrinsics& k = camera.intrinsics;
    Surface out(static_cast<size_t>(k.width_px) * static_cast<size_t>(k.height_px));
    const Raster raster = spec_.solids.empty() ? rasterize(spec_.mesh, camera) : Raster{};
    for (int y = 0; y < k.height_px; ++y)
        for (int x = 0; x < k.width_px; ++x) {
            auto& point = out[static_cast<size_t>(y) * static_cast<size_t>(k.width_px) + static_cast<size_t>(x)];
            const Camera::Ray ray = camera.ray({x + 0.5, y + 0.5});
            if (!spec_.solids.empty()) {
                if (const auto t = hit(ray)) {
                    const Vec3d p = ray.origin + *t * ray.direction;
                    point = with_normals ? SurfacePoint{p, gradient(p), nearest_solid(p)} : SurfacePoint{p, Vec3d::Zero(), 0};
                }
            } else if (const uint32_t face = raster.face.at(x, y); face != UINT32_MAX) {
                Vec3d v[3];
                for (size_t c = 0; c < 3; ++c) {
                    const auto& q = spec_.mesh.vertices[spec_.mesh.triangles[face][c]];
                    v[c] = Vec3d(q[0], q[1], q[2]);
                }
                const double along = raster.depth.at(x, y) / ray.direction.dot(camera.forward_world());
                point = SurfacePoint{ray.origin + along * ray.direction, (v[1] - v[0]).cross(v[2] - v[0]).normalized(), static_cast<int>(face)};
            }
        }
    return out;
}

std::optional<double> Object::hit(const Camera::Ray& ray) const {
    if (spec_.solids.empty()) return tree_->hit(ray);
    std::optional<double> nearest;
    for (const Solid& s : spec_.solids)
        if (const auto t = s.hit(ray); t && (!nearest || *t < *nearest)) nearest = t;
    return nearest;
}

SurfacePoint Object::nearest(const Vec3d& p, double& distance) const {
    if (spec_.solids.empty()) {
        const TriangleTree::Nearest n = tree_->nearest(p);
        distance = n.distance;
        return {tree_->nearest_on(n.triangle, p), tree_->triangle(n.triangle).normal().normalized(), n.triangle};
    }
    Vec3d q = p;
    for (int step = 0; step < 20; ++step) {
        const double v = value(q);
        if (std::abs(v) < 1e-9 * radius_) break;
        q -= v * gradient(q);
    }
    distance = (q - p).norm();
    return {q, gradient(q), nearest_solid(q)};
}

void Object::prepare_nearest() const {
    if (spec_.solids.empty() && !tree_) tree_.emplace(spec_.mesh);
}

Vec3d Object::albedo_at(const SurfacePoint& p) const {
    const auto part = static_cast<size_t>(p.part);
    const Vec3d place = (p.position - centre_) / radius_;
    if (!spec_.solids.empty() && spec_.solids[part].color) return *spec_.solids[part].color * (0.75 + 0.5 * noise(7 * place));
    if (spec_.solids.empty() && !spec_.texture.empty() && !spec_.mesh.texcoords.empty()) {
        const auto& f = spec_.mesh.triangles[part];
        const auto at = [&](size_t c) { return Vec3d(spec_.mesh.vertices[f[c]][0], spec_.mesh.vertices[f[c]][1], spec_.mesh.vertices[f[c]][2]); };
        const Vec3d w = Triangle{at(0), at(1), at(2)}.weights(p.position);
        double u = 0, v = 0;
        for (size_t c = 0; c < 3; ++c) {
            u += w[static_cast<Eigen::Index>(c)] * spec_.mesh.texcoords[part][c][0];
            v += w[static_cast<Eigen::Index>(c)] * spec_.mesh.texcoords[part][c][1];
        }
        return texture_at(u, v);
    }
    return albedo(place, spec_.pattern);
}

double Object::lowest(const Vec3d& up) const {
    double least = INFINITY;
    for (const auto& v : truth().vertices) least = std::min(least, Vec3d(v[0], v[1], v[2]).dot(up));
    return least;
}

double Object::value(const Vec3d& p) const {
    double v = INFINITY;
    for (const Solid& s : spec_.solids) v = std::min(v, s.value(p));
    return v;
}

int Object::nearest_solid(const Vec3d& p) const {
    size_t best = 0;
    for (size_t s = 1; s < spec_.solids.size(); ++s)
        if (spec_.solids[s].value(p) < spec_.solids[best].value(p)) best = s;
    return static_cast<int>(best);
}

Vec3d Object::texture_at(double u, double v) const {
    const Image8& t = spec_.texture;
    const double x = (u - std::floor(u)) * t.width - 0.5, y = (1 - (v - std::floor(v))) * t.height - 0.5;
    const double fx = std::floor(x), fy = std::floor(y), a = x - fx, b = y - fy;
    static const std::vector<double> linear = [] {
        std::vector<double> out;
        for (int i = 0; i < 256; ++i) out.push_back(linear_from_srgb(i / 255.0));
        return out;
    }();
    const auto texel = [&](double i, double j, int c) {
        const int ix = std::clamp(static_cast<int>(i), 0, t.width - 1), iy = std::clamp(static_cast<int>(j), 0, t.height - 1);
        return linear[t.at(ix, iy, t.channels < 3 ? 0 : c)];
    };
    Vec3d out;
    for (int c = 0; c < 3; ++c)
        out[c] = (1 - b) * ((1 - a) * texel(fx, fy, c) + a * texel(fx + 1, fy, c)) + b * ((1 - a) * texel(fx, fy + 1, c) + a * texel(fx + 1, fy + 1, c));
    return out;
}

Vec3d Object::gradient(const Vec3d& p) const {
    const double h = 1e-5 * radius_;
    Vec3d g;
    for (int a = 0; a < 3; ++a) g[a] = value(p + h * Vec3d::Unit(a)) - value(p - h * Vec3d::Unit(a));
    return g.normalized();
}

Mesh Object::mesh_of_solids(const Box3d& box) const {
    constexpr int kSide = 192;
    const double h = box.sizes().maxCoeff() / kSide;
    openvdb::initialize();
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(static_cast<float>(3 * h));
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    auto accessor = grid->getAccessor();
    const Vec3d n = (box.sizes() / h).array().ceil();
    std::vector<std::vector<std::pair<openvdb::Coord, float>>> slices(static_cast<size_t>(n[0]) + 5);
    tbb::parallel_for(size_t{0}, slices.size(), [&](size_t s) {
        const int i = static_cast<int>(s) - 2;
        for (int j = -2; j < n[1] + 3; ++j)
            for (int k = -2; k < n[2] + 3; ++k) {
                const double v = value(box.min() + h * Vec3d(i, j, k));
                if (std::abs(v) < 3 * h) slices[s].emplace_back(openvdb::Coord(i, j, k), static_cast<float>(v));
                else if (v < 0) slices[s].emplace_back(openvdb::Coord(i, j, k), static_cast<float>(-3 * h));
            }
    });
    for (const auto& slice : slices)
        for (const auto& [c, v] : slice) accessor.setValue(c, v);
    Progress quiet;
    Mesh mesh = extract_mesh(*grid, {}, quiet);
    for (auto& v : mesh.vertices) {
        Vec3d p = box.min() + h * Vec3d(v[0], v[1], v[2]);
        // Newton steps onto the surface; not across creases, where the gradient jumps.
        for (int step = 0; step < 3; ++step) {
            const double e = 1e-4 * h, f = value(p);
            Vec3d g;
            for (int a = 0; a < 3; ++a) g[a] = (value(p + e * Vec3d::Unit(a)) - value(p - e * Vec3d::Unit(a))) / (2 * e);
            const double g2 = g.squaredNorm();
            if (g2 > 1e-6) p -= std::clamp(f / std::sqrt(g2), -0.5 * h, 0.5 * h) * g / std::sqrt(g2);
        }
        v = {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())};
    }
    return mesh;
}

}  // namespace vdbcarve::synth
