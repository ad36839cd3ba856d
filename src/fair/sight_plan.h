// SPDX-License-Identifier: Apache-2.0
// What the lines of sight of a level are asked with: cameras in its voxels, and how large a sample of the pictures is.
#pragma once

#include <openvdb/math/Transform.h>

#include <algorithm>
#include <array>
#include <vector>

#include "vdbcarve/distance.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/kernel/fair.h"
#include "vdbcarve/kernel/fair_mask.h"

namespace vdbcarve::fairing {

/// The leaves' places on a level of the pyramid.
struct LeafLattice {
    int shift = 0;                    ///< its voxels are 2^shift of the finest ones wide
    std::array<int, 3> lo{}, size{};  ///< leaves

    /// Of the hull's longest side: the leaves at both ends hold little more than its band.
    double longest_vox() const { return 8.0 * *std::max_element(size.begin(), size.end()) - 16; }
    size_t places() const { return static_cast<size_t>(size[0]) * static_cast<size_t>(size[1]) * static_cast<size_t>(size[2]); }
    size_t place(int x, int y, int z) const {
        return (static_cast<size_t>(x - lo[0]) * static_cast<size_t>(size[1]) + static_cast<size_t>(y - lo[1])) * static_cast<size_t>(size[2]) +
               static_cast<size_t>(z - lo[2]);
    }
};

struct SightPlan {
    int scale = 1;      ///< pixels a side of a sample
    bool exact = true;  ///< samples are pixels, and all are asked in the end; else every second
    DistanceOptions fields;
    std::vector<MaskView> masks;
    std::vector<kernel::FairEye> eyes;
};

/// `scale` 0: samples about as large as a voxel of the lattice. `exact`: where that is a pixel. The masks are borrowed from the views.
SightPlan plan_sight(const LeafLattice& lattice, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale, bool exact);

/// How far, in voxels of a level, the hull of a ball as large as the lattice stands out between the contours of two neighbouring views. Views from (nearly) the
/// same place count as one. 0 without two places.
double between_contours_vox(const LeafLattice& lattice, const openvdb::math::Transform& finest, const std::vector<FairView>& views);

/// Of a view's distances, whose samples lie wherever.
kernel::FairMask mask_of(const DistanceField& header, const int16_t* silhouette, const int16_t* ignored);

}  // namespace vdbcarve::fairing
