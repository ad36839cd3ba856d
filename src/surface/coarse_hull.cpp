// SPDX-License-Identifier: Apache-2.0
#include "surface/coarse_hull.h"

#include <cmath>

#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/error.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve {

openvdb::FloatGrid::Ptr coarse_hull(const std::vector<std::string>& names, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks,
                                    int resolution, double min_seen, Progress& progress, int max_misses) {
    openvdb::initialize();
    std::vector<CarveInput> inputs;
    std::vector<MaskView> used;
    std::vector<Camera> used_cameras;
    for (size_t i = 0; i < cameras.size(); ++i) {
        if (masks[i].coverage.empty()) continue;
        inputs.push_back({names[i], cameras[i], nullptr});
        used_cameras.push_back(cameras[i]);
        used.push_back(masks[i]);
    }
    CarveOptions o;
    o.min_seen = min_seen;
    o.max_misses = max_misses;
    try {
        o.bounds_world = automatic_bounds(inputs, used, 0, o, progress);
    } catch (const openvdb::Exception&) {
        throw InputError("the scene is too small for a volume's single precision. Remedy: cameras in a smaller unit");
    }
    o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / resolution;
    // Cameras that ran away have no scale left to make voxels of.
    if (!(o.lattice.voxel_size > 1e-12) || !std::isfinite(o.lattice.voxel_size)) throw ContradictionError("the cameras leave no room for an object");
    const FieldPlan plan = plan_fields(used_cameras, o);
    DistanceOptions d;
    d.scale = plan.scale;
    d.reach_samples = plan.reach_samples;
    const std::vector<DistanceField> fields = distance_fields(used, d, progress);
    for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
    try {
        return level_set(carve(inputs, o, progress).hull, {}, progress);
    } catch (const openvdb::Exception& e) {  // of cameras so far off that floats do not hold them
        throw ContradictionError(std::string("the cameras leave no hull: ") + e.what());
    }
}

}  // namespace vdbcarve
