// SPDX-License-Identifier: Apache-2.0
#include <numeric>

#include "inside_tiles.h"
#include "leaf_neighbours.h"
#include "vdbcarve/filter.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;
using openvdb::Coord;

constexpr int kVoxels = 512;

/// Numbers the pieces of a leaf's inside; returns how many there are (at most 256, every second voxel).
uint32_t label_leaf(const Leaf& leaf, uint8_t* label) {
    const float* values = leaf.buffer().data();
    bool done[kVoxels] = {};
    uint16_t stack[kVoxels];
    uint32_t count = 0;
    for (int seed = 0; seed < kVoxels; ++seed) {
        if (done[seed] || !(values[seed] < 0.f)) continue;
        int top = 0;
        const auto visit = [&](int at) {
            if (done[at] || !(values[at] < 0.f)) return;
            done[at] = true;
            label[at] = static_cast<uint8_t>(count);
            stack[top++] = static_cast<uint16_t>(at);
        };
        visit(seed);
        while (top) {
            const int at = stack[--top], i = at >> 6, j = at >> 3 & 7, k = at & 7;
            if (i) visit(at - 64);
            if (i < 7) visit(at + 64);
            if (j) visit(at - 8);
            if (j < 7) visit(at + 8);
            if (k) visit(at - 1);
            if (k < 7) visit(at + 1);
        }
        ++count;
    }
    return count;
}

}  // namespace

std::vector<double> component_volumes(const openvdb::FloatGrid& surface) {
    const openvdb::FloatTree& tree = surface.tree();
    std::vector<const Leaf*> leaves;
    tree.getNodes(leaves);
    const size_t count = leaves.size();
    const auto around = neighbours_of(leaves);
    std::vector<uint8_t> labels(count * kVoxels);
    std::vector<uint32_t> first(count + 1, 0);
    tbb::parallel_for(size_t{0}, count, [&](size_t n) { first[n + 1] = label_leaf(*leaves[n], labels.data() + n * kVoxels); });
    for (size_t n = 0; n < count; ++n) first[n + 1] += first[n];

    // Tiles inside are one piece each, numbered after the leaves'.
    struct Tile {
        Coord origin;
        int side;
    };
    std::vector<Tile> tiles;
    std::unordered_map<Coord, uint32_t> tile_number;
    for_inside_tiles(tree, [&](const Coord& origin, int side) {
        tile_number[origin] = first[count] + static_cast<uint32_t>(tiles.size());
        tiles.push_back({origin, side});
    });
    std::vector<uint32_t> parent(first[count] + tiles.size());
    std::vector<int64_t> voxels(parent.size(), 0);
    std::iota(parent.begin(), parent.end(), 0u);
    const auto find = [&](uint32_t x) {
        while (parent[x] != x) x = parent[x] = parent[parent[x]];
        return x;
    };
    const auto join = [&](uint32_t x, uint32_t y) {
        x = find(x);
        y = find(y);
        if (x != y) parent[std::max(x, y)] = std::min(x, y);
    };
    openvdb::FloatGrid::ConstAccessor access = surface.getConstAccessor();
    /// The tile that a voxel lies in, none where it is outside or in a leaf.
    const auto tile_at = [&](const Coord& c) -> int64_t {
        if (access.probeConstLeaf(c) || !(access.getValue(c) < 0.f)) return -1;
        for (const int side : {8, 128, 4096})
            if (const auto found = tile_number.find(c & ~(side - 1)); found != tile_number.end() && tiles[found->second - first[count]].side == side) return found->second;
        return -1;
    };
    for (size_t n = 0; n < count; ++n) {
        const float* values = leaves[n]->buffer().data();
        const uint8_t* mine = labels.data() + n * kVoxels;
        for (int at = 0; at < kVoxels; ++at)
            if (values[at] < 0.f) ++voxels[first[n] + mine[at]];
        for (int f = 0; f < 6; ++f) {
            const int shift = f / 2 == 0 ? 6 : f / 2 == 1 ? 3 : 0, near = f % 2 ? 7 : 0, far = 7 - near;
            const int32_t m = around[n][static_cast<size_t>(f)];
            if (m >= 0 && f % 2 == 0) continue;  // seen from the other side
            Coord beyond = leaves[n]->origin();
            beyond[f / 2] += f % 2 ? 8 : -8;
            const int64_t whole = m < 0 ? tile_at(beyond) : -1;
            if (m < 0 && whole < 0) continue;
            for (int at = 0; at < kVoxels; ++at) {
                if ((at >> shift & 7) != near || !(values[at] < 0.f)) continue;
                const uint32_t here = first[n] + mine[at];
                if (m < 0) {
                    join(here, static_cast<uint32_t>(whole));
                } else {
                    const int there = at + ((far - near) << shift);
                    if (leaves[static_cast<size_t>(m)]->buffer().data()[there] < 0.f) join(here, first[static_cast<size_t>(m)] + labels[static_cast<size_t>(m) * kVoxels + static_cast<size_t>(there)]);
                }
            }
        }
    }
    for (size_t t = 0; t < tiles.size(); ++t) {
        const auto [o, side] = tiles[t];
        const uint32_t here = first[count] + static_cast<uint32_t>(t);
        voxels[here] += static_cast<int64_t>(side) * side * side;
        for (int axis = 0; axis < 3; ++axis)
            for (const int step : {-8, side})
                for (int a = 0; a < side; a += 8)
                    for (int b = 0; b < side; b += 8) {
                        Coord c = o;
                        c[axis] += step;
                        c[(axis + 1) % 3] += a;
                        c[(axis + 2) % 3] += b;
                        if (const int64_t other = tile_at(c); other >= 0) join(here, static_cast<uint32_t>(other));
                    }
    }
    for (uint32_t x = 0; x < parent.size(); ++x)
        if (const uint32_t root = find(x); root != x) voxels[root] += voxels[x];
    std::vector<double> out;
    const double voxel = surface.voxelSize()[0];
    for (uint32_t x = 0; x < parent.size(); ++x)
        if (parent[x] == x && voxels[x] > 0) out.push_back(static_cast<double>(voxels[x]) * voxel * voxel * voxel);
    std::sort(out.rbegin(), out.rend());
    return out;
}

size_t count_pieces(const openvdb::FloatGrid& surface) {
    const std::vector<double> volumes = component_volumes(surface);
    const double voxel = surface.voxelSize()[0], least = kLeastPiece_vox * voxel * voxel * voxel * (1 - 1e-9);
    return static_cast<size_t>(std::count_if(volumes.begin(), volumes.end(), [least](double v) { return v >= least; }));
}

}  // namespace vdbcarve
