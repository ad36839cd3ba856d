// SPDX-License-Identifier: Apache-2.0
// Stage `filter`: the level set is smoothed, its volume kept.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Filter {
    static constexpr const char* kName = "filter";
    using Result = Surface;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const GridFacts& grid;
    openvdb::FloatGrid::Ptr hull;  ///< its level set
    Surface surface;

    void prepare(Run& run);
    bool idle() const { return filter_.steps.empty(); }
    Surface passed();
    Key key() const { return Key(kName).of(surface.key).of(options.filter).of(filter_.steps).of(filter_.keep_thin_vox); }
    Surface run(Run& run);
    void save(Slot& slot, const Surface& made) const;
    Surface load(const Slot& slot) const;
    void report(const Surface& made, nlohmann::json& report) const { report["filter"] = made.filter; }

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    FilterOptions filter_{};
    nlohmann::json chosen_ = nlohmann::json::object();  ///< which chain, and why

  private:
    /// A filter knows nothing of silhouettes: what it took from them grows back.
    void cover(Surface& made, Progress& progress) const;
    nlohmann::json summary(const FilterResult& result, Progress& progress) const;
};

}  // namespace vdbcarve::pipeline
