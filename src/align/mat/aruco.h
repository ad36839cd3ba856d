// SPDX-License-Identifier: Apache-2.0
// What is used of OpenCV's markers, which moved from contrib to the main modules in 4.7. Private.
#pragma once

#include <string>
#include <vector>

#include "vdbcarve/board.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"

namespace vdbcarve {

/// Markers in a dictionary like "6X6_250"; 0 for none of that name.
int dictionary_size(const std::string& name);

/// Bits along a marker's side, without its border. The dictionary must exist.
int marker_bits(const std::string& name);

/// A marker with its black border, `side` pixels wide.
Image8 marker_image(const std::string& dictionary, int id, int side);

/// A corner of a mat in a photograph: of a marker (grid) or of the chessboard (charuco).
struct MatCorner {
    int group = 0;   ///< the marker, or the chessboard's corner, by number
    Vec2d mat_m;     ///< in the mat's frame
    Vec2d image_px;  ///< first pixel's centre at (0.5, 0.5)
};

/// All that can be seen of a mat, to a few hundredths of a pixel in sharp pictures. `grey` has one channel.
std::vector<MatCorner> find_mat(const MatLayout& mat, ImageView<uint8_t> grey);

}  // namespace vdbcarve
