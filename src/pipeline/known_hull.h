// SPDX-License-Identifier: Apache-2.0
// Hulls of earlier runs that lack only some views. Private.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace vdbcarve {

struct KnownHull {
    std::filesystem::path file;
    std::vector<size_t> views;  ///< those that it was made of, as numbers into what was asked for, rising
};

/// Among the hulls in a result's stages whose note says that they were made with the same options (`base`) and of some of these views (by what camera and mask
/// hash to), the one of most views, all of them maybe. Notes that are damaged, or without their hull, count for nothing.
std::optional<KnownHull> find_known_hull(const std::filesystem::path& stages, const std::string& base, const std::vector<std::string>& views);

}  // namespace vdbcarve
