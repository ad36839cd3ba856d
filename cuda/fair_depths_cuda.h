// SPDX-License-Identifier: Apache-2.0
// What depths say of the fair surface, on every level of the pyramid: src/fair/evidence.cpp's passes, bit for bit.
#pragma once

#include <vector>

#include "fair_cuda.h"

namespace vdbcarve::cuda {

class FairDepthStage {
  public:
    /// The level set that depths carved. False when it has no surface. Waits for the device.
    bool take(const Grid& carved, const Topology& topology, float voxel, const Stream& stream, StageTimes& times) {
        levels_ = 1;
        if (weights_.empty()) weights_.emplace_back();
        return carved_.take(carved, topology, voxel, stream, times);
    }
    const FairLevel& finest() const { return carved_.hull(0); }
    /// How sure the depths are, 0..1: of the voxels of finest()'s leaves. Waits for the device.
    void set_weights(const float* weights, const Stream& stream);
    void coarsen(const Stream& stream, StageTimes& times);

    /// The field takes the larger of its values and of what the depths carved. `shift`: which of the levels is at hand, 0 the finest.
    void begin(size_t shift, FairLevel& level, const Stream& stream, StageTimes& times) const;
    /// FairEngine::follow() (src/fair/fair_engine.h).
    void follow(size_t shift, FairLevel& level, float share, const Stream& stream, StageTimes& times) const;

    size_t bytes() const;

  private:
    kernel::FairDepths view(size_t shift) const {
        const FairLevel& level = carved_.hull(shift);
        return {level.view(level.hull), weights_[shift].data()};
    }

    FairStage carved_;                          ///< as hulls
    std::vector<DeviceBuffer<float>> weights_;  ///< those made before are kept for their memory
    size_t levels_ = 0;
};

}  // namespace vdbcarve::cuda
