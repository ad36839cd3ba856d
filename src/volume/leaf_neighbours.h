// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <array>
#include <unordered_map>
#include <vector>

#include "vdbcarve/kernel/filter.h"

namespace vdbcarve {

template <class Leaf>
std::unordered_map<openvdb::Coord, int32_t> numbers_of(const std::vector<Leaf*>& leaves) {
    std::unordered_map<openvdb::Coord, int32_t> out;
    out.reserve(2 * leaves.size());
    for (size_t n = 0; n < leaves.size(); ++n) out[leaves[n]->origin()] = static_cast<int32_t>(n);
    return out;
}

/// The six face neighbours of every leaf by number (`number`: numbers_of() them), -1 where there is none: -x +x -y +y -z +z.
template <class Leaf>
std::vector<std::array<int32_t, 6>> neighbours_of(const std::vector<Leaf*>& leaves, const std::unordered_map<openvdb::Coord, int32_t>& number) {
    std::vector<std::array<int32_t, 6>> out(leaves.size());
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        for (int f = 0; f < 6; ++f) {
            openvdb::Coord c = leaves[n]->origin();
            c[f / 2] += f % 2 ? 8 : -8;
            const auto found = number.find(c);
            out[n][static_cast<size_t>(f)] = found == number.end() ? -1 : found->second;
        }
    });
    return out;
}

/// The leaf itself and all 26 around it by number, (dx + 1) * 9 + (dy + 1) * 3 + dz + 1; kernel::kOutsideTile or kInsideTile where there is none.
template <class Tree, class Leaf>
std::vector<std::array<int32_t, 27>> surroundings_of(const Tree& tree, const std::vector<Leaf*>& leaves) {
    const auto number = numbers_of(leaves);
    std::vector<std::array<int32_t, 27>> out(leaves.size());
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        for (int a = 0; a < 27; ++a) {
            const openvdb::Coord c = leaves[n]->origin().offsetBy(8 * (a / 9 - 1), 8 * (a / 3 % 3 - 1), 8 * (a % 3 - 1));
            const auto found = number.find(c);
            out[n][static_cast<size_t>(a)] = found != number.end() ? found->second : tree.getValue(c) < 0.f ? kernel::kInsideTile : kernel::kOutsideTile;
        }
    });
    return out;
}

}  // namespace vdbcarve
