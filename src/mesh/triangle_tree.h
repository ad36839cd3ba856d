// SPDX-License-Identifier: Apache-2.0
// A bounding volume hierarchy over triangles: nearest points, first hits of rays, samples by area.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <random>
#include <unsupported/Eigen/BVH>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

struct Triangle {
    Vec3d a, b, c;
    Vec3d normal() const { return (b - a).cross(c - a); }
    /// Weights of the corners at a point of the triangle's plane.
    Vec3d weights(const Vec3d& p) const {
        const Vec3d n = normal();
        const double n2 = n.squaredNorm();
        if (n2 == 0) return {1, 0, 0};
        const double v = (p - a).cross(c - a).dot(n) / n2, w = (b - a).cross(p - a).dot(n) / n2;
        return {1 - v - w, v, w};
    }
};

/// Nearest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
inline Vec3d nearest_point(const Triangle& t, const Vec3d& p) {
    const Vec3d ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
    const double d1 = ab.dot(ap), d2 = ac.dot(ap);
    if (d1 <= 0 && d2 <= 0) return t.a;
    const Vec3d bp = p - t.b;
    const double d3 = ab.dot(bp), d4 = ac.dot(bp);
    if (d3 >= 0 && d4 <= d3) return t.b;
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return t.a + d1 / (d1 - d3) * ab;
    const Vec3d cp = p - t.c;
    const double d5 = ab.dot(cp), d6 = ac.dot(cp);
    if (d6 >= 0 && d5 <= d6) return t.c;
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return t.a + d2 / (d2 - d6) * ac;
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return t.b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (t.c - t.b);
    const double sum = va + vb + vc;
    if (sum == 0) return t.a;
    return t.a + vb / sum * ab + vc / sum * ac;
}

/// The faces of a mesh, to be searched.
class TriangleTree {
  public:
    using Place = std::function<Vec3d(const Vec3d&)>;
    /// `place` moves vertices first.
    explicit TriangleTree(const Mesh& mesh, const Place& place = {}) {
        std::vector<Eigen::AlignedBox3d> boxes;
        std::vector<int> numbers;
        for (const auto& f : mesh.triangles) {
            const auto at = [&](size_t c) {
                const auto& v = mesh.vertices[f[c]];
                const Vec3d p(v[0], v[1], v[2]);
                return place ? place(p) : p;
            };
            triangles_.push_back({at(0), at(1), at(2)});
            Eigen::AlignedBox3d box(triangles_.back().a);
            box.extend(triangles_.back().b);
            box.extend(triangles_.back().c);
            boxes.push_back(box);
            box_.extend(box);
            numbers.push_back(static_cast<int>(numbers.size()));
        }
        tree_.init(numbers.begin(), numbers.end(), boxes.begin(), boxes.end());
    }

    struct Nearest {
        double distance;
        int triangle;
    };
    Nearest nearest(const Vec3d& p) const {
        struct Minimizer {
            using Scalar = double;
            const std::vector<Triangle>& triangles;
            const Vec3d& p;
            double best = INFINITY;
            int which = -1;
            double minimumOnVolume(const Eigen::AlignedBox3d& box) const { return box.squaredExteriorDistance(p); }
            double minimumOnObject(int n) {
                const double d2 = (nearest_point(triangles[static_cast<size_t>(n)], p) - p).squaredNorm();
                if (d2 < best) {
                    best = d2;
                    which = n;
                }
                return d2;
            }
        } minimizer{triangles_, p};
        Eigen::BVMinimize(tree_, minimizer);
        return {std::sqrt(minimizer.best), minimizer.which};
    }

    Vec3d nearest_on(int n, const Vec3d& p) const { return nearest_point(triangle(n), p); }

    /// Distance along a ray to the first face.
    std::optional<double> hit(const Camera::Ray& ray) const {
        struct Walker {
            const std::vector<Triangle>& triangles;
            const Camera::Ray& ray;
            double nearest = INFINITY;
            bool intersectVolume(const Eigen::AlignedBox3d& box) const {
                double t0 = 0, t1 = nearest;
                for (int a = 0; a < 3; ++a) {
                    const double u = (box.min()[a] - ray.origin[a]) / ray.direction[a], v = (box.max()[a] - ray.origin[a]) / ray.direction[a];
                    t0 = std::max(t0, std::min(u, v));
                    t1 = std::min(t1, std::max(u, v));
                }
                return t0 <= t1;
            }
            bool intersectObject(int n) {
                // Moeller and Trumbore 1997.
                const Triangle& v = triangles[static_cast<size_t>(n)];
                const Vec3d e1 = v.b - v.a, e2 = v.c - v.a, p = ray.direction.cross(e2);
                const double det = e1.dot(p);
                if (det == 0) return false;
                const Vec3d s = ray.origin - v.a, q = s.cross(e1);
                const double a = s.dot(p) / det, b = ray.direction.dot(q) / det, t = e2.dot(q) / det;
                if (a >= 0 && b >= 0 && a + b <= 1 && t > 0) nearest = std::min(nearest, t);
                return false;
            }
        } walker{triangles_, ray};
        Eigen::BVIntersect(tree_, walker);
        return std::isfinite(walker.nearest) ? std::optional(walker.nearest) : std::nullopt;
    }

    struct Sample {
        Vec3d point, normal;
        int triangle;
    };
    /// Evenly by area: one random point in each of `count` equal shares of the area.
    std::vector<Sample> samples(size_t count, uint64_t seed) const {
        std::vector<double> sum{0};
        for (const Triangle& t : triangles_) sum.push_back(sum.back() + 0.5 * t.normal().norm());
        std::mt19937_64 engine(seed);
        const auto random = [&] { return static_cast<double>(engine() >> 11) * 0x1p-53; };
        std::vector<Sample> out;
        for (size_t n = 0; n < count; ++n) {
            const double at = (static_cast<double>(n) + random()) / static_cast<double>(count) * sum.back();
            const auto i = std::min(triangles_.size() - 1, static_cast<size_t>(std::upper_bound(sum.begin(), sum.end(), at) - sum.begin() - 1));
            const Triangle& t = triangles_[i];
            const double r = std::sqrt(random()), s = random();
            out.push_back({(1 - r) * t.a + r * (1 - s) * t.b + r * s * t.c, t.normal().normalized(), static_cast<int>(i)});
        }
        return out;
    }
    const Triangle& triangle(int n) const { return triangles_[static_cast<size_t>(n)]; }
    const Eigen::AlignedBox3d& box() const { return box_; }

  private:
    std::vector<Triangle> triangles_;
    Eigen::KdBVH<double, 3, int> tree_;
    Eigen::AlignedBox3d box_;
};

}  // namespace vdbcarve
