// SPDX-License-Identifier: Apache-2.0
#include "carve_cuda.h"

#include <algorithm>

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

// ------------------------------------------------------------------------------------ nodes

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

// ------------------------------------------------------------------------------------ leaves

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

template <bool kPerspective>
void evaluate(const Common& c, uint32_t slots, float* values, uint64_t* active, cudaStream_t s) {
    const auto blocks = static_cast<unsigned>(static_cast<size_t>(slots) * 256 / kLeafThreads);
    if (c.max_misses == 0) evaluate_leaves<1, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    else if (c.max_misses <= 3) evaluate_leaves<4, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    else evaluate_leaves<16, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    VDBCARVE_LAUNCHED();
}

}  // namespace

void CarveStage::run(const CarveJob& job, const Stream& stream, StageTimes& times) {
    const auto n = job.views.size();
    if (n > kMaxViews) throw BackendError("CUDA: " + std::to_string(n) + " views, at most " + std::to_string(kMaxViews) + ". Remedy: --backend cpu");
    Common c{};
    c.view_count = static_cast<int>(n);
    c.view_words = (c.view_count + 31) / 32;
    const auto words = static_cast<size_t>(c.view_words);
    for (size_t a = 0; a < 3; ++a) {
        c.origin_world[a] = job.origin_world[a];
        c.lo[a] = job.lo[a];
        c.hi[a] = job.hi[a];
        c.min[a] = job.min[a];
        c.max[a] = job.max[a];
    }
    c.voxel_size = job.voxel_size;
    c.band = job.band;
    c.near_depth = job.near_depth;
    c.cell_radius = job.cell_radius;
    c.max_misses = job.max_misses;
    c.need_seen = job.need_seen;
    c.occupancy = job.occupancy;

    topology_.cover(job.min, job.max, stream);
    c.topology = topology_.view();
    CarveView* host_views = host_views_.ensure(n);
    ViewConstants* host_constants = reinterpret_cast<ViewConstants*>(host_constants_.ensure(n * sizeof(ViewConstants)));
    bool perspective = true;
    for (size_t v = 0; v < n; ++v) {
        const CarveView& view = host_views[v] = job.views[v];
        const LeafToCamera steps = leaf_to_camera(view, 0, 0, 0);
        host_constants[v] = {
            steps.di, steps.dj, steps.dk, view, view.silhouette.x0, view.silhouette.y0, view.silhouette.width, view.silhouette.height, view.silhouette.samples};
        perspective = perspective && !view.orthographic;
    }
    c.views = views_.ensure(n);
    c.constants = reinterpret_cast<ViewConstants*>(constants_.ensure(n * sizeof(ViewConstants)));
    stream.to_device(views_.data(), host_views, n);
    stream.to_device(constants_.data(), host_constants_.data(), n * sizeof(ViewConstants));
    c.counters = counters_.ensure(kCounters + kTallies * kTallySize);
    c.tallies = c.counters + kCounters;
    host_counters_.ensure(kCounters + kTallies * kTallySize);

    // Leaves grow with the surface: a guess that is grown when a walk finds more.
    double area = 0;
    for (size_t a = 0; a < 3; ++a) area += static_cast<double>(job.max[(a + 1) % 3] - job.min[(a + 1) % 3]) * (job.max[(a + 2) % 3] - job.min[(a + 2) % 3]);
    const auto guess = static_cast<uint32_t>(std::min(area / 64 + 4096, 4e9));
    uint32_t want_nodes = std::max(guess, node_capacity_), want_slots = std::max(guess, slot_capacity_), want_entries = std::max(8 * guess, entry_capacity_);
    const auto shared = static_cast<int>(sizeof(uint32_t)) * kWarps * scratch_words(c.view_count, c.view_words);
    VDBCARVE_CUDA(cudaFuncSetAttribute(ask_nodes<1>, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    VDBCARVE_CUDA(cudaFuncSetAttribute(ask_nodes<8>, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    int device = 0, multiprocessors = 0;
    VDBCARVE_CUDA(cudaGetDevice(&device));
    VDBCARVE_CUDA(cudaDeviceGetAttribute(&multiprocessors, cudaDevAttrMultiProcessorCount, device));
    const unsigned grid = static_cast<unsigned>(multiprocessors) * 4;
    for (;;) {
        for (size_t side = 0; side < 2; ++side)
            c.nodes[side] = {node_key_[side].ensure(want_nodes), node_state_[side].ensure(want_nodes), node_views_[side].ensure(want_nodes * words)};
        c.slots = {slot_key_.ensure(want_slots), slot_state_.ensure(want_slots), slot_entry_.ensure(want_slots)};
        c.entries = reinterpret_cast<Entry*>(entries_.ensure(want_entries));
        c.entry_slot = entry_slot_.ensure(want_entries);
        c.node_capacity = node_capacity_ = want_nodes;
        c.slot_capacity = slot_capacity_ = want_slots;
        c.entry_capacity = entry_capacity_ = want_entries;
        times.measure("carve: nodes", stream, [&] {
            stream.zero(c.counters, kCounters + kTallies * kTallySize);
            if (c.topology.blocks) {
                ask_nodes<1><<<grid, 32 * kWarps, shared, stream.get()>>>(c, kBlockSide, 0);
                VDBCARVE_LAUNCHED();
                for (int level = 1, size = kBlockSide / 2; size >= 8; ++level, size /= 2) {
                    ask_nodes<8><<<grid, 32 * kWarps, shared, stream.get()>>>(c, size, level);
                    VDBCARVE_LAUNCHED();
                }
            }
            stream.to_host(host_counters_.data(), c.counters, kCounters);
        });
        stream.wait();
        unsigned long long nodes = 0;
        for (int level = 0; level < 4; ++level) nodes = std::max(nodes, host_counters_[kFirstLevel + level]);
        const unsigned long long slots = host_counters_[kFirstLevel + 4], entries = host_counters_[kEntries];
        if (nodes <= node_capacity_ && slots <= slot_capacity_ && entries <= entry_capacity_) break;
        constexpr unsigned long long kMost = 0xfffffff0u;
        if (nodes > kMost || slots > kMost / 4 || entries > kMost) throw BackendError("CUDA: more than 2^32 leaves or views of leaves. Remedy: --backend cpu");
        const auto roomy = [=](unsigned long long found, uint32_t had) {
            return static_cast<uint32_t>(std::max<unsigned long long>(had, std::min(found + found / 8, kMost)));
        };
        want_nodes = roomy(nodes, node_capacity_);
        want_slots = roomy(slots, slot_capacity_);
        want_entries = roomy(entries, entry_capacity_);
        topology_.cover(job.min, job.max, stream);  // without what the walk that ran out of room wrote
    }
    candidates_ = static_cast<uint32_t>(host_counters_[kFirstLevel + 4]);
    const auto entries = static_cast<uint32_t>(host_counters_[kEntries]);
    active_.ensure(static_cast<size_t>(candidates_) * 8);
    if (!job.occupancy) values_.ensure(static_cast<size_t>(candidates_) * kLeafVoxels);
    times.measure("carve: leaves", stream, [&] {
        if (candidates_ == 0) return;
        if (entries) {
            prepare_entries<<<blocks_for(entries, 128), 128, 0, stream.get()>>>(c, entries);
            VDBCARVE_LAUNCHED();
        }
        if (job.occupancy) {
            evaluate_binary<<<candidates_, kLeafVoxels, 0, stream.get()>>>(c, active_.data());
            VDBCARVE_LAUNCHED();
            return;
        }
        stream.zero(active_.data(), static_cast<size_t>(candidates_) * 8);
        if (perspective) {
            evaluate<true>(c, candidates_, values_.data(), active_.data(), stream.get());
        } else {
            evaluate<false>(c, candidates_, values_.data(), active_.data(), stream.get());
        }
        mark_inside_leaves<<<blocks_for(candidates_, 256), 256, 0, stream.get()>>>(c, candidates_);
        VDBCARVE_LAUNCHED();
    });
    times.measure("carve: topology", stream, [&] { topology_.number_leaves(stream); });
}

CarveCounts CarveStage::counts(const Stream& stream) {
    stream.to_host(host_counters_.data(), counters_.data(), kCounters + kTallies * kTallySize);
    stream.wait();
    CarveCounts out;
    for (int n = 0; n < kTallies; ++n) {
        const unsigned long long* sums = host_counters_.data() + kCounters + n * kTallySize;
        out.negative += sums[0];
        out.surface += sums[1];
        out.capped += sums[2];
        out.voxel_lookups += sums[3];
    }
    out.node_tests = host_counters_[kNodeTests];
    out.candidates = candidates_;
    return out;
}

size_t CarveStage::bytes() const {
    size_t nodes = 0;
    for (size_t side = 0; side < 2; ++side) nodes += node_key_[side].bytes() + node_state_[side].bytes() + node_views_[side].bytes();
    return topology_.bytes() + views_.bytes() + nodes + slot_key_.bytes() + slot_state_.bytes() + slot_entry_.bytes() + entries_.bytes() + entry_slot_.bytes() +
           values_.bytes() + active_.bytes();
}

}  // namespace vdbcarve::cuda
