// SPDX-License-Identifier: Apache-2.0
// The dense method: every voxel asks every view. Shares the per-voxel arithmetic with the product and nothing
// of its tree walk, so it must agree bit for bit.
#pragma once

#include <vector>

#include "vdbcarve/carve.h"

namespace vdbcarve::test {

struct DenseVolume {
    IndexBox box;
    std::vector<float> value;  ///< hull value, or 1 / 0 of the occupancy

    float at(int i, int j, int k) const {
        const int nj = box.max[1] - box.min[1], nk = box.max[2] - box.min[2];
        return value[(static_cast<size_t>(i - box.min[0]) * static_cast<size_t>(nj) + static_cast<size_t>(j - box.min[1])) * static_cast<size_t>(nk) +
                     static_cast<size_t>(k - box.min[2])];
    }
};

/// Values over the bounds and `margin_vox` around them. Takes the same options as carve().
DenseVolume dense_carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, int margin_vox);

}  // namespace vdbcarve::test
