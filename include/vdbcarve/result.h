// SPDX-License-Identifier: Apache-2.0
// What the folder of a result says about itself.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/file_frame.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// A folder that a run of vdbcarve made, finished or not.
bool made_by_us(const std::filesystem::path& output);

/// Throws InputError where the folder is ours and holds no finished result: a run was stopped while it replaced files, or before it had made any.
void require_finished(const std::filesystem::path& output);

/// The cameras of a result with their photographs, from where its report says that they are, or from the folder `images`; a view whose photograph is not there
/// any more has none. Throws InputError.
Views result_views(const std::filesystem::path& output, const std::filesystem::path& images, Progress& progress);

/// The same of the last run in that folder, finished, failed or killed: the cameras that it went on with. Throws InputError, also where it never had any.
Views last_views(const std::filesystem::path& output, const std::filesystem::path& images, Progress& progress);

/// How a file of a result lies to the scene, as its report says; the scene's own frame where it says nothing.
FileFrame frame_from_scene(const std::filesystem::path& output, const std::string& file);

}  // namespace vdbcarve
