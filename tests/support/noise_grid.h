// SPDX-License-Identifier: Apache-2.0
// Grids of class level set that are none: random values, outside all around.
#pragma once

#include <openvdb/openvdb.h>

#include <random>
#include <vector>

namespace vdbcarve::test {

/// side^3 random values in -1..1, white or averaged over 3^3; `tiny`: so near zero that every crossing lies at a voxel, or nowhere
/// in particular.
inline openvdb::FloatGrid::Ptr noise_grid(int side, bool smooth, bool tiny, uint32_t seed) {
    std::mt19937 random(seed);
    const auto at = [&](int i, int j, int k) {
        return (static_cast<size_t>(i) * static_cast<size_t>(side) + static_cast<size_t>(j)) * static_cast<size_t>(side) + static_cast<size_t>(k);
    };
    std::vector<float> values(at(side, 0, 0));
    for (float& v : values) v = static_cast<float>(random() % 200001) / 100000.f - 1.f;
    if (smooth) {
        std::vector<float> mean(values.size(), 1.f);
        for (int i = 1; i + 1 < side; ++i)
            for (int j = 1; j + 1 < side; ++j)
                for (int k = 1; k + 1 < side; ++k) {
                    float sum = 0;
                    for (int n = 0; n < 27; ++n) sum += values[at(i + n / 9 - 1, j + n / 3 % 3 - 1, k + n % 3 - 1)];
                    mean[at(i, j, k)] = sum / 9;
                }
        values = mean;
    }
    if (tiny)
        for (size_t n = 0; n < values.size(); n += 2) values[n] *= 1e-7f;
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(1.f);
    grid->setName("noise");
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    auto access = grid->getAccessor();
    // Off the leaves' borders, and on both sides of zero.
    for (int i = 0; i < side; ++i)
        for (int j = 0; j < side; ++j)
            for (int k = 0; k < side; ++k) access.setValue(openvdb::Coord(i - 19, j - 3, k + 5), values[at(i, j, k)]);
    return grid;
}

}  // namespace vdbcarve::test
