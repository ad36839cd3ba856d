// SPDX-License-Identifier: Apache-2.0
#include "base/pixel_size.h"

#include <cmath>

#include "base/statistics.h"

namespace vdbcarve {

double pixel_size_at(const std::vector<Camera>& cameras, const Vec3d& point) {
    std::vector<double> sizes;
    for (const Camera& c : cameras) {
        const Intrinsics& k = c.intrinsics;
        const double depth = k.orthographic ? 1 : (c.camera_from_world * point).z();
        if (depth > 0) sizes.push_back(depth / std::sqrt(k.fx * k.fy));
    }
    return sizes.empty() ? 0 : median(sizes);
}

}  // namespace vdbcarve
