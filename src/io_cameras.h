// SPDX-License-Identifier: Apache-2.0
// The interface behind which every camera format stands. Private.
#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "vdbcarve/error.h"
#include "vdbcarve/views.h"

namespace vdbcarve::io {

namespace fs = std::filesystem;

/// What an importer hands back before images are resolved. A camera's width and height may still be 0
/// (not in the file); `angle_x_rad` then gives the focal length once the width is known.
struct ImportedView {
    View view;
    double angle_x_rad = 0;
};

struct Imported {
    std::vector<ImportedView> views;
    std::vector<Sitting> sittings{Sitting{}};
    std::string up, units;
    bool integer_pixel_centres = false;  ///< the format counts the first pixel's centre as (0, 0)
    bool metric = true;
    std::vector<std::string> notes;
};

struct Importer {
    const char* name;
    bool (*understands)(const fs::path& candidate);
    Imported (*read)(const fs::path& candidate);
};

bool understands_transforms(const fs::path& file);
Imported read_transforms(const fs::path& file);
bool understands_colmap(const fs::path& folder);
Imported read_colmap(const fs::path& folder);
bool understands_middlebury(const fs::path& file);
Imported read_middlebury(const fs::path& file);
bool understands_projections(const fs::path& file_or_folder);
Imported read_projections(const fs::path& file_or_folder);

inline std::string read_text(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file.string() + ": cannot be opened");
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
}

}  // namespace vdbcarve::io
