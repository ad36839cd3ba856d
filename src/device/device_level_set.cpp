// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <cmath>

#include "device/device_parts.h"
#include "surface/filter_plan.h"

namespace vdbcarve {

void Device::level_set(const LevelSetOptions& options) {
    Parts& p = *parts_;
    p.use();
    if (options.half_width_vox < 2 || options.half_width_vox > 100)
        throw UsageError("level_set: half-width is " + std::to_string(options.half_width_vox) + " voxels, must be 2..100");
    p.need(p.hull, "hull");
    p.surface.topology = nullptr;
    p.surface.transform = p.hull.transform;
    if (!p.redistance(p.hull.grid, *p.hull.topology, options.half_width_vox, nullptr)) throw InputError("level_set: the hull has no zero crossing");
}

bool Device::Parts::redistance(const cuda::Grid& field, const cuda::Topology& field_topology, int half_width_vox, VolumeRepair* repair) {
    if (!level_set.solve(field, field_topology, half_width_vox + (repair && repair->move ? 1 : 0), stream, times)) return false;
    if (repair)
        repair_volume(*repair, [&](float offset) {
            const auto v = level_set.volume(field, field_topology, offset, stream, times);
            return std::pair<int64_t, int64_t>(v.units, v.crossed);
        });
    level_set.finish(field, field_topology, half_width_vox, repair ? static_cast<float>(repair->offset_vox) : 0.f, stream, times);
    const float band = static_cast<float>(half_width_vox) * static_cast<float>(surface.transform->voxelSize()[0]);
    times.measure("level_set", stream,
                  [&] { surface.grid.build(level_set.topology(), spec_of("surface", *surface.transform, band), level_set.leaves(field), stream); });
    surface.topology = &level_set.topology();
    return true;
}

FilterResult Device::filter(const FilterOptions& options, Progress& progress) {
    Parts& p = *parts_;
    p.use();
    const Parts::Volume& volume = p.need(p.surface, "level set");
    const double voxel = volume.transform->voxelSize()[0];
    const int half_width = static_cast<int>(std::lround(volume.grid.spec().background / voxel));
    check_filter(options, half_width);
    FilterResult out;
    out.backend_used = "cuda";
    VolumeRepair repair;
    repair.move = options.repair_volume;
    if (options.steps.empty()) {
        repair.target = repair.before_move = repair.volume = p.level_set.volume_of(volume.grid, *volume.topology, p.stream, p.times);
        describe_volumes(out, repair, voxel);
        return out;
    }
    repair.target = p.level_set.volume_of(volume.grid, *volume.topology, p.stream, p.times);
    progress.begin("filter", 2);
    const auto thin = options.keep_thin_vox > 0 ? thin_passes(options.keep_thin_vox) : std::vector<kernel::FilterPass>();
    p.filter.run(volume.grid, *volume.topology, passes_of(options.steps), static_cast<float>(options.keep_thin_vox), thin, static_cast<float>(half_width),
                 p.stream, p.times);
    progress.step();
    p.surface.topology = nullptr;
    if (!p.redistance(p.filter.grid(), p.filter.topology(), half_width, &repair)) explain_filtered_away(options);
    progress.step();
    describe_volumes(out, repair, voxel);
    for (const auto& [name, ms] : p.times.milliseconds())
        if (name.rfind("filter: ", 0) == 0) out.milliseconds.emplace_back(name.substr(8), ms);
    return out;
}

}  // namespace vdbcarve
