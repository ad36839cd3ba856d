// SPDX-License-Identifier: Apache-2.0
// Stage `color`: the photographs' colours on the surface.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Color {
    static constexpr const char* kName = "color";
    using Result = Colors;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const GridFacts& grid;
    const Surface& surface;

    void prepare(Run& run);
    bool idle() const { return colorless_; }
    Colors passed() const;
    Key key() const;
    Colors run(Run& run);
    void save(Slot& slot, const Colors& made) const;
    Colors load(const Slot& slot) const;
    void report(const Colors& made, nlohmann::json& report) const {
        if (!made.said.is_null()) report["color"] = made.said;
    }

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    ColorOptions color_{};
    bool colorless_ = false;

  private:
    nlohmann::json summary(const ColorResult& result, Progress& progress) const;
};

/// Colour options as the job sets them: up axis, normals of a binary model, and as many photographs at a time as fit into memory.
ColorOptions color_options(const ReconstructOptions& options, const Shoot& shoot, const Silhouettes& masks, const Surface& surface, Run& run);

}  // namespace vdbcarve::pipeline
