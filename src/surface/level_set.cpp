// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/level_set.h"

#include <openvdb/tools/ChangeBackground.h>
#include <openvdb/tools/Morphology.h>
#include <openvdb/tools/Prune.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <openvdb/tree/LeafManager.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <array>
#include <atomic>
#include <cmath>

#include "volume/inside_tiles.h"
#include "volume/leaf_neighbours.h"
#include "surface/redistance.h"
#include "vdbcarve/kernel/level_set.h"
#include "volume/same_transform.h"
#include "base/vector_loops.h"

namespace vdbcarve {

namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

/// Where voxel (i, j, k), each -1..8, of a leaf stands in a 10^3 halo.
constexpr int halo_at(int i, int j, int k) { return (i + 1) * 100 + (j + 1) * 10 + (k + 1); }

/// Copies a leaf's values and the facing layers of its neighbours into a halo. `values_of(number)` are a neighbour's 512;
/// `beyond` stands in for a missing neighbour's, or the leaf's own border values do where it is null.
template <class ValuesOf>
void fill_halo(const std::array<int32_t, 6>& neighbours, const float* own, const ValuesOf& values_of, const float* beyond, float* halo) {
    for (int i = 0; i < 8; ++i)
        for (int j = 0; j < 8; ++j) std::copy_n(own + (i << 6 | j << 3), 8, halo + halo_at(i, j, 0));
    const auto layer = [&](int face, const auto& source, const auto& target) {
        const int32_t n = neighbours[static_cast<size_t>(face)];
        const float* from = n < 0 ? nullptr : values_of(n);
        for (int a = 0; a < 8; ++a)
            for (int b = 0; b < 8; ++b)
                halo[target(a, b)] = from ? from[source(a, b)] : (beyond ? *beyond : own[source(a, b) ^ (7 << (face / 2 == 0 ? 6 : face / 2 == 1 ? 3 : 0))]);
    };
    layer(
        0, [](int a, int b) { return 7 << 6 | a << 3 | b; }, [](int a, int b) { return halo_at(-1, a, b); });
    layer(
        1, [](int a, int b) { return a << 3 | b; }, [](int a, int b) { return halo_at(8, a, b); });
    layer(
        2, [](int a, int b) { return a << 6 | 7 << 3 | b; }, [](int a, int b) { return halo_at(a, -1, b); });
    layer(
        3, [](int a, int b) { return a << 6 | b; }, [](int a, int b) { return halo_at(a, 8, b); });
    layer(
        4, [](int a, int b) { return a << 6 | b << 3 | 7; }, [](int a, int b) { return halo_at(a, b, -1); });
    layer(
        5, [](int a, int b) { return a << 6 | b << 3; }, [](int a, int b) { return halo_at(a, b, 8); });
}

}  // namespace

openvdb::FloatGrid::Ptr level_set(openvdb::FloatGrid::Ptr hull, const LevelSetOptions& options, Progress& progress) {
    if (options.half_width_vox < 2 || options.half_width_vox > 100)
        throw UsageError("level_set: half-width is " + std::to_string(options.half_width_vox) + " voxels, must be 2..100");
    return redistance(std::move(hull), options.half_width_vox, nullptr, progress);
}

int64_t inside_tile_voxels(const openvdb::FloatTree& tree) {
    int64_t out = 0;
    for_inside_tiles(tree, [&](const openvdb::Coord&, int side) { out += static_cast<int64_t>(side) * side * side; });
    return out;
}

int64_t volume_units(const openvdb::FloatGrid& surface) {
    std::vector<const Leaf*> leaves;
    surface.tree().getNodes(leaves);
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    std::atomic<int64_t> sum{0};
    tbb::parallel_for(tbb::blocked_range<size_t>(0, leaves.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
        int64_t part = 0;
        for (size_t n = range.begin(); n < range.end(); ++n)
            for (int at = 0; at < kLeafVoxels; ++at) part += kernel::filled_units(leaves[n]->buffer().data()[at] / voxel);
        sum += part;
    });
    return sum + inside_tile_voxels(surface.tree()) * kernel::kVolumeUnits;
}

openvdb::FloatGrid::Ptr redistance(openvdb::FloatGrid::Ptr hull, int half_width_vox, VolumeRepair* repair, Progress& progress) {
    // Reads better whole: the passes share the leaves, their buffers and what of them is decided.
    const auto voxel = static_cast<float>(hull->voxelSize()[0]);
    // A surface that may be moved needs a band that still reaches far enough afterwards.
    const int solved_vox = half_width_vox + (repair && repair->move ? 1 : 0);
    const float band_vox = static_cast<float>(solved_vox), band = static_cast<float>(half_width_vox) * voxel;

    openvdb::FloatGrid::Ptr surface = std::move(hull);
    surface->setName("surface");
    surface->setGridClass(openvdb::GRID_LEVEL_SET);
    std::vector<Leaf*> leaves;
    surface->tree().getNodes(leaves);
    const size_t count = leaves.size();
    const auto neighbours = neighbours_of(leaves, numbers_of(leaves));
    const int passes = kernel::level_set_passes(solved_vox);
    progress.begin("level_set", static_cast<size_t>(passes) + 2);
    const VectorLoops& loops = vector_loops();

    // Voxels beside the surface are measured from the raw values and fixed (negative); the others wait at the band's edge.
    // Two sets of distances take turns, one of them in the leaves themselves, whose signs are kept as bits.
    std::vector<float> beside_leaves(count * kLeafVoxels);
    std::vector<uint64_t> inside(count * 8, 0);
    std::vector<char> changed(count, 1), changes(count, 1);
    std::atomic<bool> crosses{false};
    const auto in_leaves = [&](size_t n) { return leaves[n]->buffer().data(); };
    const auto in_array = [&](size_t n) { return beside_leaves.data() + n * kLeafVoxels; };
    const auto for_leaves = [&](const auto& work) {
        tbb::parallel_for(tbb::blocked_range<size_t>(0, count, 16), [&](const tbb::blocked_range<size_t>& range) {
            alignas(64) float halo[1000] = {};
            for (size_t n = range.begin(); n < range.end(); ++n) work(n, halo);
        });
        progress.step();
    };
    for_leaves([&](size_t n, float* halo) {
        const float* raw = in_leaves(n);
        bool both = false;
        fill_halo(
            neighbours[n], raw, [&](int32_t m) -> const float* { return in_leaves(static_cast<size_t>(m)); }, nullptr, halo);
        loops.measure_leaf(halo, band_vox, in_array(n));
        for (size_t i = 0; i < 8; ++i) {
            uint64_t word = 0;
            for (size_t jk = 0; jk < 64; ++jk) word |= static_cast<uint64_t>(raw[i << 6 | jk] < 0.f) << jk;
            inside[n * 8 + i] = word;
        }
        for (int at = 0; at < kLeafVoxels; ++at) both |= in_array(n)[at] < 0.f;
        if (both) crosses.store(true, std::memory_order_relaxed);
    });
    if (!crosses) throw InputError("level_set: the hull has no zero crossing");

    const auto sweep = [&](const auto& from, const auto& to, bool first) {
        for_leaves([&](size_t n, float* halo) {
            // A leaf that did not change, and whose neighbours did not, holds the same in both sets.
            bool again = changed[n] != 0;
            for (const int32_t m : neighbours[n]) again = again || (m >= 0 && changed[static_cast<size_t>(m)] != 0);
            changes[n] = 0;
            if (!again) return;
            fill_halo(
                neighbours[n], from(n), [&](int32_t m) -> const float* { return from(static_cast<size_t>(m)); }, &band_vox, halo);
            changes[n] = loops.redistance_leaf(halo, band_vox, to(n)) != 0 || first;
        });
        changed.swap(changes);
    };
    for (int pass = 0; pass < passes; ++pass) {
        if (pass % 2) sweep(in_leaves, in_array, pass == 0);
        else sweep(in_array, in_leaves, pass == 0);
    }

    const auto solved = [&](size_t n) -> const float* { return passes % 2 ? in_leaves(n) : in_array(n); };
    if (repair) {
        const int64_t tiles = inside_tile_voxels(surface->tree()) * kernel::kVolumeUnits;
        repair_volume(*repair, [&](float offset) {
            std::atomic<int64_t> volume{tiles}, area{0};
            for_leaves([&](size_t n, float*) {
                int64_t part = 0, crossed = 0;
                for (int at = 0; at < kLeafVoxels; ++at) {
                    const float d = std::fabs(solved(n)[at]), moved = (inside[n * 8 + static_cast<size_t>(at >> 6)] >> (at & 63) & 1 ? -d : d) - offset;
                    part += kernel::filled_units(moved);
                    crossed += std::fabs(moved) < 0.5f;
                }
                volume += part;
                area += crossed;
            });
            return std::pair<int64_t, int64_t>(volume, area);
        });
    }
    const float offset = repair ? static_cast<float>(repair->offset_vox) : 0.f, kept_vox = static_cast<float>(half_width_vox);
    for_leaves([&](size_t n, float*) {
        Leaf& leaf = *leaves[n];
        const float* from = solved(n);
        float* values = leaf.buffer().data();
        openvdb::util::NodeMask<3> active;
        for (size_t i = 0; i < 8; ++i) {
            uint64_t word = 0;
            for (size_t jk = 0; jk < 64; ++jk) {
                const size_t at = i << 6 | jk;
                const kernel::BandVoxel v = kernel::band_voxel(std::fabs(from[at]), inside[n * 8 + i] >> jk & 1, offset, kept_vox);
                word |= static_cast<uint64_t>(v.active) << jk;
                values[at] = v.active ? v.distance_vox * voxel : (v.distance_vox < 0.f ? -band : band);
            }
            active.getWord<openvdb::Index64>(static_cast<openvdb::Index>(i)) = word;
        }
        leaf.setValueMask(active);
    });
    openvdb::tools::changeBackground(surface->tree(), band);
    openvdb::tools::pruneLevelSet(surface->tree());
    return surface;
}

openvdb::FloatGrid::Ptr halves_of_occupancy(const openvdb::MaskGrid& occupancy, int half_width_vox) {
    const auto voxel = static_cast<float>(occupancy.voxelSize()[0]);
    const float band = static_cast<float>(half_width_vox) * voxel;
    // Active tiles become voxels only near the border: dilate the voxelised mask's complement by topology.
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(band);
    grid->setTransform(same_transform(occupancy.transform()));
    openvdb::MaskTree wide(occupancy.tree());
    openvdb::tools::dilateActiveValues(wide, half_width_vox, openvdb::tools::NN_FACE, openvdb::tools::EXPAND_TILES);
    openvdb::MaskTree narrow(occupancy.tree());
    openvdb::tools::erodeActiveValues(narrow, half_width_vox, openvdb::tools::NN_FACE, openvdb::tools::EXPAND_TILES);
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
    return grid;
}

openvdb::FloatGrid::Ptr level_set_of_occupancy(const openvdb::MaskGrid& occupancy, const LevelSetOptions& options, Progress& progress) {
    return level_set(halves_of_occupancy(occupancy, options.half_width_vox), options, progress);
}

openvdb::FloatGrid::Ptr density_of(const openvdb::FloatGrid& surface) {
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    const float scale = 1.f / (2.f * 1.5f * voxel);
    openvdb::FloatGrid::Ptr density = surface.deepCopy();
    density->setTransform(same_transform(surface.transform()));
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
