// SPDX-License-Identifier: Apache-2.0
// Denkowski 2013, listing 4.1, as a plain loop over a dense volume of bytes (with the depth in both places): the
// yardstick of the benchmark. Compiled once an instruction set with -O3 -ffast-math; no inline functions of others.
#include "bench/dense_reference.h"

namespace vdbcarve {
namespace {

constexpr int kRun = 64;  // measured: 8 and 16 voxels are slower, one at a time 1.6 to 1.9 times as slow

void carve_rows(const DenseViews& views, const DenseGrid& grid, int i, int j_first, int j_last, uint8_t* volume) {
    for (int j = j_first; j < j_last; ++j) {
        uint8_t* row = volume + (static_cast<int64_t>(i) * grid.nj + j) * grid.nk;
        // Of every view, the row's first voxel and the step along it, in homogeneous pixels.
        float start[kMaxDenseViews][3], step[kMaxDenseViews][3];
        for (int n = 0; n < views.count; ++n)
            for (int r = 0; r < 3; ++r) {
                const float* p = views.pixel_from_index[n] + 4 * r;
                start[n][r] = p[0] * static_cast<float>(grid.i0 + i) + p[1] * static_cast<float>(grid.j0 + j) + p[2] * static_cast<float>(grid.k0) + p[3];
                step[n][r] = p[2];
            }
        // A run of voxels at a time, so that projecting becomes vectors; a run that is all background is left early.
        const int w = views.width, h = views.height;
        for (int k0 = 0; k0 < grid.nk; k0 += kRun) {
            uint8_t object[kRun];
            for (int k = 0; k < kRun; ++k) object[k] = 1;
            for (int n = 0; n < views.count; ++n) {
                const float f0 = static_cast<float>(k0);
                const float a = start[n][0] + f0 * step[n][0], b = start[n][1] + f0 * step[n][1], c = start[n][2] + f0 * step[n][2];
                const float da = step[n][0], db = step[n][1], dc = step[n][2];
                int at[kRun];
                uint8_t inside[kRun];
                for (int k = 0; k < kRun; ++k) {
                    const float fk = static_cast<float>(k), inverse = 1.f / (c + fk * dc);
                    const int x = static_cast<int>((a + fk * da) * inverse), y = static_cast<int>((b + fk * db) * inverse);
                    inside[k] = static_cast<unsigned>(x) < static_cast<unsigned>(w) && static_cast<unsigned>(y) < static_cast<unsigned>(h);
                    at[k] = inside[k] ? y * w + x : 0;
                }
                const uint8_t* mask = views.masks[n];
                int left = 0;
                for (int k = 0; k < kRun; ++k) {
                    object[k] = static_cast<uint8_t>(object[k] & inside[k] & mask[at[k]]);
                    left |= object[k];
                }
                if (!left) break;
            }
            for (int k = 0; k < (grid.nk - k0 < kRun ? grid.nk - k0 : kRun); ++k) row[k0 + k] = object[k];
        }
    }
}

}  // namespace

#define VDBCARVE_JOIN2(a, b) a##b
#define VDBCARVE_JOIN(a, b) VDBCARVE_JOIN2(a, b)

DenseRows VDBCARVE_JOIN(dense_rows_, VDBCARVE_ISA)();
DenseRows VDBCARVE_JOIN(dense_rows_, VDBCARVE_ISA)() { return carve_rows; }

}  // namespace vdbcarve
