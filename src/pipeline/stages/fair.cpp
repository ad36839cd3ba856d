// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/fair.h"

#include <openvdb/tree/LeafManager.h>

#include <optional>

#include "base/text.h"
#include "pipeline/fair_inputs.h"
#include "surface/euler.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/slack.h"

namespace vdbcarve::pipeline {

namespace {

constexpr const char* kFile = "surface.vdb";

/// Where depths say where the surface is, silhouettes leave nothing open.
void known_by_depth(openvdb::FloatGrid& slack, const openvdb::FloatGrid& confidence) {
    openvdb::tree::LeafManager<openvdb::FloatTree> leaves(slack.tree());
    leaves.foreach ([&](openvdb::FloatTree::LeafNodeType& leaf, size_t) {
        const auto* known = confidence.tree().probeConstLeaf(leaf.origin());
        for (auto v = leaf.beginValueOn(); known && v; ++v) v.setValue(*v * (1.f - known->getValue(v.pos())));
    });
}

}  // namespace

Surface Fair::on_hull(openvdb::FloatGrid::Ptr fair, openvdb::FloatGrid::Ptr slack) const {
    Surface out = surface;
    if (options.surface.keep_hull) {
        out.hull = openvdb::FloatGrid::create(hull->treePtr());
        out.hull->openvdb::MetaMap::operator=(*hull);
        out.hull->setTransform(hull->transformPtr());
        out.hull->setName("hull_surface");
    }
    out.grid = std::move(fair);
    out.slack = std::move(slack);
    return out;
}

void Fair::prepare(Run& run) {
    if (!idle()) return;
    run.progress().warn(text_of(
        "depths and masks disagree: one to two pixels inside the masks' contours, the depths leave only %.0f %% of the lines of sight covered (%.0f %% are "
        "needed). The masks are probably larger than the object, or filled where one sees through it. Depths alone make the surface, which is rougher. "
        "Remedy: tighter masks (a higher --threshold, a smaller --mask-close)",
        100 * surface.silhouettes_kept, 100 * kLeastKept));
}

Surface Fair::run(Run& run) {
    const std::vector<FairView> views = fair_views(shoot, masks);
    const int wanted = options.carve.half_width_vox;
    const openvdb::FloatGrid::Ptr bound = to_fair_band(hull, wanted, run.progress());
    const auto confidence = openvdb::gridPtrCast<openvdb::FloatGrid>(surface.stereo_confidence);
    const openvdb::FloatGrid::Ptr carved = confidence ? to_fair_band(surface.grid, wanted, run.progress()) : nullptr;
    std::optional<FairEvidence> evidence;
    if (confidence) evidence.emplace(FairEvidence{*carved, *confidence});
    const FairEvidence* said = evidence ? &*evidence : nullptr;
    FairResult result;
    const bool done = run.device().run("fair", [&](Device& device) {
        if (!run.is_on_device(bound)) device.set_surface(*bound);
        run.forget_device_grid();
        result = device.fair(*bound, views, options.surface.options, run.progress(), said);
    });
    if (!done) {
        run.forget_device_grid();
        result = fair(*bound, views, options.surface.options, run.progress(), said);
    }
    openvdb::FloatGrid::Ptr open = slack(*bound, *result.surface);
    if (confidence) known_by_depth(*open, *confidence);
    const long handles_before = count_handles(said ? said->carved : *bound), handles = count_handles(*result.surface);
    result.surface = from_fair_band(result.surface, wanted, run.progress());
    Surface made = on_hull(result.surface, open);
    made.fair = {{"fairness", options.surface.options.fairness},
                 {"hull_volume", result.hull_volume},
                 {"volume", result.volume},
                 {"handles_before", handles_before},
                 {"handles", handles},
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
    if (made.fair.is_null()) return;
    const double hull = made.fair.at("hull_volume"), volume = made.fair.at("volume");
    progress.note(text_of("the fair surface holds %.1f %% of the hull's volume; every silhouette stays covered", 100 * volume / hull));
    if (const long before = made.fair.at("handles_before"), now = made.fair.at("handles"); before > now)
        progress.note(
            text_of("%ld of %ld handles and webs closed, which no silhouette%s asks for", before - now, before, made.stereo_confidence ? " and no depth" : ""));
    if (const size_t open = made.fair.at("uncovered"); open > 0)
        progress.warn(text_of("the fair surface leaves %zu of %zu lines of sight uncovered. Remedy: a smaller --fairness", open,
                              made.fair.at("lines_of_sight").get<size_t>()));
}

}  // namespace vdbcarve::pipeline
