// SPDX-License-Identifier: Apache-2.0
#include "base/angles.h"

#include <cmath>

namespace vdbcarve {

std::vector<double> azimuths_rad(const std::vector<Camera>& cameras, const Vec3d& middle, const Vec3d& axis) {
    const Vec3d from = std::fabs(axis.x()) < 0.9 ? Vec3d::UnitX() : Vec3d::UnitY();
    const Vec3d zero = (from - from.dot(axis) * axis).normalized(), quarter = axis.cross(zero);
    std::vector<double> out;
    for (const Camera& c : cameras) {
        const Vec3d at = c.centre_world() - middle;
        out.push_back(std::atan2(at.dot(quarter), at.dot(zero)));
    }
    return out;
}

double turned_rad(const std::vector<double>& azimuths_rad) {
    double sum = 0;
    for (size_t i = 1; i < azimuths_rad.size(); ++i) sum += std::remainder(azimuths_rad[i] - azimuths_rad[i - 1], 2 * std::numbers::pi);
    return sum;
}

}  // namespace vdbcarve
