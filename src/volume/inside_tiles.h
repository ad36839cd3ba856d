// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/openvdb.h>

namespace vdbcarve {

/// Calls visit(first voxel, voxels a side: 8, 128 or 4096) for every tile that is inside, in the tree's order.
template <class Visit>
void for_inside_tiles(const openvdb::FloatTree& tree, const Visit& visit) {
    using Tiles = openvdb::FloatTree::ValueAllCIter;
    Tiles tile = tree.cbeginValueAll();
    tile.setMaxDepth(Tiles::LEAF_DEPTH - 1);
    for (; tile; ++tile)
        if (*tile < 0.f) {
            const openvdb::CoordBBox box = tile.getBoundingBox();
            visit(box.min(), box.dim().x());
        }
}

/// The level at which a tree holds tiles of so many voxels a side.
inline openvdb::Index tile_level(int side) { return side == 8 ? 1 : side == 128 ? 2 : 3; }

}  // namespace vdbcarve
