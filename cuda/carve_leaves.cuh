// SPDX-License-Identifier: Apache-2.0
// Carving's second half: the values of the voxels of the leaves that are left. Included by carve_cuda.cu alone.
#pragma once

#include "carve_nodes.cuh"

namespace vdbcarve::cuda {
namespace {

/// A thread a view that cuts a leaf: where the leaf is for it, and which of the leaf's cells have to be asked.
__global__ void prepare_entries(const Common c, uint32_t count) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const uint32_t packed = c.entries[n].packed;
    const CarveView& view = c.views[packed & 0x7fff];
    const int3 o = c.topology.leaf_origin(c.slots.key[c.entry_slot[n]]);
    const LeafToCamera leaf = leaf_to_camera(view, o.x, o.y, o.z);
    uint32_t mixed = 0xff, out = 0;
    if ((packed & Entry::kClear) && !c.occupancy) {
        mixed = 0;
        for (int cell = 0; cell < 8; ++cell) {
            const Vec3 centre = voxel_in_camera(leaf, static_cast<float>(cell >> 2) * 4.f + 1.5f, static_cast<float>(cell >> 1 & 1) * 4.f + 1.5f,
                                                static_cast<float>(cell & 1) * 4.f + 1.5f);
            const NodeAnswer answer = cell_answer(view.silhouette, cell_probe(view, centre, c.cell_radius, static_cast<float>(c.band)));
            if (answer == NodeAnswer::Out) out |= 1u << cell;
            if (answer == NodeAnswer::Mixed) mixed |= 1u << cell;
        }
    }
    c.entries[n] = {leaf.origin.x, leaf.origin.y, leaf.origin.z, packed | mixed << 16 | out << 24};
}

/// v = max(v, the need_seen-th smallest distance to the views' frames), for a single voxel. The values are clamped to the band and
/// most of them lie at its ends, so the rank is found by counting up from the lower end.
__device__ float raise_unseen(const Common& c, const int3& origin, int at, float band, float value) {
    float current = -band;
    for (;;) {
        float next = band;
        int up_to = 0, above = 0;  // how many are <= current; how many equal `next`
        for (int v = 0; v < c.view_count; ++v) {
            const LeafToCamera leaf = leaf_to_camera(c.views[v], origin.x, origin.y, origin.z);
            const Vec3 p = voxel_in_camera(leaf, static_cast<float>(at >> 6), static_cast<float>(at >> 3 & 7), static_cast<float>(at & 7));
            const float u = unseen_value(c.views[v], p, c.near_depth, band);
            if (u <= current) ++up_to;
            else if (u < next) next = u, above = 1;
            else if (u == next) ++above;
        }
        if (up_to >= c.need_seen) return max_f(value, current);
        if (up_to + above >= c.need_seen) return max_f(value, next);
        current = next;
    }
}

constexpr int kLeafThreads = 64;  // small blocks: a multiprocessor gets new work as soon as two cells are done

/// A warp a cell of 4 x 4 x 4 voxels, two a lane; warps do not wait for each other. kRanks: so many largest values a voxel keeps, one
/// more than the allowed misses. kPerspective: all views are.
template <int kRanks, bool kPerspective>
__global__ void __launch_bounds__(kLeafThreads, kRanks == 1 ? 16 : 8) evaluate_leaves(const Common c, float* values, uint64_t* active) {
    const uint32_t warp = blockIdx.x * (kLeafThreads / 32) + threadIdx.x / 32, slot = warp / 8, key = c.slots.key[slot], info = c.slots.state[slot];
    const int cell = static_cast<int>(warp % 8), lane = threadIdx.x % 32;
    const float band = static_cast<float>(c.band);
    const int count = static_cast<int>(info >> 16);
    const int allowed = c.max_misses - static_cast<int>(info >> kMissesShift & 0xff);
    const Entry* entries = c.entries + c.slots.first_entry[slot];
    // The lane's voxels of the leaf: (i, j, k) and (i + 2, j, k).
    const int i = (cell >> 2) * 4 + (lane >> 4), j = (cell >> 1 & 1) * 4 + (lane >> 2 & 3), k = (cell & 1) * 4 + (lane & 3);
    float* const mine_out = values + static_cast<size_t>(slot) * kLeafVoxels + (i << 6 | j << 3 | k);
    int out = 0, used = 0;
    for (int n = lane; n < (count + 31) / 32 * 32; n += 32) out += __popc(__ballot_sync(kAll, n < count && (entries[n].packed >> (24 + cell) & 1)));
    if (out > allowed) {
        mine_out[0] = mine_out[2 << 6] = band;
        return;
    }

    const float fi[2] = {static_cast<float>(i), static_cast<float>(i + 2)}, fj = static_cast<float>(j), fk = static_cast<float>(k);
    float largest[2][kRanks];
#pragma unroll
    for (int r = 0; r < kRanks; ++r) largest[0][r] = largest[1][r] = -band;
    bool done = false;
    for (int from = 0; from < count && !done; from += 32) {
        const float4 mine = from + lane < count ? reinterpret_cast<const float4*>(entries)[from + lane] : make_float4(0, 0, 0, 0);
        const uint32_t mine_packed = __float_as_uint(mine.w);
        for (uint32_t rest = __ballot_sync(kAll, mine_packed >> (16 + cell) & 1); rest; rest &= rest - 1) {
            const int source = __ffs(rest) - 1;
            LeafToCamera leaf;
            leaf.origin = {__shfl_sync(kAll, mine.x, source), __shfl_sync(kAll, mine.y, source), __shfl_sync(kAll, mine.z, source)};
            const uint32_t packed = __shfl_sync(kAll, mine_packed, source);
            const int v = static_cast<int>(packed & 0x7fff);
            ViewConstants view = c.constants[v];
            if (kPerspective) view.lens.orthographic = 0;
            leaf.di = view.di;
            leaf.dj = view.dj;
            leaf.dk = view.dk;
            float x[2];
            if (packed & Entry::kClear) {
                FieldView field;
                field.samples = view.samples;
                field.width = view.width;
                field.height = view.height;
                field.x0 = view.x0;
                field.y0 = view.y0;
                // Step by step for both voxels, so that their loads are on the way together.
                const Vec3 p0 = voxel_in_camera(leaf, fi[0], fj, fk), p1 = voxel_in_camera(leaf, fi[1], fj, fk);
                const Projected q0 = project(view.lens, p0), q1 = project(view.lens, p1);
                const Patch s0 = fetch_patch(field, q0.u, q0.v), s1 = fetch_patch(field, q1.u, q1.v);
                x[0] = patch_value(view.lens, s0, q0.mx, q0.my, p0.z, band);
                x[1] = patch_value(view.lens, s1, q1.mx, q1.my, p1.z, band);
            } else {
                // Rare, and long: not twice in the code.
#pragma unroll 1
                for (int n = 0; n < 2; ++n) {
                    const float value = view_value(c.views[v], voxel_in_camera(leaf, n ? fi[1] : fi[0], fj, fk), c.near_depth, band);
                    if (n) x[1] = value;
                    else x[0] = value;
                }
            }
            ++used;
            if constexpr (kRanks == 1) {
                largest[0][0] = max_f(largest[0][0], x[0]);
                largest[1][0] = max_f(largest[1][0], x[1]);
                if (__all_sync(kAll, largest[0][0] >= band && largest[1][0] >= band)) {
                    done = true;
                    break;
                }
            } else {
#pragma unroll
                for (int n = 0; n < 2; ++n)
#pragma unroll
                    for (int r = 0; r < kRanks; ++r)
                        if (x[n] > largest[n][r]) {
                            const float lesser = largest[n][r];
                            largest[n][r] = x[n];
                            x[n] = lesser;
                        }
            }
        }
    }
    const float surface = 0.5f * static_cast<float>(c.voxel_size);
    unsigned capped_here = 0, negative = 0, near = 0, in_band[2];
    bool inside = false;
#pragma unroll
    for (int n = 0; n < 2; ++n) {
        const int at = (i + 2 * n) << 6 | j << 3 | k;
        float value = band;
#pragma unroll
        for (int r = 0; r < kRanks; ++r)
            if (r == allowed - out) value = largest[n][r];
        if (!(info & kSeen) || !(info & kInBox)) {
            const int3 origin = c.topology.leaf_origin(key);
            if (!(info & kSeen)) value = raise_unseen(c, origin, at, band, value);
            if (!(info & kInBox)) {
                const double p[3] = {world_of(c, 0, origin.x + (at >> 6)), world_of(c, 1, origin.y + (at >> 3 & 7)), world_of(c, 2, origin.z + (at & 7))};
                const float box = clamp_f(static_cast<float>(box_distance(p, c.lo, c.hi)), -band, band);
                capped_here += __popc(__ballot_sync(kAll, box > value && fabsf(box) <= surface));
                value = max_f(value, box);
            }
        }
        mine_out[(2 * n) << 6] = value;
        in_band[n] = __ballot_sync(kAll, value > -band && value < band);
        negative += __popc(__ballot_sync(kAll, value < 0));
        near += __popc(__ballot_sync(kAll, fabsf(value) <= surface));
        if (n == 0) inside = value < 0.f;
    }
    // The cell's part of four of the leaf's words: 4 rows of 4 bits at (j & 4) * 8 + (k & 4).
    if ((in_band[0] | in_band[1]) && lane < 4) {
        const unsigned rows = (lane & 2 ? in_band[1] : in_band[0]) >> (lane & 1 ? 16 : 0) & 0xffff;
        const unsigned spread = (rows & 0xf) | (rows & 0xf0) << 4 | (rows & 0xf00) << 8 | (rows & 0xf000) << 12;
        if (spread)
            atomicOr(reinterpret_cast<unsigned long long*>(active) + static_cast<size_t>(slot) * 8 + static_cast<size_t>((cell >> 2) * 4 + lane),
                     static_cast<unsigned long long>(spread) << ((cell & 2 ? 32 : 0) + (cell & 1 ? 4 : 0)));
    }
    if (lane == 0) {
        if (in_band[0] | in_band[1]) TopologyView::mark(c.topology.leaves, key);
        if (cell == 0 && inside) atomicOr(c.slots.state + slot, kFirstInside);
        unsigned long long* sums = c.tallies + (blockIdx.x % kTallies) * kTallySize;
        if (negative) atomicAdd(sums, static_cast<unsigned long long>(negative));
        if (near) atomicAdd(sums + 1, static_cast<unsigned long long>(near));
        if (capped_here) atomicAdd(sums + 2, static_cast<unsigned long long>(capped_here));
        if (used) atomicAdd(sums + 3, static_cast<unsigned long long>(64 * used));
    }
}

/// Leaves that hold nothing of the band and are inside.
__global__ void mark_inside_leaves(const Common c, uint32_t slots) {
    const uint32_t slot = blockIdx.x * blockDim.x + threadIdx.x;
    if (slot >= slots || !(c.slots.state[slot] & kFirstInside)) return;
    const uint32_t key = c.slots.key[slot];
    if (!(c.topology.leaves[key / 64] >> (key & 63) & 1)) TopologyView::mark(c.topology.inside, key);
}

/// The paper's binary model.
__global__ void __launch_bounds__(kLeafVoxels) evaluate_binary(const Common c, uint64_t* active) {
    const uint32_t slot = blockIdx.x, key = c.slots.key[slot], info = c.slots.state[slot];
    const int3 origin = c.topology.leaf_origin(key);
    const int t = threadIdx.x, lane = t % 32;
    const float fi = static_cast<float>(t >> 6), fj = static_cast<float>(t >> 3 & 7), fk = static_cast<float>(t & 7);
    int misses = static_cast<int>(info >> kMissesShift & 0xff), seen = 0;
    const Entry* entries = c.entries + c.slots.first_entry[slot];
    for (int n = 0; n < static_cast<int>(info >> 16); ++n) {
        const Entry e = entries[n];
        const CarveView& view = c.views[e.view()];
        const ViewConstants& k = c.constants[e.view()];
        misses += binary_answer(view, voxel_in_camera({{e.x, e.y, e.z}, k.di, k.dj, k.dk}, fi, fj, fk), c.near_depth).background;
    }
    const bool all = !(info & kSeen);
    if (all)
        for (int v = 0; v < c.view_count; ++v)
            seen += seen_at(c.views[v], voxel_in_camera(leaf_to_camera(c.views[v], origin.x, origin.y, origin.z), fi, fj, fk), c.near_depth);
    const int ijk[3] = {origin.x + (t >> 6), origin.y + (t >> 3 & 7), origin.z + (t & 7)};
    bool on = misses <= c.max_misses && (!all || seen >= c.need_seen);
    for (int a = 0; a < 3; ++a) on = on && ijk[a] >= c.min[a] && ijk[a] < c.max[a];
    const unsigned word = __ballot_sync(kAll, on);
    if (lane == 0) reinterpret_cast<uint32_t*>(active)[static_cast<size_t>(slot) * 16 + t / 32] = word;
    if (lane == 0 && word) TopologyView::mark(c.topology.leaves, key);
}

}  // namespace
}  // namespace vdbcarve::cuda
