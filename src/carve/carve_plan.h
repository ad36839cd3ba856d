// SPDX-License-Identifier: Apache-2.0
// What both backends' carves start from and end with.
#pragma once

#include "vdbcarve/carve.h"

namespace vdbcarve {

struct CarvePlan {
    double band = 0;        ///< world units; 0 for occupancy
    float near_depth = 0;   ///< world units
    float cell_radius = 0;  ///< of a leaf's cell of 4^3 voxel centres, world units
    int need_seen = 0;      ///< so many views must have a point in frame
    IndexBox range;         ///< voxels that may be looked at: the bounds with the band, cut by the brick
};

CarvePlan plan_carve(size_t views, const CarveOptions& options);

/// Throw UsageError for what carve() does not take.
void check_field(const std::string& name, const Intrinsics& intrinsics, const DistanceField& field, const CarveOptions& options);
void check_carve(const std::vector<CarveInput>& inputs, const CarveOptions& options);

/// Says why nothing is left, by asking every view about a raster of points. Where the inputs have no fields, it can only say that.
[[noreturn]] void explain_empty(const std::vector<CarveInput>& inputs, const CarveOptions& options);

/// Named grids without leaves, on the options' lattice.
openvdb::FloatGrid::Ptr empty_hull(const CarveOptions& options);
openvdb::MaskGrid::Ptr empty_occupancy(const CarveOptions& options);

/// Fills in what the statistics say of the resulting tree.
void measure_tree(CarveResult& result);

}  // namespace vdbcarve
