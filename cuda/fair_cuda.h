// SPDX-License-Identifier: Apache-2.0
// The fair surface's levels on the device: src/fair/fair_level.cpp's passes, bit for bit.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/fair.h"

namespace vdbcarve::cuda {

/// A level of the pyramid: leaves of the hull and of the field, in one numbering.
struct FairLevel {
    struct Values {
        DeviceBuffer<float> of, least;  ///< kernel::FairField
    };

    std::array<int, 3> lo{}, size{};  ///< of the lattice of leaves
    uint32_t leaves = 0;
    DeviceBuffer<int32_t> leaf_at;   ///< kernel::FairField
    DeviceBuffer<int32_t> place_of;  ///< of each leaf, in the lattice
    Values hull, field;

    size_t places() const { return static_cast<size_t>(size[0]) * static_cast<size_t>(size[1]) * static_cast<size_t>(size[2]); }
    size_t voxels() const { return static_cast<size_t>(leaves) * kLeafVoxels; }
    kernel::FairField view(const Values& values) const {
        return {leaf_at.data(), {lo[0], lo[1], lo[2]}, {size[0], size[1], size[2]}, values.of.data(), values.least.data()};
    }
    size_t bytes() const { return leaf_at.bytes() + place_of.bytes() + hull.of.bytes() + hull.least.bytes() + field.of.bytes() + field.least.bytes(); }
};

/// Hulls from fine to coarse, and the level at hand; FairEngine (src/fair/fair_engine.h) says what the functions do.
class FairStage {
  public:
    /// The finest hull. False when it has no surface. Waits for the device.
    bool take(const Grid& hull, const Topology& topology, float voxel, const Stream& stream, StageTimes& times);
    void coarsen(bool whole, const Stream& stream, StageTimes& times);
    void begin(const Stream& stream, StageTimes& times);
    void refine(const Stream& stream, StageTimes& times);

    void move(const kernel::FairBlur& blur, bool stiff, const Stream& stream, StageTimes& times);
    void ease(float far_vox, const Stream& stream, StageTimes& times);
    void make_distances(const Stream& stream, StageTimes& times);
    /// Waits for the device.
    size_t drop_pieces(double share, const Stream& stream, StageTimes& times);
    /// Values::least of all leaves of the field.
    void find_least(const Stream& stream);

    /// Of the finest hull, or of the level at hand. Waits for the device.
    double hull_volume_vox(const Stream& stream) { return volume_vox(hulls_.front(), hulls_.front().hull, stream); }
    double volume_vox(const Stream& stream) { return volume_vox(level_, level_.field, stream); }

    /// The field in world units: leaves that hold some of the band, and places of the lattice that lie inside, both in no order. Waits for the device.
    struct Surface {
        const float* values;     ///< kLeafVoxels a leaf
        const uint64_t* active;  ///< 8 words a leaf
        const int32_t* places;   ///< of the leaves
        const int32_t* inside;
        uint32_t leaves, tiles;
    };
    Surface surface(float voxel, const Stream& stream, StageTimes& times);

    const FairLevel& level() const { return level_; }
    FairLevel& level() { return level_; }
    /// Null: the level at hand is the coarsest.
    const FairLevel* coarse() const { return coarsest_ ? nullptr : &coarse_; }
    /// Number 0 is the finest.
    const FairLevel& hull(size_t number) const { return hulls_[number]; }
    const FairLevel& coarsest_hull() const { return hulls_[depth_ - 1]; }
    size_t bytes() const;

  private:
    void cover(FairLevel& level, const std::array<int, 3>& lo, const std::array<int, 3>& size, const Stream& stream);
    /// Numbers the places that are not a tile, and finds how far outside tiles are from anything. Waits for the device.
    void number_leaves(FairLevel& level, const Stream& stream);
    void find_least(const FairLevel& level, FairLevel::Values& values, const Stream& stream);
    /// `hull`: not below these; or null.
    void make_distances(const FairLevel& level, float* values, const float* hull, const Stream& stream);
    double volume_vox(const FairLevel& level, const FairLevel::Values& values, const Stream& stream);
    /// Sums of n counts before each, and of all in the end. Waits for the device and returns that.
    uint32_t sum_before(const int32_t* counts, int32_t* first, size_t n, const Stream& stream);

    std::vector<FairLevel> hulls_;  ///< those made before are kept for their memory
    size_t depth_ = 0;              ///< of these, how many are finer than the level at hand, once there is one
    bool coarsest_ = true;
    FairLevel level_, coarse_;
    DeviceBuffer<float> scratch_, more_scratch_;  ///< by voxel
    DeviceBuffer<int32_t> counts_, first_, list_;
    DeviceBuffer<int32_t> parent_;  ///< of pieces
    DeviceBuffer<uint8_t> near_, nearer_, scan_;
    DeviceBuffer<unsigned long long> sizes_, sums_;
    PinnedBuffer<unsigned long long> host_sums_;
    DeviceBuffer<int> box_;
    PinnedBuffer<int> host_box_;
    DeviceBuffer<uint64_t> active_;
};

}  // namespace vdbcarve::cuda
