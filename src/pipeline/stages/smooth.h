// SPDX-License-Identifier: Apache-2.0
// Stage `smooth`: Taubin's smoothing, then fewer faces; and the measures of the mesh that is left.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Smooth {
    static constexpr const char* kName = "smooth";
    using Result = MeshMade;

    const ReconstructOptions& options;
    const Surface& surface;
    MeshMade mesh;

    void prepare(Run& run);
    bool idle() const { return taubin_.iterations == 0 && !fewer(); }
    MeshMade passed();
    Key key() const;
    MeshMade run(Run& run);
    void save(Slot& slot, const MeshMade& made) const;
    MeshMade load(const Slot& slot) const;
    void say(const MeshMade& made, Progress& progress) const;
    void report(const MeshMade& made, nlohmann::json& report) const;

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    SmoothOptions taubin_{};
    std::optional<double> volume_before_{};

  private:
    bool fewer() const { return options.smooth.faces > 0 || options.smooth.max_error > 0; }
    /// Measures the mesh and names what it is not.
    MeshMade finished(MeshMade made) const;
};

}  // namespace vdbcarve::pipeline
