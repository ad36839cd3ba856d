// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/level_set.h"

#include <algorithm>

#include "vdbcarve/caps.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::pipeline {

namespace {

constexpr const char* kFile = "surface.vdb";
constexpr double kFloorClear = 0.01;  ///< of the object's height

/// Of the surface above the floor, along up.
double height_above(const openvdb::FloatGrid& surface, const Vec3d& up, double floor) {
    double highest = floor;
    for (auto leaf = surface.tree().cbeginLeaf(); leaf; ++leaf)
        for (auto v = leaf->cbeginValueOn(); v; ++v)
            if (*v < 0) {
                const openvdb::Vec3d x = surface.indexToWorld(v.getCoord());
                highest = std::max(highest, Vec3d(x.x(), x.y(), x.z()).dot(up));
            }
    return highest - floor;
}

}  // namespace

openvdb::MaskGrid::Ptr occupancy_of(const Hull& hull) {
    return hull.occupancy ? hull.occupancy : openvdb::gridPtrCast<openvdb::MaskGrid>(read_vdb(hull.file).at(0));
}

Key LevelSet::key() const {
    Key key(kName);
    key.of(hull.key).of(options.floor.flat_base).of(shoot.views.floor).of(options.floor.clear).of(options.floor.from != FloorOptions::From::File);
    return key.of(options.floor.flat_base || shoot.views.floor ? shoot.up() : "");
}

openvdb::FloatGrid::Ptr LevelSet::redistance(Run& run) {
    LevelSetOptions level;
    level.half_width_vox = options.carve.half_width_vox;
    if (options.carve.occupancy) {
        hull.occupancy = occupancy_of(hull);
        return level_set_of_occupancy(*hull.occupancy, level, run.progress());
    }
    if (!hull.level) hull.level = read_float_grid(hull.file, "hull");
    openvdb::FloatGrid::Ptr surface;
    const bool done = run.device().run("level_set", [&](Device& device) {
        if (!run.is_on_device(hull.level)) device.set_hull(*hull.level);
        device.level_set(level);
        surface = device.surface();
        run.set_on_device(surface);
    });
    if (!done) surface = level_set(std::move(hull.level), level, run.progress());
    hull.level.reset();
    return surface;
}

Surface LevelSet::run(Run& run) {
    Surface made;
    made.grid = redistance(run);
    const Vec3d up = up_direction(shoot, masks);
    if (shoot.views.floor) cut_floor(made, run);
    if (options.floor.flat_base) {
        const SeenExtent seen = seen_extent(*made.grid, shoot.views.cameras(), used_mask_views(shoot, masks), up);
        if (seen.bottom_seen) {
            run.forget_device_grid();
            made.grid = cut_flat(std::move(made.grid), up, seen.lowest, run.progress());
        } else {
            run.progress().warn("--base flat: every silhouette is cut by its frame below; the foot stays as it is");
        }
    }
    return made;
}

void LevelSet::cut_floor(Surface& surface, Run& run) const {
    const Vec3d up = up_direction(shoot, masks);
    const double floor = *shoot.views.floor, given = options.floor.clear;
    run.forget_device_grid();
    surface.grid = cut_flat(std::move(surface.grid), up, floor, run.progress());
    if (given == 0 || (given < 0 && options.floor.from == FloorOptions::From::File)) return;
    const double clear = given > 0 ? given : kFloorClear * height_above(*surface.grid, up, floor);
    surface.grid =
        clear_floor(std::move(surface.grid), up, floor, clear, 1.25 * slope_of_views(*surface.grid, used_cameras(shoot, masks), up, floor), run.progress());
    surface.floor_clear = clear;
}

void LevelSet::save(Slot& slot, const Surface& made) const {
    write_vdb(slot.file(kFile), {made.grid}, metadata_of(shoot, masks, hull.grid.voxel_size));
    if (made.floor_clear) slot.note["floor_clear"] = *made.floor_clear;
}

Surface LevelSet::load(const Slot& slot) const {
    Surface out;
    out.grid = read_float_grid(slot.file(kFile), "surface");
    if (slot.note.contains("floor_clear")) out.floor_clear = slot.note["floor_clear"].get<double>();
    return out;
}

}  // namespace vdbcarve::pipeline
