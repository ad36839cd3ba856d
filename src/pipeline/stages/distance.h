// SPDX-License-Identifier: Apache-2.0
// Stage `distance`: bounds, voxels, how all of it fits into memory, and the distance fields that suit them.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Distance {
    static constexpr const char* kName = "distance";
    using Result = Plan;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const std::optional<KeptGrid>& kept;
    bool have_hull;  ///< the hull made from them is there: nothing is planned

    Plan run(Run& run);
    void report(const Plan& plan, nlohmann::json& report) const;

  private:
    Plan plan_grid(Run& run) const;
    void plan_fields_of(Plan& plan, Run& run) const;
    void plan_memory_of(Plan& plan, Run& run) const;
};

/// Batches and bricks, for where the run carves now.
void share_out(Plan& plan, Run& run);

}  // namespace vdbcarve::pipeline
