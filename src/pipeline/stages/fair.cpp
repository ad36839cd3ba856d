// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/fair.h"

#include "base/text.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::pipeline {

namespace {

constexpr const char* kFile = "surface.vdb";

}  // namespace

Surface Fair::on_hull(openvdb::FloatGrid::Ptr fair) const {
    Surface out = surface;
    if (options.surface.keep_hull) {
        out.hull = openvdb::FloatGrid::create(surface.grid->treePtr());
        out.hull->openvdb::MetaMap::operator=(*surface.grid);
        out.hull->setTransform(surface.grid->transformPtr());
        out.hull->setName("hull_surface");
    }
    out.grid = std::move(fair);
    return out;
}

Surface Fair::run(Run& run) {
    std::vector<FairView> views;
    const std::vector<Camera> cameras = used_cameras(shoot, masks);
    for (size_t u = 0; u < cameras.size(); ++u) views.push_back({cameras[u], view_of(masks.masks.masks[masks.used[u]])});
    run.forget_device_grid();
    const FairResult result = fair(*surface.grid, views, options.surface.options, run.progress());
    Surface made = on_hull(result.surface);
    made.fair = {{"fairness", options.surface.options.fairness},
                 {"hull_volume", result.hull_volume},
                 {"volume", result.volume},
                 {"lines_of_sight", result.lines_of_sight},
                 {"uncovered", result.uncovered}};
    return made;
}

void Fair::save(Slot& slot, const Surface& made) const {
    write_vdb(slot.file(kFile), {made.grid}, metadata_of(shoot, masks, grid.voxel_size));
    slot.note["fair"] = made.fair;
}

Surface Fair::load(const Slot& slot) const {
    Surface found = on_hull(read_float_grid(slot.file(kFile), "surface"));
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
