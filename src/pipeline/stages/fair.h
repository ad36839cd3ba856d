// SPDX-License-Identifier: Apache-2.0
// Stage `fair`: the hull's surface becomes the smoothest one inside it that covers every silhouette.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::pipeline {

/// What the views that are carved with show. Borrows the masks.
std::vector<FairView> fair_views(const Shoot& shoot, const Silhouettes& masks);
/// The fair surface is found in a band of 3 voxels or more. A level set with `half_width_vox` in such a one; and one of 3 back in `half_width_vox`.
openvdb::FloatGrid::Ptr to_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress);
openvdb::FloatGrid::Ptr from_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress);

struct Fair {
    static constexpr const char* kName = "fair";
    using Result = Surface;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const GridFacts& grid;
    openvdb::FloatGrid::Ptr hull;  ///< its level set
    Surface surface;               ///< the same, or what depths left of it

    void prepare(Run& run);
    bool idle() const { return surface.silhouettes_kept < kLeastKept; }
    Surface passed() { return std::move(surface); }
    Key key() const { return Key(kName).of(surface.key).of(options.surface); }
    Surface run(Run& run);
    void save(Slot& slot, const Surface& made) const;
    Surface load(const Slot& slot) const;
    void report(const Surface& made, nlohmann::json& report) const {
        if (!made.fair.is_null()) report["fair"] = made.fair;
    }
    void say(const Surface& made, Progress& progress) const;

    /// Where depths and silhouettes agree less (silhouettes_kept()), one of them is wrong, and a surface that follows both has ridges along every contour.
    static constexpr double kLeastKept = 0.9;

  private:
    Surface on_hull(openvdb::FloatGrid::Ptr fair, openvdb::FloatGrid::Ptr slack) const;
};

}  // namespace vdbcarve::pipeline
