// SPDX-License-Identifier: Apache-2.0
// Order statistics of small samples.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace vdbcarve {

/// The value below which `share` (0..1) of the sample lies, no interpolation; 0 for an empty sample.
template <class T>
double percentile(std::vector<T> values, double share) {
    if (values.empty()) return 0;
    const auto at = static_cast<long>(share * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), values.begin() + at, values.end());
    return static_cast<double>(values[static_cast<size_t>(at)]);
}

/// The upper middle of the sample.
template <class T>
double median(std::vector<T> values) {
    if (values.empty()) return 0;
    const auto at = static_cast<long>(values.size() / 2);
    std::nth_element(values.begin(), values.begin() + at, values.end());
    return static_cast<double>(values[static_cast<size_t>(at)]);
}

inline double square(double x) { return x * x; }

/// Root of the mean square; 0 for an empty sample.
inline double rms(const std::vector<double>& values) {
    double sum = 0;
    for (double v : values) sum += v * v;
    return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}

}  // namespace vdbcarve
