// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_invoke.h>

#include <map>
#include <numeric>
#include <optional>
#include <set>

#include "volume/inside_tiles.h"
#include "volume/leaf_neighbours.h"
#include "surface/pieces.h"
#include "vdbcarve/filter.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;
using openvdb::Coord;

constexpr int kVoxels = 512;

/// Numbers the pieces of a leaf's inside (or of its outside); returns how many there are (at most 256, every second voxel).
uint32_t label_leaf(const Leaf& leaf, bool inside, uint8_t* label) {
    const float* values = leaf.buffer().data();
    bool done[kVoxels] = {};
    uint16_t stack[kVoxels];
    uint32_t count = 0;
    for (int seed = 0; seed < kVoxels; ++seed) {
        if (done[seed] || (values[seed] < 0.f) != inside) continue;
        int top = 0;
        const auto visit = [&](int at) {
            if (done[at] || (values[at] < 0.f) != inside) return;
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

Pieces::Pieces(const openvdb::FloatGrid& surface, bool inside) : tree_(surface.tree()), inside_(inside) {
    tree_.getNodes(leaves_);
    const size_t count = leaves_.size();
    leaf_number_ = numbers_of(leaves_);
    const auto around = neighbours_of(leaves_, leaf_number_);
    labels_.resize(count * kVoxels);
    first_.assign(count + 1, 0);
    tbb::parallel_for(size_t{0}, count, [&](size_t n) { first_[n + 1] = label_leaf(*leaves_[n], inside_, labels_.data() + n * kVoxels); });
    for (size_t n = 0; n < count; ++n) first_[n + 1] += first_[n];

    // Tiles inside are one piece each, numbered after the leaves'; outside all of them are one, the open.
    if (inside_)
        for_inside_tiles(tree_, [&](const Coord& origin, int side) {
            tile_number_[origin] = first_[count] + static_cast<uint32_t>(tiles_.size());
            tiles_.push_back({origin, side});
        });
    parent_.resize(first_[count] + (inside_ ? tiles_.size() : 1));
    voxels_.assign(parent_.size(), 0);
    std::iota(parent_.begin(), parent_.end(), 0u);
    const auto join = [&](uint32_t x, uint32_t y) {
        x = root_of(x);
        y = root_of(y);
        if (x != y) parent_[std::max(x, y)] = std::min(x, y);
    };
    // What touches across the leaves' faces, found side by side and joined one by one.
    std::vector<std::vector<std::pair<uint32_t, uint32_t>>> touching(count);
    tbb::parallel_for(size_t{0}, count, [&](size_t n) {
        const float* values = leaves_[n]->buffer().data();
        const uint8_t* mine = labels_.data() + n * kVoxels;
        const auto is_ours = [&](float v) { return (v < 0.f) == inside_; };
        for (int at = 0; at < kVoxels; ++at)
            if (is_ours(values[at])) ++voxels_[first_[n] + mine[at]];
        for (int f = 0; f < 6; ++f) {
            const int shift = f / 2 == 0 ? 6 : f / 2 == 1 ? 3 : 0, near = f % 2 ? 7 : 0, far = 7 - near;
            const int32_t m = around[n][static_cast<size_t>(f)];
            if (m >= 0 && f % 2 == 0) continue;  // seen from the other side
            Coord beyond = leaves_[n]->origin();
            beyond[f / 2] += f % 2 ? 8 : -8;
            const int64_t whole = m < 0 ? tile_at(beyond) : -1;
            if (m < 0 && whole < 0) continue;
            for (int at = 0; at < kVoxels; ++at) {
                if ((at >> shift & 7) != near || !is_ours(values[at])) continue;
                std::pair<uint32_t, uint32_t> pair(first_[n] + mine[at], static_cast<uint32_t>(whole));
                if (m >= 0) {
                    const int there = at + ((far - near) << shift);
                    if (!is_ours(leaves_[static_cast<size_t>(m)]->buffer().data()[there])) continue;
                    pair.second = first_[static_cast<size_t>(m)] + labels_[static_cast<size_t>(m) * kVoxels + static_cast<size_t>(there)];
                }
                if (touching[n].empty() || touching[n].back() != pair) touching[n].push_back(pair);
            }
        }
    });
    for (const auto& pairs : touching)
        for (const auto& [here, there] : pairs) join(here, there);
    std::vector<std::vector<uint32_t>> beside(tiles_.size());  // what touches a tile's faces to +x, +y and +z; the other three faces are found from there
    tbb::parallel_for(size_t{0}, tiles_.size(), [&](size_t t) {
        const auto [o, side] = tiles_[t];
        voxels_[first_[count] + t] += static_cast<int64_t>(side) * side * side;
        for (int axis = 0; axis < 3; ++axis)
            for (int a = 0; a < side; a += 8)
                for (int b = 0; b < side; b += 8) {
                    Coord c = o;
                    c[axis] += side;
                    c[(axis + 1) % 3] += a;
                    c[(axis + 2) % 3] += b;
                    const int64_t other = tile_at(c);
                    if (other >= 0 && (beside[t].empty() || beside[t].back() != other)) beside[t].push_back(static_cast<uint32_t>(other));
                }
    });
    for (size_t t = 0; t < tiles_.size(); ++t)
        for (const uint32_t other : beside[t]) join(first_[count] + static_cast<uint32_t>(t), other);
    for (uint32_t x = 0; x < parent_.size(); ++x) {
        const uint32_t root = root_of(x);
        parent_[x] = root;
        if (root != x) voxels_[root] += voxels_[x];
    }
    open_ = inside_ ? UINT32_MAX : parent_[first_[count]];
}

uint32_t Pieces::root_of(uint32_t x) {
    while (parent_[x] != x) x = parent_[x] = parent_[parent_[x]];
    return x;
}

int64_t Pieces::tile_at(const Coord& c) const {
    if (leaf_number_.count(c & ~7) || (tree_.getValue(c) < 0.f) != inside_) return -1;
    if (!inside_) return first_.back();
    for (const int side : {8, 128, 4096})
        if (const auto found = tile_number_.find(c & ~(side - 1)); found != tile_number_.end() && tiles_[found->second - first_.back()].side == side)
            return found->second;
    return -1;
}

int64_t Pieces::in_leaf(size_t leaf, openvdb::Index n) const {
    return (leaves_[leaf]->getValue(n) < 0.f) == inside_ ? int64_t{parent_[first_[leaf] + labels_[leaf * kVoxels + n]]} : int64_t{-1};
}

int64_t Pieces::at(const Coord& c) const {
    if (const auto found = leaf_number_.find(c & ~7); found != leaf_number_.end()) return in_leaf(static_cast<size_t>(found->second), Leaf::coordToOffset(c));
    const int64_t tile = tile_at(c);
    return tile < 0 ? int64_t{-1} : int64_t{parent_[static_cast<size_t>(tile)]};
}

std::vector<double> component_volumes(const openvdb::FloatGrid& surface) {
    const Pieces pieces(surface, true);
    std::vector<double> out;
    const double voxel = surface.voxelSize()[0];
    pieces.for_each([&](uint32_t, int64_t voxels) { out.push_back(static_cast<double>(voxels) * voxel * voxel * voxel); });
    std::sort(out.rbegin(), out.rend());
    return out;
}

namespace {

/// Fills what the carved field encloses and the field of before does not. `leaves`: the carved one's.
void fill_voids(const openvdb::FloatGrid& carved, const openvdb::FloatGrid& before, const std::vector<Leaf*>& leaves, Fragments& out) {
    const Pieces voids(carved, false);
    std::vector<std::set<int64_t>> filled(leaves.size());
    std::vector<size_t> voxels(leaves.size(), 0);
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t l) {
        bool encloses = false;  // few leaves do
        voids.for_each_in_leaf(l, [&](int64_t piece) { encloses = encloses || piece != voids.open(); });
        for (openvdb::Index n = 0; encloses && n < kVoxels; ++n) {
            const int64_t piece = voids.in_leaf(l, n);
            if (piece < 0 || piece == voids.open()) continue;
            const float was = before.tree().getValue(leaves[l]->offsetToGlobalCoord(n));
            if (!(was < 0.f)) continue;  // the hull has that cavity, too
            leaves[l]->setValueOnly(n, was);
            filled[l].insert(piece);
            ++voxels[l];
        }
    });
    std::set<int64_t> all;
    for (const auto& f : filled) all.insert(f.begin(), f.end());
    out.voids = all.size();
    out.filled_voxels = std::accumulate(voxels.begin(), voxels.end(), size_t{0});
}

}  // namespace

Fragments remove_fragments(openvdb::FloatGrid& carved, const openvdb::FloatGrid& before, double least_share) {
    Fragments out;
    const float band = carved.background();
    std::vector<Leaf*> leaves;
    carved.tree().getNodes(leaves);
    std::optional<Pieces> of_carved, of_before;  // made side by side: depths nearly always leave fragments, and then both are needed
    tbb::parallel_invoke(
        [&] {
            fill_voids(carved, before, leaves, out);
            of_carved.emplace(carved, true);
        },
        [&] { of_before.emplace(before, true); });
    const Pieces &pieces = *of_carved, &whole = *of_before;
    size_t count = 0;
    pieces.for_each([&](uint32_t, int64_t) { ++count; });
    if (count < 2) return out;
    std::map<int64_t, bool> drop;  // by piece
    const auto is_dropped = [&](int64_t piece, const auto& first_voxel) {
        const auto [known, fresh] = drop.emplace(piece, false);
        if (fresh) {
            const int64_t of = whole.at(first_voxel());
            known->second = of >= 0 && static_cast<double>(pieces.voxels(piece)) < least_share * static_cast<double>(whole.voxels(of));
            if (known->second) ++out.fragments, out.dropped_voxels += static_cast<size_t>(pieces.voxels(piece));
        }
        return known->second;
    };
    std::vector<size_t> with_dropped;
    for (size_t l = 0; l < leaves.size(); ++l) {
        bool dropped = false;
        pieces.for_each_in_leaf(l, [&](int64_t piece) {
            const auto first_voxel = [&] {
                openvdb::Index n = 0;
                while (pieces.in_leaf(l, n) != piece) ++n;
                return leaves[l]->offsetToGlobalCoord(n);
            };
            dropped = is_dropped(piece, first_voxel) || dropped;
        });
        if (dropped) with_dropped.push_back(l);
    }
    tbb::parallel_for(size_t{0}, with_dropped.size(), [&](size_t d) {
        Leaf& leaf = *leaves[with_dropped[d]];
        for (openvdb::Index n = 0; n < kVoxels; ++n) {
            const int64_t piece = pieces.in_leaf(with_dropped[d], n);
            if (piece >= 0 && drop.at(piece)) leaf.setValueOnly(n, band);
        }
    });
    std::vector<std::pair<Coord, int>> tiles;
    for_inside_tiles(carved.tree(), [&](const Coord& origin, int side) {
        if (is_dropped(pieces.at(origin), [&] { return origin; })) tiles.emplace_back(origin, side);
    });
    for (const auto& [origin, side] : tiles) carved.tree().addTile(tile_level(side), origin, band, false);
    return out;
}

size_t count_pieces(const openvdb::FloatGrid& surface) {
    const std::vector<double> volumes = component_volumes(surface);
    const double voxel = surface.voxelSize()[0], least = kLeastPiece_vox * voxel * voxel * voxel * (1 - 1e-9);
    return static_cast<size_t>(std::count_if(volumes.begin(), volumes.end(), [least](double v) { return v >= least; }));
}

}  // namespace vdbcarve
