// SPDX-License-Identifier: Apache-2.0
#include "fair_depths_cuda.h"
#include "fair_leaves.cuh"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

/// A block of threads a leaf of the coarser level.
__global__ void __launch_bounds__(kLeafVoxels) coarsen_weights(FairDepths fine, FairField coarse, const int32_t* place_of, float* to) {
    const int3 o = first_voxel(coarse, place_of[blockIdx.x]);
    const int q = threadIdx.x;
    to[static_cast<size_t>(blockIdx.x) * kLeafVoxels + q] = coarser_weight(fine, o.x + (q >> 6), o.y + (q >> 3 & 7), o.z + (q & 7));
}

/// What depths say of a voxel of a level's leaf.
struct Said {
    float target, weight;
};
__device__ Said said_of(const FairDepths& d, int3 first, int q) {
    const int32_t leaf = d.carved.leaf(first.x, first.y, first.z);
    if (leaf < 0) return {FairField::tile(leaf), 0.f};
    const size_t at = static_cast<size_t>(leaf) * kLeafVoxels + q;
    return {d.carved.values[at], d.weight[at]};
}

__global__ void __launch_bounds__(kLeafVoxels) begin_led(FairDepths d, FairField f, const int32_t* place_of, float* field) {
    const size_t at = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    field[at] = max_f(field[at], said_of(d, first_voxel(f, place_of[blockIdx.x]), threadIdx.x).target);
}

__global__ void __launch_bounds__(kLeafVoxels) follow_depths(FairDepths d, FairField f, const int32_t* place_of, const float* hull, float share, float* field) {
    const size_t at = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    const Said said = said_of(d, first_voxel(f, place_of[blockIdx.x]), threadIdx.x);
    field[at] = led_value(field[at], said.target, share * said.weight, hull[at]);
}

}  // namespace

void FairDepthStage::set_weights(const float* weights, const Stream& stream) {
    const size_t count = finest().voxels();
    stream.to_device(weights_.front().ensure(count), weights, count);
    stream.wait();
}

void FairDepthStage::coarsen(const Stream& stream, StageTimes& times) {
    if (weights_.size() == levels_) weights_.emplace_back();
    carved_.coarsen(false, stream, times);
    const kernel::FairDepths fine = view(levels_ - 1);
    DeviceBuffer<float>& weights = weights_[levels_++];
    const FairLevel& level = carved_.coarsest_hull();
    times.measure("fair: levels", stream, [&] {
        coarsen_weights<<<level.leaves, kLeafVoxels, 0, stream.get()>>>(fine, level.view(level.hull), level.place_of.data(), weights.ensure(level.voxels()));
        VDBCARVE_LAUNCHED();
    });
}

void FairDepthStage::begin(size_t shift, FairLevel& level, const Stream& stream, StageTimes& times) const {
    times.measure("fair: depths", stream, [&] {
        begin_led<<<level.leaves, kLeafVoxels, 0, stream.get()>>>(view(shift), level.view(level.field), level.place_of.data(), level.field.of.data());
        VDBCARVE_LAUNCHED();
    });
}

void FairDepthStage::follow(size_t shift, FairLevel& level, float share, const Stream& stream, StageTimes& times) const {
    times.measure("fair: depths", stream, [&] {
        follow_depths<<<level.leaves, kLeafVoxels, 0, stream.get()>>>(view(shift), level.view(level.field), level.place_of.data(), level.hull.of.data(), share,
                                                                      level.field.of.data());
        VDBCARVE_LAUNCHED();
    });
}

size_t FairDepthStage::bytes() const {
    size_t sum = carved_.bytes();
    for (const DeviceBuffer<float>& w : weights_) sum += w.bytes();
    return sum;
}

}  // namespace vdbcarve::cuda
