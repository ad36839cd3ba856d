// SPDX-License-Identifier: Apache-2.0
#include "mesh/marching_cubes.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <set>
#include <unordered_map>

namespace vdbcarve {

using kernel::LeafEdges;
using kernel::MarchingCase;
using openvdb::Coord;
using Leaf = openvdb::FloatTree::LeafNodeType;

namespace {

constexpr int corner_at(int x, int y, int z) { return x << 2 | y << 1 | z; }

/// Edge between two corners that differ on one axis.
int edge_between(int a, int b) { return std::min(a, b) << 2 | ((a ^ b) == 4 ? 0 : (a ^ b) == 2 ? 1 : 2); }

/// The cell's faces as rings of corners, counter-clockwise seen from outside.
std::array<std::array<int, 4>, 6> faces() {
    std::array<std::array<int, 4>, 6> out{};
    for (size_t axis = 0; axis < 3; ++axis)
        for (int side = 0; side < 2; ++side) {
            const auto at = [&](int a, int b) {
                int p[3];
                p[axis] = side;
                p[(axis + 1) % 3] = a;
                p[(axis + 2) % 3] = b;
                return corner_at(p[0], p[1], p[2]);
            };
            std::array<int, 4>& ring = out[2 * axis + static_cast<size_t>(side)];
            ring = {at(0, 0), at(1, 0), at(1, 1), at(0, 1)};
            if (side == 0) std::reverse(ring.begin(), ring.end());
        }
    return out;
}

/// Cuts a loop into triangles, none of whose inner edges joins two of the cell's edges on one face. False when that cannot be.
bool cut_loop(const std::vector<int>& loop, const std::array<unsigned, 32>& faces_of, size_t first, size_t last, std::vector<int>& out) {
    if (last - first < 2) return true;
    const auto allowed = [&](size_t a, size_t b) {
        return b - a == 1 || (a == 0 && b == loop.size() - 1) || !(faces_of[static_cast<size_t>(loop[a])] & faces_of[static_cast<size_t>(loop[b])]);
    };
    for (size_t mid = first + 1; mid < last; ++mid) {
        if (!allowed(first, mid) || !allowed(mid, last)) continue;
        const size_t before = out.size();
        out.insert(out.end(), {loop[first], loop[mid], loop[last]});
        if (cut_loop(loop, faces_of, first, mid, out) && cut_loop(loop, faces_of, mid, last, out)) return true;
        out.resize(before);
    }
    return false;
}

std::array<MarchingCase, 256> make_cases() {
    const auto rings = faces();
    std::array<unsigned, 32> faces_of{};
    for (size_t f = 0; f < 6; ++f)
        for (size_t n = 0; n < 4; ++n) faces_of[static_cast<size_t>(edge_between(rings[f][n], rings[f][(n + 1) % 4]))] |= 1u << f;
    std::array<MarchingCase, 256> out{};
    for (size_t mask = 0; mask < 256; ++mask) {
        // A line on a face goes round a run of inside corners, from the edge where the ring enters it to where it leaves. Leaving one
        // face is entering its neighbour, so the lines chain up to loops.
        std::array<int, 32> next;
        next.fill(-1);
        for (const auto& ring : rings)
            for (size_t n = 0; n < 4; ++n) {
                const auto inside = [&](size_t m) { return (mask >> ring[m % 4] & 1) != 0; };
                if (inside(n) || !inside(n + 1)) continue;
                size_t last = n + 1;
                while (inside(last + 1)) ++last;
                next[static_cast<size_t>(edge_between(ring[n], ring[(n + 1) % 4]))] = edge_between(ring[last % 4], ring[(last + 1) % 4]);
            }
        std::array<bool, 32> done{};
        std::vector<int> triangles;
        for (int start = 0; start < 32; ++start) {
            if (next[static_cast<size_t>(start)] < 0 || done[static_cast<size_t>(start)]) continue;
            std::vector<int> loop;
            for (int e = start; !done[static_cast<size_t>(e)]; e = next[static_cast<size_t>(e)]) {
                done[static_cast<size_t>(e)] = true;
                loop.push_back(e);
            }
            if (!cut_loop(loop, faces_of, 0, loop.size() - 1, triangles)) throw Error(ExitCode::Usage, "marching cubes: a loop cannot be cut");
        }
        MarchingCase& c = out[mask];
        c.count = static_cast<uint8_t>(triangles.size() / 3);
        for (size_t n = 0; n < triangles.size(); ++n) c.edges[n] = static_cast<uint8_t>(triangles[n]);
    }
    return out;
}

constexpr int at9(int i, int j, int k) { return (i * 9 + j) * 9 + k; }

/// The values of a leaf's 8^3 cells' corners.
void gather(const openvdb::FloatGrid::ConstAccessor& accessor, const Coord& origin, const Leaf* leaf, float* out) {
    for (int i = 0; i < 9; ++i)
        for (int j = 0; j < 9; ++j) {
            if (leaf && i < 8 && j < 8) {
                std::copy_n(leaf->buffer().data() + (i << 6 | j << 3), 8, out + at9(i, j, 0));
                out[at9(i, j, 8)] = accessor.getValue(origin.offsetBy(i, j, 8));
            } else {
                for (int k = 0; k < 9; ++k) out[at9(i, j, k)] = accessor.getValue(origin.offsetBy(i, j, k));
            }
        }
}

/// Order of leaves in a tree: upper node, lower node, leaf.
bool tree_order(const Coord& a, const Coord& b) {
    for (const int side : {4096, 128, 8}) {
        const Coord x = a & ~(side - 1), y = b & ~(side - 1);
        if (x != y) return x < y;
    }
    return false;
}

/// Origins of leaves that are not there, but have cells that the surface crosses: below a leaf whose border is on another side than the
/// tile beyond. A level set with a whole band has none.
std::vector<Coord> missing_leaves(const openvdb::FloatGrid& grid, const std::vector<const Leaf*>& leaves) {
    std::vector<std::vector<Coord>> found(leaves.size());
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        openvdb::FloatGrid::ConstAccessor accessor = grid.getConstAccessor();
        for (int d = 1; d < 8; ++d) {
            const int step[3] = {d >> 2, d >> 1 & 1, d & 1};
            const Coord below = leaves[n]->origin().offsetBy(-8 * step[0], -8 * step[1], -8 * step[2]);
            if (accessor.probeConstLeaf(below)) continue;
            const bool inside = accessor.getValue(below) < 0.f;
            bool differs = false;
            for (int at = 0; at < 512 && !differs; ++at) {
                if ((step[0] && at >> 6) || (step[1] && (at >> 3 & 7)) || (step[2] && (at & 7))) continue;
                differs = (leaves[n]->getValue(static_cast<openvdb::Index>(at)) < 0.f) != inside;
            }
            if (differs) found[n].push_back(below);
        }
    });
    std::set<Coord> all;
    for (const auto& some : found) all.insert(some.begin(), some.end());
    return {all.begin(), all.end()};
}

}  // namespace

const std::array<MarchingCase, 256>& marching_cases() {
    static const std::array<MarchingCase, 256> cases = make_cases();
    return cases;
}

kernel::LatticeFrame lattice_frame(const openvdb::math::Transform& transform) {
    const openvdb::Vec3d first = transform.indexToWorld(openvdb::Vec3d(0));
    return {{first.x(), first.y(), first.z()}, transform.voxelSize().x()};
}

Mesh marching_cubes(const openvdb::FloatGrid& surface, bool normals) {
    // Reads better whole: two passes over the same leaves, whose counts, offsets and indices must agree.
    std::vector<const Leaf*> leaves;
    surface.tree().getNodes(leaves);
    std::vector<Coord> origins;
    for (const Leaf* leaf : leaves) origins.push_back(leaf->origin());
    const std::vector<Coord> missing = missing_leaves(surface, leaves);
    origins.insert(origins.end(), missing.begin(), missing.end());
    std::sort(origins.begin(), origins.end(), tree_order);
    const size_t count = origins.size();
    std::unordered_map<Coord, size_t> number;
    number.reserve(2 * count);
    for (size_t n = 0; n < count; ++n) number[origins[n]] = n;

    const auto& cases = marching_cases();
    std::vector<LeafEdges> edges(count);
    std::vector<size_t> first_vertex(count + 1, 0), first_triangle(count + 1, 0);
    const auto for_leaves = [&](const auto& work) {
        tbb::parallel_for(tbb::blocked_range<size_t>(0, count, 32), [&](const tbb::blocked_range<size_t>& range) {
            openvdb::FloatGrid::ConstAccessor accessor = surface.getConstAccessor();
            float values[729];
            for (size_t n = range.begin(); n < range.end(); ++n) {
                gather(accessor, origins[n], accessor.probeConstLeaf(origins[n]), values);
                work(n, values);
            }
        });
    };
    const auto case_of = [](const float* values, int i, int j, int k) {
        unsigned mask = 0;
        for (int c = 0; c < 8; ++c) mask |= static_cast<unsigned>(values[at9(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1))] < 0.f) << c;
        return mask;
    };
    for_leaves([&](size_t n, const float* values) {
        LeafEdges& e = edges[n];
        e = {};
        size_t triangles = 0;
        for (int at = 0; at < 512; ++at) {
            const int i = at >> 6, j = at >> 3 & 7, k = at & 7;
            const bool inside = values[at9(i, j, k)] < 0.f;
            const float* here = values + at9(i, j, k);
            const int steps[3] = {at9(1, 0, 0), at9(0, 1, 0), 1};
            for (int axis = 0; axis < 3; ++axis)
                if ((here[steps[axis]] < 0.f) != inside) e.crossed[axis * 8 + (at >> 6)] |= uint64_t{1} << (at & 63);
            triangles += cases[case_of(values, i, j, k)].count;
        }
        int vertices = 0;
        for (int w = 0; w < kernel::kLeafEdges / 64; ++w) {
            e.before[w] = static_cast<uint16_t>(vertices);
            vertices += kernel::popcount64(e.crossed[w]);
        }
        first_vertex[n + 1] = static_cast<size_t>(vertices);
        first_triangle[n + 1] = triangles;
    });
    for (size_t n = 0; n < count; ++n) {
        first_vertex[n + 1] += first_vertex[n];
        first_triangle[n + 1] += first_triangle[n];
    }
    if (first_vertex[count] > UINT32_MAX) throw InputError("mesh: more than 2^32 vertices. Remedy: a lower --resolution");
    Mesh mesh;
    mesh.vertices.resize(first_vertex[count]);
    mesh.triangles.resize(first_triangle[count]);
    if (normals) mesh.normals.resize(mesh.vertices.size());
    const kernel::LatticeFrame frame = lattice_frame(surface.transform());
    for_leaves([&](size_t n, const float* values) {
        if (first_vertex[n + 1] == first_vertex[n] && first_triangle[n + 1] == first_triangle[n]) return;
        const Coord& o = origins[n];
        openvdb::FloatGrid::ConstAccessor accessor = surface.getConstAccessor();
        const auto value_at = [&](int i, int j, int k) { return accessor.getValue(Coord(i, j, k)); };
        size_t vertex = first_vertex[n];
        for (int edge = 0; edge < kernel::kLeafEdges; ++edge) {
            if (!(edges[n].crossed[edge >> 6] >> (edge & 63) & 1)) continue;
            const int axis = edge >> 9, i = edge >> 6 & 7, j = edge >> 3 & 7, k = edge & 7;
            const float share = kernel::crossing_share(values[at9(i, j, k)], values[at9(i + (axis == 0), j + (axis == 1), k + (axis == 2))]);
            const kernel::MeshPoint p = kernel::edge_vertex(frame, o.x() + i, o.y() + j, o.z() + k, axis, share);
            mesh.vertices[vertex] = {p.x, p.y, p.z};
            if (normals) {
                const kernel::MeshPoint m = kernel::edge_normal(value_at, o.x() + i, o.y() + j, o.z() + k, axis, share);
                mesh.normals[vertex] = {m.x, m.y, m.z};
            }
            ++vertex;
        }
        // The leaf and those above it, by which axes lead there.
        std::array<size_t, 8> around{};
        for (int d = 0; d < 8; ++d) {
            const auto found = number.find(o.offsetBy(8 * (d >> 2), 8 * (d >> 1 & 1), 8 * (d & 1)));
            around[static_cast<size_t>(d)] = found == number.end() ? count : found->second;
        }
        size_t triangle = first_triangle[n];
        for (int at = 0; at < 512; ++at) {
            const int i = at >> 6, j = at >> 3 & 7, k = at & 7;
            const MarchingCase& c = cases[case_of(values, i, j, k)];
            for (int t = 0; t < c.count; ++t) {
                std::array<uint32_t, 3> ids{};
                for (int v = 0; v < 3; ++v) {
                    const int code = c.edges[3 * t + v], axis = code & 3, corner = code >> 2;
                    const int x = i + (corner >> 2), y = j + (corner >> 1 & 1), z = k + (corner & 1);
                    const size_t leaf = around[static_cast<size_t>((x >> 3) << 2 | (y >> 3) << 1 | z >> 3)];
                    const int edge = axis << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7);
                    if (leaf == count) throw InputError("mesh: grid '" + surface.getName() + "' has tiles inside and outside that touch: it is no level set");
                    ids[static_cast<size_t>(v)] = static_cast<uint32_t>(first_vertex[leaf] + static_cast<size_t>(kernel::edge_rank(edges[leaf], edge)));
                }
                mesh.triangles[triangle++] = ids;
            }
        }
    });
    return mesh;
}

}  // namespace vdbcarve
