// SPDX-License-Identifier: Apache-2.0
// Lines of sight through a level set, by a hierarchical DDA on NanoVDB's nodes (HDDA, Museth 2014): cells that are empty are crossed
// whole, whatever their size.
//
// Not NanoVDB's own ZeroCrossing: it takes cells to begin, not to be centred, at integers, wants bounding boxes that a grid built on the
// device has not, skips the voxel after every node's border, and its steps cost three times as much on a CPU (calls of fmaf and floorf).
#pragma once

#include <nanovdb/NanoVDB.h>

#include "vdbcarve/kernel/carve.h"

namespace vdbcarve::kernel {

/// Where colouring counts from: index coordinates less this, a multiple of 4096 (the widest cell) near the surface, so that floats are fine
/// however far away the world's origin is.
struct ColorBase {
    int i, j, k;
};

/// Coordinates beyond which there is nothing to be hit, from the base.
struct SightBox {
    float lo[3], hi[3];
};

/// Eight words of a leaf's voxels, word i holding bit (j << 3 | k): set where a voxel stands in the way.
inline constexpr int kWallWords = 8;

/// A level set for looking through. Borrowed.
struct SightGrid {
    const nanovdb::NanoGrid<float>* grid;
    const uint64_t* walls;  ///< kWallWords a leaf, in the grid's order: value < threshold
    float threshold;        ///< world units; of tiles
    ColorBase base;
};

/// A step beyond a cell's border, in voxels, so that rounding does not find the cell before it again.
inline constexpr float kBeyondBorder_vox = 1e-3f;

/// The node of 128^3 voxels around a voxel, at hand for the next one. (An accessor of NanoVDB's that has a leaf at hand finds it without looking at the nodes
/// above, and keeps those of another.)
template <class Value>
class BlockCache {
  public:
    using Lower = nanovdb::NanoLower<Value>;
    VDBCARVE_HD explicit BlockCache(const nanovdb::NanoGrid<Value>& grid) : grid_(&grid) {}

    VDBCARVE_HD void find(const nanovdb::Coord& c) {
        if (known_ && !(((c[0] ^ block_[0]) | (c[1] ^ block_[1]) | (c[2] ^ block_[2])) & ~127)) return;
        known_ = true;
        block_ = c;
        lower = nullptr;
        const auto accessor = grid_->getAccessor();
        width = static_cast<int>(accessor.getDim(c, 0));  // the second argument is for rays, and not looked at
        if (width < 128) lower = accessor.template getNode<Lower>();
        else active = accessor.probeValue(c, tile);
    }

    const Lower* lower = nullptr;  ///< null: a tile, of which the rest tells
    int width = 0;                 ///< 128 or 4096
    Value tile{};
    bool active = false;

  private:
    const nanovdb::NanoGrid<Value>* grid_;
    nanovdb::Coord block_;
    bool known_ = false;
};

/// How wide the empty cell is that holds a voxel (coordinates from the base): 1 to 4096, a power of two, aligned to itself; 0: the voxel stands in the way.
class SightCells {
  public:
    VDBCARVE_HD explicit SightCells(const SightGrid& grid) : grid_(grid), first_(grid.grid->tree().template getFirstNode<0>()), block_(*grid.grid) {}

    VDBCARVE_HD int width(const nanovdb::Coord& from_base) {
        const nanovdb::Coord c(from_base[0] + grid_.base.i, from_base[1] + grid_.base.j, from_base[2] + grid_.base.k);
        block_.find(c);
        if (!block_.lower) return block_.tile < grid_.threshold ? 0 : block_.width;
        const auto* node = block_.lower->data();
        const uint32_t n = BlockCache<float>::Lower::CoordToOffset(c);
        if (!node->mChildMask.isOn(n)) {
            if (node->mTable[n].value < grid_.threshold) return 0;
            // Without a leaf, 32 or 16 voxels around may be: x leads by four words, y by a quarter of one. A side changes
            // only across leaves, so that where there are none all tiles are alike.
            const uint32_t x = n >> 8, y = n >> 4 & 15, z = n & 15;
            const uint64_t quarter = uint64_t{0x000f000f000f000f} << (z & 12);
            uint64_t any = 0;
            for (uint32_t i = x & 12; i < (x & 12) + 4; ++i) any |= word(node, i, y) & quarter;
            if (!any) return 32;
            const uint64_t eighth = (uint64_t{0x00030003} << (y & 2 ? 32 : 0)) << (z & 14);
            for (uint32_t i = x & 14; i < (x & 14) + 2; ++i)
                if (word(node, i, y) & eighth) return 8;
            return 16;
        }
        const uint64_t* walls = grid_.walls + kWallWords * (node->getChild(n) - first_);
        const int i = c[0] & 7, j = c[1] & 7, k = c[2] & 7;
        const uint64_t row = walls[i];
        if (row >> (j << 3 | k) & 1) return 0;
        const uint64_t pair = (row | walls[i ^ 1]) & uint64_t{0x0303} << ((j & 6) << 3 | (k & 6));
        if (pair) return 1;
        uint64_t octant = 0;
        for (int a = i & 4; a < (i & 4) + 4; ++a) octant |= walls[a];
        if (octant & uint64_t{0x0f0f0f0f} << ((j & 4) << 3 | (k & 4))) return 2;
        for (int a = 4 - (i & 4); a < 8 - (i & 4); ++a) octant |= walls[a];
        return octant ? 4 : 8;
    }

  private:
    template <class Data>
    VDBCARVE_HD static uint64_t word(const Data* node, uint32_t x, uint32_t y) {
        return node->mChildMask.template getWord<uint64_t>(static_cast<int>(x << 2 | y >> 2));
    }

    const SightGrid& grid_;
    const nanovdb::NanoLeaf<float>* first_;
    BlockCache<float> block_;
};

/// A ray through cells (the cubes around voxel centres). Every step is computed from the start: no error builds up.
struct CellWalk {
    float from[3], along[3], inverse[3];
    float at = 0.f;  ///< voxels from the start
    float end;
    nanovdb::Coord cell;

    /// From `start` along `direction` (unit) up to `length` voxels or the box's far side.
    VDBCARVE_HD CellWalk(const SightBox& box, const Vec3& start, const Vec3& direction, float length)
        : from{start.x + 0.5f, start.y + 0.5f, start.z + 0.5f}, along{direction.x, direction.y, direction.z}, end(length) {
        for (int a = 0; a < 3; ++a) {
            inverse[a] = along[a] == 0.f ? 0.f : 1.f / along[a];
            if (along[a] != 0.f) end = min_f(end, ((along[a] > 0.f ? box.hi[a] : box.lo[a]) - from[a]) * inverse[a]);
        }
        cell = nanovdb::Coord(floor_of(from[0]), floor_of(from[1]), floor_of(from[2]));
    }
    /// How far the way goes within the aligned cell of so many voxels that holds `cell`.
    VDBCARVE_HD float border(int width) const {
        float leave = 1e30f;
        for (int a = 0; a < 3; ++a) {
            if (along[a] == 0.f) continue;
            const int low = cell[a] & ~(width - 1);
            leave = min_f(leave, (static_cast<float>(along[a] > 0.f ? low + width : low) - from[a]) * inverse[a]);
        }
        return leave;
    }
    VDBCARVE_HD void go(float to) {
        at = to;
        for (int a = 0; a < 3; ++a) cell[a] = floor_of(from[a] + at * along[a]);
    }
    VDBCARVE_HD void leave(int width) { go(max_f(border(width), at) + kBeyondBorder_vox); }
};

/// True when a voxel that stands in the way has its cell on the way from `start` along `direction` (unit) up to `length` voxels.
VDBCARVE_HD bool is_blocked(SightCells& cells, const SightBox& box, const Vec3& start, const Vec3& direction, float length) {
    CellWalk walk(box, start, direction, length);
    while (walk.at <= walk.end) {
        const int width = cells.width(walk.cell);
        if (width == 0) return true;
        walk.leave(width);
    }
    return false;
}

}  // namespace vdbcarve::kernel
