// SPDX-License-Identifier: Apache-2.0
// Re-distancing on the device: src/level_set.cpp's passes, bit for bit.
#pragma once

#include "grid_cuda.h"

namespace vdbcarve::cuda {

class LevelSetStage {
  public:
    /// Makes the level set of a hull. The surface's topology is that of the hull, without leaves that hold nothing of the band.
    /// False when the hull has no zero crossing. Waits for the device.
    bool run(const Grid& hull, const Topology& hull_topology, int half_width_vox, const Stream& stream, StageTimes& times);

    Topology& topology() { return topology_; }
    LeafSource leaves(const Grid& hull) const { return {values_, active_.data(), hull.keys(), hull.leaf_count()}; }
    size_t bytes() const { return topology_.bytes() + first_.bytes() + second_.bytes() + active_.bytes() + neighbours_.bytes() + changed_.bytes() + changes_.bytes(); }

  private:
    Topology topology_;
    DeviceBuffer<float> first_, second_;
    const float* values_ = nullptr;  ///< the one that holds the result
    DeviceBuffer<uint64_t> active_;
    DeviceBuffer<int32_t> neighbours_;
    DeviceBuffer<uint8_t> changed_, changes_;
    DeviceBuffer<unsigned> crosses_;
    PinnedBuffer<unsigned> host_crosses_;
};

}  // namespace vdbcarve::cuda
