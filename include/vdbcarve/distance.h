// SPDX-License-Identifier: Apache-2.0
// Stage `distance`: signed distance to each silhouette, sub-pixel at the contour.
#pragma once

#include <cstdint>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct DistanceOptions {
    double silhouette_offset_px = 0;  ///< grows (+) or shrinks (-) every silhouette by so many pixels
};

/// Signed distances at pixel centres, in pixels, negative inside the object.
struct DistanceField {
    ImageF silhouette;  ///< to the contour; pixels to be ignored count as object here
    ImageF ignored;     ///< to the ignored region, positive inside it; empty where nothing is ignored
};

/// Exact Euclidean distance to the contour of each mask (kernel/distance.h says how), views in parallel.
/// The sign at a pixel centre equals "mask < 1/2". A mask without a contour gives +-(width + height).
/// Time: linear in the number of pixels. Throws UsageError for a mask smaller than 2 x 2.
std::vector<DistanceField> distance_fields(const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress);

/// The same for a single 8-bit coverage image.
ImageF signed_distance(ImageView<uint8_t> coverage);

}  // namespace vdbcarve
