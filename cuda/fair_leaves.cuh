// SPDX-License-Identifier: Apache-2.0
// What the fair surface's kernels have in common.
#pragma once

#include "fair_cuda.h"

namespace vdbcarve::cuda {

inline constexpr int kLeastThreads = 128;

/// A place of the lattice in leaf coordinates; and the first voxel of the leaf there.
__device__ inline int3 leaf_at_place(const kernel::FairField& f, int64_t place) {
    const int z = static_cast<int>(place % f.size[2]);
    const int64_t row = place / f.size[2];
    return make_int3(static_cast<int>(row / f.size[1]) + f.lo[0], static_cast<int>(row % f.size[1]) + f.lo[1], z + f.lo[2]);
}
__device__ inline int3 first_voxel(const kernel::FairField& f, int64_t place) {
    const int3 l = leaf_at_place(f, place);
    return make_int3(8 * l.x, 8 * l.y, 8 * l.z);
}

/// Brings a leaf and kReach voxels around into shared memory, side 8 + 2 kReach. Ends with a barrier.
template <int kReach>
__device__ void load_halo(const kernel::FairField& f, int3 first, const float* values, float* halo) {
    constexpr int kSide = 8 + 2 * kReach;
    __shared__ int32_t around[27];
    const int t = threadIdx.x;
    if (t < 27) around[t] = f.leaf(first.x + 8 * (t / 9 - 1), first.y + 8 * (t / 3 % 3 - 1), first.z + 8 * (t % 3 - 1));
    __syncthreads();
    for (int n = t; n < kSide * kSide * kSide; n += blockDim.x) {
        const int i = n / (kSide * kSide) - kReach, j = n / kSide % kSide - kReach, k = n % kSide - kReach;
        const int32_t leaf = around[((i >> 3) + 1) * 9 + ((j >> 3) + 1) * 3 + (k >> 3) + 1];
        halo[n] = leaf < 0 ? kernel::FairField::tile(leaf) : values[static_cast<int64_t>(leaf) * kLeafVoxels + ((i & 7) << 6 | (j & 7) << 3 | (k & 7))];
    }
    __syncthreads();
}

/// The least that a point of a leaf's cells can have, by a block of kLeastThreads; thread 0 writes it. Cells reach one voxel beyond the leaf.
__device__ inline void find_least_of(const kernel::FairField& f, int3 first, float* out) {
    __shared__ float least[kLeastThreads];
    const int t = threadIdx.x;
    float v = kernel::kFairBand_vox;
    for (int n = t; n < 9 * 9 * 9; n += kLeastThreads) v = kernel::min_f(v, f.at(first.x + n / 81, first.y + n / 9 % 9, first.z + n % 9));
    least[t] = v;
    __syncthreads();
    for (int half = kLeastThreads / 2; half > 0; half /= 2) {
        if (t < half) least[t] = kernel::min_f(least[t], least[t + half]);
        __syncthreads();
    }
    if (t == 0) *out = least[0];
    __syncthreads();  // before the next leaf's
}

}  // namespace vdbcarve::cuda
