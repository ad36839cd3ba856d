// SPDX-License-Identifier: Apache-2.0
// Marching cubes: the table, and the CPU's way through a grid.
#pragma once

#include <openvdb/openvdb.h>

#include <array>

#include "vdbcarve/kernel/marching_cubes.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve {

/// Throws UsageError for options of extract_mesh() that do not go together.
void check_mesh(const MeshOptions& options);

/// By which corners are inside, corner c as bit c.
const std::array<kernel::MarchingCase, 256>& marching_cases();

/// Where the grid's voxels are. The transform scales evenly and shifts.
kernel::LatticeFrame lattice_frame(const openvdb::math::Transform& transform);

/// Vertices leaf by leaf in the tree's order, of a leaf by axis and voxel; triangles leaf by leaf, voxel by voxel.
/// Time: about 20 ns an edge crossed, in parallel over leaves; same mesh for any number of threads.
Mesh marching_cubes(const openvdb::FloatGrid& surface, bool normals);

}  // namespace vdbcarve
