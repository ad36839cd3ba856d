// SPDX-License-Identifier: Apache-2.0
// What filters do to shapes whose truth is known: vdbcarve_filter_study [FANDISK.obj] prints the first table of docs/lab/filter.md.
//
// Shapes as distances (what a hull from soft masks is) and as bits (what one from binary masks is): spheres, a tilted cube, a mesh
// with sharp edges. Ours beside OpenVDB's LevelSetFilter, once with the alpha mask that its documentation proposes for edges.
#include <openvdb/openvdb.h>
#include <openvdb/tools/GridOperators.h>
#include <openvdb/tools/LevelSetFilter.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/tools/SignedFloodFill.h>

#include <chrono>
#include <cstdio>
#include <functional>
#include <map>

#include "mesh/triangle_tree.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve {
namespace {

using openvdb::FloatGrid;
Progress quiet;

struct Shape {
    std::string name;
    FloatGrid::Ptr distances;
    std::vector<Vec3d> edges, corners;               ///< points of the true shape's
    std::function<Vec3d(const Vec3d&)> true_normal;  ///< near a point of the surface
    std::function<double(const Vec3d&)> error;       ///< distance of a point to the true surface
    double volume = 0;
};

FloatGrid::Ptr sample(const std::function<double(const Vec3d&)>& distance, int reach) {
    FloatGrid::Ptr out = FloatGrid::create(3.f);
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    auto access = out->getAccessor();
    for (int i = -reach; i <= reach; ++i)
        for (int j = -reach; j <= reach; ++j)
            for (int k = -reach; k <= reach; ++k) {
                const double d = distance(Vec3d(i, j, k));
                if (std::fabs(d) < 3) access.setValue({i, j, k}, static_cast<float>(d == 0 ? 1e-6 : d));
            }
    openvdb::tools::signedFloodFill(out->tree());
    return out;
}

Shape sphere(double radius) {
    const Vec3d centre(0.31, 0.17, -0.23);
    Shape s;
    s.name = "sphere R " + std::to_string(static_cast<int>(radius));
    s.distances = sample([=](const Vec3d& x) { return (x - centre).norm() - radius; }, static_cast<int>(radius) + 5);
    s.true_normal = [=](const Vec3d& x) -> Vec3d { return (x - centre).normalized(); };
    s.error = [=](const Vec3d& x) { return std::fabs((x - centre).norm() - radius); };
    s.volume = 4.0 / 3 * 3.14159265358979 * radius * radius * radius;
    return s;
}

Shape cube(double side, bool tilted) {
    const Mat3d turn = tilted ? turned(Vec3d(25, 20, 10)) : Mat3d(Mat3d::Identity());
    // Not tilted: faces midway between samples.
    const Vec3d centre = tilted ? Vec3d(0.31, 0.17, -0.23) : Vec3d(0.5, 0.5, 0.5);
    const double h = side / 2;
    const auto local = [=](const Vec3d& x) -> Vec3d { return turn.transpose() * (x - centre); };
    Shape s;
    s.name = std::string("cube 60") + (tilted ? ", tilted" : "");
    s.distances = sample(
        [=](const Vec3d& x) {
            const Vec3d q = local(x).cwiseAbs() - Vec3d::Constant(h);
            return q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0);
        },
        static_cast<int>(tilted ? 1.75 * h : h) + 6);
    for (int axis = 0; axis < 3; ++axis)
        for (int n = 0; n < 4; ++n) {
            for (double t = -0.8 * h; t <= 0.8 * h; t += 2.7) {
                Vec3d p;
                p[axis] = t;
                p[(axis + 1) % 3] = n & 1 ? h : -h;
                p[(axis + 2) % 3] = n & 2 ? h : -h;
                s.edges.push_back(turn * p + centre);
            }
        }
    for (int n = 0; n < 8; ++n) s.corners.push_back(turn * Vec3d(n & 1 ? h : -h, n & 2 ? h : -h, n & 4 ? h : -h) + centre);
    s.true_normal = [=](const Vec3d& x) -> Vec3d {
        const Vec3d q = local(x);
        int a;
        q.cwiseAbs().maxCoeff(&a);
        return turn.col(a) * (q[a] < 0 ? -1.0 : 1.0);
    };
    s.error = [=](const Vec3d& x) {
        const Vec3d q = local(x).cwiseAbs() - Vec3d::Constant(h);
        return std::fabs(q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0));
    };
    s.volume = side * side * side;
    return s;
}

/// A mesh, 200 voxels long; its sharp edges are those where faces turn by more than 30 degrees.
Shape solid(const std::string& file) {
    Mesh mesh = read_mesh(file);
    Eigen::AlignedBox3d box;
    for (const auto& v : mesh.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    const double scale = 200 / box.sizes().maxCoeff();
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    for (auto& v : mesh.vertices) {
        const Vec3d p = turned(Vec3d(25, 20, 10)) * (Vec3d(v[0], v[1], v[2]) - box.center()) * scale;
        v = {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
        points.emplace_back(v[0], v[1], v[2]);
    }
    std::map<std::pair<uint32_t, uint32_t>, Vec3d> normals;
    Shape s;
    s.name = "fandisk 200";
    for (const auto& t : mesh.triangles) {
        triangles.emplace_back(t[0], t[1], t[2]);
        const auto at = [&](size_t c) { return Vec3d(mesh.vertices[t[c]][0], mesh.vertices[t[c]][1], mesh.vertices[t[c]][2]); };
        const Vec3d n = (at(1) - at(0)).cross(at(2) - at(0)).normalized();
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t a = std::min(t[c], t[(c + 1) % 3]), b = std::max(t[c], t[(c + 1) % 3]);
            const auto [found, first] = normals.emplace(std::pair(a, b), n);
            if (!first && found->second.dot(n) < std::cos(30 * 3.14159 / 180)) {
                const Vec3d p(mesh.vertices[a][0], mesh.vertices[a][1], mesh.vertices[a][2]), q(mesh.vertices[b][0], mesh.vertices[b][1], mesh.vertices[b][2]);
                for (double u = 0.25; u < 1; u += 0.5) s.edges.push_back(p + u * (q - p));
            }
        }
    }
    s.distances = openvdb::tools::meshToLevelSet<FloatGrid>(*openvdb::math::Transform::createLinearTransform(1.0), points, triangles, 3.f);
    auto tree = std::make_shared<TriangleTree>(mesh);
    s.true_normal = [tree](const Vec3d& x) -> Vec3d { return tree->triangle(tree->nearest(x).triangle).normal().normalized(); };
    s.error = [tree](const Vec3d& x) { return tree->nearest(x).distance; };
    s.volume = measure(mesh).volume;
    return s;
}

/// The same as bits.
FloatGrid::Ptr as_bits(const FloatGrid& grid) {
    openvdb::MaskGrid::Ptr mask = openvdb::MaskGrid::create(false);
    mask->setTransform(grid.transformPtr()->copy());
    openvdb::CoordBBox box;
    grid.tree().evalLeafBoundingBox(box);
    auto access = grid.getConstAccessor();
    auto to = mask->getAccessor();
    for (auto c = box.begin(); c; ++c)
        if (access.getValue(*c) < 0) to.setValueOn(*c);
    return level_set_of_occupancy(*mask, {}, quiet);
}

using Work = std::function<FloatGrid::Ptr(FloatGrid::Ptr, double& before_repair)>;

Work ours(const std::string& chain) {
    return [=](FloatGrid::Ptr grid, double& before_repair) {
        FilterOptions o;
        o.steps = parse_filters(chain);
        FilterResult r = filter(grid, o, quiet);
        before_repair = r.volume_filtered / r.volume_before - 1;
        return r.surface;
    };
}

/// OpenVDB's filter as it is; no repair.
Work theirs(const std::function<void(openvdb::tools::LevelSetFilter<FloatGrid>&, const FloatGrid&)>& work) {
    return [=](FloatGrid::Ptr grid, double& before_repair) {
        const double volume = measure(extract_mesh(*grid, {}, quiet)).volume;
        const FloatGrid::Ptr original = grid->deepCopy();
        openvdb::tools::LevelSetFilter<FloatGrid> f(*grid);
        work(f, *original);
        before_repair = measure(extract_mesh(*grid, {}, quiet)).volume / volume - 1;
        return grid;
    };
}

/// 1 on faces, 0 on edges: by mean curvature of a smoothed copy.
FloatGrid::Ptr curvature_mask(const FloatGrid& grid) {
    const FloatGrid::Ptr smooth = grid.deepCopy();
    openvdb::tools::LevelSetFilter<FloatGrid>(*smooth).gaussian(1);
    const FloatGrid::Ptr mask = openvdb::tools::meanCurvature(*smooth);
    for (auto v = mask->beginValueOn(); v; ++v) v.setValue(std::fabs(*v));
    return mask;
}

void judge(const Shape& shape, const char* kind, const FloatGrid& from, const char* name, const Work& work) {
    FloatGrid::Ptr grid = from.deepCopy();
    double before = 0;
    const double volume = measure(extract_mesh(from, {}, quiet)).volume;
    const auto start = std::chrono::steady_clock::now();
    grid = work(grid, before);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const Mesh mesh = extract_mesh(*grid, {}, quiet);
    const TriangleTree tree(mesh);
    const auto mean_distance = [&](const std::vector<Vec3d>& points) {
        double sum = 0;
        for (const Vec3d& p : points) sum += tree.nearest(p).distance;
        return points.empty() ? std::nan("") : sum / static_cast<double>(points.size());
    };
    double angle2 = 0, distance = 0, area = 0;
    for (const auto& t : mesh.triangles) {
        const auto at = [&](size_t c) { return Vec3d(mesh.vertices[t[c]][0], mesh.vertices[t[c]][1], mesh.vertices[t[c]][2]); };
        const Vec3d n = (at(1) - at(0)).cross(at(2) - at(0)), middle = (at(0) + at(1) + at(2)) / 3;
        const double angle = std::acos(std::clamp(n.normalized().dot(shape.true_normal(middle)), -1.0, 1.0)) * 180 / 3.14159265358979;
        angle2 += n.norm() * angle * angle;
        distance += n.norm() * shape.error(middle);
        area += n.norm();
    }
    std::printf("| %s | %s | %s | %+.3f | %+.3f | %+.3f | %.2f | %.2f | %.2f | %.3f | %.0f |\n", shape.name.c_str(), kind, name, 100 * before,
                100 * (measure(mesh).volume / volume - 1), 100 * (measure(mesh).volume / shape.volume - 1), mean_distance(shape.edges),
                mean_distance(shape.corners), std::sqrt(angle2 / area), distance / area, 1e3 * seconds);
    std::fflush(stdout);
}

}  // namespace
}  // namespace vdbcarve

int main(int count, char** words) {
    using namespace vdbcarve;
    openvdb::initialize();
    std::vector<Shape> shapes{sphere(10), sphere(20), sphere(35), sphere(50), cube(60, false), cube(60, true)};
    if (count > 1) shapes.push_back(solid(words[1]));
    std::printf(
        "| shape | from | filter | volume %%, filtered | repaired | against truth | edge recession, voxels | corner | normals rms, degrees | distance mean, "
        "voxels | ms |\n|---|---|---|---|---|---|---|---|---|---|---|\n");
    using Filter = openvdb::tools::LevelSetFilter<FloatGrid>;
    for (const Shape& s : shapes)
        for (const bool bits : {false, true}) {
            const FloatGrid::Ptr from = bits ? as_bits(*s.distances) : s.distances;
            const char* kind = bits ? "bits" : "distances";
            judge(s, kind, *from, "none", [](FloatGrid::Ptr g, double&) { return g; });
            for (const char* chain : {"median:1", "median:1x4", "median:2", "mean-curvature:1x2", "laplacian:1", "laplacian:1x2", "laplacian:1x8", "gaussian:1",
                                      "edge-preserving:2", "edge-preserving:2x2", "edge-preserving:2x4", "median:1,edge-preserving:2x2"})
                judge(s, kind, *from, chain, ours(chain));
            judge(s, kind, *from, "re-distanced alone", [](FloatGrid::Ptr g, double&) { return level_set(g, {}, quiet); });
            judge(s, kind, *from, "LevelSetFilter median(1)", theirs([](Filter& f, const FloatGrid&) { f.median(1); }));
            judge(s, kind, *from, "LevelSetFilter gaussian(1)", theirs([](Filter& f, const FloatGrid&) { f.gaussian(1); }));
            judge(s, kind, *from, "LevelSetFilter laplacian, curvature mask, x2", theirs([](Filter& f, const FloatGrid& g) {
                      const FloatGrid::Ptr mask = curvature_mask(g);
                      f.setMaskRange(0.1f, 0.35f);
                      f.invertMask(true);
                      for (int n = 0; n < 2; ++n) f.laplacian(mask.get());
                  }));
        }
}
