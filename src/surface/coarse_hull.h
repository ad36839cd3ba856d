// SPDX-License-Identifier: Apache-2.0
// A hull just fine enough to be looked at and measured.
#pragma once

#include <openvdb/openvdb.h>

#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// Level set of the hull in automatic bounds, `resolution` voxels along their longest side; `max_misses` views may show background where it stays. Views with
/// an empty mask are left out. Throws ContradictionError where nothing is left.
openvdb::FloatGrid::Ptr coarse_hull(const std::vector<std::string>& names, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks,
                                    int resolution, double min_seen, Progress& progress, int max_misses = 0);

}  // namespace vdbcarve
