// SPDX-License-Identifier: Apache-2.0
// One stage at a time on the device: to it, through it, home. The same with and without CUDA.
#include "carve/carve_plan.h"
#include "mesh/marching_cubes.h"
#include "surface/redistance.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

double Device::milliseconds(const std::string& step) const {
    for (const auto& [name, ms] : milliseconds())
        if (name == step) return ms;
    return 0;
}

std::vector<DistanceField> distance_fields(Device& device, const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress) {
    progress.begin("distance", 1);
    device.upload(masks);
    device.distance(options);
    std::vector<DistanceField> out = device.fields();
    progress.step();
    return out;
}

CarveResult carve(Device& device, const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress) {
    for (const CarveInput& input : inputs)
        if (!input.field) throw UsageError("carve: view " + input.name + " has no distance field");
    check_carve(inputs, options);
    device.set_fields(inputs);
    CarveResult out;
    out.statistics = device.carve(inputs, options, progress);
    out.backend_used = "cuda";
    if (options.occupancy) out.occupancy = device.occupancy();
    else out.hull = device.hull();
    measure_tree(out);
    return out;
}

openvdb::FloatGrid::Ptr level_set(Device& device, const openvdb::FloatGrid& hull, const LevelSetOptions& options, Progress& progress) {
    progress.begin("level_set", 1);
    device.set_hull(hull);
    device.level_set(options);
    openvdb::FloatGrid::Ptr out = device.surface();
    progress.step();
    return out;
}

openvdb::FloatGrid::Ptr level_set_of_occupancy(Device& device, const openvdb::MaskGrid& occupancy, const LevelSetOptions& options, Progress& progress) {
    return level_set(device, *halves_of_occupancy(occupancy, options.half_width_vox), options, progress);
}

FairResult fair(Device& device, const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                const FairEvidence* evidence) {
    device.set_surface(hull);
    return device.fair(hull, views, options, progress, evidence);
}

ColorResult color_in_batches(Device& device, const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos,
                             const ColorOptions& options, Progress& progress) {
    device.set_surface(surface);
    return device.color(surface, inputs, photos, options, progress);
}

StereoResult stereo(Device& device, const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos,
                    const StereoOptions& options, Progress& progress) {
    device.set_surface(surface);
    return device.stereo(surface, inputs, photos, options, progress);
}

FilterResult filter(Device& device, const openvdb::FloatGrid& surface, const FilterOptions& options, Progress& progress) {
    device.set_surface(surface);
    FilterResult out = device.filter(options, progress);
    out.surface = device.surface();
    out.surface->openvdb::MetaMap::operator=(surface);
    out.components_before = count_pieces(surface);
    out.components = count_pieces(*out.surface);
    return out;
}

Mesh extract_mesh(Device& device, const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress) {
    check_mesh(options);
    if (options.mesher != Mesher::MarchingCubes) return extract_mesh(surface, options, progress);
    device.set_surface(surface);
    if (!device.extract_mesh(options.normals)) return extract_mesh(surface, options, progress);
    progress.begin("mesh", 1);
    Mesh out = device.fetch_mesh(options.normals);
    if (out.vertices.empty()) throw InputError("mesh: the volume has no surface");
    progress.step();
    return out;
}

}  // namespace vdbcarve
