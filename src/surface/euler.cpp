// SPDX-License-Identifier: Apache-2.0
#include "surface/euler.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <bit>
#include <functional>
#include <vector>

#include "surface/pieces.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

/// Which voxels of a leaf and of the layer behind it are inside: bits along z, by x and y.
struct Inside {
    uint32_t row[9][9] = {};

    void add(const openvdb::FloatGrid::ConstAccessor& tree, const openvdb::Coord& origin, int block) {
        const openvdb::Coord at = origin.offsetBy(block & 4 ? 8 : 0, block & 2 ? 8 : 0, block & 1 ? 8 : 0);
        const Leaf* leaf = tree.probeConstLeaf(at);
        if (!leaf && !(tree.getValue(at) < 0.f)) return;
        const int x0 = block & 4 ? 8 : 0, x1 = x0 ? 9 : 8, y0 = block & 2 ? 8 : 0, y1 = y0 ? 9 : 8, z0 = block & 1 ? 8 : 0, z1 = z0 ? 9 : 8;
        for (int x = x0; x < x1; ++x)
            for (int y = y0; y < y1; ++y)
                for (int z = z0; z < z1; ++z)
                    if (!leaf || leaf->getValue(static_cast<openvdb::Index>((x & 7) << 6 | (y & 7) << 3 | (z & 7))) < 0.f) row[x][y] |= 1u << z;
    }
};

long characteristic_of(const Inside& inside) {
    const auto count = [](uint32_t bits) { return static_cast<long>(std::popcount(bits & 0xffu)); };
    const auto along_z = [](uint32_t bits) { return bits & bits >> 1; };
    long out = 0;
    for (int x = 0; x < 8; ++x)
        for (int y = 0; y < 8; ++y) {
            const uint32_t here = inside.row[x][y], by_x = here & inside.row[x + 1][y], by_y = here & inside.row[x][y + 1],
                           by_both = by_x & by_y & inside.row[x + 1][y + 1];
            out += count(here) - count(by_x) - count(by_y) + count(by_both);
            out += -count(along_z(here)) + count(along_z(by_x)) + count(along_z(by_y)) - count(along_z(by_both));
        }
    return out;
}

}  // namespace

long euler_characteristic(const openvdb::FloatGrid& surface) {
    std::vector<const Leaf*> leaves;
    surface.tree().getNodes(leaves);
    // A voxel with nothing but the inside around it adds 1 - 3 + 3 - 1: tiles add nothing.
    return tbb::parallel_reduce(
        tbb::blocked_range<size_t>(0, leaves.size(), 64), 0L,
        [&](const tbb::blocked_range<size_t>& range, long sum) {
            const openvdb::FloatGrid::ConstAccessor tree = surface.getConstAccessor();
            for (size_t n = range.begin(); n < range.end(); ++n) {
                Inside inside;
                for (int block = 0; block < 8; ++block) inside.add(tree, leaves[n]->origin(), block);
                sum += characteristic_of(inside);
            }
            return sum;
        },
        std::plus<>());
}

long count_handles(const openvdb::FloatGrid& surface) {
    long pieces = 0;
    Pieces(surface, true).for_each([&](uint32_t, int64_t) { ++pieces; });
    return pieces - euler_characteristic(surface);
}

}  // namespace vdbcarve
