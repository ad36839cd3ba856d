// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include "device/device_parts.h"
#include "mesh/marching_cubes.h"

namespace vdbcarve {

bool Device::extract_mesh(bool normals) {
    Parts& p = *parts_;
    p.use();
    const auto& volume = p.need(p.surface, "level set");
    return p.mesh.run(volume.grid, *volume.topology, marching_cases(), normals, p.stream, p.times);
}

Mesh Device::fetch_mesh(bool normals) {
    Parts& p = *parts_;
    p.use();
    if (!p.mesh.made() || (normals && !p.mesh.has_normals())) throw UsageError(std::string("the device holds no mesh") + (normals ? " with normals" : ""));
    Mesh out;
    out.vertices.resize(p.mesh.vertex_count());
    out.triangles.resize(p.mesh.triangle_count());
    p.fetcher.fetch_to(out.vertices.data(), p.mesh.vertices(), out.vertices.size() * sizeof(out.vertices[0]), p.stream);
    p.fetcher.fetch_to(out.triangles.data(), p.mesh.triangles(), out.triangles.size() * sizeof(out.triangles[0]), p.stream);
    if (normals) {
        out.normals.resize(out.vertices.size());
        p.fetcher.fetch_to(out.normals.data(), p.mesh.normals(), out.normals.size() * sizeof(out.normals[0]), p.stream);
    }
    return out;
}

}  // namespace vdbcarve
