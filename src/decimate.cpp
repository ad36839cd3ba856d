// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/decimate.h"

#include <OpenMesh/Tools/Decimater/DecimaterT.hh>
#include <OpenMesh/Tools/Decimater/ModHausdorffT.hh>
#include <OpenMesh/Tools/Decimater/ModNormalFlippingT.hh>
#include <OpenMesh/Tools/Decimater/ModQuadricT.hh>
#include <cmath>

#include "open_mesh.h"

namespace vdbcarve {

size_t decimate(Mesh& mesh, const DecimateOptions& options, Progress& progress) {
    if (options.faces == 0 && !(options.max_error > 0)) throw UsageError("decimate: neither a number of faces nor an error is given");
    if (!(options.max_error >= 0 && std::isfinite(options.max_error))) throw UsageError("decimate: the error is " + std::to_string(options.max_error) + ", must be > 0");
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

}  // namespace vdbcarve
