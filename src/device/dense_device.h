// SPDX-License-Identifier: Apache-2.0
// The dense method on the device, for the benchmark.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdbcarve {

struct DenseTimes {
    double upload_ms = 0, carve_ms = 0;  ///< medians; the upload is wall time
    size_t object_voxels = 0;
};

/// Byte masks (0 background) of one size, and 3x4 matrices from index coordinates to homogeneous pixels. Throws BackendError.
DenseTimes dense_on_device(const std::vector<const uint8_t*>& masks, int width, int height, const std::vector<std::array<float, 12>>& pixel_from_index,
                           const std::array<int, 3>& dims, int device, int runs);

}  // namespace vdbcarve
