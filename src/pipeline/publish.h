// SPDX-License-Identifier: Apache-2.0
// What a run leaves in OUT: files that appear together, report.json last.
#pragma once

#include "pipeline/run.h"
#include "pipeline/stages/export.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

/// Masks into OUT/masks right away, to be looked at and edited while the run goes on. Where OUT has a result, which stays whole until the run is done, into
/// OUT/stages instead.
void show_masks(Run& run, const Silhouettes& masks);

/// The end of `mask`: masks, and overlays of them on their photographs.
Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks);
/// The end of `align`: cameras.json, drawings, and in preview.png the hull over the views that fit worst. Where the mat was enough, there are no masks.
Reconstruction publish_cameras(Run& run, const Shoot& shoot, const Silhouettes& masks);
/// The end of a dry run.
Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks, const Plan& plan);
/// The end of `carve`: the raw hull, one file or a folder of bricks.
Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks, const std::optional<KeptGrid>& kept, const Hull& hull);
/// The end of `reconstruct`. Runs stage export.
Reconstruction publish(Run& run, const Made& made);

/// Cameras that align() does not stand behind: they go to OUT/unverified, beside what an earlier run made, and the run ends (UndeterminedError); unless they
/// are accepted, with a warning.
void refuse_or_warn(Run& run, const Shoot& shoot, const Silhouettes& masks);

}  // namespace vdbcarve::pipeline
