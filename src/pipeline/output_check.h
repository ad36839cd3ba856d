// SPDX-License-Identifier: Apache-2.0
// Whether a run may write into the folder that it was given. Private.
#pragma once

#include <filesystem>

#include "vdbcarve/mask.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// Throws OutputError where a run with this output would write into a folder that its photographs, masks or cameras are read from (the scene, an added scene,
/// images/, masks/ …), or would replace the camera file. `views` may still be empty (before a video's frames are extracted).
void refuse_output_among_inputs(const std::filesystem::path& output, const ViewsOptions& scene, const MaskOptions& masks, const Views& views);

/// Throws OutputError where a folder that no run of ours made (--force) holds files or folders that a run would replace, delete or later clean. Masks are
/// looked at one by one when they are written.
void refuse_foreign_results(const std::filesystem::path& output);

}  // namespace vdbcarve
