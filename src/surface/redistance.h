// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/openvdb.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <utility>

#include "vdbcarve/filter.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// What is asked of a re-distancing that keeps volume, and what came of it. Volumes in kernel::kVolumeUnits of a voxel.
struct VolumeRepair {
    int64_t target = 0;
    bool move = true;  ///< false: only measure
    int64_t before_move = 0, volume = 0;
    double offset_vox = 0;  ///< outwards
    int steps = 0;
};

/// Finds the offset with Newton's method. `measure(offset)` gives the volume, and the voxels that the surface passes, with the surface moved outwards so far.
template <class Measure>
void repair_volume(VolumeRepair& repair, const Measure& measure) {
    float offset = 0;
    auto [volume, area] = measure(offset);
    repair.before_move = volume;
    const auto off = [&] { return static_cast<double>(repair.target - volume); };
    while (repair.move && repair.steps < kMostRepairSteps && area > 0 && std::fabs(off()) > 0.1 * kVolumeTolerance * static_cast<double>(repair.target)) {
        const double step = off() / (static_cast<double>(area) * static_cast<double>(kernel::kVolumeUnits));
        offset = static_cast<float>(std::clamp(static_cast<double>(offset) + step, -1.0, 1.0));
        std::tie(volume, area) = measure(offset);
        ++repair.steps;
    }
    repair.volume = volume;
    repair.offset_vox = static_cast<double>(offset);
}

/// level_set() of any field whose leaves hold its zero crossing, with the volume kept where `repair` is given.
openvdb::FloatGrid::Ptr redistance(openvdb::FloatGrid::Ptr field, int half_width_vox, VolumeRepair* repair, Progress& progress);

/// What level_set_of_occupancy() re-distances: +-1/2 voxel at the border, +-band elsewhere.
openvdb::FloatGrid::Ptr halves_of_occupancy(const openvdb::MaskGrid& occupancy, int half_width_vox);

/// Voxels inside that lie in tiles.
int64_t inside_tile_voxels(const openvdb::FloatTree& tree);

/// The volume of a level set, as VolumeRepair counts it.
int64_t volume_units(const openvdb::FloatGrid& surface);

}  // namespace vdbcarve
