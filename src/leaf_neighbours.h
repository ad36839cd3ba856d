// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <array>
#include <unordered_map>
#include <vector>

namespace vdbcarve {

/// The six face neighbours of every leaf by number, -1 where there is none: -x +x -y +y -z +z.
template <class Leaf>
std::vector<std::array<int32_t, 6>> neighbours_of(const std::vector<Leaf*>& leaves) {
    std::unordered_map<openvdb::Coord, int32_t> number;
    number.reserve(2 * leaves.size());
    for (size_t n = 0; n < leaves.size(); ++n) number[leaves[n]->origin()] = static_cast<int32_t>(n);
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

}  // namespace vdbcarve
