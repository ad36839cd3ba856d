// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mesh.h"

#include <openvdb/tools/VolumeToMesh.h>

#include "marching_cubes.h"
#include "vdbcarve/device.h"

namespace vdbcarve {

Mesh extract_mesh(const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress) {
    if (!(options.adaptivity >= 0 && options.adaptivity <= 1))
        throw UsageError("adaptivity is " + std::to_string(options.adaptivity) + ", must be 0..1");
    progress.begin("mesh", 1);
    if (options.normals && options.mesher != Mesher::MarchingCubes) throw UsageError("mesh: normals are made by --mesher marching-cubes only");
    if (options.mesher == Mesher::MarchingCubes) {
        if (options.adaptivity > 0) throw UsageError("mesh: --adaptivity is of --mesher dual; marching cubes has none");
        Mesh mesh;
        bool done = false;
        if (options.backend == Backend::Cuda) {
            DevicePipeline device(options.device);
            device.set_surface(surface);
            done = device.extract_mesh(options.normals);
            if (done) mesh = device.fetch_mesh(options.normals);
        }
        if (!done) mesh = marching_cubes(surface, options.normals);
        if (mesh.vertices.empty()) throw InputError("mesh: the volume has no surface");
        progress.step();
        return mesh;
    }
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    std::vector<openvdb::Vec4I> quads;
    openvdb::tools::volumeToMesh(surface, points, triangles, quads, 0.0, options.adaptivity);
    if (points.empty()) throw InputError("mesh: the volume has no surface");

    Mesh mesh;
    mesh.vertices.reserve(points.size());
    for (const openvdb::Vec3s& p : points) mesh.vertices.push_back({p.x(), p.y(), p.z()});
    mesh.triangles.reserve(triangles.size() + 2 * quads.size());
    // volumeToMesh winds a grid of class level set clockwise seen from outside, any other class the other way.
    const bool flip = surface.getGridClass() == openvdb::GRID_LEVEL_SET;
    const auto add = [&](uint32_t a, uint32_t b, uint32_t c) {
        if (flip) mesh.triangles.push_back({a, c, b});
        else mesh.triangles.push_back({a, b, c});
    };
    for (const openvdb::Vec3I& t : triangles) add(t[0], t[1], t[2]);
    for (const openvdb::Vec4I& q : quads) {
        const float first = (points[q[0]] - points[q[2]]).lengthSqr(), second = (points[q[1]] - points[q[3]]).lengthSqr();
        if (first <= second) {
            add(q[0], q[1], q[2]);
            add(q[0], q[2], q[3]);
        } else {
            add(q[0], q[1], q[3]);
            add(q[1], q[2], q[3]);
        }
    }
    progress.step();
    return mesh;
}

}  // namespace vdbcarve
