// SPDX-License-Identifier: Apache-2.0
// OUT/masks: copies of the masks for the user to look at and to edit, with a note of which of them are ours.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "pipeline/out_folder.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

/// Masks in OUT/masks that are not as a run left them, by view; empty paths: they are. Each is said.
std::vector<std::filesystem::path> edited_masks(const std::filesystem::path& output, const std::vector<std::string>& names, Progress& progress);

/// Throws OutputError where place_masks() would replace a file in OUT/masks that no run of ours wrote: it is somebody else's, with --force too.
void refuse_foreign_masks(const std::filesystem::path& output, const Silhouettes& masks);

/// Puts the masks into a set of final files, but for those that are there already and those that the user edited. Throws OutputError where a file that no run
/// of ours wrote is in the way: --force lets a run into a folder with other files, it does not give these away.
void place_masks(ResultSet& set, const Silhouettes& masks, Progress& progress);

}  // namespace vdbcarve::pipeline
