// SPDX-License-Identifier: Apache-2.0
// Stage `mesh`: the level set's zero surface as closed triangles.
#pragma once

#include <openvdb/openvdb.h>

#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

struct MeshOptions {
    double adaptivity = 0;  ///< 0: uniform; up to 1: larger polygons where the surface is flat
};

/// Dual contouring of OpenVDB (tools::volumeToMesh, one vertex a cell and sheet), quads cut along the shorter
/// diagonal, wound counter-clockwise seen from outside (volumeToMesh winds level sets the other way). Closed
/// and 2-manifold. Throws InputError when there is no surface.
Mesh extract_mesh(const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress);

}  // namespace vdbcarve
