// SPDX-License-Identifier: Apache-2.0
// Carving's first half: which nodes of the tree a silhouette's edge cuts. Included by carve_cuda.cu alone.
#pragma once

#include "carve_cuda.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kAll = ~0u;

enum Counter { kNodeTests, kEntries, kFirstLevel, kCounters = kFirstLevel + 5 };
// Sums over leaves, spread so that few warps add to one place: negative voxels, voxels near the surface, those of them on the bounds' caps,
// look-ups.
constexpr int kTallies = 256, kTallySize = 4;

/// What the voxels of a leaf need of a view, apart from where the leaf is.
struct alignas(16) ViewConstants {
    Vec3 di, dj, dk;
    Projection lens;
    float x0, y0;
    int width, height;
    const int16_t* samples;
};
static_assert(sizeof(ViewConstants) == 96);

/// One view that cuts one leaf.
struct alignas(16) Entry {
    float x, y, z;    ///< the leaf's first voxel in camera space
    uint32_t packed;  ///< view, whether the leaf is clear of its frame, and as bits the cells that are out, or have to be asked

    static constexpr uint32_t kClear = 1u << 15;
    __device__ int view() const { return static_cast<int>(packed & 0x7fff); }
};

/// Nodes of one size. A key is block * 4096 + (x << 8 | y << 4 | z), place in the block in nodes of that size.
struct NodeList {
    uint32_t *key, *state, *views;  ///< views: view_words a node, as bits
};

/// Leaves that have to be evaluated.
struct SlotList {
    uint32_t *key, *state, *first_entry;
};

struct Common {
    const CarveView* views;
    const ViewConstants* constants;
    int view_count, view_words;
    double origin_world[3], voxel_size, band;
    float near_depth, cell_radius;
    int max_misses, need_seen;
    double lo[3], hi[3];
    int min[3], max[3];
    bool occupancy;
    TopologyView topology;
    unsigned long long *counters, *tallies;
    NodeList nodes[2];  ///< sizes take turns
    SlotList slots;
    Entry* entries;
    uint32_t* entry_slot;
    uint32_t node_capacity, slot_capacity, entry_capacity;
};

// A node's state, in one word.
constexpr uint32_t kSeen = 1, kInBox = 2, kFirstInside = 4;  // the last: of a leaf's first voxel, once it is known
constexpr int kMissesShift = 8;

__device__ double world_of(const Common& c, int axis, double index) { return c.origin_world[axis] + (index + 0.5) * c.voxel_size; }

constexpr int kWarps = 8;

/// Shared memory of a warp of ask_nodes, in words: the parent's views as a list, and of each child the views that cut, those of them
/// that are clear of the frame, and counts.
__host__ __device__ constexpr int scratch_words(int views, int view_words) { return (views + 1) / 2 + 16 * view_words + 16; }

/// Adds all leaves of a node of `side` leaves at (x, y, z), in leaves of the block.
__device__ void mark_inside(unsigned long long* inside, int x, int y, int z, int side, int lane) {
    const unsigned long long run = (side == 16 ? 0xffffull : (1ull << side) - 1) << z;
    for (int n = lane; n < side * side; n += 32) {
        const int row = (x + n / side) * 16 + y + n % side;
        atomicOr(inside + row / 4, run << (row % 4 * 16));
    }
}

/// A warp a parent: asks the parent's views about its children (the blocks themselves, or eight nodes of `size` voxels) and writes down
/// those that live on, as nodes or, at 8 voxels, as slots.
template <int kChildren>
__global__ void __launch_bounds__(32 * kWarps) ask_nodes(const Common c, int size, int level) {
    extern __shared__ uint32_t shared[];
    const int lane = threadIdx.x % 32, words = c.view_words;
    uint32_t* cut = shared + (threadIdx.x / 32) * scratch_words(c.view_count, words);
    uint32_t* clear = cut + 8 * words;
    int* out = reinterpret_cast<int*>(clear + 8 * words);
    int* seeing = out + 8;
    auto* list = reinterpret_cast<uint16_t*>(seeing + 8);
    const NodeList from = c.nodes[level % 2], to = c.nodes[(level + 1) % 2];
    const uint32_t parents =
        kChildren == 1 ? static_cast<uint32_t>(c.topology.blocks) : min(static_cast<uint32_t>(c.counters[kFirstLevel + level - 1]), c.node_capacity);
    const double half = 0.5 * (size - 1), h = c.voxel_size, radius = sqrt(3.0) * half * h;
    unsigned long long tests = 0;

    for (uint32_t parent = blockIdx.x * kWarps + threadIdx.x / 32; parent < parents; parent += gridDim.x * kWarps) {
        const uint32_t parent_key = kChildren == 1 ? parent * kBlockLeaves : from.key[parent];
        const uint32_t parent_state = kChildren == 1 ? (c.need_seen <= 0 ? kSeen : 0) : from.state[parent];
        const uint32_t* parent_views = from.views + static_cast<size_t>(parent) * words;
        const int block = static_cast<int>(parent_key / kBlockLeaves);
        const int4 origin = c.topology.origin[block];
        const int first[3] = {static_cast<int>(parent_key >> 8 & 15), static_cast<int>(parent_key >> 4 & 15), static_cast<int>(parent_key & 15)};
        const int block_at[3] = {origin.x, origin.y, origin.z};
        const auto place = [&](int child, int axis) { return kChildren == 1 ? 0 : 2 * first[axis] + (child >> (2 - axis) & 1); };
        const auto corner = [&](int child, int axis) { return block_at[axis] + place(child, axis) * size; };

        // The parent's views as a list.
        int listed = 0;
        for (int w = 0; w < words; ++w) {
            const uint32_t bits = kChildren == 1 ? (c.view_count - 32 * w >= 32 ? kAll : (1u << (c.view_count - 32 * w)) - 1) : parent_views[w];
            if (bits >> lane & 1) list[listed + __popc(bits & ((1u << lane) - 1))] = static_cast<uint16_t>(32 * w + lane);
            listed += __popc(bits);
        }
        for (int n = lane; n < 16 * words; n += 32) cut[n] = 0;  // and `clear`, which follows
        if (lane < 16) out[lane] = 0;                            // and `seeing`

        // Does the child reach into the range and the bounds?
        bool live = lane < kChildren, in_box = parent_state & kInBox;
        if (live) {
            double p[3];
#pragma unroll
            for (int a = 0; a < 3; ++a) {
                const int o = corner(lane, a);
                live = live && o < c.max[a] && o + size > c.min[a];
                p[a] = world_of(c, a, o + half);
            }
            if (!in_box) {
                const double d = box_distance(p, c.lo, c.hi), rounding = 1e-3 * h;
                live = live && d - radius - rounding <= c.band;
                in_box = d + radius + rounding < -c.band;
            }
        }
        const unsigned living = __ballot_sync(kAll, live);
        __syncwarp();
        if (!living) continue;

        // Until enough views see all of a node, every view is asked.
        const bool seen = parent_state & kSeen;
        const int pairs = (seen ? listed : c.view_count) * kChildren;
        tests += static_cast<unsigned>(pairs);
        for (int p = lane; p < pairs; p += 32) {
            const int child = p % kChildren;
            if (!(living >> child & 1)) continue;
            const int v = seen ? list[p / kChildren] : p / kChildren;
            const bool asked = seen || kChildren == 1 || (parent_views[v / 32] >> (v % 32) & 1);
            const CarveView& view = c.views[v];
            const NodeAnswers answers =
                node_answers(view, node_ball(view, corner(child, 0) + half, corner(child, 1) + half, corner(child, 2) + half, radius), c.near_depth, c.band);
            if (asked && answers.hull == NodeAnswer::Out) atomicAdd(out + child, 1);
            if (asked && answers.hull == NodeAnswer::Mixed) {
                atomicOr(cut + child * words + v / 32, 1u << (v % 32));
                if (answers.clear_of_frame) atomicOr(clear + child * words + v / 32, 1u << (v % 32));
            }
            if (!seen) atomicAdd(seeing + child, (answers.unseen == NodeAnswer::In ? 1 << 16 : 0) + (answers.unseen != NodeAnswer::Out));
        }
        __syncwarp();

        // Lane n decides about child n.
        int misses = 0, cuts = 0;
        bool child_seen = seen, full = false;
        if (live) {
            misses = static_cast<int>(parent_state >> kMissesShift) + out[lane];
            live = misses <= c.max_misses;
            if (!seen) {
                live = live && (seeing[lane] & 0xffff) >= c.need_seen;
                child_seen = (seeing[lane] >> 16) >= c.need_seen;
            }
            for (int w = 0; w < words; ++w) cuts += __popc(cut[lane * words + w]);
            full = live && child_seen && in_box && misses + cuts <= c.max_misses;
            if (c.occupancy)  // a node that reaches past the range is cut up further; leaves are clipped voxel by voxel
#pragma unroll
                for (int a = 0; a < 3; ++a) full = full && corner(lane, a) >= c.min[a] && corner(lane, a) + size <= c.max[a];
            live = live && !full;
        }
        for (unsigned rest = __ballot_sync(kAll, full); rest; rest &= rest - 1) {
            const int child = __ffs(rest) - 1, side = size / 8;
            mark_inside(reinterpret_cast<unsigned long long*>(c.topology.inside) + static_cast<size_t>(block) * kBlockWords, place(child, 0) * side,
                        place(child, 1) * side, place(child, 2) * side, side, lane);
        }
        const unsigned survivors = __ballot_sync(kAll, live);
        if (!survivors) continue;
        uint32_t number = 0, entry = 0;
        const int wanted = live ? cuts : 0;
        int before = wanted;
        for (int d = 1; d < 8; d *= 2) {
            const int x = __shfl_up_sync(kAll, before, d);
            if (lane >= d) before += x;
        }
        const int all_cuts = __shfl_sync(kAll, before, 7);
        if (lane == 0) {
            number = static_cast<uint32_t>(atomicAdd(c.counters + kFirstLevel + level, static_cast<unsigned long long>(__popc(survivors))));
            if (size == 8) entry = static_cast<uint32_t>(atomicAdd(c.counters + kEntries, static_cast<unsigned long long>(all_cuts)));
        }
        number = __shfl_sync(kAll, number, 0) + __popc(survivors & ((1u << lane) - 1));
        entry = __shfl_sync(kAll, entry, 0) + static_cast<uint32_t>(before - wanted);
        const uint32_t state = (child_seen ? kSeen : 0) | (in_box ? kInBox : 0) | static_cast<uint32_t>(misses) << kMissesShift;
        const uint32_t key =
            static_cast<uint32_t>(block) * kBlockLeaves + static_cast<uint32_t>(place(lane & 7, 0) << 8 | place(lane & 7, 1) << 4 | place(lane & 7, 2));
        // What finds no room is counted all the same: the host makes room and walks again.
        if (size > 8) {
            if (live && number < c.node_capacity) {
                to.key[number] = key;
                to.state[number] = state;
            }
            for (unsigned rest = survivors; rest; rest &= rest - 1) {
                const int child = __ffs(rest) - 1;
                const uint32_t at = __shfl_sync(kAll, number, child);
                if (at < c.node_capacity)
                    for (int w = lane; w < words; w += 32) to.views[static_cast<size_t>(at) * words + w] = cut[child * words + w];
            }
        } else {
            if (live && number < c.slot_capacity) {
                c.slots.key[number] = key;
                c.slots.state[number] = state | static_cast<uint32_t>(cuts) << 16;
                c.slots.first_entry[number] = entry;
            }
            for (unsigned rest = survivors; rest; rest &= rest - 1) {
                const int child = __ffs(rest) - 1;
                uint32_t at = __shfl_sync(kAll, entry, child);
                const uint32_t slot = __shfl_sync(kAll, number, child);
                for (int w = 0; w < words; ++w) {
                    const uint32_t bits = cut[child * words + w];
                    const uint32_t mine = at + __popc(bits & ((1u << lane) - 1));
                    if ((bits >> lane & 1) && mine < c.entry_capacity) {
                        c.entries[mine].packed = static_cast<uint32_t>(32 * w + lane) | (clear[child * words + w] >> lane & 1 ? Entry::kClear : 0);
                        c.entry_slot[mine] = slot;
                    }
                    at += __popc(bits);
                }
            }
        }
        __syncwarp();
    }
    if (lane == 0 && tests) atomicAdd(c.counters + kNodeTests, tests);
}

}  // namespace
}  // namespace vdbcarve::cuda
