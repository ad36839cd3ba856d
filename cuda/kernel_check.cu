// SPDX-License-Identifier: Apache-2.0
// Compiles the shared kernel headers for the device. Not linked into anything.
#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/distance.h"
#include "vdbcarve/kernel/level_set.h"

namespace vdbcarve::kernel {

__global__ void ask_voxels(const CarveView* view, const Vec3* points, float* values, int count, float near_depth, float band) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at < count) values[at] = max_f(view_value(*view, points[at], near_depth, band), unseen_value(*view, points[at], near_depth, band));
}

__global__ void ask_nodes(const CarveView* view, const NodeBall* balls, NodeAnswers* answers, int count, double near_depth, double band) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at < count) answers[at] = node_answers(*view, balls[at], near_depth, band);
}

__global__ void contour(const uint8_t* corners, ContourPieces* pieces, int32_t* distance2, int count) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at >= count) return;
    pieces[at] = contour_pieces(corners[4 * at], corners[4 * at + 1], corners[4 * at + 2], corners[4 * at + 3]);
    const ContourPieces& p = pieces[at];
    distance2[at] = root_of(segment_distance2(make_segment(p.ax[0], p.ay[0], p.bx[0], p.by[0]), 0.f, 64.f));
}

__global__ void redistance(const float* raw, float* out, int count) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at + 6 >= count) return;
    const float across = opposite(raw[at], raw[at + 1], raw[at + 2]), change = slope(raw[at], raw[at + 1], raw[at + 2], across);
    out[at] = across < 0.f ? eikonal(raw[at + 1], raw[at + 2], raw[at + 3]) : plane_distance(raw[at], change, change, change);
}

}  // namespace vdbcarve::kernel
