// SPDX-License-Identifier: Apache-2.0
// How the field of a level moves, and what it has become.
#include <cmath>
#include <utility>

#include "fair_leaves.cuh"
#include "vdbcarve/kernel/level_set.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr int kBlurThreads = 256;

__device__ int64_t voxels_of(uint32_t leaf) { return static_cast<int64_t>(leaf) * kLeafVoxels; }

/// A block of threads a leaf, axis after axis (base/vector_loops.cpp's blur_leaf). `back`: kernel::put_back() of what is blurred.
__global__ void __launch_bounds__(kBlurThreads) blur(FairField f, const int32_t* place_of, FairBlur b, const float* from, bool back, float* to) {
    constexpr int kSide = 8 + 2 * kFairReach;
    __shared__ float halo[kSide * kSide * kSide], x[8 * kSide * kSide];
    load_halo<kFairReach>(f, first_voxel(f, place_of[blockIdx.x]), from, halo);
    for (int n = threadIdx.x; n < 8 * kSide * kSide; n += kBlurThreads) {
        const float* at = halo + kFairReach * kSide * kSide + n;
        x[n] = blurred(b.weight, [at](int d) { return at[d * kSide * kSide]; });
    }
    __syncthreads();
    float* y = halo;
    for (int n = threadIdx.x; n < 8 * 8 * kSide; n += kBlurThreads) {
        const float* at = x + n / (8 * kSide) * (kSide * kSide) + kFairReach * kSide + n % (8 * kSide);
        y[n] = blurred(b.weight, [at](int d) { return at[d * kSide]; });
    }
    __syncthreads();
    for (int n = threadIdx.x; n < kLeafVoxels; n += kBlurThreads) {
        const float* at = y + n / 8 * kSide + kFairReach + n % 8;
        const float v = blurred(b.weight, [at](int d) { return at[d]; });
        const int64_t place = voxels_of(blockIdx.x) + n;
        to[place] = back ? put_back(from[place], v) : v;
    }
}

constexpr int kSide = 10;
__device__ int halo_at(int t) { return ((t >> 6) + 1) * kSide * kSide + ((t >> 3 & 7) + 1) * kSide + (t & 7) + 1; }

__global__ void __launch_bounds__(kLeafVoxels) straighten(FairField f, const int32_t* place_of, const float* from, const float* hull, float* to) {
    __shared__ float halo[kSide * kSide * kSide];
    load_halo<1>(f, first_voxel(f, place_of[blockIdx.x]), from, halo);
    const float* here = halo + halo_at(threadIdx.x);
    const int64_t at = voxels_of(blockIdx.x) + threadIdx.x;
    to[at] = straightened([here](int i, int j, int k) { return here[i * kSide * kSide + j * kSide + k]; }, hull[at]);
}

/// Magnitudes; those beside the surface are fixed, which their sign says.
__global__ void __launch_bounds__(kLeafVoxels) measure(FairField f, const int32_t* place_of, const float* from, float* to) {
    __shared__ float halo[kSide * kSide * kSide];
    load_halo<1>(f, first_voxel(f, place_of[blockIdx.x]), from, halo);
    const float *h = halo + halo_at(threadIdx.x), here = *h;
    const float x = opposite(here, h[-kSide * kSide], h[kSide * kSide]), y = opposite(here, h[-kSide], h[kSide]), z = opposite(here, h[-1], h[1]);
    const float d = plane_distance(here, slope(here, h[-kSide * kSide], h[kSide * kSide], x), slope(here, h[-kSide], h[kSide], y), slope(here, h[-1], h[1], z));
    to[voxels_of(blockIdx.x) + threadIdx.x] = max_f(max_f(x, y), z) < 0.f ? kFairBand_vox : -min_f(d, kFairBand_vox);
}

__global__ void __launch_bounds__(kLeafVoxels) redistance(FairField f, const int32_t* place_of, const float* from, float* to) {
    __shared__ float halo[kSide * kSide * kSide];
    load_halo<1>(f, first_voxel(f, place_of[blockIdx.x]), from, halo);
    const float *h = halo + halo_at(threadIdx.x), here = *h;
    float d = here;
    if (here >= 0.f) {
        const float x = min_f(fabsf(h[-kSide * kSide]), fabsf(h[kSide * kSide])), y = min_f(fabsf(h[-kSide]), fabsf(h[kSide]));
        d = min_f(min_f(eikonal(x, y, min_f(fabsf(h[-1]), fabsf(h[1]))), kFairBand_vox), here);
    }
    to[voxels_of(blockIdx.x) + threadIdx.x] = d;
}

/// Signs again.
__global__ void __launch_bounds__(kLeafVoxels) sign(const float* distances, const float* hull, float* values) {
    const int64_t at = voxels_of(blockIdx.x) + threadIdx.x;
    const float d = fabsf(distances[at]), v = values[at] < 0.f ? -d : d;
    values[at] = hull ? max_f(v, hull[at]) : v;
}

__global__ void __launch_bounds__(kLeastThreads) find_leasts(FairField f, const int32_t* place_of, float* least) {
    find_least_of(f, first_voxel(f, place_of[blockIdx.x]), least + blockIdx.x);
}

/// A block of threads a leaf.
__global__ void __launch_bounds__(kLeafVoxels) add_volumes(const float* values, unsigned long long* sum) {
    __shared__ unsigned all;  // a leaf's is 2^34 at most, so in two halves
    __shared__ unsigned low;
    if (threadIdx.x == 0) all = low = 0;
    __syncthreads();
    const auto units = static_cast<unsigned>(fair_volume_units(values[voxels_of(blockIdx.x) + threadIdx.x]));
    atomicAdd(&all, units >> 16);
    atomicAdd(&low, units & 0xffff);
    __syncthreads();
    if (threadIdx.x == 0) atomicAdd(sum, (static_cast<unsigned long long>(all) << 16) + low);
}

__global__ void count_inside(const int32_t* leaf_at, int64_t places, unsigned long long* sum) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    const int count = __syncthreads_count(p < places && leaf_at[p] == kInsideTile);
    if (threadIdx.x == 0 && count) atomicAdd(sum, static_cast<unsigned long long>(count));
}

__global__ void __launch_bounds__(kLeafVoxels) ease_leaves(const float* hull, float far, float* field) {
    const size_t at = voxels_of(blockIdx.x) + threadIdx.x;
    field[at] = eased(field[at], hull[at], far);
}

/// Leaves that hold some of the band, and those that lie inside; counts[0] and [1].
__global__ void __launch_bounds__(kLeafVoxels) finish(const float* values, const int32_t* place_of, float voxel, float* to, uint32_t* active, int32_t* places,
                                                      int32_t* inside, unsigned long long* counts) {
    __shared__ unsigned slot;
    const int t = threadIdx.x;
    const float from = values[voxels_of(blockIdx.x) + t];
    const bool below = __syncthreads_or(from < kFairBand_vox), above = __syncthreads_or(from > -kFairBand_vox);
    if (!below) return;
    if (t == 0) {
        if (above) places[slot = static_cast<unsigned>(atomicAdd(counts, 1ull))] = place_of[blockIdx.x];
        else inside[atomicAdd(counts + 1, 1ull)] = place_of[blockIdx.x];
    }
    if (!above) return;
    __syncthreads();
    const float v = off_zero(from), band = kFairBand_vox * voxel;
    const bool on = fabsf(v) < kFairBand_vox;
    to[voxels_of(slot) + t] = on ? v * voxel : v < 0.f ? -band : band;
    const unsigned word = __ballot_sync(~0u, on);
    if (t % 32 == 0) active[static_cast<size_t>(slot) * 16 + t / 32] = word;
}

__global__ void list_inside(const int32_t* leaf_at, int64_t places, int32_t* inside, unsigned long long* count) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p < places && leaf_at[p] == kInsideTile) inside[atomicAdd(count, 1ull)] = static_cast<int32_t>(p);
}

}  // namespace

void FairStage::move(const FairBlur& b, bool stiff, const Stream& stream, StageTimes& times) {
    const cudaStream_t s = stream.get();
    const FairField f = level_.view(level_.field);
    const int32_t* place_of = level_.place_of.data();
    float *once = scratch_.ensure(level_.voxels()), *twice = stiff ? more_scratch_.ensure(level_.voxels()) : nullptr;
    times.measure("fair: move", stream, [&] {
        blur<<<level_.leaves, kBlurThreads, 0, s>>>(f, place_of, b, level_.field.of.data(), false, once);
        VDBCARVE_LAUNCHED();
        if (stiff) {
            blur<<<level_.leaves, kBlurThreads, 0, s>>>(f, place_of, b, once, true, twice);
            VDBCARVE_LAUNCHED();
        }
        straighten<<<level_.leaves, kLeafVoxels, 0, s>>>(f, place_of, stiff ? twice : once, level_.hull.of.data(), level_.field.of.data());
        VDBCARVE_LAUNCHED();
    });
}

void FairStage::ease(float far_vox, const Stream& stream, StageTimes& times) {
    times.measure("fair: move", stream, [&] {
        ease_leaves<<<level_.leaves, kLeafVoxels, 0, stream.get()>>>(level_.hull.of.data(), far_vox, level_.field.of.data());
        VDBCARVE_LAUNCHED();
    });
}

void FairStage::make_distances(const FairLevel& level, float* values, const float* hull, const Stream& stream) {
    const cudaStream_t s = stream.get();
    const FairField f = level.view(level.hull);  // for its lattice
    const int32_t* place_of = level.place_of.data();
    float *now = scratch_.ensure(level.voxels()), *next = more_scratch_.ensure(level.voxels());
    measure<<<level.leaves, kLeafVoxels, 0, s>>>(f, place_of, values, now);
    VDBCARVE_LAUNCHED();
    for (int n = level_set_passes(static_cast<int>(kFairBand_vox)); n > 0; --n) {
        redistance<<<level.leaves, kLeafVoxels, 0, s>>>(f, place_of, now, next);
        VDBCARVE_LAUNCHED();
        std::swap(now, next);
    }
    sign<<<level.leaves, kLeafVoxels, 0, s>>>(now, hull, values);
    VDBCARVE_LAUNCHED();
}

void FairStage::make_distances(const Stream& stream, StageTimes& times) {
    times.measure("fair: distances", stream, [&] { make_distances(level_, level_.field.of.data(), level_.hull.of.data(), stream); });
}

void FairStage::find_least(const FairLevel& level, FairLevel::Values& values, const Stream& stream) {
    values.least.ensure(level.leaves);
    find_leasts<<<level.leaves, kLeastThreads, 0, stream.get()>>>(level.view(values), level.place_of.data(), values.least.data());
    VDBCARVE_LAUNCHED();
}

void FairStage::find_least(const Stream& stream) { find_least(level_, level_.field, stream); }

double FairStage::volume_vox(const FairLevel& level, const FairLevel::Values& values, const Stream& stream) {
    constexpr unsigned kThreads = 256;
    unsigned long long* sums = sums_.ensure(2);
    stream.zero(sums, 2);
    add_volumes<<<level.leaves, kLeafVoxels, 0, stream.get()>>>(values.of.data(), sums);
    VDBCARVE_LAUNCHED();
    count_inside<<<blocks_for(level.places(), kThreads), kThreads, 0, stream.get()>>>(level.leaf_at.data(), static_cast<int64_t>(level.places()), sums + 1);
    VDBCARVE_LAUNCHED();
    const unsigned long long* home = host_sums_.ensure(2);
    stream.to_host(host_sums_.data(), sums, 2);
    stream.wait();
    return static_cast<double>(home[0]) / kFairVolumeUnits + static_cast<double>(kLeafVoxels) * static_cast<double>(home[1]);
}

FairStage::Surface FairStage::surface(float voxel, const Stream& stream, StageTimes& times) {
    constexpr unsigned kThreads = 256;
    const cudaStream_t s = stream.get();
    unsigned long long* counts = sums_.ensure(2);
    float* values = scratch_.ensure(level_.voxels());
    uint64_t* active = active_.ensure(8 * static_cast<size_t>(level_.leaves));
    int32_t *places = first_.ensure(level_.leaves), *inside = list_.ensure(level_.places());
    times.measure("fair: surface", stream, [&] {
        stream.zero(counts, 2);
        finish<<<level_.leaves, kLeafVoxels, 0, s>>>(level_.field.of.data(), level_.place_of.data(), voxel, values, reinterpret_cast<uint32_t*>(active), places,
                                                     inside, counts);
        VDBCARVE_LAUNCHED();
        list_inside<<<blocks_for(level_.places(), kThreads), kThreads, 0, s>>>(level_.leaf_at.data(), static_cast<int64_t>(level_.places()), inside,
                                                                               counts + 1);
        VDBCARVE_LAUNCHED();
        stream.to_host(host_sums_.ensure(2), counts, 2);
    });
    stream.wait();
    return {values, active, places, inside, static_cast<uint32_t>(host_sums_[0]), static_cast<uint32_t>(host_sums_[1])};
}

}  // namespace vdbcarve::cuda
