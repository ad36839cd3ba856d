// SPDX-License-Identifier: Apache-2.0
// Stage `distance`: signed distance to each silhouette, sub-pixel at the contour.
#pragma once

#include <cstdint>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/distance.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct DistanceOptions {
    double silhouette_offset_px = 0;  ///< grows (+) or shrinks (-) every silhouette by so many pixels of the mask
    /// Pixels of the mask along each side of a sample (field-scale). 1: a sample a pixel. Coarser samples average the
    /// mask; their contour stays sub-pixel.
    int scale = 1;
    /// Distances saturate here, in samples. Carving needs the band and the size of a leaf in samples (plan_fields).
    double reach_samples = kernel::kMaxReach_px;
    /// Coarse samples take the largest coverage instead of the mean: silhouettes never shrink (for bounds).
    bool conservative = false;
};

/// Signed distance over a window of the image; kernel::FieldView says how it is read.
struct SampledField {
    std::vector<int16_t> samples;  ///< row-major, 1/64 of a sample's side, negative inside the object
    std::vector<int16_t> blocks;
    int x0 = 0, y0 = 0, width = 0, height = 0;  ///< window, samples
    int blocks_per_row = 0;
    float reach = 0;   ///< samples
    bool cut[4] = {};  ///< left, top, right, bottom: the window ends there inside the frame

    bool empty() const { return samples.empty(); }
    kernel::FieldView view() const;
    /// Signed distance at the sample (x, y) of the whole image, in samples.
    float at(int x, int y) const;
    size_t bytes() const { return 2 * (samples.size() + blocks.size()); }
};

/// Signed distances of one view, negative inside the object.
struct DistanceField {
    SampledField silhouette;  ///< to the contour; pixels to be ignored count as object here
    SampledField ignored;     ///< to the ignored region, positive inside it; empty where nothing is ignored
    int scale = 1;
    int mask_width = 0, mask_height = 0;  ///< pixels
    int object_box[4] = {0, 0, -1, -1};   ///< x_min, y_min, x_max, y_max of the samples that are object

    bool shows_object() const { return object_box[2] >= object_box[0]; }
    size_t bytes() const { return silhouette.bytes() + ignored.bytes(); }
};

/// Bytes that the field of a mask will take, without making it.
size_t planned_field_bytes(const MaskView& mask, const DistanceOptions& options);

/// Exact Euclidean distance to the contour of each mask within the reach (kernel/distance.h says how), over the window
/// that holds the object, views in parallel. The sign at a pixel centre equals "mask < 1/2".
/// Time: about window area x reach. Throws UsageError for a mask smaller than 2 x 2 samples, a scale below 1 and
/// a reach outside 4..kMaxReach_px.
std::vector<DistanceField> distance_fields(const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress);

/// The same for a single 8-bit coverage image, whole, in pixels, saturated at `reach_px`.
ImageF signed_distance(ImageView<uint8_t> coverage, int reach_px = kernel::kMaxReach_px);

}  // namespace vdbcarve
