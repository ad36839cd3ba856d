// SPDX-License-Identifier: Apache-2.0
#include "grid_cuda.h"

#include <algorithm>
#include <climits>
#include <cstring>

namespace vdbcarve::cuda {
namespace {

using NanoGrid = nanovdb::NanoGrid<float>;
using NanoTree = nanovdb::NanoTree<float>;
using NanoRoot = nanovdb::NanoRoot<float>;
using NanoUpper = nanovdb::NanoUpper<float>;
using NanoLower = nanovdb::NanoLower<float>;
using NanoLeaf = nanovdb::NanoLeaf<float>;

/// A warp a block of leaves.
__global__ void count_leaves(const uint64_t* leaves, int blocks, uint16_t* word_first, uint32_t* counts) {
    const int block = static_cast<int>((blockIdx.x * blockDim.x + threadIdx.x) / 32), lane = threadIdx.x % 32;
    if (block >= blocks) return;
    const uint64_t* words = leaves + static_cast<size_t>(block) * kBlockWords;
    const int a = __popcll(words[2 * lane]), b = __popcll(words[2 * lane + 1]);
    int sum = a + b;
    for (int d = 1; d < 32; d *= 2) {
        const int before = __shfl_up_sync(~0u, sum, d);
        if (lane >= d) sum += before;
    }
    word_first[static_cast<size_t>(block) * kBlockWords + 2 * lane] = static_cast<uint16_t>(sum - a - b);
    word_first[static_cast<size_t>(block) * kBlockWords + 2 * lane + 1] = static_cast<uint16_t>(sum - b);
    if (lane == 31) counts[block] = static_cast<uint32_t>(sum);
}

constexpr int kScanThreads = 1024;

/// One block of threads: sums over the blocks before, in place; totals[0] leaves, [1] lower nodes, then the lower nodes before each
/// upper node's first block.
__global__ void __launch_bounds__(kScanThreads)
    scan_blocks(uint32_t* first, int blocks, int32_t* lower, uint32_t* lower_block, const uint32_t* upper_first, int uppers, uint32_t* totals) {
    __shared__ uint32_t warp_leaves[32], warp_lowers[32];
    uint32_t leaves_before = 0, lowers_before = 0;
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    for (int from = 0; from < blocks; from += kScanThreads) {
        const int block = from + static_cast<int>(threadIdx.x);
        const uint32_t count = block < blocks ? first[block] : 0;
        uint32_t leaves = count, lowers = count != 0;
        for (int d = 1; d < 32; d *= 2) {
            const uint32_t l = __shfl_up_sync(~0u, leaves, d), n = __shfl_up_sync(~0u, lowers, d);
            if (lane >= d) {
                leaves += l;
                lowers += n;
            }
        }
        if (lane == 31) {
            warp_leaves[warp] = leaves;
            warp_lowers[warp] = lowers;
        }
        __syncthreads();
        uint32_t sum_leaves = 0, sum_lowers = 0, all_leaves = 0, all_lowers = 0;
        for (int w = 0; w < kScanThreads / 32; ++w) {
            if (w == warp) {
                sum_leaves = all_leaves;
                sum_lowers = all_lowers;
            }
            all_leaves += warp_leaves[w];
            all_lowers += warp_lowers[w];
        }
        if (block < blocks) {
            first[block] = leaves_before + sum_leaves + leaves - count;
            const uint32_t number = lowers_before + sum_lowers + lowers - (count != 0);
            lower[block] = count ? static_cast<int32_t>(number) : ~static_cast<int32_t>(number);  // negative: none, after so many
            if (count) lower_block[number] = static_cast<uint32_t>(block);
        }
        leaves_before += all_leaves;
        lowers_before += all_lowers;
        __syncthreads();
    }
    if (threadIdx.x == 0) {
        totals[0] = leaves_before;
        totals[1] = lowers_before;
    }
    for (int u = static_cast<int>(threadIdx.x); u <= uppers; u += kScanThreads) {
        const int32_t at = u < uppers ? lower[upper_first[u]] : static_cast<int32_t>(lowers_before);
        totals[2 + u] = static_cast<uint32_t>(at < 0 ? ~at : at);
    }
}

union Entry {
    float value;
    int64_t child;
};

__device__ int64_t tile_bits(float value) {
    Entry e;
    e.child = 0;
    e.value = value;
    return e.child;
}

struct NodePlaces {
    uint8_t* buffer;
    size_t upper_at, lower_at, leaf_at;
};

__global__ void make_uppers(NodePlaces places, TopologyView topology, const int32_t* lower, const uint32_t* upper_first, const uint32_t* numbers,
                            float background) {
    // numbers[n]: which of the topology's upper nodes the n-th upper node of the grid is.
    const uint32_t u = numbers[blockIdx.y];
    auto* node = reinterpret_cast<NanoUpper*>(places.buffer + places.upper_at) + blockIdx.y;
    auto* data = node->data();
    const int4 some = topology.origin[upper_first[u]];
    const int x0 = some.x & ~4095, y0 = some.y & ~4095, z0 = some.z & ~4095;
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    const int bx = (x0 >> 7) + (n >> 10) - topology.lo[0], by = (y0 >> 7) + (n >> 5 & 31) - topology.lo[1], bz = (z0 >> 7) + (n & 31) - topology.lo[2];
    int block = -1;
    if (bx >= 0 && by >= 0 && bz >= 0 && bx < topology.size[0] && by < topology.size[1] && bz < topology.size[2])
        block = topology.block_at[(static_cast<int64_t>(bx) * topology.size[1] + by) * topology.size[2] + bz];
    int64_t entry = tile_bits(background);
    bool child = false;
    if (block >= 0) {
        if (lower[block] >= 0) {
            child = true;
            entry = static_cast<int64_t>(places.lower_at + static_cast<size_t>(lower[block]) * sizeof(NanoLower)) -
                    static_cast<int64_t>(places.upper_at + blockIdx.y * sizeof(NanoUpper));
        } else {
            // Without a leaf the whole block is on one side.
            uint64_t any = 0;
            for (int w = 0; w < kBlockWords; ++w) any |= topology.inside[static_cast<size_t>(block) * kBlockWords + w];
            if (any) entry = tile_bits(-background);
        }
    }
    reinterpret_cast<int64_t*>(data->mTable)[n] = entry;
    const unsigned children = __ballot_sync(~0u, child);
    if (n % 32 == 0) reinterpret_cast<uint32_t*>(&data->mChildMask)[n / 32] = children;
    if (n == 0) {
        data->mBBox[0] = nanovdb::Coord(x0, y0, z0);
        data->mBBox[1] = nanovdb::Coord(x0, y0, z0);
    }
}

__global__ void make_lowers(NodePlaces places, TopologyView topology, const uint32_t* lower_block, float background) {
    auto* data = (reinterpret_cast<NanoLower*>(places.buffer + places.lower_at) + blockIdx.x)->data();
    const int block = static_cast<int>(lower_block[blockIdx.x]);
    const int64_t here = static_cast<int64_t>(places.lower_at + blockIdx.x * sizeof(NanoLower));
    for (int n = threadIdx.x; n < kBlockLeaves; n += blockDim.x) {
        const int64_t leaf = topology.leaf_number(block, n);
        const bool inside = topology.inside[static_cast<size_t>(block) * kBlockWords + n / 64] >> (n & 63) & 1;
        reinterpret_cast<int64_t*>(data->mTable)[n] = leaf >= 0 ? static_cast<int64_t>(places.leaf_at + static_cast<size_t>(leaf) * sizeof(NanoLeaf)) - here
                                                                : tile_bits(inside ? -background : background);
    }
    for (int w = threadIdx.x; w < kBlockWords; w += blockDim.x)
        reinterpret_cast<uint64_t*>(&data->mChildMask)[w] = topology.leaves[static_cast<size_t>(block) * kBlockWords + w];
    if (threadIdx.x == 0) {
        const int4 o = topology.origin[block];
        data->mBBox[0] = nanovdb::Coord(o.x, o.y, o.z);
        data->mBBox[1] = nanovdb::Coord(o.x, o.y, o.z);
    }
}

/// 128 threads a slot, four voxels each.
__global__ void make_leaves(NodePlaces places, TopologyView topology, LeafSource source, uint32_t* keys) {
    const uint32_t slot = blockIdx.x, key = source.keys[slot];
    const int64_t number = topology.leaf_number(static_cast<int>(key / kBlockLeaves), static_cast<int>(key % kBlockLeaves));
    if (number < 0) return;
    auto* data = (reinterpret_cast<NanoLeaf*>(places.buffer + places.leaf_at) + number)->data();
    const auto* from = reinterpret_cast<const float4*>(source.values + static_cast<size_t>(slot) * kLeafVoxels);
    reinterpret_cast<float4*>(data->mValues)[threadIdx.x] = from[threadIdx.x];
    if (threadIdx.x < 8) reinterpret_cast<uint64_t*>(&data->mValueMask)[threadIdx.x] = source.active[static_cast<size_t>(slot) * 8 + threadIdx.x];
    if (threadIdx.x == 32) {
        const int3 o = topology.leaf_origin(key);
        data->mBBoxMin = nanovdb::Coord(o.x, o.y, o.z);
        data->mBBoxDif[0] = data->mBBoxDif[1] = data->mBBoxDif[2] = data->mFlags = 0;
        data->mMinimum = data->mMaximum = data->mAverage = data->mStdDevi = 0.f;
        keys[number] = key;
    }
}

struct Box {
    int lo[3], hi[3];
};

__device__ void widen(nanovdb::BBox<nanovdb::Coord>& box, const Box& by) {
    for (int a = 0; a < 3; ++a) {
        atomicMin(&box[0][a], by.lo[a]);
        atomicMax(&box[1][a], by.hi[a]);
    }
}

/// Bounding boxes of the active voxels: of a lower node's leaves, of the lower nodes, of all. Node boxes hold origins before, which
/// the leaves' keys replace here.
__global__ void make_boxes(NodePlaces places, TopologyView topology, const uint32_t* keys, uint32_t leaf_count, NanoRoot* root, const int32_t* lower) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= leaf_count) return;
    auto* data = (reinterpret_cast<NanoLeaf*>(places.buffer + places.leaf_at) + n)->data();
    const auto* words = reinterpret_cast<const uint64_t*>(&data->mValueMask);
    uint64_t all = 0;
    int x0 = 8, x1 = -1;
    for (int x = 0; x < 8; ++x) {
        if (!words[x]) continue;
        all |= words[x];
        x0 = min(x0, x);
        x1 = max(x1, x);
    }
    if (!all) return;
    unsigned z = 0;
    int y0 = 8, y1 = -1;
    for (int y = 0; y < 8; ++y) {
        const unsigned row = static_cast<unsigned>(all >> (8 * y)) & 255u;
        if (!row) continue;
        z |= row;
        y0 = min(y0, y);
        y1 = max(y1, y);
    }
    const int z0 = __ffs(z) - 1, z1 = 31 - __clz(z);
    const int3 o = topology.leaf_origin(keys[n]);
    const Box box{{o.x + x0, o.y + y0, o.z + z0}, {o.x + x1, o.y + y1, o.z + z1}};
    data->mBBoxMin = nanovdb::Coord(box.lo[0], box.lo[1], box.lo[2]);
    data->mBBoxDif[0] = static_cast<uint8_t>(x1 - x0);
    data->mBBoxDif[1] = static_cast<uint8_t>(y1 - y0);
    data->mBBoxDif[2] = static_cast<uint8_t>(z1 - z0);
    data->mFlags = 2;  // has a box
    auto* parent = (reinterpret_cast<NanoLower*>(places.buffer + places.lower_at) + lower[keys[n] / kBlockLeaves])->data();
    widen(parent->mBBox, box);
    widen(root->data()->mBBox, box);
}

__global__ void empty_boxes(NodePlaces places, uint32_t lowers, uint32_t uppers) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    const auto clear = [](nanovdb::BBox<nanovdb::Coord>& box) {
        box[0] = nanovdb::Coord::max();
        box[1] = nanovdb::Coord::min();
    };
    if (n < lowers) clear((reinterpret_cast<NanoLower*>(places.buffer + places.lower_at) + n)->data()->mBBox);
    else if (n < lowers + uppers) clear((reinterpret_cast<NanoUpper*>(places.buffer + places.upper_at) + (n - lowers))->data()->mBBox);
}

/// A block of threads an upper node.
__global__ void __launch_bounds__(kLeafVoxels) mark_walls(const Grid::Leaf* leaves, float threshold, uint32_t* walls) {
    const uint32_t n = blockIdx.x;
    const int t = threadIdx.x;
    const unsigned word = __ballot_sync(~0u, leaves[n].data()->mValues[t] < threshold);
    if (t % 32 == 0) walls[16 * n + t / 32] = word;
}

__global__ void make_upper_boxes(NodePlaces places, const uint32_t* numbers, const uint32_t* upper_first, const int32_t* lower, uint32_t uppers) {
    for (uint32_t u = blockIdx.x; u < uppers; u += gridDim.x) {
        auto* data = (reinterpret_cast<NanoUpper*>(places.buffer + places.upper_at) + u)->data();
        for (uint32_t b = upper_first[numbers[u]] + threadIdx.x; b < upper_first[numbers[u] + 1]; b += blockDim.x) {
            if (lower[b] < 0) continue;
            const auto& child = (reinterpret_cast<const NanoLower*>(places.buffer + places.lower_at) + lower[b])->data()->mBBox;
            widen(data->mBBox, {{child[0][0], child[0][1], child[0][2]}, {child[1][0], child[1][1], child[1][2]}});
        }
    }
}

__global__ void list_neighbours(TopologyView topology, const uint32_t* keys, uint32_t count, int32_t* out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= 6 * count) return;
    const int face = static_cast<int>(n % 6), step = face % 2 ? 1 : -1;
    out[n] = static_cast<int32_t>(topology.neighbour(keys[n / 6], face / 2 == 0 ? step : 0, face / 2 == 1 ? step : 0, face / 2 == 2 ? step : 0));
}

}  // namespace

void Topology::cover(const std::array<int, 3>& min, const std::array<int, 3>& max, const Stream& stream) {
    std::vector<std::array<int, 3>> origins;
    for (int i = min[0] & ~(kBlockSide - 1); i < max[0]; i += kBlockSide)
        for (int j = min[1] & ~(kBlockSide - 1); j < max[1]; j += kBlockSide)
            for (int k = min[2] & ~(kBlockSide - 1); k < max[2]; k += kBlockSide) origins.push_back({i, j, k});
    cover(std::move(origins), stream);
}

void Topology::cover(std::vector<std::array<int, 3>> origins, const Stream& stream) {
    if (origins.size() >= (size_t{1} << 20))
        throw BackendError("CUDA: " + std::to_string(origins.size()) + " blocks of 128^3 voxels, at most a million. Remedy: fewer voxels, or --backend cpu");
    const auto upper_of = [](const std::array<int, 3>& o) { return std::array<int, 3>{o[0] & ~4095, o[1] & ~4095, o[2] & ~4095}; };
    std::sort(origins.begin(), origins.end(), [&](const auto& a, const auto& b) {
        const auto ua = upper_of(a), ub = upper_of(b);
        return ua != ub ? ua < ub : a < b;
    });
    if (ready_ && origins == origins_) {  // as for the run before: the tables are there
        stream.zero(leaves_.data(), origins_.size() * kBlockWords);
        stream.zero(inside_.data(), origins_.size() * kBlockWords);
        return;
    }
    ready_ = false;
    origins_ = std::move(origins);
    uppers_.clear();
    upper_first_.clear();
    int hi[3];
    for (int a = 0; a < 3; ++a) lo_[a] = INT_MAX, hi[a] = INT_MIN;
    for (size_t b = 0; b < origins_.size(); ++b) {
        const auto upper = upper_of(origins_[b]);
        if (uppers_.empty() || uppers_.back() != upper) {
            uppers_.push_back(upper);
            upper_first_.push_back(static_cast<uint32_t>(b));
        }
        for (size_t a = 0; a < 3; ++a) {
            lo_[a] = std::min(lo_[a], origins_[b][a] >> 7);
            hi[a] = std::max(hi[a], origins_[b][a] >> 7);
        }
    }
    upper_first_.push_back(static_cast<uint32_t>(origins_.size()));
    for (int a = 0; a < 3; ++a) size_[a] = origins_.empty() ? 0 : hi[a] - lo_[a] + 1;
    const size_t cells = static_cast<size_t>(size_[0]) * static_cast<size_t>(size_[1]) * static_cast<size_t>(size_[2]);
    if (cells > (size_t{1} << 28)) throw BackendError("CUDA: the grid's blocks are too far apart. Remedy: --backend cpu");
    lookup_.assign(cells, -1);
    for (size_t b = 0; b < origins_.size(); ++b) {
        const auto at = [&](size_t a) { return static_cast<size_t>((origins_[b][a] >> 7) - lo_[a]); };
        lookup_[(at(0) * static_cast<size_t>(size_[1]) + at(1)) * static_cast<size_t>(size_[2]) + at(2)] = static_cast<int>(b);
    }
    upload(stream);
}

void Topology::cover_like(const Topology& other, const Stream& stream) { cover(other.origins_, stream); }

void Topology::upload(const Stream& stream) {
    const size_t n = origins_.size();
    std::vector<int4> four(n);
    for (size_t b = 0; b < n; ++b) four[b] = make_int4(origins_[b][0], origins_[b][1], origins_[b][2], 0);
    stream.to_device(device_origins_.ensure(n), four.data(), n);
    stream.to_device(block_at_.ensure(lookup_.size()), lookup_.data(), lookup_.size());
    stream.to_device(device_upper_first_.ensure(upper_first_.size()), upper_first_.data(), upper_first_.size());
    leaves_.ensure(n * kBlockWords);
    inside_.ensure(n * kBlockWords);
    word_first_.ensure(n * kBlockWords);
    first_.ensure(n);
    lower_.ensure(n);
    lower_block_.ensure(n);
    device_counts_.ensure(3 + uppers_.size());
    counts_.ensure(3 + uppers_.size());
    stream.zero(leaves_.data(), n * kBlockWords);
    stream.zero(inside_.data(), n * kBlockWords);
    stream.wait();  // `four` goes away
    ready_ = true;
}

void Topology::number_leaves(const Stream& stream) {
    const int n = static_cast<int>(origins_.size()), uppers = static_cast<int>(uppers_.size());
    if (n == 0) {
        stream.wait();
        std::fill_n(counts_.data(), 3, 0u);
        return;
    }
    count_leaves<<<blocks_for(static_cast<size_t>(n) * 32, 256), 256, 0, stream.get()>>>(leaves_.data(), n, word_first_.data(), first_.data());
    VDBCARVE_LAUNCHED();
    scan_blocks<<<1, kScanThreads, 0, stream.get()>>>(first_.data(), n, lower_.data(), lower_block_.data(), device_upper_first_.data(), uppers,
                                                      device_counts_.data());
    VDBCARVE_LAUNCHED();
    stream.to_host(counts_.data(), device_counts_.data(), 3 + static_cast<size_t>(uppers));
}

TopologyView Topology::view() const {
    TopologyView v{};
    v.origin = device_origins_.data();
    v.leaves = leaves_.data();
    v.inside = inside_.data();
    v.word_first = word_first_.data();
    v.first = first_.data();
    v.block_at = block_at_.data();
    for (int a = 0; a < 3; ++a) v.lo[a] = lo_[a], v.size[a] = size_[a];
    v.blocks = static_cast<int>(origins_.size());
    return v;
}

void Grid::build(const Topology& topology, const GridSpec& spec, const LeafSource& source, const Stream& stream) {
    spec_ = spec;
    stream.wait();  // for the counts
    const uint32_t leaves = topology.counts_[0], lowers = topology.counts_[1];
    std::vector<uint32_t> uppers;
    for (size_t u = 0; u < topology.uppers_.size(); ++u)
        if (topology.counts_[3 + u] > topology.counts_[2 + u]) uppers.push_back(static_cast<uint32_t>(u));
    const uint32_t tiles = static_cast<uint32_t>(uppers.size());
    const size_t tree_at = NanoGrid::memUsage(), root_at = tree_at + NanoTree::memUsage();
    NodePlaces places{};
    places.upper_at = root_at + NanoRoot::memUsage(tiles);
    places.lower_at = places.upper_at + uppers.size() * sizeof(NanoUpper);
    places.leaf_at = places.lower_at + lowers * sizeof(NanoLower);
    size_ = places.leaf_at + leaves * sizeof(NanoLeaf);
    leaf_at_ = places.leaf_at;
    leaf_count_ = leaves;
    places.buffer = buffer_.ensure(size_);
    keys_.ensure(leaves);
    upper_numbers_.ensure(uppers.size());

    // Grid, tree and root are small: made here.
    uint8_t* head = head_.ensure(places.upper_at + uppers.size() * sizeof(uint32_t));
    std::memset(head, 0, places.upper_at);
    auto* grid = reinterpret_cast<nanovdb::GridData*>(head);
    grid->mMagic = NANOVDB_MAGIC_NUMBER;
    grid->mVersion = nanovdb::Version();
    grid->mFlags = static_cast<uint32_t>(nanovdb::GridFlags::IsBreadthFirst);
    grid->mGridCount = 1;
    grid->mGridSize = size_;
    std::strncpy(grid->mGridName, spec.name.c_str(), nanovdb::GridData::MaxNameSize - 1);
    grid->mMap.set(spec.voxel_size, nanovdb::Vec3d(spec.first_voxel_world[0], spec.first_voxel_world[1], spec.first_voxel_world[2]), 1.0);
    grid->mWorldBBox = nanovdb::BBox<nanovdb::Vec3R>();
    grid->mVoxelSize = nanovdb::Vec3R(spec.voxel_size);
    grid->mGridClass = nanovdb::GridClass::LevelSet;
    grid->mGridType = nanovdb::GridType::Float;
    auto* tree = reinterpret_cast<NanoTree::DataType*>(head + tree_at);
    tree->mNodeOffset[3] = root_at - tree_at;
    tree->mNodeOffset[2] = uppers.empty() ? 0 : places.upper_at - tree_at;
    tree->mNodeOffset[1] = lowers ? places.lower_at - tree_at : 0;
    tree->mNodeOffset[0] = leaves ? places.leaf_at - tree_at : 0;
    tree->mNodeCount[0] = leaves;
    tree->mNodeCount[1] = lowers;
    tree->mNodeCount[2] = tiles;
    auto* root = reinterpret_cast<NanoRoot::DataType*>(head + root_at);
    root->mBBox[0] = nanovdb::Coord::max();
    root->mBBox[1] = nanovdb::Coord::min();
    root->mTableSize = tiles;
    root->mBackground = root->mMinimum = root->mMaximum = spec.background;
    for (uint32_t n = 0; n < tiles; ++n) {
        const auto& o = topology.uppers_[uppers[n]];
        auto* tile = root->tile(n);
        tile->key = NanoRoot::DataType::CoordToKey(nanovdb::Coord(o[0], o[1], o[2]));
        tile->child = static_cast<int64_t>(places.upper_at + n * sizeof(NanoUpper)) - static_cast<int64_t>(root_at);
    }
    auto* numbers = reinterpret_cast<uint32_t*>(head + places.upper_at);
    std::copy(uppers.begin(), uppers.end(), numbers);
    stream.to_device(places.buffer, head, places.upper_at);
    if (leaves == 0) return;
    stream.to_device(upper_numbers_.data(), numbers, uppers.size());
    stream.zero(places.buffer + places.upper_at, places.leaf_at - places.upper_at);

    const TopologyView view = topology.view();
    const cudaStream_t s = stream.get();
    make_uppers<<<dim3(32768 / 256, tiles), 256, 0, s>>>(places, view, topology.lower_.data(), topology.device_upper_first_.data(), upper_numbers_.data(),
                                                         spec.background);
    VDBCARVE_LAUNCHED();
    make_lowers<<<lowers, 512, 0, s>>>(places, view, topology.lower_block_.data(), spec.background);
    VDBCARVE_LAUNCHED();
    make_leaves<<<source.slots, 128, 0, s>>>(places, view, source, keys_.data());
    VDBCARVE_LAUNCHED();
    empty_boxes<<<blocks_for(lowers + tiles, 128), 128, 0, s>>>(places, lowers, tiles);
    VDBCARVE_LAUNCHED();
    make_boxes<<<blocks_for(leaves, 128), 128, 0, s>>>(places, view, keys_.data(), leaves, reinterpret_cast<NanoRoot*>(places.buffer + root_at),
                                                       topology.lower_.data());
    VDBCARVE_LAUNCHED();
    make_upper_boxes<<<tiles, 256, 0, s>>>(places, upper_numbers_.data(), topology.device_upper_first_.data(), topology.lower_.data(), tiles);
    VDBCARVE_LAUNCHED();
}

void build_walls(const Grid& grid, float threshold, uint64_t* out, const Stream& stream) {
    mark_walls<<<grid.leaf_count(), kLeafVoxels, 0, stream.get()>>>(grid.leaves(), threshold, reinterpret_cast<uint32_t*>(out));
    VDBCARVE_LAUNCHED();
}

void find_neighbours(const Topology& topology, const Grid& grid, int32_t* out, const Stream& stream) {
    const uint32_t n = grid.leaf_count();
    list_neighbours<<<blocks_for(6 * static_cast<size_t>(n), 256), 256, 0, stream.get()>>>(topology.view(), grid.keys(), n, out);
    VDBCARVE_LAUNCHED();
}

}  // namespace vdbcarve::cuda
