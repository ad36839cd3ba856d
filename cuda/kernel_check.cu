// SPDX-License-Identifier: Apache-2.0
// Compiles the shared kernel headers for the device. Not linked into anything.
#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/distance.h"

namespace vdbcarve::kernel {

__global__ void ask_voxels(const CarveView* view, const Vec3* points, float* values, int count, float near_depth, float band) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at < count) values[at] = max_f(view_value(*view, points[at], near_depth, band), unseen_value(*view, points[at], near_depth, band));
}

__global__ void ask_nodes(const CarveView* view, const NodeBall* balls, NodeAnswers* answers, int count, double near_depth, double band) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at < count) answers[at] = node_answers(*view, balls[at], near_depth, band);
}

__global__ void contour(const uint8_t* corners, ContourPieces* pieces, int64_t* columns, int count) {
    const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (at >= count) return;
    pieces[at] = contour_pieces(corners[4 * at], corners[4 * at + 1], corners[4 * at + 2], corners[4 * at + 3]);
    columns[at] = parabola_switch(0, corners[4 * at], 1 + at, corners[4 * at + 1]);
}

}  // namespace vdbcarve::kernel
