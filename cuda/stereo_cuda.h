// SPDX-License-Identifier: Apache-2.0
// Depths on the device: kernel/stereo.h, a thread a pixel.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/stereo_hull.h"

namespace vdbcarve::cuda {

/// A view's pixels in host memory; without pixels it takes no part.
struct StereoPixels {
    const float* grey = nullptr;
    const uint8_t* object = nullptr;  ///< 1: of the object; 2: and not near its rim
    int width = 0, height = 0;
    kernel::StereoLens lens{};
};

class StereoStage {
  public:
    StereoStage();
    ~StereoStage();

    /// The pixels to the device, and what lines of sight need of the grid. `after_coarser`: what was matched last was of half this size, and is begun with.
    void begin(const std::vector<StereoPixels>& views, bool after_coarser, const Grid& grid, const kernel::ColorBase& base, const kernel::SightBox& box, const Stream& stream, StageTimes& times);

    /// Best planes of a view and their likelihoods, which stay on the device. `reference` comes without pointers. `hull_pixels` of the view's pixels see the hull.
    void match(kernel::StereoReference reference, const kernel::HullView& hull, int passes, const kernel::StereoTrustRule& rule, const Stream& stream, StageTimes& times);

    /// Likelihoods of what other views of those matched find, too; 0 elsewhere.
    void agree(const std::vector<kernel::StereoReference>& references, const kernel::StereoTrustRule& rule, const Stream& stream, StageTimes& times);

    /// Device memory, of one view.
    const kernel::StereoBest* planes(size_t view) const;
    const float* agreed(size_t view) const;
    /// Pixels that see the hull, and those that have a likelihood, of all views (two numbers each); waits for the device.
    std::vector<uint32_t> counts(const Stream& stream) const;

    size_t bytes() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace vdbcarve::cuda
