// SPDX-License-Identifier: Apache-2.0
// What every mask made from a photograph goes through: clean-up of what is object and what is not, and an edge as soft as the photograph's. Private.
#pragma once

#include <opencv2/core.hpp>

#include "vdbcarve/mask.h"

namespace vdbcarve {

/// Opens, closes, keeps the largest piece, fills holes. `binary`: 8-bit, 0 or 255.
void clean_up(cv::Mat& binary, const MaskCleanUp& options);

/// Coverage of the pixels along the edge of `binary`, as a mixture of light: of the object's colour deeper inside, and of the background's outside (or of
/// `plate`, the background itself, where it is known: three channels, sRGB). Elsewhere it is 0 or 255. So the edge is found to a fraction of a pixel where
/// `binary` is right to within two. Time: pixels, and 200 for each along the edge.
Image8 soft_edge(ImageView<uint8_t> photo, const cv::Mat& binary, ImageView<uint8_t> plate = {});

}  // namespace vdbcarve
