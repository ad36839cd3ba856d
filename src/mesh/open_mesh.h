// SPDX-License-Identifier: Apache-2.0
// Our arrays as OpenMesh's half-edge mesh and back.
#pragma once

#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <string>

#include "vdbcarve/error.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

struct HalfEdgeTraits : OpenMesh::DefaultTraits {
    using Point = OpenMesh::Vec3f;
    using Normal = OpenMesh::Vec3f;
    VertexAttributes(OpenMesh::Attributes::None);
    HalfedgeAttributes(OpenMesh::Attributes::PrevHalfedge);
    EdgeAttributes(OpenMesh::Attributes::None);
    FaceAttributes(OpenMesh::Attributes::None);
};
using HalfEdgeMesh = OpenMesh::TriMesh_ArrayKernelT<HalfEdgeTraits>;

/// Vertices keep their numbers. Throws InputError where a face does not fit: OpenMesh holds 2-manifolds.
inline HalfEdgeMesh to_half_edges(const Mesh& mesh) {
    HalfEdgeMesh out;
    out.reserve(mesh.vertices.size(), mesh.triangles.size() * 3 / 2, mesh.triangles.size());
    for (const auto& p : mesh.vertices) out.add_vertex(HalfEdgeMesh::Point(p[0], p[1], p[2]));
    const auto handle = [](uint32_t v) { return HalfEdgeMesh::VertexHandle(static_cast<int>(v)); };
    omerr().disable();
    for (size_t t = 0; t < mesh.triangles.size(); ++t) {
        const auto& c = mesh.triangles[t];
        if (!out.add_face(handle(c[0]), handle(c[1]), handle(c[2])).is_valid())
            throw InputError("the mesh is no 2-manifold at face " + std::to_string(t) + " (vertices " + std::to_string(c[0]) + ", " + std::to_string(c[1]) +
                             ", " + std::to_string(c[2]) + "): it cannot be smoothed or decimated");
    }
    return out;
}

}  // namespace vdbcarve
