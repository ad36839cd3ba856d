// SPDX-License-Identifier: Apache-2.0
#include "synthetic/noise.h"

#include <cmath>

namespace vdbcarve::synth {

double hash_noise(int64_t x, int64_t y, int64_t z) {
    uint64_t h =
        static_cast<uint64_t>(x) * 0x9E3779B97F4A7C15ull ^ static_cast<uint64_t>(y) * 0xC2B2AE3D27D4EB4Full ^ static_cast<uint64_t>(z) * 0x165667B19E3779F9ull;
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9ull;
    h ^= h >> 32;
    return static_cast<double>(h & 0xFFFFFF) / 0xFFFFFF;
}

double noise(const Vec3d& p) {
    const Vec3d f(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
    Vec3d w = p - f;
    for (double& a : w) a = a * a * (3 - 2 * a);
    double sum = 0;
    for (int c = 0; c < 8; ++c) {
        const int i = c & 1, j = c >> 1 & 1, k = c >> 2;
        sum += (i ? w.x() : 1 - w.x()) * (j ? w.y() : 1 - w.y()) * (k ? w.z() : 1 - w.z()) *
               hash_noise(static_cast<int64_t>(f.x()) + i, static_cast<int64_t>(f.y()) + j, static_cast<int64_t>(f.z()) + k);
    }
    return sum;
}

double wobble(int x, int y, double length, uint64_t seed) {
    const double shift = static_cast<double>(seed % 10007) * 17.3;
    if (length <= 0) {
        // Sum of four uniforms, standard deviation 1.
        double sum = 0;
        for (int i = 0; i < 4; ++i) sum += hash_noise(x, y, static_cast<int64_t>(seed % 1000003) * 4 + i) - 0.5;
        return sum * std::sqrt(3.0);
    }
    double sum = 0;
    for (int i = 0; i < 3; ++i) sum += noise(Vec3d(x / length + shift + 31.7 * i, y / length - shift, 7.1 * i + static_cast<double>(seed % 997))) - 0.5;
    return sum * 3.6;  // measured: value noise has a standard deviation of 0.16
}

}  // namespace vdbcarve::synth
