// SPDX-License-Identifier: Apache-2.0
// Lines of sight through a level set, node by node where it is empty.
#pragma once

#include <nanovdb/NanoVDB.h>
#include <nanovdb/util/HDDA.h>
#include <nanovdb/util/Ray.h>

#include "vdbcarve/kernel/carve.h"

namespace vdbcarve::kernel {

/// Index coordinates beyond which there is nothing to be hit.
struct SightBox {
    float lo[3], hi[3];
};

/// A step beyond a cell's border, in voxels, so that rounding does not find the cell before it again.
inline constexpr float kBeyondBorder_vox = 1e-3f;

/// True when a voxel whose value is below `threshold` has its cell (the cube around its centre) on the way from `start` along
/// `direction` (unit, index coordinates) up to `length` voxels. NanoVDB's HDDA steps over empty nodes whole; its own ZeroCrossing
/// takes cells to begin, not to be centred, at integers, wants bounding boxes that a grid built on the device has not, and skips the
/// voxel after every node's border.
template <class Accessor>
VDBCARVE_HD bool is_blocked(const Accessor& grid, const SightBox& box, const Vec3& start, const Vec3& direction, float length, float threshold) {
    const float from[3] = {start.x + 0.5f, start.y + 0.5f, start.z + 0.5f}, along[3] = {direction.x, direction.y, direction.z};
    float end = length;
    for (int a = 0; a < 3; ++a) {
        if (along[a] == 0.f) continue;
        end = min_f(end, ((along[a] > 0.f ? box.hi[a] : box.lo[a]) - from[a]) / along[a]);
    }
    if (!(end > 0.f)) return false;
    using Ray = nanovdb::Ray<float>;
    const Ray ray(nanovdb::Vec3f(from[0], from[1], from[2]), nanovdb::Vec3f(along[0], along[1], along[2]), 0.f, end);
    nanovdb::Coord cell = nanovdb::RoundDown<nanovdb::Coord>(ray(0.f));
    nanovdb::HDDA<Ray> walk(ray, static_cast<int>(grid.getDim(cell, ray)));
    for (;;) {
        if (grid.getValue(cell) < threshold) return true;
        if (!walk.step()) return false;
        cell = nanovdb::RoundDown<nanovdb::Coord>(ray(walk.time() + kBeyondBorder_vox));
        walk.update(ray, static_cast<int>(grid.getDim(cell, ray)));
    }
}

}  // namespace vdbcarve::kernel
