// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/color.h"

#include <algorithm>
#include <cmath>

#include "base/memory.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

namespace {

constexpr const char* kFile = "color.vdb";

/// What of the options decides colours; `batch` does not.
ColorOptions deciding(const ReconstructOptions& o, const Shoot& shoot) {
    ColorOptions out = o.color.options;
    out.gains.clear();
    if (o.carve.occupancy && out.normal_radius_vox == 0) out.normal_radius_vox = 3;
    if (const std::string& up = shoot.views.up; !up.empty()) {
        out.up = Vec3d::Unit(up.back() - 'x');
        if (up.front() == '-') out.up = -out.up;
    }
    return out;
}

json note_of(const std::vector<ViewColor>& views) {
    json out = json::array();
    for (const ViewColor& v : views) out.push_back({{"used", v.used}, {"gain", v.gain}, {"share", v.first_choice_share}});
    return out;
}

}  // namespace

ColorOptions color_options(const ReconstructOptions& o, const Shoot& shoot, const Silhouettes& masks, const Surface& surface, Run& run) {
    ColorOptions out = deciding(o, shoot);
    const double limit = run.memory_limit();
    const double room = limit - static_cast<double>(resident_memory_bytes()) - static_cast<double>(surface.grid->tree().leafCount()) * kColorPerLeaf;
    const double wanted = o.color.options.batch ? static_cast<double>(o.color.options.batch) : static_cast<double>(masks.used.size());
    out.batch = static_cast<size_t>(std::clamp(room / largest_photo_bytes(shoot, masks), 1.0, wanted));
    if (static_cast<double>(out.batch) < wanted)
        run.progress().note("photographs of " + std::to_string(out.batch) + " views at a time, to stay within " + gigabytes(limit));
    return out;
}

void Color::prepare(Run& run) {
    color_ = deciding(options, shoot);
    colorless_ = photos_are_masks(shoot, masks);
    if (colorless_) run.progress().note("the images are the silhouettes themselves: there is no colour to take");
}

Colors Color::passed() const {
    Colors none;
    none.key = "none";
    return none;
}

Key Color::key() const {
    Key key(kName);
    key.of(surface.key).of(color_).of(options.color.leave_out);
    add_photographs(key, shoot, masks);
    return key;
}

Colors Color::run(Run& run) {
    const std::vector<ColorInput> inputs = color_inputs(shoot, masks, options.color.leave_out);
    Photographs photographs(shoot, masks, run.progress());
    const ColorOptions here = color_options(options, shoot, masks, surface, run);
    ColorResult result;
    try {
        const bool done = run.device().run("color", [&](Device& device) {
            if (!run.is_on_device(surface.grid)) device.set_surface(*surface.grid);
            run.set_on_device(surface.grid);
            ColorOptions there = here;
            const double room = 0.9 * static_cast<double>(device.free_bytes()) - static_cast<double>(surface.grid->tree().leafCount()) * kDeviceColorPerLeaf;
            there.batch = static_cast<size_t>(std::clamp(room / (2 * largest_photo_bytes(shoot, masks)), 1.0, static_cast<double>(here.batch)));
            result = device.color(*surface.grid, inputs, photographs.source(), there, run.progress());
        });
        if (!done) result = color_in_batches(*surface.grid, inputs, photographs.source(), here, run.progress());
    } catch (const ContradictionError& e) {
        // The shape stands without its colours.
        run.progress().warn(std::string(e.what()) + "; the result has no colour");
        return {};
    }
    Colors made;
    made.grid = result.color;
    made.views = result.views;
    made.confidence = result.confidence;
    const auto surface_voxels = static_cast<double>(result.statistics.surface_voxels);
    for (size_t u = 0; u < inputs.size(); ++u)
        made.of_view.push_back(
            {inputs[u].use && !photographs.is_missing(u), result.exposure.gains[u], static_cast<double>(result.statistics.voxels_of_view[u]) / surface_voxels});
    made.said = summary(result, run.progress());
    return made;
}

json Color::summary(const ColorResult& result, Progress& progress) const {
    const ColorStatistics& s = result.statistics;
    const auto of_surface = [&](size_t n) { return static_cast<double>(n) / static_cast<double>(s.surface_voxels); };
    json ms;
    for (const auto& [name, value] : result.milliseconds) ms[name] = value;
    json out{
        {"surface_voxels", s.surface_voxels}, {"seen_share", of_surface(s.colored)}, {"synthesised_share", of_surface(s.synthesised)}, {"milliseconds", ms}};
    if (color_.exposure) {
        out["exposure_disagreement_before"] = result.exposure.disagreement_before;
        out["exposure_disagreement"] = result.exposure.disagreement;
    }
    if (of_surface(s.synthesised) > 0.25)
        progress.warn(std::to_string(std::lround(100 * of_surface(s.synthesised))) +
                      " % of the surface is seen by no photograph (6 degrees or more above it, 3 px inside its mask): its colour is made up from around it");
    return out;
}

void Color::save(Slot& slot, const Colors& made) const {
    if (made.grid) write_vdb(slot.file(kFile), {made.grid, made.views, made.confidence}, metadata_of(shoot, masks, grid.voxel_size));
    slot.note = {{"color", made.said}, {"views", note_of(made.of_view)}};
}

Colors Color::load(const Slot& slot) const {
    Colors out;
    out.said = slot.note.at("color");
    for (const json& view : slot.note.at("views")) out.of_view.push_back({view.at("used"), view.at("gain"), view.at("share")});
    if (out.said.is_null()) return out;  // no photograph could be read: the note's warning says so
    for (const openvdb::GridBase::Ptr& stored : read_vdb(slot.file(kFile))) {
        if (stored->getName() == "color") out.grid = openvdb::gridPtrCast<openvdb::Vec3SGrid>(stored);
        if (stored->getName() == "views") out.views = stored;
        if (stored->getName() == "confidence") out.confidence = stored;
    }
    if (!out.grid || out.of_view.size() != masks.used.size()) throw InputError(slot.file(kFile).string() + ": does not hold these colours");
    return out;
}

}  // namespace vdbcarve::pipeline
