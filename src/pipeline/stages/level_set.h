// SPDX-License-Identifier: Apache-2.0
// Stage `level_set`: the raw hull becomes a level set, cut at the floor.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct LevelSet {
    static constexpr const char* kName = "level_set";
    using Result = Surface;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    Hull& hull;  ///< its grids are used up

    Key key() const;
    Surface run(Run& run);
    void save(Slot& slot, const Surface& made) const;
    Surface load(const Slot& slot) const;
    void report(const Surface& made, nlohmann::json& report) const {
        if (made.floor_clear && report.contains("floor")) report["floor"]["clear"] = *made.floor_clear;
    }

  private:
    openvdb::FloatGrid::Ptr redistance(Run& run);
    void cut_floor(Surface& surface, Run& run) const;
};

/// The binary model of --occupancy, from its file where it is not in memory.
openvdb::MaskGrid::Ptr occupancy_of(const Hull& hull);

}  // namespace vdbcarve::pipeline
