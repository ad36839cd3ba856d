// SPDX-License-Identifier: Apache-2.0
// What stereo found and what came of it, for people to look at. Private.
#pragma once

#include <openvdb/openvdb.h>

#include <filesystem>
#include <vector>

#include "vdbcarve/stereo.h"

namespace vdbcarve {

struct StereoTile {
    std::string name;
    Camera camera;
    Image8 photo;  ///< without lens distortion; may be empty
    const DepthMap* map;
};

/// A row for each view: the photograph; its trusted depths, near ones light; how sure they are; the surface, orange where depths carved it and grey where the
/// hull stands.
Image8 stereo_sheet(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface, const std::vector<StereoTile>& tiles);

/// NAME.depth.tiff (32-bit float, along the camera's z, world units; 0: none) and NAME.confidence.png (0..255) of every view that has some, into a folder that
/// is there.
void write_depth_maps(const std::filesystem::path& folder, const std::vector<std::string>& names, const std::vector<DepthMap>& maps);

}  // namespace vdbcarve
