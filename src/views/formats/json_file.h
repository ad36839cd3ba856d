// SPDX-License-Identifier: Apache-2.0
// JSON files, with what to say where they are none. Private.
#pragma once

#include <nlohmann/json.hpp>

#include "views/formats/camera_formats.h"

namespace vdbcarve::io {

inline nlohmann::json parse_json(const fs::path& file) {
    try {
        return nlohmann::json::parse(read_text(file));
    } catch (const nlohmann::json::exception& e) {
        throw InputError(file.string() + ": is not JSON: " + e.what());
    }
}

}  // namespace vdbcarve::io
