// SPDX-License-Identifier: Apache-2.0
// The library without files: cameras and masks in memory in, a level set out.
#include <cstdio>

#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/export.h"
#include "vdbcarve/level_set.h"

int main() {
    using namespace vdbcarve;
    openvdb::initialize();
    Progress progress;

    // Eight views of a ball of radius 1 from 5 units away: its silhouette is a disc.
    std::vector<Mask> masks;
    std::vector<Camera> cameras;
    for (int i = 0; i < 8; ++i) {
        Camera camera;
        camera.intrinsics = {500, 500, 0, 160, 120, 320, 240, false};  // fx fy skew cx cy width height orthographic
        camera.camera_from_world.rotation = Eigen::AngleAxisd(i * 0.7853981633974483, Vec3d::UnitY()).toRotationMatrix();
        camera.camera_from_world.translation = Vec3d(0, 0, 5);
        cameras.push_back(camera);
        Mask mask;
        mask.coverage = Image8(320, 240);
        const double radius_px = 500 / std::sqrt(24.0);  // f tan(asin(1/5))
        for (int y = 0; y < 240; ++y)
            for (int x = 0; x < 320; ++x)
                mask.coverage.at(x, y) = static_cast<uint8_t>(255 * std::clamp(radius_px - std::hypot(x + 0.5 - 160, y + 0.5 - 120) + 0.5, 0.0, 1.0));
        masks.push_back(mask);
    }

    std::vector<MaskView> views;
    for (const Mask& mask : masks) views.push_back(view_of(mask));
    const std::vector<DistanceField> fields = distance_fields(views, {}, progress);

    std::vector<CarveInput> inputs;
    for (size_t i = 0; i < fields.size(); ++i) inputs.push_back({"view " + std::to_string(i), cameras[i], &fields[i]});
    CarveOptions options;
    options.bounds_world = automatic_bounds(inputs, options, progress);
    options.lattice.voxel_size = 0.02;
    const CarveResult hull = carve(inputs, options, progress);
    const auto surface = level_set(hull.hull, {}, progress);
    write_vdb("ball.vdb", {surface, density_of(*surface)}, {"", "y", inputs.size(), 0.02, ""});
    std::printf("ball.vdb: %zu active voxels\n", static_cast<size_t>(surface->activeVoxelCount()));
}
