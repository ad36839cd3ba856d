// SPDX-License-Identifier: Apache-2.0
// Which bounds and voxels a result keeps when views are added to it.
#pragma once

#include "pipeline/values.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::pipeline {

/// Nothing where nothing is added, where there is no result, and where its cameras were others: then its bounds mean nothing here, which is said. Throws
/// UsageError where the result was made of scenes that this run would lose.
std::optional<KeptGrid> grid_to_keep(const ReconstructOptions& options, const Shoot& shoot, Progress& progress);

/// The options that repeat a run: where a grid was kept, with that instead of what led to it.
ReconstructOptions repeatable(const ReconstructOptions& options, const std::optional<KeptGrid>& kept);

}  // namespace vdbcarve::pipeline
