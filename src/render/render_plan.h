// SPDX-License-Identifier: Apache-2.0
// What both backends' renderers start from.
#pragma once

#include <openvdb/openvdb.h>

#include <vector>

#include "vdbcarve/kernel/render.h"
#include "vdbcarve/render.h"

namespace vdbcarve {

/// Where a volume lies, for rays.
struct RenderFrame {
    kernel::ColorBase base{};
    kernel::SightBox box{};
    double voxel_size = 1;
    Vec3d origin_world = Vec3d::Zero();  ///< of the base

    RenderFrame() = default;
    /// Of a lattice (centre of voxel (0, 0, 0), world) and the box of its leaves.
    RenderFrame(const openvdb::CoordBBox& leaves, const Vec3d& first_world, double voxel_size);
};

const std::vector<uint8_t>& srgb_table();
std::vector<kernel::Vec3> ambient_directions(int rays);

/// Without the tables. Throws UsageError for what render() does not take.
kernel::RenderRule render_rule(const RenderFrame& frame, const Camera& camera, const RenderOptions& options);

/// The light, in axes given by their unit vectors.
kernel::Lights lights_of(const Camera& camera, const Vec3d& up_world);

}  // namespace vdbcarve
