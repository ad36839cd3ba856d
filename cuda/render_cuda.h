// SPDX-License-Identifier: Apache-2.0
// Pictures on the device: kernel/render.h, a thread a pixel.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/render.h"

namespace vdbcarve::cuda {

class RenderStage {
  public:
    RenderStage();
    ~RenderStage();

    /// A NanoVDB grid of Vec3f, from host memory.
    void set_colors(const uint8_t* bytes, size_t size, const Stream& stream);
    void clear_colors();

    /// First and last voxel of what holds the leaves. Waits for the device.
    std::array<int, 6> leaf_box(const Grid& grid, const Stream& stream, StageTimes& times);

    /// The pixels, RGBA, device memory, until the next call. `rule` comes without its tables, which follow.
    const uint8_t* render(const Grid& grid, const kernel::ColorBase& base, const kernel::SightBox& box, kernel::RenderRule rule,
                          const std::vector<kernel::Vec3>& ambient, const std::vector<uint8_t>& srgb, const Stream& stream, StageTimes& times);

    size_t bytes() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace vdbcarve::cuda
