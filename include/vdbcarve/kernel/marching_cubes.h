// SPDX-License-Identifier: Apache-2.0
// Marching cubes on leaves of 8^3 voxels, after Lorensen and Cline 1987, with a table that cannot leave holes.
//
// A cell has its eight corners at neighbouring voxels; corner c is at (c >> 2, c >> 1 & 1, c & 1), and it is inside where its
// value is negative. A vertex stands on every lattice edge whose ends are on different sides, once: edges belong to the voxel at
// their lower end. On a face with two diagonal inside corners these stay apart, whatever the values are, so that both
// cells at the face draw the same lines on it and the surface is closed. Each cell's lines form loops, each crossing edge of the
// cell in exactly one: the four cells around an edge give its vertex one fan. Loops are cut into triangles without a diagonal between
// two edges of one face, which the neighbouring cell might draw too. Hence every mesh edge has two faces and every vertex one fan,
// on any input (src/mesh/marching_cubes.cpp makes the table and the tests go through all cases and their neighbours).
#pragma once

#include <cmath>
#include <cstdint>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

/// Triangles of one of the 256 cases. A corner of a triangle is an edge of the cell, as (corner at its lower end) << 2 | axis.
struct MarchingCase {
    uint8_t count;  ///< of triangles, 0..5
    uint8_t edges[15];
};

inline constexpr int kLeafEdges = 3 * 512;  ///< edge axis * 512 + (i << 6 | j << 3 | k)

/// Which of a leaf's edges the surface crosses.
struct LeafEdges {
    uint64_t crossed[kLeafEdges / 64];
    uint16_t before[kLeafEdges / 64];  ///< crossed edges in the words before
};

VDBCARVE_HD int popcount64(uint64_t x) {
#if defined(__CUDA_ARCH__)
    return __popcll(x);
#else
    return __builtin_popcountll(x);
#endif
}

/// Number of a crossed edge among its leaf's.
VDBCARVE_HD int edge_rank(const LeafEdges& leaf, int edge) {
    const uint64_t lower = (uint64_t{1} << (edge & 63)) - 1;
    return leaf.before[edge >> 6] + popcount64(leaf.crossed[edge >> 6] & lower);
}

/// Nearer than this share of a voxel to a corner no vertex comes: vertices around one corner stay apart in float coordinates,
/// and no triangle loses its area.
inline constexpr float kLeastShare = 1.f / 256;

/// Where, from 0 to 1, the value crosses zero between two voxels of different sides.
VDBCARVE_HD float crossing_share(float first, float second) {
    const float t = first / (first - second);
    return t < kLeastShare ? kLeastShare : (t > 1.f - kLeastShare ? 1.f - kLeastShare : t);
}

/// The lattice in the world: voxel (0, 0, 0) has its centre at `first`.
struct LatticeFrame {
    double first[3], voxel_size;
};

struct MeshPoint {
    float x, y, z;
};

/// World position of the vertex on the edge along `axis` from voxel (i, j, k).
VDBCARVE_HD MeshPoint edge_vertex(const LatticeFrame& frame, int i, int j, int k, int axis, float share) {
    const double s = share;
    return {static_cast<float>((axis == 0 ? i + s : i) * frame.voxel_size + frame.first[0]),
            static_cast<float>((axis == 1 ? j + s : j) * frame.voxel_size + frame.first[1]),
            static_cast<float>((axis == 2 ? k + s : k) * frame.voxel_size + frame.first[2])};
}

/// Unit normal there, outward: central differences at both ends, interpolated. `value(i, j, k)` reads the field.
template <class Value>
VDBCARVE_HD MeshPoint edge_normal(const Value& value, int i, int j, int k, int axis, float share) {
    const auto slope = [&](int x, int y, int z, float out[3]) {
        out[0] = value(x + 1, y, z) - value(x - 1, y, z);
        out[1] = value(x, y + 1, z) - value(x, y - 1, z);
        out[2] = value(x, y, z + 1) - value(x, y, z - 1);
    };
    float a[3], b[3], n[3], size2 = 0.f;
    slope(i, j, k, a);
    slope(i + (axis == 0), j + (axis == 1), k + (axis == 2), b);
    for (int d = 0; d < 3; ++d) {
        n[d] = a[d] + share * (b[d] - a[d]);
        size2 += n[d] * n[d];
    }
    // Where the slopes cancel, the edge itself knows which way is out.
    if (!(size2 > 0.f)) {
        const float sign = value(i, j, k) < 0.f ? 1.f : -1.f;
        return {axis == 0 ? sign : 0.f, axis == 1 ? sign : 0.f, axis == 2 ? sign : 0.f};
    }
    const float size = std::sqrt(size2);
    return {n[0] / size, n[1] / size, n[2] / size};
}

}  // namespace vdbcarve::kernel
