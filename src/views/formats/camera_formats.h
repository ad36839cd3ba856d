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
    double focal_36mm = 0;              ///< as on 36 mm wide film; > 0: the focal length once the size is known
    Vec2d centre_36mm = Vec2d::Zero();  ///< the principal point from the middle on, likewise
};

struct Imported {
    std::vector<ImportedView> views;
    std::vector<Sitting> sittings{Sitting{}};
    std::string up, units;
    std::optional<double> floor;  ///< along `up`
    std::vector<std::string> unverified;
    bool integer_pixel_centres = false;  ///< the format counts the first pixel's centre as (0, 0)
    bool metric = true;
    std::vector<std::string> notes;
    std::vector<std::string> warnings;
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

bool understands_filestorage(const fs::path& file);
Imported read_filestorage(const fs::path& file);
bool understands_metashape(const fs::path& file);
Imported read_metashape(const fs::path& file);
bool understands_bundler(const fs::path& file);
Imported read_bundler(const fs::path& file);
/// OpenMVG's and Meshroom's.
bool understands_sfm(const fs::path& file);
Imported read_sfm(const fs::path& file);
bool understands_realitycapture(const fs::path& file);
Imported read_realitycapture(const fs::path& file);
bool understands_matlab(const fs::path& file);
Imported read_matlab(const fs::path& file);
bool understands_nvm(const fs::path& file);
Imported read_nvm(const fs::path& file);

/// Views of 3x4 matrices in whatever file; nameless ones are the images in natural order. A world that they show mirrored is mirrored back.
struct NamedProjection {
    std::string name;
    Mat34d projection;
};
Imported imported_projections(const fs::path& file, std::vector<NamedProjection> matrices);

/// A number, all of the word. Throws InputError saying where.
inline double number_in(const std::string& word, const std::string& where) {
    try {
        size_t used = 0;
        const double value = std::stod(word, &used);  // reads nan and inf too: check_views names them
        if (used == word.size()) return value;
    } catch (const std::exception&) {
    }
    throw InputError(where + ": '" + word + "' is not a number");
}

inline std::string read_text(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file.string() + ": cannot be opened");
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
}

}  // namespace vdbcarve::io
