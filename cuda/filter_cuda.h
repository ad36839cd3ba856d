// SPDX-License-Identifier: Apache-2.0
// Filters of a level set on the device: src/surface/filter.cpp's passes, bit for bit.
#pragma once

#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/filter.h"

namespace vdbcarve::cuda {

class FilterStage {
  public:
    /// Filters a level set, in voxels, on its leaves and those beside them where the band reaches their border. Parts thinner than keep_thin_vox keep
    /// their values (0: none does); `thin_passes` find them. The result, grid(), is no level set yet. Waits for the device once.
    void run(const Grid& surface, const Topology& topology, const std::vector<kernel::FilterPass>& passes, float keep_thin_vox,
             const std::vector<kernel::FilterPass>& thin_passes, float half_width_vox, const Stream& stream, StageTimes& times);

    const Grid& grid() const { return grid_; }
    const Topology& topology() const { return topology_; }
    size_t bytes() const {
        return topology_.bytes() + grid_.bytes() + before_.bytes() + first_.bytes() + second_.bytes() + share_.bytes() + around_.bytes() + keys_.bytes() +
               active_.bytes();
    }

  private:
    Topology topology_;
    Grid grid_;
    DeviceBuffer<float> before_, first_, second_, share_;
    DeviceBuffer<int32_t> around_;
    DeviceBuffer<uint32_t> keys_;
    DeviceBuffer<uint64_t> active_;
};

}  // namespace vdbcarve::cuda
