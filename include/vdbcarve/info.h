// SPDX-License-Identifier: Apache-2.0
// What a file, a scene or a result holds.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/progress.h"

namespace vdbcarve {

/// A JSON document about a .vdb, a mesh, a camera file, a scene folder or a result folder. Throws InputError.
std::string info_json(const std::filesystem::path& file, Progress& progress);

}  // namespace vdbcarve
