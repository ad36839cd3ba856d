// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/level_set.h"

#include <openvdb/tools/FastSweeping.h>
#include <openvdb/tools/Morphology.h>
#include <openvdb/tools/Prune.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <openvdb/tree/LeafManager.h>

#include <cmath>

namespace vdbcarve {

openvdb::FloatGrid::Ptr level_set(const openvdb::FloatGrid& hull, const LevelSetOptions& options, Progress& progress) {
    progress.begin("level_set", 2);
    const auto voxel = static_cast<float>(hull.voxelSize()[0]);
    const float band = static_cast<float>(options.half_width_vox) * voxel;
    if (hull.activeVoxelCount() == 0) throw InputError("level_set: the hull has no surface");
    openvdb::FloatGrid::Ptr surface = openvdb::tools::sdfToSdf(hull, 0.0f, options.iterations);
    if (!surface) throw InputError("level_set: the hull has no zero crossing");
    progress.step();

    const float least = 1e-6f * voxel;
    openvdb::tree::LeafManager<openvdb::FloatTree> leaves(surface->tree());
    const openvdb::FloatTree& before = hull.tree();
    leaves.foreach ([&](openvdb::FloatTree::LeafNodeType& leaf, size_t) {
        const auto* raw = before.probeConstLeaf(leaf.origin());
        for (openvdb::Index at = 0; at < openvdb::FloatTree::LeafNodeType::SIZE; ++at) {
            const float old = raw ? raw->getValue(at) : leaf.getValue(at);
            const float sign = old < 0.f ? -1.f : 1.f;
            float size = std::fabs(leaf.getValue(at));
            // Sweeping may hand a voxel the other side's sign where two sheets are less than a voxel apart.
            if ((leaf.getValue(at) < 0.f) != (old < 0.f)) size = least;
            if (size < least) size = least;
            if (size >= band) leaf.setValueOff(at, sign * band);
            else leaf.setValueOn(at, sign * size);
        }
    });
    surface->setName("surface");
    surface->setGridClass(openvdb::GRID_LEVEL_SET);
    surface->setTransform(hull.transform().copy());
    openvdb::tools::changeBackground(surface->tree(), band);
    openvdb::tools::pruneLevelSet(surface->tree());
    progress.step();
    return surface;
}

openvdb::FloatGrid::Ptr level_set_of_occupancy(const openvdb::MaskGrid& occupancy, const LevelSetOptions& options, Progress& progress) {
    const auto voxel = static_cast<float>(occupancy.voxelSize()[0]);
    const float band = static_cast<float>(options.half_width_vox) * voxel;
    // Active tiles become voxels only near the border: dilate the voxelised mask's complement by topology.
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(band);
    grid->setTransform(occupancy.transform().copy());
    openvdb::MaskTree wide(occupancy.tree());
    openvdb::tools::dilateActiveValues(wide, options.half_width_vox, openvdb::tools::NN_FACE, openvdb::tools::EXPAND_TILES);
    openvdb::MaskTree narrow(occupancy.tree());
    openvdb::tools::erodeActiveValues(narrow, options.half_width_vox, openvdb::tools::NN_FACE, openvdb::tools::EXPAND_TILES);
    wide.topologyDifference(narrow);
    grid->tree().topologyUnion(wide);
    openvdb::tree::LeafManager<openvdb::FloatTree> leaves(grid->tree());
    leaves.foreach ([&](openvdb::FloatTree::LeafNodeType& leaf, size_t) {
        openvdb::MaskGrid::ConstAccessor inside = occupancy.getConstAccessor();
        for (openvdb::Index at = 0; at < openvdb::FloatTree::LeafNodeType::SIZE; ++at) {
            const openvdb::Coord c = leaf.offsetToGlobalCoord(at);
            const bool in = inside.isValueOn(c);
            bool border = false;
            for (int a = 0; a < 3; ++a)
                for (int d : {-1, 1}) {
                    openvdb::Coord n = c;
                    n[a] += d;
                    border |= inside.isValueOn(n) != in;
                }
            const float value = border ? 0.5f * voxel : band;
            leaf.setValueOnly(at, in ? -value : value);
        }
    });
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    openvdb::tools::signedFloodFill(grid->tree());
    return level_set(*grid, options, progress);
}

openvdb::FloatGrid::Ptr density_of(const openvdb::FloatGrid& surface) {
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    const float scale = 1.f / (2.f * 1.5f * voxel);
    openvdb::FloatGrid::Ptr density = surface.deepCopy();
    density->setName("density");
    density->setGridClass(openvdb::GRID_FOG_VOLUME);
    openvdb::tree::LeafManager<openvdb::FloatTree> leaves(density->tree());
    leaves.foreach ([&](openvdb::FloatTree::LeafNodeType& leaf, size_t) {
        for (openvdb::Index at = 0; at < openvdb::FloatTree::LeafNodeType::SIZE; ++at) {
            const float d = std::min(1.f, std::max(0.f, 0.5f - leaf.getValue(at) * scale));
            if (d > 0.f) leaf.setValueOn(at, d);
            else leaf.setValueOff(at, 0.f);
        }
    });
    // Tiles: inside becomes 1 and active, outside 0 and inactive.
    openvdb::FloatTree& tree = density->tree();
    openvdb::FloatTree::ValueAllIter tiles = tree.beginValueAll();
    tiles.setMaxDepth(openvdb::FloatTree::ValueAllIter::LEAF_DEPTH - 1);
    for (; tiles; ++tiles) {
        const bool inside = *tiles < 0.f;
        tiles.setValue(inside ? 1.f : 0.f);
        tiles.setActiveState(inside);
    }
    tree.root().setBackground(0.f, false);
    openvdb::tools::prune(tree);
    return density;
}

}  // namespace vdbcarve
