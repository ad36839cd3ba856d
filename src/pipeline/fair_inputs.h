// SPDX-License-Identifier: Apache-2.0
// What the fair surface is made from, for the stages that make it or ask it: views, and level sets in the band that it needs.
#pragma once

#include "pipeline/values.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::pipeline {

/// What the views that are carved with show. Borrows the masks.
std::vector<FairView> fair_views(const Shoot& shoot, const Silhouettes& masks);
/// The fair surface is found in a band of 3 voxels or more: a level set of `half_width_vox` with such a band, and one with that band as one of
/// `half_width_vox`. Those that are wide enough are passed on.
openvdb::FloatGrid::Ptr to_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress);
openvdb::FloatGrid::Ptr from_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress);

}  // namespace vdbcarve::pipeline
