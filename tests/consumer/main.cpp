// SPDX-License-Identifier: Apache-2.0
// A program outside of the project that uses the installed library: masks and cameras in memory, no files.
#include <cstdio>

#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/synthetic.h"

int main() {
    using namespace vdbcarve;
    openvdb::initialize();
    Progress progress;
    SyntheticSpec spec = builtin_spec("torus");
    spec.photos = false;
    spec.rig.views = 6;
    const SyntheticScene scene = synthesize(spec, progress);
    std::vector<MaskView> masks;
    for (const Mask& m : scene.masks) masks.push_back(view_of(m));
    const auto fields = distance_fields(masks, {}, progress);
    std::vector<CarveInput> inputs;
    for (size_t i = 0; i < fields.size(); ++i) inputs.push_back({scene.views.views[i].name, scene.views.views[i].camera, &fields[i]});
    CarveOptions options;
    options.bounds_world = automatic_bounds(inputs, options, progress);
    options.lattice.voxel_size = options.bounds_world.sizes().maxCoeff() / 64;
    const auto surface = level_set(carve(inputs, options, progress).hull, {}, progress);
    const MeshMeasures m = measure(extract_mesh(*surface, {}, progress));
    std::printf("%zu faces, genus %ld\n", m.faces, m.genus);
    return m.manifold && m.genus == 1 ? 0 : 1;
}
