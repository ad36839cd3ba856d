// SPDX-License-Identifier: Apache-2.0
// The dense method of the paper on the device, for the benchmark: a byte a voxel, every voxel against every mask.
#pragma once

#include <array>
#include <vector>

#include "device_buffer.h"
#include "stream.h"

namespace vdbcarve::cuda {

class DenseStage {
  public:
    /// Byte masks (0 background), all of one size, and 3x4 matrices from index coordinates to homogeneous pixels.
    void upload(const std::vector<const uint8_t*>& masks, int width, int height, const std::vector<std::array<float, 12>>& pixel_from_index,
                const Stream& stream);
    /// Voxels from (0, 0, 0); a thread a voxel, left as soon as one view shows background. Contracted and approximate arithmetic
    /// is allowed: it is what one would write.
    void run(const std::array<int, 3>& dims, const Stream& stream);
    /// Voxels that are object. Waits.
    size_t count(const Stream& stream);
    size_t bytes() const { return masks_.bytes() + volume_.bytes(); }

  private:
    int views_ = 0, width_ = 0, height_ = 0;
    size_t voxels_ = 0;
    DeviceBuffer<uint8_t> masks_, volume_;
    DeviceBuffer<unsigned long long> count_;
};

}  // namespace vdbcarve::cuda
