// SPDX-License-Identifier: Apache-2.0
#include "level_set_cuda.h"

#include <cmath>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/kernel/level_set.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

// A thread has four voxels in a row, k = 4 h .. 4 h + 3. In shared memory a row takes 12 floats: the voxel before it at 3, its own
// eight from 4 on, aligned for vectors, and the one after it at 12, which the next row does not use.
constexpr int kRow = 12, kSlice = 10 * kRow, kThreads = kLeafVoxels / 4;
__device__ int halo_at(int i, int j, int k) { return (i + 1) * kSlice + (j + 1) * kRow + k + 4; }
constexpr int kHalo = 10 * kSlice + 4;

/// Fills a leaf's halo and returns the thread's own voxels. `values_of(leaf)` points to 512 values; `beyond(own)` says what stands in for
/// a missing neighbour's voxel that would touch the leaf's own value.
template <class ValuesOf, class Beyond>
__device__ float4 fill_halo(float* halo, const int32_t* neighbours, int64_t leaf, const ValuesOf& values_of, const Beyond& beyond) {
    const int t = threadIdx.x, i = t >> 4, j = t >> 1 & 7, h = t & 1;
    const float* own = values_of(leaf);
    const float4 mine = reinterpret_cast<const float4*>(own)[t];
    *reinterpret_cast<float4*>(halo + halo_at(i, j, 4 * h)) = mine;
    const int32_t* around = neighbours + 6 * leaf;
    // Faces across x and y lie in rows, 16 vectors each.
    if (t < 64) {
        const int face = t >> 4, a = t >> 1 & 7, upper = face & 1;
        const int32_t n = around[face];
        const int far = upper ? 0 : 7, near = 7 - far, at = upper ? 8 : -1;
        const bool x = face < 2;
        const int source = x ? far << 6 | a << 3 : a << 6 | far << 3, own_at = x ? near << 6 | a << 3 : a << 6 | near << 3;
        const float4 v = *reinterpret_cast<const float4*>((n >= 0 ? values_of(n) + source : own + own_at) + 4 * h);
        *reinterpret_cast<float4*>(halo + (x ? halo_at(at, a, 4 * h) : halo_at(a, at, 4 * h))) =
            n >= 0 ? v : make_float4(beyond(v.x), beyond(v.y), beyond(v.z), beyond(v.w));
    }
    // Those across z one by one: the thread's half of the row decides which.
    const int32_t n = around[4 + h];
    halo[halo_at(i, j, h ? 8 : -1)] = n >= 0 ? values_of(n)[(i << 6 | j << 3) + (h ? 0 : 7)] : beyond(h ? mine.w : mine.x);
    return mine;
}

/// Calls solve(here, x before, x after, y before, …) for the thread's four voxels.
template <class Solve>
__device__ float4 for_four(const float* halo, const float4& mine, const Solve& solve) {
    const int t = threadIdx.x;
    const float* h = halo + halo_at(t >> 4, t >> 1 & 7, 4 * (t & 1));
    const float4 x0 = *reinterpret_cast<const float4*>(h - kSlice), x1 = *reinterpret_cast<const float4*>(h + kSlice);
    const float4 y0 = *reinterpret_cast<const float4*>(h - kRow), y1 = *reinterpret_cast<const float4*>(h + kRow);
    const float before = h[-1], after = h[4];
    return {solve(mine.x, x0.x, x1.x, y0.x, y1.x, before, mine.y), solve(mine.y, x0.y, x1.y, y0.y, y1.y, mine.x, mine.z),
            solve(mine.z, x0.z, x1.z, y0.z, y1.z, mine.y, mine.w), solve(mine.w, x0.w, x1.w, y0.w, y1.w, mine.z, after)};
}

/// Voxels beside the surface take their distance (negative: fixed), the others wait at the band's edge.
__global__ void __launch_bounds__(kThreads) measure(const Grid::Leaf* leaves, const int32_t* neighbours, float band_vox, float* out, unsigned* crosses) {
    __shared__ __align__(16) float halo[kHalo];
    const uint32_t leaf = blockIdx.x;
    const float4 mine = fill_halo(
        halo, neighbours, leaf, [&](int64_t n) -> const float* { return leaves[n].data()->mValues; }, [](float own) { return own; });
    __syncthreads();
    bool beside = false;
    reinterpret_cast<float4*>(out + static_cast<size_t>(leaf) * kLeafVoxels)[threadIdx.x] =
        for_four(halo, mine, [&](float here, float x0, float x1, float y0, float y1, float z0, float z1) {
            const float x = opposite(here, x0, x1), y = opposite(here, y0, y1), z = opposite(here, z0, z1);
            if (max_f(max_f(x, y), z) < 0.f) return band_vox;
            beside = true;
            return -min_f(plane_distance(here, slope(here, x0, x1, x), slope(here, y0, y1, y), slope(here, z0, z1, z)), band_vox);
        });
    if (__any_sync(~0u, beside) && threadIdx.x % 32 == 0) *crosses = 1;
}

/// One pass. A leaf that did not change, and whose neighbours did not, holds the same in both sets.
__global__ void __launch_bounds__(kThreads)
    redistance(const float* from, float* to, const int32_t* neighbours, const uint8_t* changed, uint8_t* changes, float band_vox, bool first) {
    __shared__ __align__(16) float halo[kHalo];
    const uint32_t leaf = blockIdx.x;
    bool again = first;
    if (!first) {
        again = changed[leaf] != 0;
        for (int f = 0; f < 6; ++f) {
            const int32_t n = neighbours[6 * leaf + f];
            again = again || (n >= 0 && changed[n]);
        }
    }
    if (!again) {
        if (threadIdx.x == 0) changes[leaf] = 0;
        return;
    }
    const float4 mine = fill_halo(
        halo, neighbours, leaf, [&](int64_t n) { return from + n * kLeafVoxels; }, [&](float) { return band_vox; });
    __syncthreads();
    const float4 d = for_four(halo, mine, [&](float here, float x0, float x1, float y0, float y1, float z0, float z1) {
        if (here < 0.f) return here;
        const float x = min_f(fabsf(x0), fabsf(x1)), y = min_f(fabsf(y0), fabsf(y1)), z = min_f(fabsf(z0), fabsf(z1));
        // The solution is larger than the least neighbour: nothing to gain from larger ones.
        if (min_f(min_f(x, y), z) >= here) return here;
        return min_f(min_f(eikonal(x, y, z), band_vox), here);
    });
    reinterpret_cast<float4*>(to + static_cast<size_t>(leaf) * kLeafVoxels)[threadIdx.x] = d;
    const bool any = __syncthreads_or(d.x != mine.x || d.y != mine.y || d.z != mine.z || d.w != mine.w);
    if (threadIdx.x == 0) changes[leaf] = any || first;
}

/// Signs and world units again; which leaves hold some of the band.
__global__ void __launch_bounds__(kLeafVoxels) finish_leaves(const Grid::Leaf* hull, float* distances, const uint32_t* keys, float half_width_vox,
                                                             float offset_vox, float voxel, TopologyView surface, uint64_t* active) {
    const uint32_t leaf = blockIdx.x, key = keys[leaf];
    const int t = threadIdx.x;
    const size_t at = static_cast<size_t>(leaf) * kLeafVoxels + t;
    const BandVoxel v = band_voxel(fabsf(distances[at]), hull[leaf].data()->mValues[t] < 0.f, offset_vox, half_width_vox);
    const bool inside = v.distance_vox < 0.f;
    const float band = half_width_vox * voxel;
    distances[at] = v.active ? v.distance_vox * voxel : inside ? -band : band;
    const unsigned word = __ballot_sync(~0u, v.active);
    if (t % 32 == 0) reinterpret_cast<uint32_t*>(active)[static_cast<size_t>(leaf) * 16 + t / 32] = word;
    const bool any = __syncthreads_or(word != 0);
    if (t == 0) {
        if (any) TopologyView::mark(surface.leaves, key);
        else if (inside) TopologyView::mark(surface.inside, key);
    }
}

__device__ void add_up(unsigned long long value, unsigned long long* sum) {
    for (int d = 16; d > 0; d /= 2) value += __shfl_down_sync(~0u, value, d);
    if (threadIdx.x % 32 == 0 && value) atomicAdd(sum, value);
}

__global__ void __launch_bounds__(kLeafVoxels) measure_moved(const Grid::Leaf* hull, const float* distances, float offset_vox, unsigned long long* sums) {
    const size_t at = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    const float d = fabsf(distances[at]), moved = (hull[blockIdx.x].data()->mValues[threadIdx.x] < 0.f ? -d : d) - offset_vox;
    add_up(static_cast<unsigned long long>(filled_units(moved)), sums);
    add_up(fabsf(moved) < 0.5f, sums + 1);
}

__global__ void __launch_bounds__(kLeafVoxels) measure_leaves(const Grid::Leaf* leaves, float voxel, unsigned long long* sum) {
    add_up(static_cast<unsigned long long>(filled_units(leaves[blockIdx.x].data()->mValues[threadIdx.x] / voxel)), sum);
}

/// Voxels of leaves that are inside whole.
__global__ void measure_inside(TopologyView topology, unsigned long long* sum) {
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    add_up(n < topology.blocks * kBlockWords
               ? static_cast<unsigned long long>(__popcll(topology.inside[n])) * kLeafVoxels * static_cast<unsigned long long>(kVolumeUnits)
               : 0,
           sum);
}

}  // namespace

bool LevelSetStage::solve(const Grid& hull, const Topology& hull_topology, int half_width_vox, const Stream& stream, StageTimes& times) {
    const uint32_t n = hull.leaf_count();
    if (n == 0) return false;
    const size_t voxels = static_cast<size_t>(n) * kLeafVoxels;
    float* from = first_.ensure(voxels);
    float* to = second_.ensure(voxels);
    active_.ensure(static_cast<size_t>(n) * 8);
    neighbours_.ensure(static_cast<size_t>(n) * 6);
    uint8_t* changed = changed_.ensure(n);
    uint8_t* changes = changes_.ensure(n);
    crosses_.ensure(1);
    host_crosses_.ensure(1);
    const float band_vox = static_cast<float>(half_width_vox);
    const int passes = level_set_passes(half_width_vox);
    const cudaStream_t s = stream.get();
    times.measure("level_set", stream, [&] {
        stream.zero(crosses_.data(), 1);
        find_neighbours(hull_topology, hull, neighbours_.data(), stream);
        measure<<<n, kThreads, 0, s>>>(hull.leaves(), neighbours_.data(), band_vox, from, crosses_.data());
        VDBCARVE_LAUNCHED();
        for (int pass = 0; pass < passes; ++pass) {
            redistance<<<n, kThreads, 0, s>>>(from, to, neighbours_.data(), changed, changes, band_vox, pass == 0);
            VDBCARVE_LAUNCHED();
            std::swap(from, to);
            std::swap(changed, changes);
        }
        values_ = from;
        stream.to_host(host_crosses_.data(), crosses_.data(), 1);
    });
    stream.wait();
    return host_crosses_[0] != 0;
}

LevelSetStage::Volume LevelSetStage::finish_sums(const Topology& topology, const Stream& stream) {
    const TopologyView view = topology.view();
    measure_inside<<<blocks_for(static_cast<size_t>(view.blocks) * kBlockWords, 256), 256, 0, stream.get()>>>(view, sums_.data());
    VDBCARVE_LAUNCHED();
    stream.to_host(host_sums_.ensure(2), sums_.data(), 2);
    stream.wait();
    return {static_cast<int64_t>(host_sums_[0]), static_cast<int64_t>(host_sums_[1])};
}

LevelSetStage::Volume LevelSetStage::volume(const Grid& hull, const Topology& hull_topology, float offset_vox, const Stream& stream, StageTimes& times) {
    Volume out{};
    times.measure("level_set", stream, [&] {
        stream.zero(sums_.ensure(2), 2);
        measure_moved<<<hull.leaf_count(), kLeafVoxels, 0, stream.get()>>>(hull.leaves(), values_, offset_vox, sums_.data());
        VDBCARVE_LAUNCHED();
        out = finish_sums(hull_topology, stream);
    });
    return out;
}

int64_t LevelSetStage::volume_of(const Grid& surface, const Topology& topology, const Stream& stream, StageTimes& times) {
    Volume out{};
    times.measure("filter: prepare", stream, [&] {
        stream.zero(sums_.ensure(2), 2);
        measure_leaves<<<surface.leaf_count(), kLeafVoxels, 0, stream.get()>>>(surface.leaves(), static_cast<float>(surface.spec().voxel_size), sums_.data());
        VDBCARVE_LAUNCHED();
        out = finish_sums(topology, stream);
    });
    return out.units;
}

void LevelSetStage::finish(const Grid& hull, const Topology& hull_topology, int half_width_vox, float offset_vox, const Stream& stream, StageTimes& times) {
    const cudaStream_t s = stream.get();
    topology_.cover_like(hull_topology, stream);
    times.measure("level_set", stream, [&] {
        const TopologyView old_view = hull_topology.view(), new_view = topology_.view();
        VDBCARVE_CUDA(cudaMemcpyAsync(new_view.inside, old_view.inside, static_cast<size_t>(old_view.blocks) * kBlockWords * sizeof(uint64_t),
                                      cudaMemcpyDeviceToDevice, s));
        finish_leaves<<<hull.leaf_count(), kLeafVoxels, 0, s>>>(hull.leaves(), values_, hull.keys(), static_cast<float>(half_width_vox), offset_vox,
                                                                static_cast<float>(hull.spec().voxel_size), new_view, active_.data());
        VDBCARVE_LAUNCHED();
        topology_.number_leaves(stream);
    });
}

}  // namespace vdbcarve::cuda
