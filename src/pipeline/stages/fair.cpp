// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/fair.h"

#include "base/text.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/slack.h"

namespace vdbcarve::pipeline {

namespace {

constexpr const char* kFile = "surface.vdb";

}  // namespace

Surface Fair::on_hull(openvdb::FloatGrid::Ptr fair, openvdb::FloatGrid::Ptr slack) const {
    Surface out = surface;
    if (options.surface.keep_hull) {
        out.hull = openvdb::FloatGrid::create(surface.grid->treePtr());
        out.hull->openvdb::MetaMap::operator=(*surface.grid);
        out.hull->setTransform(surface.grid->transformPtr());
        out.hull->setName("hull_surface");
    }
    out.grid = std::move(fair);
    out.slack = std::move(slack);
    return out;
}

Surface Fair::run(Run& run) {
    std::vector<FairView> views;
    const std::vector<Camera> cameras = used_cameras(shoot, masks);
    for (size_t u = 0; u < cameras.size(); ++u) views.push_back({cameras[u], view_of(masks.masks.masks[masks.used[u]])});
    // The fair surface is found with a band of 3 voxels; other widths are made of it.
    LevelSetOptions band;
    const int wanted = options.carve.half_width_vox;
    const openvdb::FloatGrid::Ptr hull = wanted < band.half_width_vox ? level_set(surface.grid->deepCopy(), band, run.progress()) : surface.grid;
    FairResult result;
    const bool done = run.device().run("fair", [&](Device& device) {
        if (!run.is_on_device(hull)) device.set_surface(*hull);
        run.forget_device_grid();
        result = device.fair(*hull, views, options.surface.options, run.progress());
    });
    if (!done) {
        run.forget_device_grid();
        result = fair(*hull, views, options.surface.options, run.progress());
    }
    const openvdb::FloatGrid::Ptr open = slack(*hull, *result.surface);
    if (wanted != band.half_width_vox) {
        band.half_width_vox = wanted;
        result.surface = level_set(result.surface, band, run.progress());
    }
    Surface made = on_hull(result.surface, open);
    made.fair = {{"fairness", options.surface.options.fairness},
                 {"hull_volume", result.hull_volume},
                 {"volume", result.volume},
                 {"lines_of_sight", result.lines_of_sight},
                 {"uncovered", result.uncovered}};
    return made;
}

void Fair::save(Slot& slot, const Surface& made) const {
    write_vdb(slot.file(kFile), {made.grid, made.slack}, metadata_of(shoot, masks, grid.voxel_size));
    slot.note["fair"] = made.fair;
}

Surface Fair::load(const Slot& slot) const {
    Surface found = on_hull(read_float_grid(slot.file(kFile), "surface"), read_float_grid(slot.file(kFile), "slack"));
    found.fair = slot.note.at("fair");
    return found;
}

void Fair::say(const Surface& made, Progress& progress) const {
    const double hull = made.fair.at("hull_volume"), volume = made.fair.at("volume");
    progress.note(text_of("the fair surface holds %.1f %% of the hull's volume; every silhouette stays covered", 100 * volume / hull));
    if (const size_t open = made.fair.at("uncovered"); open > 0)
        progress.warn(text_of("the fair surface leaves %zu of %zu lines of sight uncovered. Remedy: a smaller --fairness", open,
                              made.fair.at("lines_of_sight").get<size_t>()));
}

}  // namespace vdbcarve::pipeline
