// SPDX-License-Identifier: Apache-2.0
// A NanoVDB grid of floats that is built where its leaves are: on the device.
//
// Index space is covered by blocks of 128^3 voxels, what NanoVDB calls lower nodes, in NanoVDB's own order. A stage says, as
// one bit for each leaf of a block, which leaves there are and which other leaves lie inside the object; build() makes root,
// upper and lower nodes of that, and takes the leaves' values. Later versions of NanoVDB bring builders of their own: they
// would replace build().
#pragma once

#include <nanovdb/NanoVDB.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "device_buffer.h"
#include "stream.h"

namespace vdbcarve::cuda {

inline constexpr int kLeafVoxels = 512;
inline constexpr int kBlockSide = 128;     ///< voxels along a block
inline constexpr int kBlockLeaves = 4096;  ///< 16^3
inline constexpr int kBlockWords = kBlockLeaves / 64;

/// Borrowed by kernels. A leaf's key is block * kBlockLeaves + its offset in the block (x << 8 | y << 4 | z, in leaves).
struct TopologyView {
    const int4* origin;          ///< of each block, index coordinates
    uint64_t* leaves;            ///< kBlockWords words a block: leaves that exist
    uint64_t* inside;            ///< leaves that do not exist and are inside the object
    const uint16_t* word_first;  ///< leaves of the block in the words before each word
    const uint32_t* first;       ///< leaves in the blocks before
    const int* block_at;         ///< number of the block at a place of the bounding lattice of blocks, or -1
    int lo[3], size[3];          ///< of that lattice, in blocks
    int blocks;

#if defined(__CUDACC__)
    /// Sets a leaf's bit in `leaves` or `inside`, by its key.
    __device__ static void mark(uint64_t* bits, uint32_t key) { atomicOr(reinterpret_cast<unsigned long long*>(bits) + key / 64, 1ull << (key & 63)); }
    /// Number of the block that holds a voxel, or -1; and its leaf's offset in there.
    __device__ int block_of(int x, int y, int z) const {
        const int bx = (x >> 7) - lo[0], by = (y >> 7) - lo[1], bz = (z >> 7) - lo[2];
        if (bx < 0 || by < 0 || bz < 0 || bx >= size[0] || by >= size[1] || bz >= size[2]) return -1;
        return block_at[(static_cast<int64_t>(bx) * size[1] + by) * size[2] + bz];
    }
    __device__ static int offset_of(int x, int y, int z) { return (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15); }
    /// Whether a leaf that does not exist lies inside.
    __device__ bool is_inside(int block, int offset) const { return inside[static_cast<size_t>(block) * kBlockWords + offset / 64] >> (offset & 63) & 1; }
    /// Number of a leaf, or -1 where there is none.
    __device__ int64_t leaf_number(int block, int offset) const {
        const uint64_t word = leaves[block * kBlockWords + (offset >> 6)];
        const uint64_t bit = uint64_t{1} << (offset & 63);
        if (!(word & bit)) return -1;
        return static_cast<int64_t>(first[block]) + word_first[block * kBlockWords + (offset >> 6)] + __popcll(word & (bit - 1));
    }
    /// The same for the leaf that is (dx, dy, dz) leaves away, each -1..1, from the one with the key.
    __device__ int64_t neighbour(uint32_t key, int dx, int dy, int dz) const {
        int block = static_cast<int>(key / kBlockLeaves);
        const int offset = static_cast<int>(key % kBlockLeaves);
        const int x = (offset >> 8) + dx, y = (offset >> 4 & 15) + dy, z = (offset & 15) + dz;
        if ((x | y | z) & ~15) {
            const int4 o = origin[block];
            const int bx = (o.x >> 7) + (x >> 4) - lo[0], by = (o.y >> 7) + (y >> 4) - lo[1], bz = (o.z >> 7) + (z >> 4) - lo[2];
            if (bx < 0 || by < 0 || bz < 0 || bx >= size[0] || by >= size[1] || bz >= size[2]) return -1;
            block = block_at[(static_cast<int64_t>(bx) * size[1] + by) * size[2] + bz];
            if (block < 0) return -1;
        }
        return leaf_number(block, (x & 15) << 8 | (y & 15) << 4 | (z & 15));
    }
    /// First voxel of a leaf.
    __device__ int3 leaf_origin(uint32_t key) const {
        const int4 o = origin[key / kBlockLeaves];
        const int offset = static_cast<int>(key % kBlockLeaves);
        return make_int3(o.x + (offset >> 8) * 8, o.y + (offset >> 4 & 15) * 8, o.z + (offset & 15) * 8);
    }
#endif
};

class Topology {
  public:
    /// Blocks that cover the voxels min <= index < max.
    void cover(const std::array<int, 3>& min, const std::array<int, 3>& max, const Stream& stream);
    /// The given blocks (origins, multiples of 128, no two equal; any order).
    void cover(std::vector<std::array<int, 3>> origins, const Stream& stream);
    /// The blocks of another topology, without leaves.
    void cover_like(const Topology& other, const Stream& stream);
    /// Counts leaves block by block; what TopologyView::leaf_number needs, and build().
    void number_leaves(const Stream& stream);
    /// Leaves numbered. Waits for the device.
    uint32_t leaf_count(const Stream& stream) const {
        stream.wait();
        return counts_.data()[0];
    }

    TopologyView view() const;
    const std::vector<std::array<int, 3>>& origins() const { return origins_; }
    size_t bytes() const {
        return leaves_.bytes() + inside_.bytes() + device_origins_.bytes() + block_at_.bytes() + word_first_.bytes() + first_.bytes() + lower_.bytes() +
               lower_block_.bytes();
    }

  private:
    friend class Grid;
    void upload(const Stream& stream);

    std::vector<std::array<int, 3>> origins_;
    std::vector<std::array<int, 3>> uppers_;  ///< origins of the 4096^3 nodes that hold blocks, in order
    std::vector<uint32_t> upper_first_;       ///< first block of each, and one past the last
    std::vector<int> lookup_;
    int lo_[3] = {}, size_[3] = {};
    bool ready_ = false;             ///< the device has the tables of origins_
    PinnedBuffer<uint32_t> counts_;  ///< leaves, lower nodes; then the lower nodes before each upper node's blocks, and all
    DeviceBuffer<int4> device_origins_;
    DeviceBuffer<int> block_at_;
    DeviceBuffer<uint64_t> leaves_, inside_;
    DeviceBuffer<uint16_t> word_first_;
    DeviceBuffer<uint32_t> first_, device_counts_, device_upper_first_;
    DeviceBuffer<int32_t> lower_;         ///< number of the block's lower node; negative where it has none
    DeviceBuffer<uint32_t> lower_block_;  ///< and back
};

/// Where the values of leaves lie, slot by slot; slots whose leaf the topology does not have are skipped.
struct LeafSource {
    const float* values;     ///< kLeafVoxels a slot
    const uint64_t* active;  ///< 8 words a slot
    const uint32_t* keys;
    uint32_t slots;
};

struct GridSpec {
    std::string name;
    double voxel_size;
    std::array<double, 3> first_voxel_world;  ///< centre of voxel (0, 0, 0)
    float background;                         ///< outside; tiles inside hold its negative
};

/// A level set on the device. The buffer holds a valid nanovdb::NanoGrid<float>, its layout that of nanovdb::openToNanoVDB, statistics
/// and checksum apart, which are filled on the host (finish_nanovdb).
class Grid {
  public:
    /// Builds the grid of a topology whose leaves are numbered. Waits for the device once, for the counts.
    void build(const Topology& topology, const GridSpec& spec, const LeafSource& leaves, const Stream& stream);

    using Leaf = nanovdb::NanoLeaf<float>;
    const nanovdb::NanoGrid<float>* grid() const { return reinterpret_cast<const nanovdb::NanoGrid<float>*>(buffer_.data()); }
    const Leaf* leaves() const { return reinterpret_cast<const Leaf*>(buffer_.data() + leaf_at_); }
    const uint32_t* keys() const { return keys_.data(); }
    uint32_t leaf_count() const { return leaf_count_; }
    size_t size() const { return size_; }
    const GridSpec& spec() const { return spec_; }
    size_t bytes() const { return buffer_.bytes() + keys_.bytes(); }

  private:
    GridSpec spec_;
    DeviceBuffer<uint8_t> buffer_;
    DeviceBuffer<uint32_t> keys_;
    DeviceBuffer<uint32_t> upper_numbers_;
    PinnedBuffer<uint8_t> head_;
    size_t size_ = 0, leaf_at_ = 0;
    uint32_t leaf_count_ = 0;
};

/// kernel::SightGrid::walls: a bit for every voxel of every leaf, set where the value is below the threshold; 8 words a leaf.
void build_walls(const Grid& grid, float threshold, uint64_t* out, const Stream& stream);

/// The six face neighbours of every leaf by number, -1 where there is none: -x +x -y +y -z +z; 6 a leaf.
void find_neighbours(const Topology& topology, const Grid& grid, int32_t* out, const Stream& stream);

}  // namespace vdbcarve::cuda
