// SPDX-License-Identifier: Apache-2.0
// Meshes between stages: all of their bits, which .ply (8-bit colours) does not keep. Private to OUT/stages.
#pragma once

#include <filesystem>
#include <optional>

#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// Texture coordinates and `extrapolated` are left out. Throws OutputError.
void store_mesh(const std::filesystem::path& file, const Mesh& mesh);

/// Nothing where there is no such file, or not a whole one.
std::optional<Mesh> stored_mesh(const std::filesystem::path& file);

}  // namespace vdbcarve
