// SPDX-License-Identifier: Apache-2.0
// Stage `mesh`: the level set's zero surface as closed triangles.
#pragma once

#include <openvdb/openvdb.h>

#include "vdbcarve/backend.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

enum class Mesher {
    Dual,          ///< one vertex a cell
    MarchingCubes  ///< one vertex an edge of the lattice
};

struct MeshOptions {
    double adaptivity = 0;  ///< 0: uniform; up to 1: larger polygons where the surface is flat (Mesher::Dual)
    Mesher mesher = Mesher::Dual;
    bool normals = false;   ///< unit normals from the volume's gradient (Mesher::MarchingCubes)
    Backend backend = Backend::Cpu;  ///< of marching cubes; not Auto: see choose_backend
    int device = 0;
};

/// Marching cubes: kernel/marching_cubes.h says how. Closed and 2-manifold on any grid whose tiles inside and outside do
/// not touch each other; the same mesh, in the same order, on both backends.
///
/// Dual contouring of OpenVDB (tools::volumeToMesh, one vertex a cell and sheet), quads cut along the shorter
/// diagonal, wound counter-clockwise seen from outside (volumeToMesh winds level sets the other way). Closed
/// and 2-manifold.
/// Throws InputError when there is no surface.
Mesh extract_mesh(const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress);

}  // namespace vdbcarve
