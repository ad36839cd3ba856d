// SPDX-License-Identifier: Apache-2.0
// Solids as signed distances, and rays that meet them.
#include "vdbcarve/synthetic.h"

#include <cmath>

namespace vdbcarve {
namespace {

double box_value(const Vec3d& p, const Vec3d& half) {
    const Vec3d q = p.cwiseAbs() - half;
    return q.cwiseMax(0.0).norm() + std::min(q.maxCoeff(), 0.0);
}

/// std::hypot guards against overflow at ten times the cost.
double length(double x, double y) { return std::sqrt(x * x + y * y); }

double torus_value(const Vec3d& p, double ring, double tube) { return length(length(p.x(), p.y()) - ring, p.z()) - tube; }

double cylinder_value(const Vec3d& p, double radius, double z_low, double z_high) {
    const double across = length(p.x(), p.y()) - radius, along = std::max(z_low - p.z(), p.z() - z_high);
    return length(std::max(across, 0.0), std::max(along, 0.0)) + std::min(std::max(across, along), 0.0);
}

double cup_value(const Vec3d& p, double radius, double half_height, double wall) {
    const double outer = cylinder_value(p, radius, -half_height, half_height);
    const double hollow = cylinder_value(p, radius - wall, -half_height + 1.5 * wall, 2 * half_height);
    // The handle: a ring standing upright, its plane holds the z axis; what would stick into the hollow is cut.
    const Vec3d h(p.x() - radius, p.z(), p.y());
    const double handle = torus_value(h, 0.6 * half_height, 0.8 * wall);
    return std::max(std::min(outer, handle), -hollow);
}

double bowl_value(const Vec3d& p, double radius, double half_height, double depth) {
    constexpr double kRim = 0.86;
    const double rim = kRim * radius, ball = (rim * rim + depth * depth) / (2 * depth);
    return std::max(cylinder_value(p, radius, -half_height, half_height), ball - (p - Vec3d(0, 0, half_height - depth + ball)).norm());
}

}  // namespace

double Solid::value(const Vec3d& point_world) const { return value_here(world_from_solid.inverse() * point_world); }

double Solid::value_here(const Vec3d& p) const {
    switch (kind) {
        case Kind::Ellipsoid:
            return (p.cwiseQuotient(size).norm() - 1) * size.minCoeff();
        case Kind::Box:
            return box_value(p, size);
        case Kind::Torus:
            return torus_value(p, size[0], size[1]);
        case Kind::Cup:
            return cup_value(p, size[0], size[1], size[2]);
        case Kind::Bowl:
            return bowl_value(p, size[0], size[1], size[2]);
    }
    return 0;
}

double Solid::reach() const {
    switch (kind) {
        case Kind::Ellipsoid:
            return size.maxCoeff();
        case Kind::Box:
            return size.norm();
        case Kind::Torus:
            return size[0] + size[1];
        case Kind::Cup:
            return std::hypot(size[0], size[1]) + 0.6 * size[1] + 0.8 * size[2];
        case Kind::Bowl:
            return std::hypot(size[0], size[1]);
    }
    return 0;
}

std::optional<double> Solid::hit(const Camera::Ray& ray_world) const {
    const Mat3d turn = world_from_solid.rotation.transpose();
    const Vec3d from_centre = ray_world.origin - world_from_solid.translation;
    const double miss2 = from_centre.squaredNorm() - std::pow(from_centre.dot(ray_world.direction), 2);
    if (miss2 > reach() * reach()) return std::nullopt;
    const Vec3d o = turn * from_centre, d = turn * ray_world.direction;
    if (kind == Kind::Ellipsoid) {
        const Vec3d os = o.cwiseQuotient(size), ds = d.cwiseQuotient(size);
        const double a = ds.squaredNorm(), b = os.dot(ds), c = os.squaredNorm() - 1, disc = b * b - a * c;
        if (disc < 0) return std::nullopt;
        const double t = (-b - std::sqrt(disc)) / a;
        return t > 0 ? std::optional(t) : std::nullopt;
    }
    if (kind == Kind::Box) {
        double t0 = 0, t1 = INFINITY;
        for (int a = 0; a < 3; ++a) {
            const double u = (-size[a] - o[a]) / d[a], v = (size[a] - o[a]) / d[a];
            t0 = std::max(t0, std::min(u, v));
            t1 = std::min(t1, std::max(u, v));
        }
        return t0 <= t1 ? std::optional(t0) : std::nullopt;
    }
    // Sphere tracing between the entry into and the exit from the ball that holds the solid.
    const double ball = reach(), b = o.dot(d), disc = b * b - (o.squaredNorm() - ball * ball);
    if (disc < 0) return std::nullopt;
    double t = std::max(0.0, -b - std::sqrt(disc));
    const double end = -b + std::sqrt(disc), close = 1e-5 * ball;  // far below a sample's width
    for (int step = 0; step < 400 && t <= end; ++step) {
        const Vec3d p = o + t * d;
        const double v = value_here(p);
        if (v < close) return t;
        t += v;
    }
    return std::nullopt;
}

}  // namespace vdbcarve
