// SPDX-License-Identifier: Apache-2.0
// Stage `mesh`: the level set's zero surface as closed triangles.
#pragma once

#include <openvdb/openvdb.h>

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
    bool normals = false;  ///< unit normals from the volume's gradient (Mesher::MarchingCubes)
    bool quads = false;    ///< keep quads as such (Mesh::quads; Mesher::Dual)
    int pieces = 1;        ///< the grid is gone through in so many slabs, one in the mesher at a time (Mesher::Dual, adaptivity 0)
};

/// Marching cubes: kernel/marching_cubes.h says how. Closed and 2-manifold on any grid whose tiles inside and outside do
/// not touch each other; the same mesh, in the same order, on both backends.
///
/// Dual contouring of OpenVDB (tools::volumeToMesh, one vertex a cell and sheet), quads cut along the shorter
/// diagonal, wound counter-clockwise seen from outside (volumeToMesh winds level sets the other way). Closed
/// and 2-manifold on any grid. Samples of zero, or nearly, would make faces without area: where there are such faces, the mesh is made again with samples at
/// least 1/256 voxel off. In slabs the same vertices and faces come in another order; vertices on a slab's border are made on both sides, with the same bits,
/// and become one.
/// Memory besides the grid, an estimate for planning: kMeshBytesPerLeaf for the mesh, kMesherBytesPerLeaf for the mesher, which slabs divide.
/// Throws InputError when there is no surface, UsageError for options that do not go together.
inline constexpr double kMeshBytesPerLeaf = 5000, kMesherBytesPerLeaf = 6000;
Mesh extract_mesh(const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress);

}  // namespace vdbcarve
