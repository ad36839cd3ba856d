// SPDX-License-Identifier: Apache-2.0
// Lines of sight that have no surface near: few, so the CPU reaches them one after the other, whoever found them.
#pragma once

#include <vector>

#include "fair/fair_level.h"

namespace vdbcarve::fairing {

/// No bridge reaches farther.
inline constexpr int kLongestBridge_vox = 48;

/// A line that does not meet the field, and where it would soonest.
struct LoneLine {
    kernel::FairLine line;
    kernel::FairOpen at;
};

/// Joins each line's place by a thin piece of the hull to the nearest surface; where there is no way inside the hull, it stands alone. By view and sample,
/// whatever order they come in. Returns the leaves whose values fell; their Values::least is not updated.
std::vector<size_t> reach_alone(Level& level, std::vector<LoneLine> lines);

}  // namespace vdbcarve::fairing
