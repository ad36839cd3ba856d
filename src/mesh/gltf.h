// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <ostream>

#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// Binary glTF 2.0. `file` is for messages. Throws OutputError where it would not fit the format's 4 GiB.
void write_glb(std::ostream& out, const Mesh& mesh, const std::filesystem::path& file);

/// All triangles of the default scene, each node's transform applied. Throws InputError.
Mesh read_glb(const std::filesystem::path& file);

}  // namespace vdbcarve
