// SPDX-License-Identifier: Apache-2.0
// Hulls of earlier runs that more views can be added to.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "pipeline/store.h"

namespace vdbcarve::pipeline {

struct KnownHull {
    Slot slot;                   ///< of stage carve
    std::filesystem::path file;  ///< the hull in it
    std::vector<size_t> views;   ///< those that it was made of, as numbers into what was asked for, rising
};

/// Among the finished hulls whose note says that they were made with the same options (`base`) and of some of these views (by what camera and mask hash to),
/// the one of most views, all of them maybe. Hulls in bricks, and what is damaged, count for nothing.
std::optional<KnownHull> find_known_hull(const Store& store, const std::string& base, const std::vector<std::string>& views);

}  // namespace vdbcarve::pipeline
