// SPDX-License-Identifier: Apache-2.0
#include "mesh_cuda.h"

#include <cub/device/device_scan.cuh>

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kAll = ~0u;
constexpr int kCorners = 729;

__device__ int at9(int i, int j, int k) { return (i * 9 + j) * 9 + k; }

/// The 217 corners that belong to leaves above: 3 faces of 64, 3 edges of 8, one corner.
__device__ void border_corner(int t, int at[3]) {
    int i = 8, j = 8, k = 8;
    if (t < 64) j = t >> 3, k = t & 7;
    else if (t < 128) i = t >> 3 & 7, k = t & 7;
    else if (t < 192) i = t >> 3 & 7, j = t & 7;
    else if (t < 200) k = t & 7;
    else if (t < 208) j = t & 7;
    else if (t < 216) i = t & 7;
    at[0] = i;
    at[1] = j;
    at[2] = k;
}

/// The values of a leaf's 8^3 cells' corners, and the numbers of the leaf and those above it, by which axes lead there.
__device__ void gather(const nanovdb::NanoGrid<float>* grid, const Grid::Leaf* leaves, const TopologyView& topology, const uint32_t* keys, uint32_t leaf,
                       float* values, int* around) {
    const int t = threadIdx.x;
    if (t < 8) around[t] = t == 0 ? static_cast<int>(leaf) : static_cast<int>(topology.neighbour(keys[leaf], t >> 2, t >> 1 & 1, t & 1));
    values[at9(t >> 6, t >> 3 & 7, t & 7)] = leaves[leaf].data()->mValues[t];
    __syncthreads();
    if (t < 217) {
        int at[3];
        border_corner(t, at);
        const int i = at[0], j = at[1], k = at[2];
        const int n = around[(i >> 3) << 2 | (j >> 3) << 1 | k >> 3];
        if (n >= 0) {
            values[at9(i, j, k)] = leaves[n].data()->mValues[(i & 7) << 6 | (j & 7) << 3 | (k & 7)];
        } else {
            const int3 o = topology.leaf_origin(keys[leaf]);
            values[at9(i, j, k)] = grid->tree().root().getValue(nanovdb::Coord(o.x + i, o.y + j, o.z + k));
        }
    }
    __syncthreads();
}

__device__ unsigned case_of(const float* values, int t) {
    const float* v = values + at9(t >> 6, t >> 3 & 7, t & 7);
    unsigned mask = 0;
#pragma unroll
    for (int c = 0; c < 8; ++c) mask |= static_cast<unsigned>(v[at9(c >> 2, c >> 1 & 1, c & 1)] < 0.f) << c;
    return mask;
}

__global__ void __launch_bounds__(kLeafVoxels)
    count(const nanovdb::NanoGrid<float>* grid, const Grid::Leaf* leaves, TopologyView topology, const uint32_t* keys, const MarchingCase* cases,
          LeafEdges* edges, uint32_t* vertices, uint32_t* triangles, unsigned* open) {
    __shared__ float values[kCorners];
    __shared__ int around[8];
    __shared__ LeafEdges found;
    __shared__ unsigned sum, insides[16];
    const uint32_t leaf = blockIdx.x;
    const int t = threadIdx.x, lane = t % 32;
    gather(grid, leaves, topology, keys, leaf, values, around);
    if (t == 0) sum = 0;
    const float* here = values + at9(t >> 6, t >> 3 & 7, t & 7);
    const bool inside = *here < 0.f;
    auto* words = reinterpret_cast<uint32_t*>(found.crossed);
    const int steps[3] = {at9(1, 0, 0), at9(0, 1, 0), 1};
    for (int axis = 0; axis < 3; ++axis) {
        const unsigned word = __ballot_sync(kAll, (here[steps[axis]] < 0.f) != inside);
        if (lane == 0) words[axis * 16 + t / 32] = word;
    }
    const unsigned inside_here = __ballot_sync(kAll, inside);
    if (lane == 0) insides[t / 32] = inside_here;
    __syncthreads();
    // Crossed edges in leaves above that are not there.
    if (t < 217) {
        int at[3];
        border_corner(t, at);
        if (around[(at[0] >> 3) << 2 | (at[1] >> 3) << 1 | at[2] >> 3] < 0) {
            const bool here_inside = values[at9(at[0], at[1], at[2])] < 0.f;
            for (int axis = 0; axis < 3; ++axis)
                if (at[axis] < 8 && (values[at9(at[0] + (axis == 0), at[1] + (axis == 1), at[2] + (axis == 2))] < 0.f) != here_inside) *open = 1;
        }
    }
    // Leaves that are not there below this one, with another side beyond their border than on it.
    if (t < 7) {
        const int d = t + 1, x = d >> 2, y = d >> 1 & 1, z = d & 1;
        if (topology.neighbour(keys[leaf], -x, -y, -z) < 0) {
            const int3 o = topology.leaf_origin(keys[leaf]);
            const bool beyond = grid->tree().root().getValue(nanovdb::Coord(o.x - 8 * x, o.y - 8 * y, o.z - 8 * z)) < 0.f;
            // A word is four rows of eight voxels; two of them make a slice.
            unsigned differs = 0;
            for (int w = 0; w < (x ? 2 : 16); ++w) {
                if (y && w % 2) continue;
                const unsigned border = (y ? 0x000000ffu : kAll) & (z ? 0x01010101u : kAll);
                differs |= (insides[w] ^ (beyond ? kAll : 0u)) & border;
            }
            if (differs) *open = 1;
        }
    }
    __syncthreads();
    const unsigned mask = case_of(values, t);
    unsigned n = cases[mask].count;
    for (int d = 16; d; d /= 2) n += __shfl_xor_sync(kAll, n, d);
    if (lane == 0 && n) atomicAdd(&sum, n);
    if (t < 32) {
        const int here_count = t < 24 ? __popcll(found.crossed[t]) : 0;
        int upto = here_count;
        for (int d = 1; d < 32; d *= 2) {
            const int before = __shfl_up_sync(kAll, upto, d);
            if (lane >= d) upto += before;
        }
        if (t < 24) found.before[t] = static_cast<uint16_t>(upto - here_count);
        if (t == 31) vertices[leaf] = static_cast<uint32_t>(upto);
    }
    __syncthreads();
    static_assert(sizeof(LeafEdges) % 4 == 0);
    if (t < static_cast<int>(sizeof(LeafEdges) / 4)) reinterpret_cast<uint32_t*>(edges + leaf)[t] = reinterpret_cast<const uint32_t*>(&found)[t];
    if (t == 0) triangles[leaf] = sum;
}

template <bool kNormals>
__global__ void __launch_bounds__(kLeafVoxels) emit(const nanovdb::NanoGrid<float>* grid, const Grid::Leaf* leaves, TopologyView topology, const uint32_t* keys,
                                                    const MarchingCase* cases, const LeafEdges* edges, const uint32_t* first_vertex,
                                                    const uint32_t* first_triangle, LatticeFrame frame, float* vertices, float* normals, uint32_t* triangles) {
    __shared__ float values[kCorners];
    __shared__ int around[8];
    __shared__ LeafEdges own;
    __shared__ unsigned warp_sums[16];
    __shared__ uint8_t masks[kLeafVoxels];
    __shared__ uint16_t list[5 * kLeafVoxels];  // at most 5 triangles a cell, 3 edges a voxel
    const uint32_t leaf = blockIdx.x;
    const uint32_t vertex = first_vertex[leaf], triangle = first_triangle[leaf];
    if (first_vertex[leaf + 1] == vertex && first_triangle[leaf + 1] == triangle) return;
    const int t = threadIdx.x, lane = t % 32;
    if (t < static_cast<int>(sizeof(LeafEdges) / 4)) reinterpret_cast<uint32_t*>(&own)[t] = reinterpret_cast<const uint32_t*>(edges + leaf)[t];
    gather(grid, leaves, topology, keys, leaf, values, around);
    // What is crossed is sparse: edges first, then triangles, are put in lists that all threads share out.
    const float* here = values + at9(t >> 6, t >> 3 & 7, t & 7);
    const int3 o = topology.leaf_origin(keys[leaf]);
    for (int axis = 0; axis < 3; ++axis) {
        const int edge = axis * 512 + t;
        if (own.crossed[edge >> 6] >> (edge & 63) & 1) list[edge_rank(own, edge)] = static_cast<uint16_t>(edge);
    }
    const unsigned mask = case_of(values, t), count_here = cases[mask].count;
    masks[t] = static_cast<uint8_t>(mask);
    unsigned upto = count_here;
    for (int d = 1; d < 32; d *= 2) {
        const unsigned before = __shfl_up_sync(kAll, upto, d);
        if (lane >= d) upto += before;
    }
    if (lane == 31) warp_sums[t / 32] = upto;
    __syncthreads();
    const int edges_here = static_cast<int>(first_vertex[leaf + 1] - vertex);
    for (int n = t; n < edges_here; n += kLeafVoxels) {
        const int edge = list[n], axis = edge >> 9, i = edge >> 6 & 7, j = edge >> 3 & 7, k = edge & 7;
        const size_t at = 3 * (static_cast<size_t>(vertex) + static_cast<size_t>(n));
        const float share = crossing_share(values[at9(i, j, k)], values[at9(i + (axis == 0), j + (axis == 1), k + (axis == 2))]);
        const MeshPoint p = edge_vertex(frame, o.x + i, o.y + j, o.z + k, axis, share);
        vertices[at] = p.x;
        vertices[at + 1] = p.y;
        vertices[at + 2] = p.z;
        if constexpr (kNormals) {
            const auto value = [&](int x, int y, int z) { return grid->tree().root().getValue(nanovdb::Coord(x, y, z)); };
            const MeshPoint normal = edge_normal(value, o.x + i, o.y + j, o.z + k, axis, share);
            normals[at] = normal.x;
            normals[at + 1] = normal.y;
            normals[at + 2] = normal.z;
        }
    }
    __syncthreads();  // the list is used again
    unsigned at = upto - count_here;
    for (int w = 0; w < t / 32; ++w) at += warp_sums[w];
    for (unsigned n = 0; n < count_here; ++n) list[at + n] = static_cast<uint16_t>(t | n << 9);
    __syncthreads();
    const unsigned triangles_here = first_triangle[leaf + 1] - triangle;
    for (unsigned n = t; n < 3 * triangles_here; n += kLeafVoxels) {
        const unsigned item = list[n / 3], cell = item & 511;
        const int code = cases[masks[cell]].edges[3 * (item >> 9) + n % 3], axis = code & 3, corner = code >> 2;
        const int x = static_cast<int>(cell >> 6) + (corner >> 2), y = static_cast<int>(cell >> 3 & 7) + (corner >> 1 & 1),
                  z = static_cast<int>(cell & 7) + (corner & 1);
        const int edge = axis << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7);
        const int from = around[(x >> 3) << 2 | (y >> 3) << 1 | z >> 3];
        triangles[3 * static_cast<size_t>(triangle) + n] = from == static_cast<int>(leaf)
                                                               ? vertex + static_cast<uint32_t>(edge_rank(own, edge))
                                                               : first_vertex[from] + static_cast<uint32_t>(edge_rank(edges[from], edge));
    }
}

}  // namespace

bool MeshStage::run(const Grid& surface, const Topology& topology, const std::array<MarchingCase, 256>& cases, bool normals, const Stream& stream,
                    StageTimes& times) {
    vertex_count_ = triangle_count_ = 0;
    made_ = has_normals_ = false;
    const uint32_t n = surface.leaf_count();
    if (n == 0) {
        made_ = true;
        has_normals_ = normals;
        return true;
    }
    if (!cases_.data()) {
        stream.to_device(cases_.ensure(cases.size()), cases.data(), cases.size());
        stream.wait();
    }
    edges_.ensure(n);
    open_.ensure(1);
    // A last entry of zero, so that the sums before it are those of all.
    uint32_t* counts = counts_.ensure(2 * (static_cast<size_t>(n) + 1));
    uint32_t* firsts = firsts_.ensure(2 * (static_cast<size_t>(n) + 1));
    uint32_t *triangles = counts + n + 1, *first_triangle = firsts + n + 1;
    const TopologyView view = topology.view();
    const cudaStream_t s = stream.get();
    size_t scratch = 0;
    VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(nullptr, scratch, counts, firsts, static_cast<int>(n + 1), s));
    scratch_.ensure(scratch);
    uint32_t* totals = host_totals_.ensure(3);
    times.measure("mesh", stream, [&] {
        stream.zero(open_.data(), 1);
        stream.zero(counts + n, 1);
        stream.zero(triangles + n, 1);
        count<<<n, kLeafVoxels, 0, s>>>(surface.grid(), surface.leaves(), view, surface.keys(), cases_.data(), edges_.data(), counts, triangles, open_.data());
        VDBCARVE_LAUNCHED();
        VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(scratch_.data(), scratch, counts, firsts, static_cast<int>(n + 1), s));
        VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(scratch_.data(), scratch, triangles, first_triangle, static_cast<int>(n + 1), s));
        stream.to_host(totals, firsts + n, 1);
        stream.to_host(totals + 1, first_triangle + n, 1);
        stream.to_host(totals + 2, open_.data(), 1);
        stream.wait();
        if (totals[2]) return;
        vertex_count_ = totals[0];
        triangle_count_ = totals[1];
        vertices_.ensure(3 * vertex_count_);
        triangles_.ensure(3 * triangle_count_);
        if (normals) normals_.ensure(3 * vertex_count_);
        const auto& spec = surface.spec();
        const LatticeFrame frame{{spec.first_voxel_world[0], spec.first_voxel_world[1], spec.first_voxel_world[2]}, spec.voxel_size};
        (normals ? emit<true> : emit<false>)<<<n, kLeafVoxels, 0, s>>>(surface.grid(), surface.leaves(), view, surface.keys(), cases_.data(), edges_.data(),
                                                                       firsts, first_triangle, frame, vertices_.data(), normals_.data(), triangles_.data());
        VDBCARVE_LAUNCHED();
        made_ = true;
        has_normals_ = normals;
    });
    return made_;
}

}  // namespace vdbcarve::cuda
