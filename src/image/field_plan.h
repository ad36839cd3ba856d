// SPDX-License-Identifier: Apache-2.0
// What a distance field will look like, before it is made. Lengths in samples unless said otherwise.
#pragma once

#include "vdbcarve/distance.h"

namespace vdbcarve {

struct FieldWindow {
    int x0, y0, x1, y1;  ///< x0 <= x < x1
};

/// In 1/64 sample, as WindowDistance wants them.
struct FieldLengths {
    int reach, offset, clamp;
};

double field_offset(const DistanceOptions& options);
double field_reach(const DistanceOptions& options);
FieldLengths field_lengths(double reach, double offset);

/// Around an object's box (inclusive), within the frame. The contour is within a sample of an object's sample, the offset moves it;
/// the border's samples saturate.
FieldWindow window_around(const int object_box[4], int width, int height, double reach, double offset);

/// A field of that window of the frame, without samples and blocks.
SampledField field_header(int frame_width, int frame_height, const FieldWindow& window, double reach);

/// Throw UsageError.
void check_distance(const DistanceOptions& options);
void check_mask_size(int mask_width, int mask_height, int scale);

}  // namespace vdbcarve
