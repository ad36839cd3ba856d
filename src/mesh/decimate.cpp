// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/decimate.h"

#include <OpenMesh/Tools/Decimater/DecimaterT.hh>
#include <OpenMesh/Tools/Decimater/ModHausdorffT.hh>
#include <OpenMesh/Tools/Decimater/ModNormalFlippingT.hh>
#include <OpenMesh/Tools/Decimater/ModQuadricT.hh>
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "mesh/open_mesh.h"

namespace vdbcarve {

size_t decimate(Mesh& mesh, const DecimateOptions& options, Progress& progress) {
    if (options.faces == 0 && !(options.max_error > 0)) throw UsageError("decimate: neither a number of faces nor an error is given");
    if (!(options.max_error >= 0 && std::isfinite(options.max_error)))
        throw UsageError("decimate: the error is " + std::to_string(options.max_error) + ", must be > 0");
    if (options.faces > 0 && options.faces < 4) throw UsageError("decimate: a closed mesh has at least 4 faces, not " + std::to_string(options.faces));
    if (!(options.max_turn_deg > 0 && options.max_turn_deg <= 180)) throw UsageError("decimate: faces may turn by more than 0 and at most 180 degrees");
    progress.begin("decimate", 1);
    if (options.faces >= mesh.triangles.size()) return mesh.triangles.size();
    HalfEdgeMesh half_edges = to_half_edges(mesh);
    half_edges.request_vertex_status();
    half_edges.request_edge_status();
    half_edges.request_halfedge_status();
    half_edges.request_face_status();
    half_edges.request_face_normals();
    half_edges.update_face_normals();

    namespace dec = OpenMesh::Decimater;
    dec::DecimaterT<HalfEdgeMesh> decimater(half_edges);
    dec::ModQuadricT<HalfEdgeMesh>::Handle quadric;
    dec::ModNormalFlippingT<HalfEdgeMesh>::Handle flipping;
    dec::ModHausdorffT<HalfEdgeMesh>::Handle distance;
    decimater.add(quadric);
    decimater.module(quadric).unset_max_err();
    decimater.add(flipping);
    decimater.module(flipping).set_max_normal_deviation(static_cast<float>(options.max_turn_deg));
    if (options.max_error > 0) {
        decimater.add(distance);
        decimater.module(distance).set_tolerance(static_cast<float>(options.max_error));
    }
    if (!decimater.initialize()) throw Error(ExitCode::Usage, "decimate: OpenMesh's decimater could not be set up");
    decimater.decimate_to_faces(0, options.faces);

    // What is left, in the old order.
    std::vector<uint32_t> number(mesh.vertices.size(), 0);
    Mesh out;
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
        if (half_edges.status(HalfEdgeMesh::VertexHandle(static_cast<int>(v))).deleted()) continue;
        number[v] = static_cast<uint32_t>(out.vertices.size());
        out.vertices.push_back(mesh.vertices[v]);
        if (!mesh.colors.empty()) out.colors.push_back(mesh.colors[v]);
        if (!mesh.extrapolated.empty()) out.extrapolated.push_back(mesh.extrapolated[v]);
        if (!mesh.slack.empty()) out.slack.push_back(mesh.slack[v]);
    }
    for (size_t f = 0; f < mesh.triangles.size(); ++f) {
        const HalfEdgeMesh::FaceHandle face(static_cast<int>(f));
        if (half_edges.status(face).deleted()) continue;
        std::array<uint32_t, 3> corners{};
        size_t c = 0;
        for (auto v = half_edges.cfv_iter(face); v.is_valid() && c < 3; ++v) corners[c++] = number[static_cast<size_t>(v->idx())];
        out.triangles.push_back(corners);
    }
    if (!mesh.normals.empty()) out.normals = vertex_normals(out);
    mesh = std::move(out);
    progress.step();
    return mesh.triangles.size();
}

namespace {

/// One vertex for each cell of a raster that has some.
Mesh clustered(const Mesh& mesh, const std::array<float, 3>& low, float cell) {
    struct Sum {
        double position[3]{}, color[3]{};
        double count = 0;
    };
    std::unordered_map<uint64_t, uint32_t> cells;
    cells.reserve(mesh.vertices.size() / 8);
    std::vector<Sum> sums;
    std::vector<uint32_t> number(mesh.vertices.size());
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
        uint64_t key = 0;
        for (size_t a = 0; a < 3; ++a) key = key << 21 | static_cast<uint64_t>((mesh.vertices[v][a] - low[a]) / cell);
        const auto [found, fresh] = cells.emplace(key, static_cast<uint32_t>(sums.size()));
        if (fresh) sums.emplace_back();
        Sum& sum = sums[number[v] = found->second];
        sum.count += 1;
        for (size_t a = 0; a < 3; ++a) {
            sum.position[a] += static_cast<double>(mesh.vertices[v][a]);
            if (!mesh.colors.empty()) sum.color[a] += static_cast<double>(mesh.colors[v][a]);
        }
    }
    Mesh out;
    for (const Sum& sum : sums) {
        const auto mean = [&](const double(&of)[3]) {
            return std::array<float, 3>{static_cast<float>(of[0] / sum.count), static_cast<float>(of[1] / sum.count), static_cast<float>(of[2] / sum.count)};
        };
        out.vertices.push_back(mean(sum.position));
        if (!mesh.colors.empty()) out.colors.push_back(mean(sum.color));
    }
    for (const auto& t : mesh.triangles) {
        const uint32_t a = number[t[0]], b = number[t[1]], c = number[t[2]];
        if (a != b && b != c && c != a) out.triangles.push_back(a < b && a < c ? std::array{a, b, c} : b < c ? std::array{b, c, a} : std::array{c, a, b});
    }
    // Where two sides of a thin part fell together, faces are there twice.
    std::sort(out.triangles.begin(), out.triangles.end());
    out.triangles.erase(std::unique(out.triangles.begin(), out.triangles.end()), out.triangles.end());
    return out;
}

}  // namespace

Mesh simplified_for_display(const Mesh& mesh, size_t most_faces) {
    if (mesh.triangles.size() <= most_faces || mesh.vertices.empty()) return {mesh.vertices, mesh.triangles, {}, mesh.colors, {}, {}, {}, 0};
    std::array<float, 3> low = mesh.vertices.front(), high = low;
    for (const auto& v : mesh.vertices)
        for (size_t a = 0; a < 3; ++a) {
            low[a] = std::min(low[a], v[a]);
            high[a] = std::max(high[a], v[a]);
        }
    const float longest = std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
    // Two faces to a cell that the surface goes through, about 1.5 such cells to a cell's area of surface.
    double area = 0;
    for (const auto& t : mesh.triangles) {
        double d[2][3];
        for (size_t a = 0; a < 3; ++a)
            for (size_t k = 0; k < 2; ++k) d[k][a] = static_cast<double>(mesh.vertices[t[k + 1]][a]) - static_cast<double>(mesh.vertices[t[0]][a]);
        area += 0.5 * std::hypot(d[0][1] * d[1][2] - d[0][2] * d[1][1], d[0][2] * d[1][0] - d[0][0] * d[1][2], d[0][0] * d[1][1] - d[0][1] * d[1][0]);
    }
    auto cell = static_cast<float>(std::sqrt(3 * area / static_cast<double>(std::max<size_t>(most_faces, 4))));
    cell = std::max(cell, longest / 1e6f);
    for (;; cell *= 1.15f) {
        Mesh out = clustered(mesh, low, cell);
        if (out.triangles.size() <= most_faces || cell > longest) return out;
    }
}

}  // namespace vdbcarve
