// SPDX-License-Identifier: Apache-2.0
// Which voxels hang together. Private.
#pragma once

#include <openvdb/openvdb.h>

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace vdbcarve {

/// The pieces of a level set's inside, or of its outside, connected by faces of voxels. Borrows the tree. Time: that of reading the leaves.
class Pieces {
  public:
    Pieces(const openvdb::FloatGrid& surface, bool inside);

    /// The piece that a voxel belongs to; -1 where it is on the other side.
    int64_t at(const openvdb::Coord& c) const;
    /// The same for a voxel of a leaf, by the leaf's number in the tree's order.
    int64_t in_leaf(size_t leaf, openvdb::Index voxel) const;
    /// visit(piece) for what a leaf has of them, the same piece more than once where it is several within the leaf.
    template <class Visit>
    void for_each_in_leaf(size_t leaf, const Visit& visit) const {
        for (uint32_t x = first_[leaf]; x < first_[leaf + 1]; ++x) visit(int64_t{parent_[x]});
    }
    int64_t voxels(int64_t piece) const { return voxels_[static_cast<size_t>(piece)]; }
    /// Of the outside: the piece that goes on for ever, whose voxels are not counted.
    int64_t open() const { return open_; }

    /// visit(piece, its voxels), in order of numbers.
    template <class Visit>
    void for_each(const Visit& visit) const {
        for (uint32_t x = 0; x < parent_.size(); ++x)
            if (parent_[x] == x && voxels_[x] > 0) visit(x, voxels_[x]);
    }

  private:
    struct Tile {
        openvdb::Coord origin;
        int side;
    };
    uint32_t root_of(uint32_t x);
    /// The tile that a voxel lies in, none where it is on the other side or in a leaf.
    int64_t tile_at(const openvdb::Coord& c) const;

    const openvdb::FloatTree& tree_;
    bool inside_;
    std::vector<const openvdb::FloatTree::LeafNodeType*> leaves_;
    std::unordered_map<openvdb::Coord, int32_t> leaf_number_;
    std::vector<uint8_t> labels_;  ///< of a leaf's voxels
    std::vector<uint32_t> first_;  ///< piece of each leaf
    std::vector<Tile> tiles_;
    std::unordered_map<openvdb::Coord, uint32_t> tile_number_;
    std::vector<uint32_t> parent_;
    std::vector<int64_t> voxels_;
    uint32_t open_ = UINT32_MAX;
};

/// What carving left that nobody can have seen.
struct Fragments {
    size_t fragments = 0, dropped_voxels = 0;  ///< pieces of less than a share of the piece of before that they were part of
    size_t voids = 0, filled_voxels = 0;       ///< carved, and enclosed
};

/// Removes them from a field whose leaves hold its zero crossing, and from nothing that was so before.
Fragments remove_fragments(openvdb::FloatGrid& carved, const openvdb::FloatGrid& before, double least_share);

}  // namespace vdbcarve
