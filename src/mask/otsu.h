// SPDX-License-Identifier: Apache-2.0
// A histogram's best split. Private.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace vdbcarve {

using Histogram = std::array<uint64_t, 256>;

/// Otsu's threshold, the first level above the split: the one with the largest variance between classes,
/// of the values or of their square roots.
inline double otsu_level(const Histogram& histogram, bool of_root) {
    const auto x = [&](size_t v) { return of_root ? std::sqrt(255.0 * static_cast<double>(v)) : static_cast<double>(v); };
    double total = 0, sum = 0;
    for (size_t v = 0; v < 256; ++v) {
        total += static_cast<double>(histogram[v]);
        sum += static_cast<double>(histogram[v]) * x(v);
    }
    double below = 0, below_sum = 0, best = -1, level = 128;
    for (size_t v = 0; v < 255; ++v) {
        below += static_cast<double>(histogram[v]);
        below_sum += static_cast<double>(histogram[v]) * x(v);
        if (below == 0 || below == total) continue;
        const double apart = below_sum / below - (sum - below_sum) / (total - below);
        const double between = below * (total - below) * apart * apart;
        if (between > best) {
            best = between;
            level = static_cast<double>(v + 1);
        }
    }
    return level;
}

}  // namespace vdbcarve
