// SPDX-License-Identifier: Apache-2.0
// Stage `fair`: the hull's surface becomes the smoothest one inside it that covers every silhouette.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

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
