// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/triangle_mesh.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <numeric>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace {

/// Union-find over vertices; a piece is known by its first vertex.
class Pieces {
  public:
    explicit Pieces(size_t vertices) : parent_(vertices) { std::iota(parent_.begin(), parent_.end(), 0u); }
    uint32_t find(uint32_t x) {
        while (parent_[x] != x) x = parent_[x] = parent_[parent_[x]];
        return x;
    }
    void join(uint32_t x, uint32_t y) {
        x = find(x);
        y = find(y);
        if (x != y) parent_[std::max(x, y)] = std::min(x, y);
    }

  private:
    std::vector<uint32_t> parent_;
};

Eigen::Vector3d point_of(const Mesh& mesh, uint32_t v) { return {mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]}; }

}  // namespace

MeshMeasures measure(const Mesh& mesh) {
    // Reads better whole: every measure comes from one walk over edges and faces.
    MeshMeasures out;
    out.vertices = mesh.vertices.size();
    out.faces = mesh.triangles.size();
    const size_t half_edges = 3 * out.faces;
    const auto from = [&](size_t h) { return mesh.triangles[h / 3][h % 3]; };
    const auto head = [&](size_t h) { return mesh.triangles[h / 3][(h % 3 + 1) % 3]; };

    // Half-edges by their smaller vertex, in order; among those of one vertex, few, the ones of one edge are found by looking.
    constexpr uint32_t kNone = UINT32_MAX;
    if (half_edges >= kNone) throw InputError("mesh: " + std::to_string(out.faces) + " faces are too many. Remedy: --faces, or a lower --resolution");
    std::vector<uint32_t> first(out.vertices + 1, 0), at_vertex(half_edges);
    for (size_t h = 0; h < half_edges; ++h) ++first[std::min(from(h), head(h)) + 1];
    for (size_t v = 0; v < out.vertices; ++v) first[v + 1] += first[v];
    for (size_t h = 0; h < half_edges; ++h) at_vertex[first[std::min(from(h), head(h))]++] = static_cast<uint32_t>(h);
    // Now first[v] is where the next vertex starts.
    std::vector<uint32_t> opposite(half_edges, kNone);
    std::atomic<size_t> all_edges{0}, boundary{0}, complex{0};
    tbb::parallel_for(tbb::blocked_range<size_t>(0, out.vertices, 4096), [&](const tbb::blocked_range<size_t>& range) {
        size_t edge_count = 0, boundary_count = 0, complex_count = 0;
        std::vector<std::pair<uint32_t, uint32_t>> here;  // larger vertex, half-edge
        for (size_t v = range.begin(); v < range.end(); ++v) {
            here.clear();
            for (uint32_t n = v ? first[v - 1] : 0; n < first[v]; ++n) here.emplace_back(std::max(from(at_vertex[n]), head(at_vertex[n])), at_vertex[n]);
            std::sort(here.begin(), here.end());
            for (size_t i = 0; i < here.size();) {
                size_t end = i + 1;
                while (end < here.size() && here[end].first == here[i].first) ++end;
                ++edge_count;
                if (end - i == 1) ++boundary_count;
                else if (end - i > 2 || from(here[i].second) == from(here[i + 1].second)) ++complex_count;
                else {
                    opposite[here[i].second] = here[i + 1].second;
                    opposite[here[i + 1].second] = here[i].second;
                }
                i = end;
            }
        }
        all_edges += edge_count;
        boundary += boundary_count;
        complex += complex_count;
    });
    const size_t edges = all_edges;
    out.boundary_edges = boundary;
    out.non_manifold_edges = complex;
    first = {};
    at_vertex = {};
    out.closed = out.faces > 0 && out.boundary_edges == 0 && out.non_manifold_edges == 0;

    // Fans around vertices, and connected components.
    Pieces pieces(out.vertices);
    std::vector<uint8_t> fans(out.vertices, 0);
    std::vector<bool> seen(half_edges, false);
    for (size_t h = 0; h < half_edges; ++h) {
        pieces.join(from(h), head(h));
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
            if (pieces.find(v) == v) ++out.components;
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

DroppedPieces drop_small_pieces(Mesh& mesh, double least_share) {
    Pieces pieces(mesh.vertices.size());
    for (const auto& t : mesh.triangles) {
        pieces.join(t[0], t[1]);
        pieces.join(t[1], t[2]);
    }
    DroppedPieces out;
    if (mesh.triangles.empty()) return out;
    const Eigen::Vector3d origin = point_of(mesh, 0);
    std::vector<double> volume(mesh.vertices.size(), 0);
    for (const auto& t : mesh.triangles) {
        const Eigen::Vector3d a = point_of(mesh, t[0]) - origin, b = point_of(mesh, t[1]) - origin, c = point_of(mesh, t[2]) - origin;
        volume[pieces.find(t[0])] += a.dot(b.cross(c)) / 6;
    }
    std::vector<uint32_t> roots;
    double all = 0;
    for (const auto& t : mesh.triangles)
        for (uint32_t v : t)
            if (pieces.find(v) == v) roots.push_back(v);
    std::sort(roots.begin(), roots.end());
    roots.erase(std::unique(roots.begin(), roots.end()), roots.end());
    uint32_t largest = roots.front();
    for (uint32_t r : roots) {
        all += std::fabs(volume[r]);
        if (std::fabs(volume[r]) > std::fabs(volume[largest])) largest = r;
    }
    std::vector<bool> gone(mesh.vertices.size(), false);
    for (uint32_t r : roots) {
        gone[r] = r != largest && std::fabs(volume[r]) < least_share * all;
        if (gone[r]) {
            ++out.pieces;
            out.volume_share += std::fabs(volume[r]) / all;
        } else {
            ++out.kept;
        }
    }
    if (out.pieces == 0) return out;
    std::vector<uint32_t> number(mesh.vertices.size());
    size_t kept = 0;
    const auto keep = [&](auto& values, size_t from, size_t to) {
        if (!values.empty()) values[to] = values[from];
    };
    for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
        if (gone[pieces.find(v)]) continue;
        number[v] = static_cast<uint32_t>(kept);
        keep(mesh.vertices, v, kept);
        keep(mesh.normals, v, kept);
        keep(mesh.colors, v, kept);
        keep(mesh.extrapolated, v, kept);
        keep(mesh.slack, v, kept);
        ++kept;
    }
    // A quad's halves go together.
    const size_t first_quad = mesh.triangles.size() - 2 * mesh.quads;
    size_t faces = 0, quads = 0;
    for (size_t f = 0; f < mesh.triangles.size(); ++f) {
        const auto t = mesh.triangles[f];
        if (gone[pieces.find(t[0])]) continue;
        keep(mesh.texcoords, f, faces);
        mesh.triangles[faces++] = {number[t[0]], number[t[1]], number[t[2]]};
        quads += f >= first_quad;
    }
    mesh.quads = quads / 2;
    mesh.triangles.resize(faces);
    mesh.vertices.resize(kept);
    for (auto* values : {&mesh.normals, &mesh.colors})
        if (!values->empty()) values->resize(kept);
    if (!mesh.extrapolated.empty()) mesh.extrapolated.resize(kept);
    if (!mesh.slack.empty()) mesh.slack.resize(kept);
    if (!mesh.texcoords.empty()) mesh.texcoords.resize(faces);
    return out;
}

std::vector<std::array<float, 3>> vertex_normals(const Mesh& mesh) {
    std::vector<std::array<float, 3>> out(mesh.vertices.size(), {0, 0, 0});
    std::vector<Eigen::Vector3f> sums(mesh.vertices.size(), Eigen::Vector3f::Zero()), some(sums);
    for (const auto& t : mesh.triangles) {
        const Eigen::Vector3d a = point_of(mesh, t[0]);
        const Eigen::Vector3f n = (point_of(mesh, t[1]) - a).cross(point_of(mesh, t[2]) - a).cast<float>();
        for (uint32_t v : t) {
            sums[v] += n;
            if (n.squaredNorm() > some[v].squaredNorm()) some[v] = n;
        }
    }
    tbb::parallel_for(size_t{0}, out.size(), [&](size_t v) {
        Eigen::Vector3d n = sums[v].cast<double>();
        if (!(n.norm() > 1e-6 * some[v].cast<double>().norm())) n = some[v].cast<double>();
        if (!(n.norm() > 0)) n = Eigen::Vector3d::UnitY();
        n.normalize();
        out[v] = {static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z())};
    });
    return out;
}

}  // namespace vdbcarve
