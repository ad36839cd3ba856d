// SPDX-License-Identifier: Apache-2.0
// Stage `level_set`: the raw hull becomes a true signed distance field.
#pragma once

#include <openvdb/openvdb.h>

#include "vdbcarve/progress.h"

namespace vdbcarve {

struct LevelSetOptions {
    int half_width_vox = 3;
};

/// Re-distances the hull: kernel/level_set.h says how. No sign changes, the zero set stays where it crosses the
/// lattice's edges up to curvature within a voxel, |gradient| = 1 to first order. The band never leaves the hull's leaves.
/// Name "surface", GRID_LEVEL_SET, background = half-width. No value is exactly zero (|v| >= 1e-6 voxel), so that
/// meshing makes no zero-area faces. Same bits for any number of threads. The hull's leaves become the surface's: pass a
/// deepCopy() of a hull that is to be kept. Memory: once the hull's leaves besides them. Throws InputError when the grid has no
/// zero crossing.
openvdb::FloatGrid::Ptr level_set(openvdb::FloatGrid::Ptr hull, const LevelSetOptions& options, Progress& progress);

/// A crude level set of an occupancy: +-1/2 voxel at the border, re-distanced. For meshing the binary model.
openvdb::FloatGrid::Ptr level_set_of_occupancy(const openvdb::MaskGrid& occupancy, const LevelSetOptions& options, Progress& progress);

/// Fog volume of a level set: clamp(1/2 - phi / (2 w), 0, 1) with w = 1.5 voxel, so 1/2 exactly on the surface,
/// 1 inside. Active where positive. Name "density".
openvdb::FloatGrid::Ptr density_of(const openvdb::FloatGrid& surface);

}  // namespace vdbcarve
