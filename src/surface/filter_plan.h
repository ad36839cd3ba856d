// SPDX-License-Identifier: Apache-2.0
// What both ways through the filters share.
#pragma once

#include <openvdb/openvdb.h>

#include <vector>

#include "surface/redistance.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/kernel/filter.h"

namespace vdbcarve {

/// The half-width of a level set, in voxels. Throws InputError for another grid.
int half_width_of(const openvdb::FloatGrid& surface);

/// Throws UsageError.
void check_filter(const FilterOptions& options, int half_width_vox);

/// The chain, pass by pass.
std::vector<kernel::FilterPass> passes_of(const std::vector<FilterStep>& steps);
/// The passes after which each voxel has the least value near it, for kernel::change_share.
std::vector<kernel::FilterPass> thin_passes(double keep_thin_vox);

/// What a result says of volumes, from the repair's.
void describe_volumes(FilterResult& result, const VolumeRepair& repair, double voxel);

[[noreturn]] void explain_filtered_away(const FilterOptions& options);

}  // namespace vdbcarve
