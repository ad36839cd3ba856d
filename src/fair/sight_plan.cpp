// SPDX-License-Identifier: Apache-2.0
#include "fair/sight_plan.h"

#include <algorithm>
#include <cmath>

#include "base/pixel_size.h"

namespace vdbcarve::fairing {

using kernel::FairEye;

namespace {

constexpr int kReach_samples = 4;

/// Centre of voxel (0, 0, 0) of a level, world.
Vec3d first_voxel(const openvdb::math::Transform& finest, int shift) {
    const openvdb::Vec3d first = finest.indexToWorld(openvdb::Vec3d(0.5 * ((1 << shift) - 1)));
    return {first.x(), first.y(), first.z()};
}

FairEye eye_of(const Camera& camera, int scale, const Vec3d& origin, double voxel) {
    const Intrinsics& k = camera.intrinsics;
    FairEye e{};
    e.fx = k.fx / scale;
    e.fy = k.fy / scale;
    e.skew = k.skew / scale;
    e.cx = k.cx / scale;
    e.cy = k.cy / scale;
    e.inverse_fx = 1 / e.fx;
    e.inverse_fy = 1 / e.fy;
    e.inverse_voxel = 1 / voxel;
    e.orthographic = k.orthographic;
    const Vec3d centre = (camera.centre_world() - origin) / voxel;
    const Mat3d world_from_camera = camera.camera_from_world.rotation.transpose();
    for (int a = 0; a < 3; ++a) {
        e.centre[a] = centre[a];
        for (int b = 0; b < 3; ++b) e.axes[a][b] = world_from_camera(a, b);
    }
    return e;
}

Vec3d middle_of(const LeafLattice& lattice, const Vec3d& origin, double voxel) {
    Vec3d middle;
    for (size_t a = 0; a < 3; ++a) middle[static_cast<int>(a)] = 8 * (lattice.lo[a] + 0.5 * lattice.size[a]);
    return origin + voxel * middle;
}

}  // namespace

SightPlan plan_sight(const LeafLattice& lattice, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale, bool exact) {
    const double voxel = finest.voxelSize()[0] * (1 << lattice.shift);
    const Vec3d origin = first_voxel(finest, lattice.shift);
    SightPlan out;
    out.scale = std::max(scale, 1);
    if (scale == 0) {
        std::vector<Camera> cameras;
        for (const FairView& v : views) cameras.push_back(v.camera);
        for (const double pixel = pixel_size_at(cameras, middle_of(lattice, origin, voxel)); pixel > 0 && 2 * out.scale * pixel <= voxel;) out.scale *= 2;
    }
    out.exact = exact && out.scale == 1;
    for (const FairView& v : views) {
        out.masks.push_back(v.mask);
        out.eyes.push_back(eye_of(v.camera, out.scale, origin, voxel));
    }
    out.fields.scale = out.scale;
    out.fields.reach_samples = kReach_samples;
    return out;
}

double between_contours_vox(const LeafLattice& lattice, const openvdb::math::Transform& finest, const std::vector<FairView>& views) {
    const double voxel = finest.voxelSize()[0] * (1 << lattice.shift);
    const Vec3d middle = middle_of(lattice, first_voxel(finest, lattice.shift), voxel);
    std::vector<Vec3d> ways;
    for (const FairView& v : views)
        ways.push_back(v.camera.intrinsics.orthographic ? Vec3d(v.camera.camera_from_world.rotation.row(2))
                                                        : Vec3d((middle - v.camera.centre_world()).normalized()));
    const double same = std::cos(0.02);
    std::vector<double> angles;  // of every view to its nearest neighbour
    for (size_t a = 0; a < ways.size(); ++a) {
        double most = -2;
        for (size_t b = 0; b < ways.size(); ++b)
            if (const double cosine = ways[a].dot(ways[b]); cosine < same) most = std::max(most, cosine);
        if (most > -2) angles.push_back(std::acos(std::max(most, -1.0)));
    }
    if (angles.empty()) return 0;
    std::nth_element(angles.begin(), angles.begin() + static_cast<long>(angles.size() / 2), angles.end());
    return 0.5 * lattice.longest_vox() * (1 / std::cos(0.5 * angles[angles.size() / 2]) - 1);
}

kernel::FairMask mask_of(const DistanceField& header, const int16_t* silhouette, const int16_t* ignored) {
    const SampledField &s = header.silhouette, &i = header.ignored;
    return {silhouette, ignored, s.x0, s.y0, silhouette ? s.width : 0, silhouette ? s.height : 0, i.x0, i.y0, i.width, i.height};
}

}  // namespace vdbcarve::fairing
