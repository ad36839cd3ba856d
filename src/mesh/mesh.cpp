// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mesh.h"

#include <openvdb/tools/VolumeToMesh.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <climits>
#include <map>
#include <set>
#include <stdexcept>

#include "volume/inside_tiles.h"
#include "mesh/marching_cubes.h"
#include "volume/same_transform.h"

namespace vdbcarve {

namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

/// Pushes samples that lie on the surface, or nearly, off it.
void push_off_zero(openvdb::FloatGrid& grid) {
    const float least = kernel::kLeastShare * static_cast<float>(grid.voxelSize()[0]);
    openvdb::tree::LeafManager<openvdb::FloatTree>(grid.tree()).foreach ([least](Leaf& leaf, size_t) {
        float* values = leaf.buffer().data();
        for (openvdb::Index at = 0; at < Leaf::SIZE; ++at)
            if (std::fabs(values[at]) < least) values[at] = values[at] < 0.f ? -least : least;
    });
}

/// The leaves with a voxel within first <= x < last, those of their neighbours that decide their cells, and tiles.
openvdb::FloatGrid::Ptr slab_of(const openvdb::FloatGrid& grid, int axis, int first, int last) {
    openvdb::FloatGrid::Ptr out = openvdb::FloatGrid::create(grid.background());
    out->openvdb::MetaMap::operator=(grid);
    out->setTransform(same_transform(grid.transform()));
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const int at = leaf->origin()[axis];
        if (at + 8 > first - 8 && at < last + 8) out->tree().addLeaf(new Leaf(*leaf));
    }
    for_inside_tiles(grid.tree(), [&](const openvdb::Coord& origin, int side) {
        if (origin[axis] + side > first - 16 && origin[axis] < last + 16) out->tree().addTile(tile_level(side), origin, -grid.background(), false);
    });
    return out;
}

struct Polygons {
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    std::vector<openvdb::Vec4I> quads;
};

/// Planes, voxel coordinates along an axis and multiples of 8, between which about the same number of leaves lie; the first and the last are beyond everything.
std::vector<int> slab_borders(const openvdb::FloatGrid& grid, int axis, int pieces) {
    std::map<int, size_t> layers;
    size_t count = 0;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf, ++count) ++layers[leaf->origin()[axis]];
    std::vector<int> out{INT_MIN / 2};
    size_t before = 0;
    for (const auto& [at, leaves] : layers) {
        if (before * static_cast<size_t>(pieces) >= out.size() * count && at > out.back()) out.push_back(at);
        before += leaves;
    }
    out.push_back(INT_MAX / 2);
    return out;
}

int longest_axis(const openvdb::FloatGrid& grid) {
    openvdb::CoordBBox box;
    grid.tree().evalLeafBoundingBox(box);
    return static_cast<int>(box.maxExtent());
}

/// The whole surface, slab by slab. A face belongs to the slab that its middle lies in: faces near a border come from both sides with the same bits.
Polygons mesh_in_slabs(const openvdb::FloatGrid& grid, int pieces, bool push_off) {
    const int axis = longest_axis(grid);
    const std::vector<int> borders = slab_borders(grid, axis, pieces);
    const double voxel = grid.voxelSize()[0], first_world = grid.indexToWorld(openvdb::Vec3d(0))[axis];
    Polygons out;
    /// Vertices near the border above, by their place.
    std::map<std::array<float, 3>, uint32_t> seam;
    for (size_t s = 0; s + 1 < borders.size(); ++s) {
        const openvdb::FloatGrid::Ptr slab = slab_of(grid, axis, borders[s], borders[s + 1]);
        if (push_off) push_off_zero(*slab);
        Polygons part;
        openvdb::tools::volumeToMesh(*slab, part.points, part.triangles, part.quads, 0.0, 0.0);
        const double lo = borders[s] * voxel + first_world, hi = borders[s + 1] * voxel + first_world;
        // Vertices of two sheets at one place could not be told apart on a border.
        std::set<std::array<float, 3>> near_border;
        for (const openvdb::Vec3s& p : part.points)
            if (std::fabs(p[axis] - lo) < 4 * voxel && !near_border.insert({p.x(), p.y(), p.z()}).second) throw std::domain_error("two vertices at one place");
        constexpr uint32_t kNew = UINT32_MAX;
        std::vector<uint32_t> number(part.points.size(), kNew);
        std::map<std::array<float, 3>, uint32_t> next_seam;
        const auto vertex = [&](uint32_t v) {
            if (number[v] != kNew) return number[v];
            const openvdb::Vec3s& p = part.points[v];
            const std::array<float, 3> key{p.x(), p.y(), p.z()};
            const double x = p[axis];
            if (x < lo + 4 * voxel)
                if (const auto found = seam.find(key); found != seam.end()) return number[v] = found->second;
            if (out.points.size() >= kNew) throw InputError("mesh: more than 2^32 vertices. Remedy: a lower --resolution");
            number[v] = static_cast<uint32_t>(out.points.size());
            out.points.push_back(p);
            if (x > hi - 4 * voxel && !next_seam.emplace(key, number[v]).second) throw std::domain_error("two vertices at one place");
            return number[v];
        };
        for (const openvdb::Vec4I& q : part.quads) {
            const double middle = (static_cast<double>(part.points[q[0]][axis]) + part.points[q[2]][axis]) +
                                  (static_cast<double>(part.points[q[1]][axis]) + part.points[q[3]][axis]);
            if (middle < 4 * lo || middle >= 4 * hi) continue;
            out.quads.emplace_back(vertex(q[0]), vertex(q[1]), vertex(q[2]), vertex(q[3]));
        }
        seam = std::move(next_seam);
    }
    return out;
}

Polygons mesh_whole(const openvdb::FloatGrid& grid, double adaptivity, bool push_off) {
    Polygons out;
    if (push_off) {
        const openvdb::FloatGrid::Ptr copy = grid.deepCopy();
        push_off_zero(*copy);
        openvdb::tools::volumeToMesh(*copy, out.points, out.triangles, out.quads, 0.0, adaptivity);
    } else {
        openvdb::tools::volumeToMesh(grid, out.points, out.triangles, out.quads, 0.0, adaptivity);
    }
    return out;
}

Polygons polygons_of(const openvdb::FloatGrid& grid, const MeshOptions& options, bool push_off, Progress& progress) {
    if (options.pieces > 1) {
        try {
            return mesh_in_slabs(grid, options.pieces, push_off);
        } catch (const std::domain_error&) {
            progress.note("mesh: vertices of two sheets coincide where slabs meet; made whole instead");
        }
    }
    return mesh_whole(grid, options.adaptivity, push_off);
}

/// Triangles and quads with the outside on the left, quads cut along the shorter diagonal.
Mesh to_mesh(Polygons polygons, bool flip, bool keep_quads) {
    auto& points = polygons.points;
    Mesh mesh;
    mesh.vertices.resize(points.size());
    for (size_t v = 0; v < points.size(); ++v) mesh.vertices[v] = {points[v].x(), points[v].y(), points[v].z()};
    mesh.triangles.resize(polygons.triangles.size() + 2 * polygons.quads.size());
    if (keep_quads) mesh.quads = polygons.quads.size();
    const auto wound = [flip](uint32_t a, uint32_t b, uint32_t c) { return flip ? std::array<uint32_t, 3>{a, c, b} : std::array<uint32_t, 3>{a, b, c}; };
    for (size_t t = 0; t < polygons.triangles.size(); ++t)
        mesh.triangles[t] = wound(polygons.triangles[t][0], polygons.triangles[t][1], polygons.triangles[t][2]);
    auto* quad = mesh.triangles.data() + polygons.triangles.size();
    tbb::parallel_for(size_t{0}, polygons.quads.size(), [&](size_t n) {
        const openvdb::Vec4I& q = polygons.quads[n];
        std::array<uint32_t, 4> c = flip ? std::array<uint32_t, 4>{q[0], q[3], q[2], q[1]} : std::array<uint32_t, 4>{q[0], q[1], q[2], q[3]};
        if ((points[c[1]] - points[c[3]]).lengthSqr() < (points[c[0]] - points[c[2]]).lengthSqr()) std::rotate(c.begin(), c.begin() + 1, c.end());
        quad[2 * n] = {c[0], c[1], c[2]};
        quad[2 * n + 1] = {c[0], c[2], c[3]};
    });
    return mesh;
}

bool has_flat_faces(const Mesh& mesh) {
    std::atomic<bool> any{false};
    tbb::parallel_for(tbb::blocked_range<size_t>(0, mesh.triangles.size(), 65536), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t t = range.begin(); t < range.end() && !any; ++t) {
            const auto point = [&](size_t c) {
                const auto& p = mesh.vertices[mesh.triangles[t][c]];
                return openvdb::Vec3d(p[0], p[1], p[2]);
            };
            const openvdb::Vec3d a = point(0);
            if ((point(1) - a).cross(point(2) - a).lengthSqr() == 0) any = true;
        }
    });
    return any;
}

}  // namespace

void check_mesh(const MeshOptions& options) {
    if (!(options.adaptivity >= 0 && options.adaptivity <= 1)) throw UsageError("adaptivity is " + std::to_string(options.adaptivity) + ", must be 0..1");
    const bool dual = options.mesher == Mesher::Dual;
    if (options.quads && !dual) throw UsageError("mesh: quads are made by --mesher dual only");
    if (options.normals && dual) throw UsageError("mesh: normals are made by --mesher marching-cubes only");
    if (options.adaptivity > 0 && !dual) throw UsageError("mesh: --adaptivity is of --mesher dual; marching cubes has none");
    if (options.pieces < 1 && dual) throw UsageError("mesh: " + std::to_string(options.pieces) + " slabs");
    if (options.pieces > 1 && options.adaptivity > 0) throw UsageError("mesh: an adaptive mesh cannot be made in slabs");
}

Mesh extract_mesh(const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress) {
    check_mesh(options);
    progress.begin("mesh", 1);
    if (options.mesher == Mesher::MarchingCubes) {
        Mesh mesh = marching_cubes(surface, options.normals);
        if (mesh.vertices.empty()) throw InputError("mesh: the volume has no surface");
        progress.step();
        return mesh;
    }
    // volumeToMesh winds a grid of class level set clockwise seen from outside, any other class the other way.
    const bool flip = surface.getGridClass() == openvdb::GRID_LEVEL_SET;
    Mesh mesh = to_mesh(polygons_of(surface, options, false, progress), flip, options.quads);
    if (mesh.vertices.empty()) throw InputError("mesh: the volume has no surface");
    if (has_flat_faces(mesh)) {
        mesh = {};
        mesh = to_mesh(polygons_of(surface, options, true, progress), flip, options.quads);
    }
    progress.step();
    return mesh;
}

}  // namespace vdbcarve
