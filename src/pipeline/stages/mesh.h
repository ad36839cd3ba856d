// SPDX-License-Identifier: Apache-2.0
// Stage `mesh`: the level set's zero surface as triangles, coloured.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct ExtractMesh {
    static constexpr const char* kName = "mesh";
    using Result = MeshMade;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const Surface& surface;
    const Colors& colors;

    void prepare(Run& run);
    Key key() const;
    MeshMade run(Run& run);
    void save(Slot& slot, const MeshMade& made) const;
    MeshMade load(const Slot& slot) const;
    void report(const MeshMade& made, nlohmann::json& report) const {
        if (made.vertices_seen_share) report["color"]["vertices_seen_share"] = *made.vertices_seen_share;
    }

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    int slabs_ = 1;
    double expected_bytes_ = 0;

  private:
    bool colors_from_photos() const { return options.color.from_photos && colors.grid; }
    /// Colours of the mesh's vertices.
    void color(MeshMade& made, Run& run) const;
};

}  // namespace vdbcarve::pipeline
