// SPDX-License-Identifier: Apache-2.0
// The pieces of the inside, connected by faces of voxels: found leaf by leaf, then joined across the leaves' faces (src/fair/fair_level.cpp).
#include "fair_leaves.cuh"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kThreads = 256;
/// Pieces that a leaf can have: every second voxel.
constexpr int kMostPieces = kLeafVoxels / 2;

/// A piece's number within its leaf, from 1, by voxel; 0: outside. Labels of tiles follow those of all leaves, by place.
struct Labels {
    const uint16_t* of;
    const int32_t* first;
    int32_t tiles;

    __device__ int32_t at(const FairField& f, int64_t place, int q) const {
        const int32_t n = f.leaf_at[place];
        if (n == kInsideTile) return tiles + static_cast<int32_t>(place);
        const int piece = n < 0 ? 0 : of[static_cast<int64_t>(n) * kLeafVoxels + q];
        return piece ? first[n] + piece - 1 : -1;
    }
};

/// A block of threads a leaf: each voxel takes the least number around until none changes.
__global__ void __launch_bounds__(kLeafVoxels) label_leaves(const float* values, uint16_t* of, int32_t* counts) {
    __shared__ int label[kLeafVoxels], number[kLeafVoxels], count;
    const int t = threadIdx.x;
    const int64_t at = static_cast<int64_t>(blockIdx.x) * kLeafVoxels + t;
    const bool inside = values[at] < 0.f;
    label[t] = inside ? t : kLeafVoxels;
    if (t == 0) count = 0;
    bool changes = true;
    while (__syncthreads_or(changes)) {
        int least = label[t];
        if (inside) {
            for (int shift = 0; shift <= 6; shift += 3) {
                if (t >> shift & 7) least = min(least, label[t - (1 << shift)]);
                if ((t >> shift & 7) < 7) least = min(least, label[t + (1 << shift)]);
            }
            least = label[least];
        }
        changes = inside && least < label[t];
        __syncthreads();
        if (changes) label[t] = least;
    }
    if (inside && label[t] == t) number[t] = atomicAdd(&count, 1);
    __syncthreads();
    of[at] = static_cast<uint16_t>(inside ? number[label[t]] + 1 : 0);
    if (t == 0) counts[blockIdx.x] = count;
}

__global__ void begin_pieces(int32_t* parent, unsigned long long* sizes, int64_t count) {
    const int64_t n = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n >= count) return;
    parent[n] = static_cast<int32_t>(n);
    sizes[n] = 0;
}

/// While others join, a label's parent is a smaller one of the same piece, or itself.
__device__ int32_t root_of(const volatile int32_t* parent, int32_t n) {
    for (int32_t next = parent[n]; next != n; next = parent[n]) n = next;
    return n;
}

__device__ void join(int32_t* parent, int32_t a, int32_t b) {
    for (;;) {
        a = root_of(parent, a);
        b = root_of(parent, b);
        if (a == b) return;
        const int32_t high = a > b ? a : b, low = a > b ? b : a;
        if (atomicCAS(parent + high, high, low) == high) return;
    }
}

/// A block of threads a place, a thread an axis and a voxel of the face towards the place before.
__global__ void __launch_bounds__(192) join_places(FairField f, Labels labels, int32_t* parent) {
    const int64_t place = blockIdx.x;
    if (is_outside(f.leaf_at[place])) return;
    const int axis = static_cast<int>(threadIdx.x) / 64, a = static_cast<int>(threadIdx.x) / 8 % 8, b = static_cast<int>(threadIdx.x) % 8;
    const int3 l = leaf_at_place(f, place);
    if ((axis == 0 ? l.x : axis == 1 ? l.y : l.z) == f.lo[axis]) return;
    const int64_t beside = place - (axis == 0 ? static_cast<int64_t>(f.size[1]) * f.size[2] : axis == 1 ? f.size[2] : 1);
    if (is_outside(f.leaf_at[beside])) return;
    const int across = axis == 0 ? 6 : axis == 1 ? 3 : 0, u = axis == 0 ? 3 : 6, v = axis == 2 ? 3 : 0;
    const int q = a << u | b << v;
    const int32_t mine = labels.at(f, place, q), theirs = labels.at(f, beside, q | 7 << across);
    if (mine >= 0 && theirs >= 0) join(parent, mine, theirs);
}

/// A block of threads a leaf.
__global__ void __launch_bounds__(kLeafVoxels) add_leaves(Labels labels, const int32_t* parent, unsigned long long* sizes) {
    __shared__ unsigned counts[kMostPieces];
    const int t = threadIdx.x;
    if (t < kMostPieces) counts[t] = 0;
    __syncthreads();
    const int piece = labels.of[static_cast<int64_t>(blockIdx.x) * kLeafVoxels + t];
    if (piece) atomicAdd(&counts[piece - 1], 1u);
    __syncthreads();
    if (t < kMostPieces && counts[t]) atomicAdd(sizes + root_of(parent, labels.first[blockIdx.x] + t), static_cast<unsigned long long>(counts[t]));
}

__global__ void add_tiles(FairField f, int64_t places, Labels labels, const int32_t* parent, unsigned long long* sizes) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p < places && f.leaf_at[p] == kInsideTile) atomicAdd(sizes + root_of(parent, labels.tiles + static_cast<int32_t>(p)), 512ull);
}

__global__ void find_largest(const unsigned long long* sizes, int64_t count, unsigned long long* largest) {
    const int64_t n = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n < count && sizes[n]) atomicMax(largest, sizes[n]);
}

__device__ bool goes(unsigned long long size, const unsigned long long* largest, double share) {
    return size > 0 && static_cast<double>(size) < share * static_cast<double>(*largest);
}

/// Only roots have a size.
__global__ void count_dropped(const unsigned long long* sizes, int64_t count, const unsigned long long* largest, double share, unsigned long long* dropped) {
    const int64_t n = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n < count && goes(sizes[n], largest, share)) atomicAdd(dropped, 1ull);
}

__global__ void __launch_bounds__(kLeafVoxels)
    drop(Labels labels, const int32_t* parent, const unsigned long long* sizes, const unsigned long long* largest, double share, float* values) {
    const int64_t at = static_cast<int64_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    if (labels.of[at] && goes(sizes[root_of(parent, labels.first[blockIdx.x] + labels.of[at] - 1)], largest, share)) values[at] = 1.f;
}

__global__ void drop_tiles(int32_t* leaf_at, int64_t places, Labels labels, const int32_t* parent, const unsigned long long* sizes,
                           const unsigned long long* largest, double share) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p < places && leaf_at[p] == kInsideTile && goes(sizes[root_of(parent, labels.tiles + static_cast<int32_t>(p))], largest, share))
        leaf_at[p] = kOutsideTile;
}

}  // namespace

size_t FairStage::drop_pieces(double share, const Stream& stream, StageTimes& times) {
    const cudaStream_t s = stream.get();
    const FairField f = level_.view(level_.field);
    const auto places = static_cast<int64_t>(level_.places());
    auto* of = reinterpret_cast<uint16_t*>(scratch_.ensure(level_.voxels()));
    int32_t *counts = counts_.ensure(level_.leaves + size_t{1}), *first = first_.ensure(level_.leaves + size_t{1});
    unsigned long long *largest = sums_.ensure(2), *dropped = largest + 1, *home = host_sums_.ensure(2);
    times.measure("fair: pieces", stream, [&] {
        stream.zero(largest, 2);
        stream.zero(counts + level_.leaves, 1);
        label_leaves<<<level_.leaves, kLeafVoxels, 0, s>>>(f.values, of, counts);
        VDBCARVE_LAUNCHED();
        const auto tiles = static_cast<int32_t>(sum_before(counts, first, level_.leaves, stream));
        const Labels labels{of, first, tiles};
        const int64_t all = tiles + places;
        int32_t* parent = parent_.ensure(static_cast<size_t>(all));
        unsigned long long* sizes = sizes_.ensure(static_cast<size_t>(all));
        const unsigned blocks = blocks_for(static_cast<size_t>(all), kThreads);
        begin_pieces<<<blocks, kThreads, 0, s>>>(parent, sizes, all);
        VDBCARVE_LAUNCHED();
        join_places<<<static_cast<unsigned>(places), 192, 0, s>>>(f, labels, parent);
        VDBCARVE_LAUNCHED();
        add_leaves<<<level_.leaves, kLeafVoxels, 0, s>>>(labels, parent, sizes);
        VDBCARVE_LAUNCHED();
        add_tiles<<<blocks_for(level_.places(), kThreads), kThreads, 0, s>>>(f, places, labels, parent, sizes);
        VDBCARVE_LAUNCHED();
        find_largest<<<blocks, kThreads, 0, s>>>(sizes, all, largest);
        VDBCARVE_LAUNCHED();
        count_dropped<<<blocks, kThreads, 0, s>>>(sizes, all, largest, share, dropped);
        VDBCARVE_LAUNCHED();
        drop<<<level_.leaves, kLeafVoxels, 0, s>>>(labels, parent, sizes, largest, share, level_.field.of.data());
        VDBCARVE_LAUNCHED();
        drop_tiles<<<blocks_for(level_.places(), kThreads), kThreads, 0, s>>>(level_.leaf_at.data(), places, labels, parent, sizes, largest, share);
        VDBCARVE_LAUNCHED();
        stream.to_host(home, largest, 2);
    });
    stream.wait();
    return static_cast<size_t>(home[1]);
}

}  // namespace vdbcarve::cuda
