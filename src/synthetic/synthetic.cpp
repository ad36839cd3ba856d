// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/synthetic.h"

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "image/image_io.h"
#include "mesh/triangle_tree.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

constexpr double kPi = std::numbers::pi;

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

namespace {

/// Uniform in -1..1, the same on every standard library.
class Dice {
  public:
    explicit Dice(uint64_t seed) : engine_(seed) {}
    double operator()() { return static_cast<double>(engine_() >> 11) * 0x1p-52 - 1.0; }

  private:
    std::mt19937_64 engine_;
};

Camera look_at(const Vec3d& centre, const Vec3d& target, double roll_rad, const Intrinsics& k) {
    const Vec3d z = (target - centre).normalized();
    Vec3d up = Vec3d::UnitZ();
    if (std::abs(z.dot(up)) > 0.999) up = Vec3d::UnitY();
    const Vec3d x0 = z.cross(up).normalized(), y0 = z.cross(x0);
    const double c = std::cos(roll_rad), s = std::sin(roll_rad);
    Camera camera;
    camera.intrinsics = k;
    camera.camera_from_world.rotation.row(0) = (c * x0 + s * y0).transpose();
    camera.camera_from_world.rotation.row(1) = (-s * x0 + c * y0).transpose();
    camera.camera_from_world.rotation.row(2) = z.transpose();
    camera.camera_from_world.translation = -(camera.camera_from_world.rotation * centre);
    return camera;
}

struct Direction {
    double azimuth_rad, elevation_rad;
};

constexpr double rad(double deg) { return deg * kPi / 180; }

std::vector<Direction> directions(const Rig& rig) {
    std::vector<Direction> out;
    const auto ring = [&](int views, double elevation_deg, double phase, double arc_deg) {
        for (int i = 0; i < views; ++i) {
            // Angular speed 1 + v cos: its integral keeps the ends of a turn where they were.
            const double turn = (i + phase) / views;
            const double at = turn + rig.speed_variation * std::sin(2 * kPi * turn) / (2 * kPi);
            out.push_back({rad(rig.start_deg) + rad(arc_deg) * at, rad(elevation_deg)});
        }
    };
    switch (rig.kind) {
        case Rig::Kind::Orbit:
            ring(rig.views, rig.elevation_deg, 0, rig.arc_deg);
            break;
        case Rig::Kind::Rings:
            for (size_t r = 0; r < rig.rings.size(); ++r) ring(rig.rings[r].views, rig.rings[r].elevation_deg, r % 2 ? 0.5 : 0, rig.arc_deg);
            break;
        case Rig::Kind::Dome:
            // Fibonacci points on the upper half sphere, spread evenly by area.
            for (int i = 0; i < rig.views; ++i) out.push_back({rad(rig.start_deg) + i * kPi * (3 - std::sqrt(5.0)), std::asin((i + 0.5) / rig.views * 0.97)});
            break;
    }
    return out;
}

double hash_noise(int64_t x, int64_t y, int64_t z) {
    uint64_t h =
        static_cast<uint64_t>(x) * 0x9E3779B97F4A7C15ull ^ static_cast<uint64_t>(y) * 0xC2B2AE3D27D4EB4Full ^ static_cast<uint64_t>(z) * 0x165667B19E3779F9ull;
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9ull;
    h ^= h >> 32;
    return static_cast<double>(h & 0xFFFFFF) / 0xFFFFFF;
}

/// Smooth value noise in 0..1, lattice spacing 1.
double noise(const Vec3d& p) {
    const Vec3d f(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
    Vec3d w = p - f;
    for (double& a : w) a = a * a * (3 - 2 * a);
    double sum = 0;
    for (int c = 0; c < 8; ++c) {
        const int i = c & 1, j = c >> 1 & 1, k = c >> 2;
        sum += (i ? w.x() : 1 - w.x()) * (j ? w.y() : 1 - w.y()) * (k ? w.z() : 1 - w.z()) *
               hash_noise(static_cast<int64_t>(f.x()) + i, static_cast<int64_t>(f.y()) + j, static_cast<int64_t>(f.z()) + k);
    }
    return sum;
}

/// Linear albedo on the object, as a function of place in units of the object's radius.
Vec3d albedo(const Vec3d& p, Pattern pattern) {
    const Vec3d clay(0.62, 0.30, 0.16), glaze(0.12, 0.36, 0.45);
    if (pattern == Pattern::Plain) return 0.8 * clay;
    if (pattern == Pattern::Checks) {
        constexpr double kSide = 0.12, kEdge = 0.3;  // of a check, of the radius; blurred over that much of it, so that pictures do not alias
        double sign = 1;
        for (int a = 0; a < 3; ++a) sign *= std::clamp(std::sin(kPi * (p[a] / kSide + 0.5)) / kEdge, -1.0, 1.0);
        return 0.5 * ((1 + sign) * clay + (1 - sign) * glaze);
    }
    const double n = 0.6 * noise(5 * p) + 0.3 * noise(11 * p) + 0.1 * noise(23 * p);
    const double vein = std::pow(std::abs(std::sin(6 * p.x() + 4 * p.z() + 9 * n)), 4);
    return (1 - vein) * (clay * (0.6 + 0.6 * n)) + vein * glaze;
}

/// Linear light from the room, as a function of the viewing direction.
Vec3d room(const Vec3d& d) {
    const double n = noise(6 * d + Vec3d(31, 7, 3)), m = noise(17 * d + Vec3d(5, 11, 40));
    const double wall = 0.10 + 0.25 * n + 0.08 * m, floor = d.z() < -0.1 ? 0.7 : 1.0;
    const double stripe = std::sin(14 * std::atan2(d.y(), d.x())) > 0.6 ? 0.6 : 1.0;
    return floor * stripe * wall * Vec3d(0.9, 1.0, 1.05 + 0.3 * m);
}

struct SurfacePoint {
    Vec3d position, normal;
    int part;  ///< number of the solid or face
};

/// The object, solids or mesh, as the renderer asks it.
class Object {
  public:
    explicit Object(const SyntheticSpec& spec) : spec_(spec) {
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
    const Vec3d& centre() const { return centre_; }
    double radius() const { return radius_; }
    const Mesh& truth() const { return spec_.solids.empty() ? spec_.mesh : truth_; }

    using Surface = std::vector<std::optional<SurfacePoint>>;

    /// Share of each pixel that the object covers. `surface` is what surface() says of the same camera.
    Image8 coverage(const Camera& camera, const Surface& surface) const {
        if (spec_.solids.empty()) return coverage_of(spec_.mesh, camera, 16);
        // Traced rays cost a hundred times a closed form; 8 x 8 of them still tell 1/64 of a pixel.
        const bool closed_form = std::all_of(spec_.solids.begin(), spec_.solids.end(),
                                             [](const Solid& s) { return s.kind == Solid::Kind::Ellipsoid || s.kind == Solid::Kind::Box; });
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

    /// What each pixel centre sees; nothing where it sees past the object.
    /// Normals are left out unless asked for: they cost six more evaluations.
    Surface surface(const Camera& camera, bool with_normals) const {
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

    /// Distance along a ray to the first surface point. Meshes: by a bounding volume hierarchy.
    std::optional<double> hit(const Camera::Ray& ray) const {
        if (spec_.solids.empty()) return tree_->hit(ray);
        std::optional<double> nearest;
        for (const Solid& s : spec_.solids)
            if (const auto t = s.hit(ray); t && (!nearest || *t < *nearest)) nearest = t;
        return nearest;
    }
    /// The surface point nearest to a place, and its distance. Solids: by steps along the gradient. Meshes: after prepare_nearest().
    SurfacePoint nearest(const Vec3d& p, double& distance) const {
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
    void prepare_nearest() const {
        if (spec_.solids.empty() && !tree_) tree_.emplace(spec_.mesh);
    }
    Pattern pattern() const { return spec_.pattern; }
    /// Linear colour of the surface itself.
    Vec3d albedo_at(const SurfacePoint& p) const {
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
    /// Height of the lowest point along an axis.
    double lowest(const Vec3d& up) const {
        double least = INFINITY;
        for (const auto& v : truth().vertices) least = std::min(least, Vec3d(v[0], v[1], v[2]).dot(up));
        return least;
    }

  private:
    double value(const Vec3d& p) const {
        double v = INFINITY;
        for (const Solid& s : spec_.solids) v = std::min(v, s.value(p));
        return v;
    }
    int nearest_solid(const Vec3d& p) const {
        size_t best = 0;
        for (size_t s = 1; s < spec_.solids.size(); ++s)
            if (spec_.solids[s].value(p) < spec_.solids[best].value(p)) best = s;
        return static_cast<int>(best);
    }
    /// Bilinear in linear light; v upwards, repeated.
    Vec3d texture_at(double u, double v) const {
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
    Vec3d gradient(const Vec3d& p) const {
        const double h = 1e-5 * radius_;
        Vec3d g;
        for (int a = 0; a < 3; ++a) g[a] = value(p + h * Vec3d::Unit(a)) - value(p - h * Vec3d::Unit(a));
        return g.normalized();
    }
    Mesh mesh_of_solids(const Box3d& box) const {
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

    const SyntheticSpec& spec_;
    Vec3d centre_ = Vec3d::Zero();
    double radius_ = 0;
    Mesh truth_;
    mutable std::optional<TriangleTree> tree_;  ///< of the mesh's faces
};

/// Where light and room stand: their frame is the camera's for a turntable, the object's otherwise.
struct Room {
    Mat3d room_from_scene;
    Vec3d up_scene;  ///< the table's normal

    Vec3d key() const { return room_from_scene.transpose() * Vec3d(0.5, -0.6, 0.9).normalized(); }
    Vec3d fill() const { return room_from_scene.transpose() * Vec3d(-0.8, 0.3, 0.2).normalized(); }
    /// Light that a matt white surface sends back.
    double diffuse(const Vec3d& normal, const PhotoLook& look) const {
        if (look.flat) return 1;
        return 0.22 + 0.75 * std::max(0.0, normal.dot(key())) + 0.25 * std::max(0.0, normal.dot(fill()));
    }
};

Room room_of(const Rig& rig, double azimuth_rad, const Mat3d& side_from_scene) {
    Room place;
    place.up_scene = side_from_scene.transpose() * Vec3d::UnitZ();
    place.room_from_scene = side_from_scene;
    if (rig.motion == Rig::Motion::Turntable) place.room_from_scene = Mat3d(Eigen::AngleAxisd(-azimuth_rad, Vec3d::UnitZ())) * side_from_scene;
    return place;
}

/// How the lamps of one photograph differ from what they are meant to be.
struct Lamps {
    Vec3d gain = Vec3d::Ones();
    double across = 0;  ///< more light at the right border than in the middle, as a share; as much less at the left one

    /// Of photograph i of n.
    static Lamps wandering(double drift, size_t i, size_t n, double exposure) {
        Lamps out;
        const double passed = 2 * kPi * static_cast<double>(i) / static_cast<double>(n);
        for (int c = 0; c < 3; ++c) out.gain[c] = exposure * (1 + drift * std::sin(1.3 * passed + 0.4 * c + 0.5));
        out.across = 0.5 * drift * std::sin(0.7 * passed + 2);
        return out;
    }
};

/// Without `surface` a clean plate: the object and its shadow are not there.
Image8 photograph(const Object& object, const Camera& camera, const Image8& coverage, const Object::Surface* surface, const PhotoLook& look, const Room& place,
                  const Lamps& lamps) {
    const Intrinsics& k = camera.intrinsics;
    Image8 out(k.width_px, k.height_px, 3);
    const Vec3d key = place.key();
    const double foot = look.table ? object.lowest(place.up_scene) : 0;
    const auto shade = [&](const SurfacePoint& p, const Vec3d& to_eye) {
        const double highlight =
            look.gloss > 0 && p.normal.dot(key) > 0 ? look.gloss * std::pow(std::max(0.0, p.normal.dot((key + to_eye).normalized())), 60) : 0;
        const Vec3d spilt = look.backdrop ? Vec3d(look.spill * std::pow(1 - std::max(0.0, p.normal.dot(to_eye)), 2) * *look.backdrop) : Vec3d::Zero();
        return Vec3d(place.diffuse(p.normal, look) * object.albedo_at(p) + Vec3d::Constant(highlight) + spilt);
    };
    // What a ray sees past the object: the room, or the table with the object's shadow and reflection.
    const auto beyond = [&](const Camera::Ray& ray) -> Vec3d {
        const double down = ray.direction.dot(place.up_scene), above = ray.origin.dot(place.up_scene) - foot;
        if (look.table && down < -1e-6 && above > 0) {
            const Vec3d p = ray.origin - above / down * ray.direction;
            const Vec3d from_middle = p - object.centre() - (p - object.centre()).dot(place.up_scene) * place.up_scene;
            if (from_middle.norm() < 3 * object.radius()) {
                const Vec3d lifted = p + 1e-4 * object.radius() * place.up_scene;
                const double grain = noise(8 * (place.room_from_scene * from_middle) / object.radius());
                Vec3d wood = (0.5 + 0.3 * grain) * Vec3d(0.45, 0.33, 0.22);
                if (surface && object.hit({lifted, key})) wood *= 0.35;
                if (surface && look.table_reflection > 0)
                    if (const auto t = object.hit({lifted, (ray.direction - 2 * down * place.up_scene).normalized()}))
                        wood = (1 - look.table_reflection) * wood +
                               look.table_reflection * 0.7 *
                                   albedo((lifted + *t * (ray.direction - 2 * down * place.up_scene) - object.centre()) / object.radius(), object.pattern());
                return wood;
            }
        }
        const Vec3d towards = place.room_from_scene * ray.direction;
        // Folds, and light that falls off to the sides.
        if (look.backdrop) return (0.75 + 0.35 * noise(3 * towards) + 0.1 * towards.x()) * *look.backdrop;
        return room(towards);
    };
    for (int y = 0; y < k.height_px; ++y)
        for (int x = 0; x < k.width_px; ++x) {
            const Camera::Ray ray = camera.ray({x + 0.5, y + 0.5});
            const double alpha = surface ? coverage.at(x, y) / 255.0 : 0;
            Vec3d light = alpha < 1 ? beyond(ray) : Vec3d::Zero().eval();
            if (alpha > 0) {
                // A pixel that is partly covered but whose centre sees past takes a neighbour's surface.
                const SurfacePoint* point = nullptr;
                for (const auto& [dx, dy] : {std::pair{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}}) {
                    const int nx = x + dx, ny = y + dy;
                    if (nx < 0 || ny < 0 || nx >= k.width_px || ny >= k.height_px) continue;
                    const auto& s = (*surface)[static_cast<size_t>(ny) * static_cast<size_t>(k.width_px) + static_cast<size_t>(nx)];
                    if (s) {
                        point = &*s;
                        break;
                    }
                }
                if (point) light = (1 - alpha) * light + alpha * shade(*point, -ray.direction);
            }
            const double here = 1 + lamps.across * (2 * (x + 0.5) / k.width_px - 1);
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = srgb8_from_linear(here * lamps.gain[c] * light[c]);
        }
    return out;
}

std::vector<TrueColor> colors_at(const SyntheticSpec& spec, const Object& object, const std::vector<Vec3d>& points) {
    object.prepare_nearest();
    const std::vector<Direction> where = directions(spec.rig);
    const bool moving_light = spec.rig.motion == Rig::Motion::Turntable;
    std::vector<TrueColor> out(points.size());
    tbb::parallel_for(size_t{0}, points.size(), [&](size_t n) {
        const SurfacePoint p = object.nearest(points[n], out[n].distance);
        double light = 0, weight = 0;
        for (const Direction& d : where) {
            const Vec3d eye(std::cos(d.elevation_rad) * std::cos(d.azimuth_rad), std::cos(d.elevation_rad) * std::sin(d.azimuth_rad),
                            std::sin(d.elevation_rad));
            const double w = moving_light ? std::pow(std::max(0.0, p.normal.dot(eye)), 4) : 1.0;
            light += w * room_of(spec.rig, d.azimuth_rad, Mat3d::Identity()).diffuse(p.normal, spec.look);
            weight += w;
            if (!moving_light) break;
        }
        const Vec3d c = (weight > 0 ? light / weight : 1.0) * object.albedo_at(p);
        out[n].color = {static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])};
    });
    return out;
}

/// Noise of mean 0 and standard deviation about 1 over the plane, smooth over `length` pixels.
double wobble(int x, int y, double length, uint64_t seed) {
    const double shift = static_cast<double>(seed % 10007) * 17.3;
    if (length <= 0) {
        // Sum of four uniforms, standard deviation 1.
        double sum = 0;
        for (int i = 0; i < 4; ++i) sum += hash_noise(x, y, static_cast<int64_t>(seed % 1000003) * 4 + i) - 0.5;
        return sum * std::sqrt(3.0);
    }
    double sum = 0;
    for (int i = 0; i < 3; ++i) sum += noise(Vec3d(x / length + shift + 31.7 * i, y / length - shift, 7.1 * i + static_cast<double>(seed % 997))) - 0.5;
    return sum * 3.6;  // measured: value noise has a standard deviation of 0.16
}

void damage(Image8& mask, const MaskDamage& d, bool holes_here, uint64_t seed) {
    const auto reach = static_cast<int>(std::ceil(4 * d.noise_px + std::abs(d.dilate_px) + 2));
    if (d.noise_px > 0 || d.dilate_px != 0) {
        const ImageF s = signed_distance(mask, std::clamp(reach + 2, 8, kernel::kMaxReach_px));
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x) {
                const float at = s.at(x, y);
                if (std::fabs(at) > static_cast<float>(reach)) continue;
                const double moved = at - d.dilate_px - (d.noise_px > 0 ? d.noise_px * wobble(x, y, d.correlation_px, seed) : 0);
                mask.at(x, y) = static_cast<uint8_t>(std::lround(255 * std::clamp(0.5 - moved, 0.0, 1.0)));
            }
    }
    if (!holes_here) return;
    Dice dice(seed);
    const ImageF s = signed_distance(mask, std::min(kernel::kMaxReach_px, static_cast<int>(4 * d.radius_px) + 8));
    const auto disc = [&](bool hole, const auto& suits) {
        for (int attempt = 0; attempt < 10000; ++attempt) {
            const int cx = static_cast<int>((0.5 + 0.5 * dice()) * (mask.width - 1)), cy = static_cast<int>((0.5 + 0.5 * dice()) * (mask.height - 1));
            if (!suits(s.at(cx, cy))) continue;
            const int r = static_cast<int>(d.radius_px) + 2;
            for (int y = std::max(0, cy - r); y <= std::min(mask.height - 1, cy + r); ++y)
                for (int x = std::max(0, cx - r); x <= std::min(mask.width - 1, cx + r); ++x) {
                    const double in = std::clamp(d.radius_px - std::hypot(x - cx, y - cy) + 0.5, 0.0, 1.0);
                    const double old = mask.at(x, y) / 255.0;
                    mask.at(x, y) = static_cast<uint8_t>(std::lround(255 * (hole ? std::min(old, 1 - in) : std::max(old, in))));
                }
            return;
        }
    };
    for (int i = 0; i < d.holes; ++i) disc(true, [&](float v) { return v < -1.2 * d.radius_px; });
    for (int i = 0; i < d.blobs; ++i) disc(false, [&](float v) { return std::fabs(v) < 0.5 * d.radius_px; });
}

void add_sensor_noise(Image8& photo, double sigma, uint64_t seed) {
    for (size_t i = 0; i < photo.data.size(); ++i)
        photo.data[i] = static_cast<uint8_t>(
            std::clamp(std::lround(photo.data[i] + sigma * wobble(static_cast<int>(i % 65521), static_cast<int>(i / 65521), 0, seed)), 0L, 255L));
}

std::string frame_name(size_t i, const char* extension) {
    const std::string n = std::to_string(i);
    return std::string(4 - std::min<size_t>(4, n.size()), '0') + n + extension;
}

}  // namespace

Pattern pattern_called(const std::string& name) {
    if (name == "clay") return Pattern::Clay;
    if (name == "checks") return Pattern::Checks;
    if (name == "plain") return Pattern::Plain;
    throw InputError("synth: pattern '" + name + "' is none of clay, checks, plain");
}

SyntheticSpec builtin_spec(const std::string& name) {
    SyntheticSpec spec;
    spec.name = name;
    const auto add = [&](Solid::Kind kind, const Vec3d& size, const Vec3d& centre, const Vec3d& turn_deg) {
        Solid s;
        s.kind = kind;
        s.size = size;
        s.world_from_solid.rotation = turned(turn_deg);
        s.world_from_solid.translation = centre;
        spec.solids.push_back(s);
    };
    if (name == "cup") {
        add(Solid::Kind::Cup, {0.45, 0.5, 0.06}, {0, 0, 0}, {0, 0, 20});
    } else if (name == "bowl") {
        add(Solid::Kind::Bowl, {0.5, 0.14, 0.2}, {0, 0, 0}, {0, 0, 0});
    } else if (name == "ellipsoids") {
        add(Solid::Kind::Ellipsoid, {0.55, 0.35, 0.3}, {0, 0, 0}, {10, 20, 30});
        add(Solid::Kind::Ellipsoid, {0.2, 0.25, 0.45}, {0.35, 0.1, 0.3}, {25, -15, 0});
        add(Solid::Kind::Ellipsoid, {0.18, 0.4, 0.15}, {-0.4, -0.2, 0.1}, {0, 30, 40});
        add(Solid::Kind::Ellipsoid, {0.12, 0.12, 0.5}, {0, 0.3, -0.3}, {-20, 0, 0});
    } else if (name == "boxes") {
        add(Solid::Kind::Box, {0.4, 0.3, 0.2}, {0, 0, -0.1}, {0, 0, 25});
        add(Solid::Kind::Box, {0.12, 0.35, 0.3}, {0.1, 0, 0.25}, {20, 35, 0});
    } else if (name == "torus") {
        add(Solid::Kind::Torus, {0.45, 0.14, 0}, {0, 0, 0}, {60, 10, 0});
    } else if (name == "pair") {
        add(Solid::Kind::Ellipsoid, {0.2, 0.2, 0.32}, {0.5, 0, 0}, {0, 0, 0});
        spec.solids.back().color = Vec3d(0.6, 0.06, 0.05);
        add(Solid::Kind::Box, {0.1, 0.45, 0.4}, {-0.25, 0, 0}, {0, 0, 10});
        spec.solids.back().color = Vec3d(0.05, 0.25, 0.55);
    } else {
        throw UsageError("synth: no built-in object '" + name +
                         "' (cup, bowl, ellipsoids, boxes, torus, pair), and no such spec (.json) or mesh (.ply, .obj, .stl)");
    }
    return spec;
}

namespace {

/// How a hand is off, -1..1: azimuth, elevation, place and aim along x, y, z, roll.
using Hand = std::array<double, 9>;

/// Anew for every photograph; of a film, anew four times a second and smooth between.
std::vector<Hand> hands_of(size_t views, double film_rate_hz, uint64_t seed) {
    constexpr double kTremor_hz = 4;
    const double frames = film_rate_hz > 0 ? std::max(1.0, film_rate_hz / kTremor_hz) : 1;
    Dice dice(seed);
    std::vector<Hand> knots(static_cast<size_t>(static_cast<double>(views) / frames) + 2), out;
    for (Hand& h : knots)
        for (double& x : h) x = dice();
    for (size_t i = 0; i < views; ++i) {
        const double at = static_cast<double>(i) / frames;
        const auto before = static_cast<size_t>(at);
        const double share = 0.5 - 0.5 * std::cos(kPi * (at - static_cast<double>(before)));
        out.push_back({});
        for (size_t x = 0; x < 9; ++x) out.back()[x] = (1 - share) * knots[before][x] + share * knots[before + 1][x];
    }
    return out;
}

}  // namespace

SyntheticScene synthesize(const SyntheticSpec& spec, Progress& progress) {
    const Rig& rig = spec.rig;
    std::string bad;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) bad += (bad.empty() ? "" : "; ") + what;
    };
    need(rig.width_px >= 2 && rig.height_px >= 2, "the image must be at least 2 x 2");
    need(rig.fov_deg > 0 && rig.fov_deg < 170, "the field of view must be within 0..170 degrees");
    need(rig.pixel_aspect > 0 && rig.fill > 0, "pixel aspect and fill must be > 0");
    need(rig.sittings == 1 || rig.sittings == 2, "one or two sittings");
    need(std::abs(rig.speed_variation) <= 0.9, "the speed's variation is at most 0.9");
    need(std::abs(rig.breathing) <= 0.5, "focus breathing is at most 0.5");
    need(std::abs(rig.crop_drift_px) <= 1000, "the crop drifts by at most 1000 px");
    need(spec.look.jpeg_quality >= 0 && spec.look.jpeg_quality <= 100, "the JPEG quality must be 1..100 (0: PNG)");
    const MaskDamage& d = spec.damage;
    need(d.noise_px >= 0 && d.noise_px <= 50 && std::abs(d.dilate_px) <= 50 && d.correlation_px >= 0,
         "masks' noise and dilation are 0..50 px, its correlation is >= 0");
    need(d.holes >= 0 && d.blobs >= 0 && d.radius_px >= 1 && d.radius_px <= 500 && d.share >= 0 && d.share <= 1,
         "masks' holes and blobs are >= 0, of radius 1..500 px, in a share 0..1 of the views");
    need(spec.look.exposure_jitter >= 0 && spec.look.exposure_jitter < 1, "the exposure's jitter is 0..1");
    need(spec.texture.empty() || !spec.mesh.texcoords.empty(), "a texture needs a mesh with texture coordinates (.obj)");
    need(spec.look.blur_px >= 0 && spec.look.blur_px <= 50 && spec.look.noise >= 0 && spec.look.gloss >= 0, "blur is 0..50 px, noise and gloss are >= 0");
    need(rig.lens.coefficients.empty() || rig.lens.coefficients.size() == 4, "a lens has four coefficients: k1, k2, p1, p2");
    need(!(rig.lens.distorts() && rig.orthographic), "a parallel projection has no lens");
    if (!bad.empty()) throw UsageError("synth: " + bad);
    const std::vector<Direction> where = directions(rig);
    if (where.empty()) throw UsageError("synth: zero views");
    const Object object(spec);
    const double half_fov = 0.5 * rad(rig.fov_deg);
    const double distance = rig.distance > 0 ? rig.distance : object.radius() / std::sin(std::atan(rig.fill * std::tan(half_fov)));

    Intrinsics k;
    k.width_px = rig.width_px;
    k.height_px = rig.height_px;
    k.cx = 0.5 * rig.width_px;
    k.cy = 0.5 * rig.height_px;
    k.orthographic = rig.orthographic;
    k.fy = rig.orthographic ? 0.5 * rig.height_px * rig.fill / object.radius() : 0.5 * rig.height_px / std::tan(half_fov);
    k.fx = k.fy / rig.pixel_aspect;

    // The second sitting: the object tipped over about its middle. Cameras stand in the sitting's own frame.
    Rigid3 scene_from_side;
    scene_from_side.rotation = turned({90, 0, 35}).transpose();
    scene_from_side.translation = object.centre() - scene_from_side.rotation * object.centre();
    const auto in_second = [&](size_t i) { return rig.sittings == 2 && 2 * i >= where.size(); };

    SyntheticScene scene;
    scene.look = spec.look;
    scene.truth = object.truth();
    const std::vector<Hand> hands = hands_of(where.size(), spec.look.film_rate_hz, spec.seed);
    std::vector<double> azimuths;
    for (size_t i = 0; i < where.size(); ++i) {
        const auto place = [&](double azimuth, double elevation) {
            return Vec3d(object.centre() +
                         distance * Vec3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)));
        };
        View view;
        view.name = "images/" + frame_name(i, spec.photos && spec.look.jpeg_quality > 0 ? ".jpg" : ".png");
        view.mask_path = "masks/" + frame_name(i, ".png");
        view.lens = rig.lens;
        view.sitting = in_second(i) ? "1" : "0";
        view.camera = look_at(place(where[i].azimuth_rad, where[i].elevation_rad), object.centre(), 0, k);
        scene.nominal.views.push_back(view);
        const Hand& hand = hands[i];
        const double azimuth = where[i].azimuth_rad + rad(rig.shake_angle_deg) * hand[0],
                     elevation = where[i].elevation_rad + rad(rig.shake_elevation_deg) * hand[1];
        Vec3d moved, aim;
        for (size_t a = 0; a < 3; ++a) {
            moved[static_cast<int>(a)] = rig.shake_position * distance * hand[2 + 2 * a];
            aim[static_cast<int>(a)] = rig.shake_look_at * distance * hand[3 + 2 * a];
        }
        Intrinsics breathed = k;
        const double factor = 1 + rig.breathing * std::sin(2 * kPi * 1.7 * static_cast<double>(i) / static_cast<double>(where.size()) + 0.6);
        breathed.fx *= factor;
        breathed.fy *= factor;
        const double passed = 2 * kPi * static_cast<double>(i) / static_cast<double>(where.size());
        breathed.cx += rig.crop_drift_px * std::sin(2.3 * passed + 1.1);
        breathed.cy += rig.crop_drift_px * std::sin(1.4 * passed + 2.6);
        view.camera = look_at(place(azimuth, elevation) + moved, object.centre() + aim, rad(rig.shake_roll_deg) * hand[8], breathed);
        scene.views.views.push_back(view);
        azimuths.push_back(azimuth);
    }
    scene.views.up = scene.nominal.up = "z";
    if (rig.sittings == 2) {
        scene.views.sittings.push_back({"1", scene_from_side, 1.0});
        scene.nominal.sittings.push_back({"1", Rigid3(), 1.0});  // how it was tipped is not known to the photographer
    }
    const std::vector<Camera> cameras = scene.views.cameras();
    Dice light(spec.seed + 1000003);
    for (size_t i = 0; i < where.size(); ++i) scene.exposures.push_back(1 + spec.look.exposure_jitter * light());
    scene.masks.resize(where.size());
    if (spec.damage.any()) scene.true_masks.resize(where.size());
    if (spec.photos) scene.photos.resize(where.size());
    if (spec.photos && spec.look.plates) scene.plates.resize(where.size());
    progress.begin("synth", where.size());
    tbb::parallel_for(size_t{0}, where.size(), [&](size_t i) {
        // With a lens the picture is taken without it first, with room around, and then bent.
        Camera camera = cameras[i];
        const int margin = rig.lens.distorts() ? std::max(rig.width_px, rig.height_px) / 5 : 0;
        camera.intrinsics.width_px += 2 * margin;
        camera.intrinsics.height_px += 2 * margin;
        camera.intrinsics.cx += margin;
        camera.intrinsics.cy += margin;
        // A mesh's masks come from its own rasteriser.
        const Object::Surface surface = spec.photos || !spec.solids.empty() ? object.surface(camera, spec.photos) : Object::Surface();
        Image8 mask = object.coverage(camera, surface);
        Image8 photo, plate;
        if (spec.photos) {
            const Mat3d side_from_scene = in_second(i) ? Mat3d(scene_from_side.rotation.transpose()) : Mat3d(Mat3d::Identity());
            const Room place = room_of(rig, azimuths[i], side_from_scene);
            photo = photograph(object, camera, mask, &surface, spec.look, place, Lamps::wandering(spec.look.light_drift, i, where.size(), scene.exposures[i]));
            if (spec.look.plates) plate = photograph(object, camera, mask, nullptr, spec.look, place, {});
        }
        if (margin > 0) {
            const Intrinsics& own = cameras[i].intrinsics;
            mask = io::distort(mask, margin, own, rig.lens);
            for (Image8* picture : {&photo, &plate})
                if (!picture->empty()) *picture = io::distort(*picture, margin, own, rig.lens);
        }
        const auto expose = [&](Image8& picture, uint64_t seed) {
            if (spec.look.blur_px > 0) picture = io::blurred(picture, spec.look.blur_px);
            if (spec.look.noise > 0) add_sensor_noise(picture, spec.look.noise, seed);
        };
        if (spec.photos) {
            expose(photo, spec.seed * 7919 + i);
            scene.photos[i] = std::move(photo);
        }
        if (!plate.empty()) {
            expose(plate, spec.seed * 6007 + i);
            scene.plates[i] = std::move(plate);
        }
        if (spec.damage.any()) {
            scene.true_masks[i].coverage = mask;
            const double every = spec.damage.share;
            const bool holes_here = std::floor((static_cast<double>(i) + 1) * every) > std::floor(static_cast<double>(i) * every);
            damage(mask, spec.damage, holes_here, spec.seed * 104729 + i);
        }
        scene.masks[i].coverage = std::move(mask);
        progress.step();
    });
    if (spec.photos) {
        std::vector<Vec3d> points;
        for (const auto& v : scene.truth.vertices) points.emplace_back(v[0], v[1], v[2]);
        for (const TrueColor& c : colors_at(spec, object, points)) scene.truth.colors.push_back(c.color);
    }
    return scene;
}

std::vector<TrueColor> surface_colors(const SyntheticSpec& spec, const std::vector<Vec3d>& points) { return colors_at(spec, Object(spec), points); }

}  // namespace vdbcarve
