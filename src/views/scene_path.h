// SPDX-License-Identifier: Apache-2.0
// Paths that options give, in a scene.
#pragma once

#include <filesystem>

namespace vdbcarve::io {

/// The path as given when it is absolute or exists in the scene, else relative to the working folder.
inline std::filesystem::path in_scene(const std::filesystem::path& given, const std::filesystem::path& scene) {
    if (given.empty() || given.is_absolute()) return given;
    return std::filesystem::exists(scene / given) ? scene / given : given;
}

}  // namespace vdbcarve::io
