// SPDX-License-Identifier: Apache-2.0
// Notes in the folder of a result.
#pragma once

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

namespace vdbcarve {

/// In every folder that vdbcarve made, from the first stage of a run on.
inline constexpr const char* kMarker = "stages/made_by_vdbcarve.json";

/// Masks of a run that OUT's finished result has not made way for yet, {"file name": "where it lies, from OUT"}: should the run fail, they are what `bundle`
/// sends.
inline constexpr const char* kUnfinishedMasks = "stages/unfinished_masks.json";

/// JSON as text. What is no UTF-8 (a path, what a program said) is replaced, not thrown at.
inline std::string dumped(const nlohmann::json& value, int indent = -1) { return value.dump(indent, ' ', false, nlohmann::json::error_handler_t::replace); }

/// What a file of ours holds; an empty object where it is missing or damaged.
inline nlohmann::json parse_or_empty(const std::filesystem::path& file) {
    try {
        std::ifstream in(file);
        nlohmann::json out = in ? nlohmann::json::parse(in) : nlohmann::json::object();
        return out.is_object() ? out : nlohmann::json::object();
    } catch (const nlohmann::json::exception&) {
        return nlohmann::json::object();  // a note of ours that was damaged is as good as none
    }
}

}  // namespace vdbcarve
