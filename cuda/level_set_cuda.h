// SPDX-License-Identifier: Apache-2.0
// Re-distancing on the device: src/surface/level_set.cpp's passes, bit for bit.
#pragma once

#include "grid_cuda.h"

namespace vdbcarve::cuda {

class LevelSetStage {
  public:
    /// Solves for the distances, as far as the half-width. False when the hull has no zero crossing. Waits for the device.
    bool solve(const Grid& hull, const Topology& hull_topology, int half_width_vox, const Stream& stream, StageTimes& times);
    struct Volume {
        int64_t units, crossed;  ///< kernel::kVolumeUnits of a voxel; voxels that the surface passes
    };
    /// The volume enclosed with the surface moved outwards so far. Waits for the device.
    Volume volume(const Grid& hull, const Topology& hull_topology, float offset_vox, const Stream& stream, StageTimes& times);
    /// The volume of a level set. Waits for the device.
    int64_t volume_of(const Grid& surface, const Topology& topology, const Stream& stream, StageTimes& times);
    /// Makes the level set of what was solved. The surface's topology is that of the hull, without leaves that hold nothing of the band.
    void finish(const Grid& hull, const Topology& hull_topology, int half_width_vox, float offset_vox, const Stream& stream, StageTimes& times);

    Topology& topology() { return topology_; }
    LeafSource leaves(const Grid& hull) const { return {values_, active_.data(), hull.keys(), hull.leaf_count()}; }
    size_t bytes() const {
        return topology_.bytes() + first_.bytes() + second_.bytes() + active_.bytes() + neighbours_.bytes() + changed_.bytes() + changes_.bytes();
    }

  private:
    /// Voxels inside tiles added to sums_, which come home. Waits for the device.
    Volume finish_sums(const Topology& topology, const Stream& stream);

    Topology topology_;
    DeviceBuffer<float> first_, second_;
    float* values_ = nullptr;  ///< the one that holds the result
    DeviceBuffer<unsigned long long> sums_;
    PinnedBuffer<unsigned long long> host_sums_;
    DeviceBuffer<uint64_t> active_;
    DeviceBuffer<int32_t> neighbours_;
    DeviceBuffer<uint8_t> changed_, changes_;
    DeviceBuffer<unsigned> crosses_;
    PinnedBuffer<unsigned> host_crosses_;
};

}  // namespace vdbcarve::cuda
