// SPDX-License-Identifier: Apache-2.0
// Stage `views`: the scene becomes views; a video becomes photographs first.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

/// Cameras are to be found in this run, or are being found.
bool finds_cameras(const ReconstructOptions& options, const Views& views);

struct LoadViews {
    static constexpr const char* kName = "views";
    using Result = Shoot;

    const ReconstructOptions& options;

    /// Opens OUT once the scene and the options are known to go together.
    Shoot run(Run& run);
    void report(const Shoot& shoot, nlohmann::json& report) const;
};

}  // namespace vdbcarve::pipeline
