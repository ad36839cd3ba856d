// SPDX-License-Identifier: Apache-2.0
// Where the table is that an object stands on. Private.
#pragma once

#include <openvdb/openvdb.h>

#include <functional>
#include <optional>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct Floor {
    double height = 0;     ///< along up, world units
    double likeness = 0;   ///< correlation, 0..1, of what neighbouring views see on it around the object; 0: it was told by contours
    double next_best = 0;  ///< the same of the best plane elsewhere
};

/// The plane across `up` that photographs show around the object: what two neighbouring views see at a place of the table is alike only at the table's
/// height (a plane sweep; Collins, "A space-sweep approach to true multi-image matching", CVPR 1996). Shadows lie on the table and help; a reflection lies
/// below it, moves against it, and does not. Planes from `lowest` - 0.3 height to `highest` of the hull are asked, to a thousandth of its height.
/// Nothing where no plane stands out: a table without any pattern, or none in the picture. photo_of(i): RGB or grey, without lens distortion, the size of the
/// mask, or empty. Time: the photographs' decoding, and some hundred pictures of 64 x 64 for each view.
std::optional<Floor> find_table(const openvdb::FloatGrid& hull, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks,
                                const std::function<Image8(size_t)>& photo_of, const Vec3d& up, Progress& progress);

}  // namespace vdbcarve
