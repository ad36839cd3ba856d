// SPDX-License-Identifier: Apache-2.0
#include "filter_cuda.h"

#include <algorithm>

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

/// A thread a word of the old topology.
__global__ void copy_inside(TopologyView from, TopologyView to) {
    const int n = blockIdx.x * blockDim.x + threadIdx.x, block = n / kBlockWords;
    if (block >= from.blocks) return;
    const int4 o = from.origin[block];
    to.inside[static_cast<size_t>(to.block_of(o.x, o.y, o.z)) * kBlockWords + n % kBlockWords] = from.inside[n];
}

/// A warp a leaf: itself, and the leaves beside it where its outermost voxels are in the band.
__global__ void grow(const Grid::Leaf* leaves, const uint32_t* keys, uint32_t count, TopologyView from, TopologyView to) {
    const uint32_t n = (blockIdx.x * blockDim.x + threadIdx.x) / 32;
    const int lane = threadIdx.x % 32;
    if (n >= count || lane > 6) return;
    const int3 o = from.leaf_origin(keys[n]);
    int x = o.x, y = o.y, z = o.z;
    if (lane < 6) {
        const auto* words = reinterpret_cast<const uint64_t*>(&leaves[n].data()->mValueMask);
        uint64_t all = 0;
        for (int w = 0; w < 8; ++w) all |= words[w];
        constexpr uint64_t kFirst = 0x0101010101010101;
        const uint64_t layer = lane == 0   ? words[0]
                               : lane == 1 ? words[7]
                               : lane == 2 ? all & 0xff
                               : lane == 3 ? all >> 56
                               : lane == 4 ? all & kFirst
                                           : all & kFirst << 7;
        if (!layer) return;
        const int step = lane % 2 ? 8 : -8;
        (lane / 2 == 0 ? x : lane / 2 == 1 ? y : z) += step;
    }
    TopologyView::mark(to.leaves, static_cast<uint32_t>(to.block_of(x, y, z)) * kBlockLeaves + static_cast<uint32_t>(TopologyView::offset_of(x, y, z)));
}

/// A thread a word of the new topology.
__global__ void list_keys(TopologyView t, uint32_t* keys) {
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= t.blocks * kBlockWords) return;
    uint64_t word = t.leaves[n];
    while (word) {
        const int bit = __ffsll(static_cast<long long>(word)) - 1;
        word &= word - 1;
        const int block = n / kBlockWords, offset = n % kBlockWords * 64 + bit;
        keys[t.leaf_number(block, offset)] = static_cast<uint32_t>(block * kBlockLeaves + offset);
    }
}

/// A block of threads a leaf: its values in voxels, or the tile's.
__global__ void __launch_bounds__(kLeafVoxels)
    load_leaves(const Grid::Leaf* leaves, TopologyView from, TopologyView to, const uint32_t* keys, float voxel, float band, float band_vox, float* out) {
    const uint32_t n = blockIdx.x, key = keys[n];
    const int3 o = to.leaf_origin(key);
    const int block = from.block_of(o.x, o.y, o.z);
    const int64_t old = block < 0 ? -1 : from.leaf_number(block, TopologyView::offset_of(o.x, o.y, o.z));
    const bool inside = to.inside[key / 64] >> (key & 63) & 1;
    out[static_cast<size_t>(n) * kLeafVoxels + threadIdx.x] = old >= 0 ? in_voxels(leaves[old].data()->mValues[threadIdx.x], voxel, band, band_vox)
                                                              : inside ? -band_vox
                                                                       : band_vox;
}

/// Leaves hold their own signs.
__global__ void clear_inside(TopologyView t) {
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n < t.blocks * kBlockWords) t.inside[n] &= ~t.leaves[n];
}

__global__ void list_surroundings(TopologyView t, const uint32_t* keys, uint32_t count, int32_t* out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= 27 * count) return;
    const int a = static_cast<int>(n % 27);
    const int3 o = t.leaf_origin(keys[n / 27]);
    const int x = o.x + 8 * (a / 9 - 1), y = o.y + 8 * (a / 3 % 3 - 1), z = o.z + 8 * (a % 3 - 1);
    const int block = t.block_of(x, y, z);
    int32_t found = kOutsideTile;
    if (block >= 0) {
        const int offset = TopologyView::offset_of(x, y, z);
        const int64_t leaf = t.leaf_number(block, offset);
        found = leaf >= 0 ? static_cast<int32_t>(leaf) : t.is_inside(block, offset) ? kInsideTile : kOutsideTile;
    }
    out[n] = found;
}

/// Brings a leaf and what lies around it into shared memory: `halo` is (8 + 2 rx) (8 + 2 ry) (8 + 2 rz) values. Ends with a barrier.
__device__ void load_halo(const float* from, const int32_t* around, int rx, int ry, int rz, float band_vox, float* halo) {
    __shared__ int32_t leaves[27];
    const int sy = 8 + 2 * rz, sx = (8 + 2 * ry) * sy, size = (8 + 2 * rx) * sx, t = threadIdx.x;
    if (t < 27) leaves[t] = around[static_cast<size_t>(blockIdx.x) * 27 + t];
    __syncthreads();
    for (int n = t; n < size; n += kLeafVoxels) {
        const int x = n / sx - rx, y = n % sx / sy - ry, z = n % sy - rz;
        const int32_t leaf = leaves[((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3 + (z >> 3) + 1];
        halo[n] = leaf >= 0             ? from[static_cast<size_t>(leaf) * kLeafVoxels + ((x & 7) << 6 | (y & 7) << 3 | (z & 7))]
                  : leaf == kInsideTile ? -band_vox
                                        : band_vox;
    }
    __syncthreads();
}

/// A block of threads a leaf. kMedian: the median's width, 0 for the other filters.
template <int kMedian>
__global__ void __launch_bounds__(kLeafVoxels) filter(FilterPass pass, const float* from, const int32_t* around, float band_vox, float* to) {
    extern __shared__ float halo[];
    const int rx = pass_reach(pass, 0), ry = pass_reach(pass, 1), rz = pass_reach(pass, 2), sy = 8 + 2 * rz, sx = (8 + 2 * ry) * sy, t = threadIdx.x;
    load_halo(from, around, rx, ry, rz, band_vox, halo);
    const int here = ((t >> 6) + rx) * sx + ((t >> 3 & 7) + ry) * sy + (t & 7) + rz;
    const auto at = [&](int i, int j, int k) { return halo[here + i * sx + j * sy + k]; };
    const int step = pass.axis == 0 ? sx : pass.axis == 1 ? sy : 1;
    const auto line = [&](int n) { return halo[here + n * step]; };
    float out;
    if constexpr (kMedian > 0) {
        out = median_around<kMedian, float>(at);
    } else {
        switch (pass.kind) {
            case FilterPass::MeanCurvature:
                out = mean_curvature_step<float>(at);
                break;
            case FilterPass::MeanOfSix:
                out = mean_of_six<float>(at);
                break;
            case FilterPass::Box:
                out = box_along<float>(line, pass.width);
                break;
            default:
                out = least_along<float>(line, pass.width);
                break;
        }
    }
    to[static_cast<size_t>(blockIdx.x) * kLeafVoxels + t] = out;
}

/// The same for the edge-preserving filter, which needs the normals around.
__global__ void __launch_bounds__(kLeafVoxels) filter_edges(FilterPass pass, const float* from, const int32_t* around, float band_vox, float* to) {
    extern __shared__ float halo[];
    const int r = pass.width + 1, s = 8 + 2 * r, t = threadIdx.x;
    float* normals = halo + s * s * s;
    load_halo(from, around, r, r, r, band_vox, halo);
    const int w = pass.width, m = 8 + 2 * w, count = m * m * m;
    for (int n = t; n < count; n += kLeafVoxels) {
        const int center = ((n / (m * m) + 1) * s + n / m % m + 1) * s + n % m + 1;
        const BandNormal<float> normal = band_normal<float>([&](int i, int j, int k) { return halo[center + (i * s + j) * s + k]; });
        normals[n] = normal.x;
        normals[count + n] = normal.y;
        normals[2 * count + n] = normal.z;
    }
    __syncthreads();
    const int i0 = t >> 6, j0 = t >> 3 & 7, k0 = t & 7;
    const int here = ((i0 + r) * s + j0 + r) * s + k0 + r, mine = ((i0 + w) * m + j0 + w) * m + k0 + w;
    to[static_cast<size_t>(blockIdx.x) * kLeafVoxels + t] =
        edge_preserving<float>([&](int i, int j, int k) { return halo[here + (i * s + j) * s + k]; },
                               [&](int i, int j, int k) {
                                   const int n = mine + (i * m + j) * m + k;
                                   return BandNormal<float>{normals[n], normals[count + n], normals[2 * count + n]};
                               },
                               w, band_vox);
}

__global__ void __launch_bounds__(kLeafVoxels) find_shares(const float* deepest, float keep_thin_vox, float* share) {
    const size_t n = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    share[n] = change_share(deepest[n], keep_thin_vox);
}

__global__ void __launch_bounds__(kLeafVoxels) keep_thin(const float* before, const float* share, float* values) {
    const size_t n = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    if (share[n] < 1.f) values[n] = before[n] + share[n] * (values[n] - before[n]);
}

/// A thread a voxel, a block a leaf.
__global__ void __launch_bounds__(kLeafVoxels) keep_sides(const int32_t* around, float* values) {
    const size_t n = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    float v = values[n];
    for (int face = 0; face < 6; ++face) {
        const int shift = face / 2 == 0 ? 6 : face / 2 == 1 ? 3 : 0;
        if ((static_cast<int>(threadIdx.x) >> shift & 7) == (face % 2 ? 7 : 0))
            v = beside_tile(v, around[static_cast<size_t>(blockIdx.x) * 27 + beyond_face(face)]);
    }
    values[n] = v;
}

void launch(const FilterPass& pass, const float* from, float* to, const int32_t* around, uint32_t leaves, float band_vox, const cudaStream_t s) {
    size_t halo = 1;
    for (int axis = 0; axis < 3; ++axis) halo *= 8 + 2 * static_cast<size_t>(pass_reach(pass, axis));
    halo *= sizeof(float);
    if (pass.kind == FilterPass::EdgePreserving) {
        const size_t side = 8 + 2 * static_cast<size_t>(pass.width);
        filter_edges<<<leaves, kLeafVoxels, halo + 3 * side * side * side * sizeof(float), s>>>(pass, from, around, band_vox, to);
    } else if (pass.kind == FilterPass::Median) {
        (pass.width == 1 ? filter<1> : filter<2>)<<<leaves, kLeafVoxels, halo, s>>>(pass, from, around, band_vox, to);
    } else {
        filter<0><<<leaves, kLeafVoxels, halo, s>>>(pass, from, around, band_vox, to);
    }
    VDBCARVE_LAUNCHED();
}

}  // namespace

void FilterStage::run(const Grid& surface, const Topology& topology, const std::vector<FilterPass>& passes, float keep_thin_vox,
                      const std::vector<FilterPass>& thin_passes, float half_width_vox, const Stream& stream, StageTimes& times) {
    const cudaStream_t s = stream.get();
    // Blocks for leaves that grow across a block's border.
    std::vector<std::array<int, 3>> origins;
    for (const auto& o : topology.origins())
        for (int f = 0; f < 7; ++f) {
            std::array<int, 3> c = o;
            if (f < 6) c[static_cast<size_t>(f / 2)] += f % 2 ? kBlockSide : -kBlockSide;
            origins.push_back(c);
        }
    std::sort(origins.begin(), origins.end());
    origins.erase(std::unique(origins.begin(), origins.end()), origins.end());
    topology_.cover(std::move(origins), stream);
    const TopologyView old_view = topology.view();
    uint32_t n = 0;
    times.measure("filter: prepare", stream, [&] {
        const TopologyView view = topology_.view();
        copy_inside<<<blocks_for(static_cast<size_t>(old_view.blocks) * kBlockWords, 256), 256, 0, s>>>(old_view, view);
        VDBCARVE_LAUNCHED();
        grow<<<blocks_for(static_cast<size_t>(surface.leaf_count()) * 32, 256), 256, 0, s>>>(surface.leaves(), surface.keys(), surface.leaf_count(), old_view,
                                                                                             view);
        VDBCARVE_LAUNCHED();
        topology_.number_leaves(stream);
        n = topology_.leaf_count(stream);
        const TopologyView counted = topology_.view();
        const size_t words = static_cast<size_t>(counted.blocks) * kBlockWords;
        list_keys<<<blocks_for(words, 256), 256, 0, s>>>(counted, keys_.ensure(n));
        VDBCARVE_LAUNCHED();
        load_leaves<<<n, kLeafVoxels, 0, s>>>(surface.leaves(), old_view, counted, keys_.data(), static_cast<float>(surface.spec().voxel_size),
                                              surface.spec().background, half_width_vox, first_.ensure(static_cast<size_t>(n) * kLeafVoxels));
        VDBCARVE_LAUNCHED();
        clear_inside<<<blocks_for(words, 256), 256, 0, s>>>(counted);
        VDBCARVE_LAUNCHED();
        list_surroundings<<<blocks_for(27 * static_cast<size_t>(n), 256), 256, 0, s>>>(counted, keys_.data(), n, around_.ensure(27 * static_cast<size_t>(n)));
        VDBCARVE_LAUNCHED();
    });
    const size_t voxels = static_cast<size_t>(n) * kLeafVoxels;
    float *from = first_.data(), *to = second_.ensure(voxels);
    const auto pass = [&](const FilterPass& p) {
        launch(p, from, to, around_.data(), n, half_width_vox, s);
        std::swap(from, to);
    };
    if (keep_thin_vox > 0)
        times.measure("filter: thin", stream, [&] {
            VDBCARVE_CUDA(cudaMemcpyAsync(before_.ensure(voxels), from, voxels * sizeof(float), cudaMemcpyDeviceToDevice, s));
            for (const FilterPass& p : thin_passes) pass(p);
            find_shares<<<n, kLeafVoxels, 0, s>>>(from, keep_thin_vox, share_.ensure(voxels));
            VDBCARVE_LAUNCHED();
            VDBCARVE_CUDA(cudaMemcpyAsync(from, before_.data(), voxels * sizeof(float), cudaMemcpyDeviceToDevice, s));
        });
    times.measure("filter: passes", stream, [&] {
        for (const FilterPass& p : passes) pass(p);
        if (keep_thin_vox > 0) {
            keep_thin<<<n, kLeafVoxels, 0, s>>>(before_.data(), share_.data(), from);
            VDBCARVE_LAUNCHED();
        }
        keep_sides<<<n, kLeafVoxels, 0, s>>>(around_.data(), from);
        VDBCARVE_LAUNCHED();
        active_.ensure(static_cast<size_t>(n) * 8);
        stream.zero(active_.data(), static_cast<size_t>(n) * 8);
        grid_.build(topology_, surface.spec(), {from, active_.data(), keys_.data(), n}, stream);
    });
}

}  // namespace vdbcarve::cuda
