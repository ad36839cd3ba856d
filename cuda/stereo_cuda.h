// SPDX-License-Identifier: Apache-2.0
// Depths on the device: kernel/stereo.h, a thread a pixel.
#pragma once

#include <array>
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

    /// What lines of sight need of the grid, which has to stay where it is.
    void set_hull(const Grid& grid, const kernel::ColorBase& base, const kernel::SightBox& box, const Stream& stream, StageTimes& times);

    /// The pixels of a size of photographs to the device, coarsest first, where what is found of it stays. `after_coarser`: level + 1 is there, of half this
    /// size, and is begun with.
    void begin(size_t level, const std::vector<StereoPixels>& views, bool after_coarser, const Stream& stream, StageTimes& times);

    struct Work {
        kernel::StereoReference reference;  ///< without pointers
        kernel::HullView hull;
    };
    /// Best planes of views and their likelihoods, which stay on the device. Several views at a time, for one of a coarse level does not fill the device.
    void match(const std::vector<Work>& views, int first_pass, int last_pass, const kernel::StereoTrustRule& rule, const Stream& stream, StageTimes& times);

    /// Likelihoods of what other views of those matched find, too; 0 elsewhere.
    void agree(const std::vector<Work>& views, const kernel::StereoTrustRule& rule, const Stream& stream, StageTimes& times);

    /// Of the depths that each of the levels is trusted with, those where no finer one has any: a photograph is heard once.
    void leave_to_finer(size_t levels, const Stream& stream, StageTimes& times);

    /// Pixels that see the hull, and those that have a likelihood, of all views of the level begun last (two numbers each); waits for the device.
    std::vector<uint32_t> counts(const Stream& stream) const;

    /// Blocks of 8^3 that the depths say something of, in no order.
    struct Fused {
        uint32_t count;
        const uint32_t* block;             ///< device memory, as what follows
        const float *values, *confidence;  ///< 512 of each
    };
    /// A view of a level, for the fusion; `fusion` comes without pointers.
    struct FusedView {
        size_t level, view;
        kernel::FusionView fusion;
    };
    /// Asks all views about every voxel of the blocks, whose first voxels are given. Waits for the device.
    Fused fuse(const kernel::FusionRule& rule, const std::vector<FusedView>& views, const std::vector<std::array<int, 3>>& blocks, const Stream& stream,
               StageTimes& times);

    /// Trusted depths of a view of the finest level, 0 elsewhere, and confidences: device memory, until the next call.
    const float* depths(size_t view, const Stream& stream, StageTimes& times);
    const float* confidence(size_t view) const;

    /// Gives the memory of all views back.
    void release();

    size_t bytes() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace vdbcarve::cuda
