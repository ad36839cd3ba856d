// SPDX-License-Identifier: Apache-2.0
// Carving on the device: nodes are asked size by size, a warp a parent, from lists that the device counts itself; then leaves, a
// block of threads each. The arithmetic is kernel/carve.h; the result is src/carve/carve.cpp's, bit for bit.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/carve.h"

namespace vdbcarve::cuda {

/// A warp keeps the views of a parent as a list, those of its children as bits, in shared memory.
inline constexpr int kMaxViews = 2048;

/// What src/carve/carve.cpp makes of CarveOptions; fields of the views lie on the device.
struct CarveJob {
    std::vector<kernel::CarveView> views;
    double origin_world[3], voxel_size;
    double band;        ///< world units, 0 for occupancy
    float near_depth;   ///< world units
    float cell_radius;  ///< world units
    int max_misses, need_seen;
    double lo[3], hi[3];          ///< bounds, world
    std::array<int, 3> min, max;  ///< voxels that may be looked at
    bool occupancy;
};

struct CarveCounts {
    uint64_t negative = 0, surface = 0, capped = 0, node_tests = 0, voxel_lookups = 0;
    uint32_t candidates = 0;  ///< leaves that were evaluated
};

/// What one carve leaves on the device, slot by slot, and the topology that says which slots are leaves of the hull.
class CarveStage {
  public:
    /// Waits for the device once, for the number of leaves to evaluate.
    void run(const CarveJob& job, const Stream& stream, StageTimes& times);

    Topology& topology() { return topology_; }
    LeafSource leaves() const { return {values_.data(), active_.data(), slot_key_.data(), candidates_}; }
    /// Waits.
    CarveCounts counts(const Stream& stream);
    size_t bytes() const;

  private:
    Topology topology_;
    PinnedBuffer<kernel::CarveView> host_views_;
    DeviceBuffer<kernel::CarveView> views_;
    PinnedBuffer<uint8_t> host_constants_;
    DeviceBuffer<uint8_t> constants_;
    std::array<DeviceBuffer<uint32_t>, 2> node_key_, node_state_, node_views_;
    DeviceBuffer<uint32_t> slot_key_, slot_state_, slot_entry_, entry_slot_;
    DeviceBuffer<float4> entries_;
    DeviceBuffer<float> values_;
    DeviceBuffer<uint64_t> active_;
    DeviceBuffer<unsigned long long> counters_;
    PinnedBuffer<unsigned long long> host_counters_;
    uint32_t candidates_ = 0, node_capacity_ = 0, slot_capacity_ = 0, entry_capacity_ = 0;
};

}  // namespace vdbcarve::cuda
