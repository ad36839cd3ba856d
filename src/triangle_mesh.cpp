// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/triangle_mesh.h"

#include <tbb/parallel_sort.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <numeric>

namespace vdbcarve {

MeshMeasures measure(const Mesh& mesh) {
    MeshMeasures out;
    out.vertices = mesh.vertices.size();
    out.faces = mesh.triangles.size();
    const size_t half_edges = 3 * out.faces;
    const auto from = [&](size_t h) { return mesh.triangles[h / 3][h % 3]; };
    const auto head = [&](size_t h) { return mesh.triangles[h / 3][(h % 3 + 1) % 3]; };

    struct Keyed {
        uint64_t key;  // smaller vertex, larger vertex
        uint32_t half_edge;
    };
    std::vector<Keyed> keyed(half_edges);
    for (size_t h = 0; h < half_edges; ++h) {
        const uint64_t a = from(h), b = head(h);
        keyed[h] = {a < b ? a << 32 | b : b << 32 | a, static_cast<uint32_t>(h)};
    }
    tbb::parallel_sort(keyed.begin(), keyed.end(), [](const Keyed& a, const Keyed& b) { return a.key != b.key ? a.key < b.key : a.half_edge < b.half_edge; });
    constexpr uint32_t kNone = UINT32_MAX;
    std::vector<uint32_t> opposite(half_edges, kNone);
    size_t edges = 0;
    for (size_t i = 0; i < half_edges;) {
        size_t end = i + 1;
        while (end < half_edges && keyed[end].key == keyed[i].key) ++end;
        ++edges;
        if (end - i == 1) ++out.boundary_edges;
        else if (end - i > 2 || from(keyed[i].half_edge) == from(keyed[i + 1].half_edge)) ++out.non_manifold_edges;
        else {
            opposite[keyed[i].half_edge] = keyed[i + 1].half_edge;
            opposite[keyed[i + 1].half_edge] = keyed[i].half_edge;
        }
        i = end;
    }
    keyed = {};
    out.closed = out.faces > 0 && out.boundary_edges == 0 && out.non_manifold_edges == 0;

    // Fans around vertices, and connected components (union-find over vertices).
    std::vector<uint32_t> parent(out.vertices);
    std::iota(parent.begin(), parent.end(), 0u);
    const auto find = [&](uint32_t x) {
        while (parent[x] != x) x = parent[x] = parent[parent[x]];
        return x;
    };
    std::vector<uint8_t> fans(out.vertices, 0);
    std::vector<bool> seen(half_edges, false);
    for (size_t h = 0; h < half_edges; ++h) {
        const uint32_t a = find(from(h)), b = find(head(h));
        if (a != b) parent[std::max(a, b)] = std::min(a, b);
        if (seen[h]) continue;
        uint8_t& count = fans[from(h)];
        if (count < 255) ++count;
        // Turn around the vertex: the edge before h in its face, seen from the other side, starts here again.
        for (size_t at = h; !seen[at];) {
            seen[at] = true;
            const size_t before = at - at % 3 + (at % 3 + 2) % 3;
            if (opposite[before] == kNone) break;
            at = opposite[before];
        }
    }
    size_t used = 0;
    for (uint32_t v = 0; v < out.vertices; ++v) {
        if (fans[v] > 1) ++out.non_manifold_vertices;
        if (fans[v] > 0) {
            ++used;
            if (find(v) == v) ++out.components;
        }
    }
    out.manifold = out.closed && out.non_manifold_vertices == 0;
    const long euler = static_cast<long>(used) - static_cast<long>(edges) + static_cast<long>(out.faces);
    out.genus = (2 * static_cast<long>(out.components) - euler) / 2;

    // About the first vertex, so that a far-away origin costs no digits.
    const auto point = [&](uint32_t v) { return Eigen::Vector3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
    const Eigen::Vector3d origin = mesh.vertices.empty() ? Eigen::Vector3d::Zero() : point(0);
    for (const auto& t : mesh.triangles) {
        const Eigen::Vector3d a = point(t[0]) - origin, b = point(t[1]) - origin, c = point(t[2]) - origin;
        const Eigen::Vector3d n = (b - a).cross(c - a);
        out.volume += a.dot(b.cross(c)) / 6;
        out.area += 0.5 * n.norm();
        if (n.squaredNorm() == 0) ++out.zero_area_faces;
    }
    return out;
}

}  // namespace vdbcarve
