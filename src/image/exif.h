// SPDX-License-Identifier: Apache-2.0
// What a photograph says about how it was taken. Private.
#pragma once

#include <filesystem>

namespace vdbcarve::io {

/// Focal length in pixels of a picture of this size: from the equivalent on 36 x 24 mm film, else from the focal length and the sensor's resolution;
/// 0 where the file says neither.
double exif_focal_px(const std::filesystem::path& file, int width_px, int height_px);

/// 1..8: how the stored picture is turned to be shown (TIFF 6.0); 1, not at all, where the file says nothing.
int exif_orientation(const std::filesystem::path& file);

}  // namespace vdbcarve::io
