// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/floor.h"

#include "surface/coarse_hull.h"
#include "surface/floor.h"
#include "base/text.h"
#include "vdbcarve/caps.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

namespace {

json said(const FloorFound& f) {
    json out{{"height", f.height}, {"from", f.from}};
    if (f.likeness) out["likeness"] = *f.likeness;
    if (f.next_best) out["next_best"] = *f.next_best;
    return out;
}

}  // namespace

bool FindFloor::idle() const {
    if (shoot.up().empty()) throw UsageError("--floor: which way is up? Remedy: --up");
    return options.from == FloorOptions::From::Given;
}

Key FindFloor::key() const { return Key(kName).of(masks.key).of(shoot.up()).of(min_seen).of(shoot.views.cameras()).of(masks.used); }

FloorFound FindFloor::run(Run& run) {
    Progress& progress = run.progress();
    const std::vector<MaskView> views = used_mask_views(shoot, masks);
    const std::vector<Camera> cameras = shoot.views.cameras();
    const Vec3d up = up_direction(shoot, masks);
    const auto hull = coarse_hull(shoot.views.names(), cameras, views, 192, min_seen, progress);
    const auto table = find_table(
        *hull, cameras, views, [&](size_t i) { return photo_to_show(shoot.views.views[i], progress); }, up, progress);
    if (table) return {table->height, "photographs", table->likeness, table->next_best};
    const SeenExtent seen = seen_extent(*hull, cameras, views, up);
    if (!seen.bottom_seen)
        throw UndeterminedError(
            "--floor auto: the photographs show no table (a pattern on it is needed), and every silhouette is cut by its frame below. Remedy: --floor HEIGHT");
    progress.warn(
        text_of("--floor auto: the photographs show no table (a pattern on it is needed); the floor is put where the lowest contour was seen, at "
                "%.5g. A reflection in the masks would lower it. Remedy: --floor HEIGHT, where that is wrong",
                seen.lowest));
    return {seen.lowest, "lowest contour", {}, {}};
}

void FindFloor::save(Slot& slot, const FloorFound& made) const { slot.note = said(made); }

FloorFound FindFloor::load(const Slot& slot) const {
    FloorFound out{slot.note.at("height"), slot.note.at("from"), {}, {}};
    if (slot.note.contains("likeness")) out.likeness = slot.note["likeness"].get<double>();
    if (slot.note.contains("next_best")) out.next_best = slot.note["next_best"].get<double>();
    return out;
}

void FindFloor::say(const FloorFound& made, Progress& progress) const {
    if (!idle()) progress.note(text_of("the floor is at %.5g along %s (%s)", made.height, shoot.up().c_str(), made.from.c_str()));
}

void FindFloor::report(const FloorFound& made, json& report) const { report["floor"] = said(made); }

}  // namespace vdbcarve::pipeline
