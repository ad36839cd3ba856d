// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/filter.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "base/statistics.h"
#include "base/text.h"
#include "pipeline/fair_inputs.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

namespace {

constexpr const char* kFile = "surface.vdb";

/// Of the masks that are carved with, the median.
double mask_softness(const Silhouettes& masks) {
    std::vector<double> all(masks.used.size());
    tbb::parallel_for(size_t{0}, all.size(), [&](size_t u) { all[u] = contour_softness(masks.masks.masks[masks.used[u]].coverage); });
    return median(all);
}

}  // namespace

void Filter::prepare(Run& run) {
    filter_.repair_volume = options.filter.repair_volume;
    filter_.keep_thin_vox = std::min(options.filter.keep_thin_vox, most_keep_thin_vox(options.carve.half_width_vox));
    if (filter_.keep_thin_vox < options.filter.keep_thin_vox && options.filter.steps)
        run.progress().note("--keep-thin is " + std::to_string(filter_.keep_thin_vox).substr(0, 4) + " voxels at most with this band");
    if (options.filter.steps) {
        filter_.steps = *options.filter.steps;
    } else if (!surface.fair.is_null()) {
        filter_.steps.clear();  // it is smooth
    } else {
        const double softness = mask_softness(masks);
        filter_.steps = default_filters(options.carve.occupancy ? -1 : softness);
        chosen_["mask_softness"] = softness;
    }
    chosen_["chain"] = filters_text(filter_.steps);
}

Surface Filter::passed() {
    Surface out = std::move(surface);
    out.filter = chosen_;
    return out;
}

Surface Filter::run(Run& run) {
    Surface made = std::move(surface);
    FilterResult result;
    const bool done = run.device().run("filter", [&](Device& device) {
        if (!run.is_on_device(made.grid)) device.set_surface(*made.grid);
        run.forget_device_grid();  // until it is whole again
        result = device.filter(filter_, run.progress());
        result.components_before = count_pieces(*made.grid);
        made.grid = device.surface();
        run.set_on_device(made.grid);
        result.components = count_pieces(*made.grid);
    });
    if (!done) {
        run.forget_device_grid();
        result = filter(std::move(made.grid), filter_, run.progress());
        made.grid = result.surface;
    }
    made.filter = summary(result, run.progress());
    if (!made.fair.is_null()) {
        run.forget_device_grid();
        cover(made, run.progress());
    }
    made.filter_chain = chosen_["chain"];
    made.filter_volumes = {result.volume_before, result.volume_filtered};
    return made;
}

void Filter::cover(Surface& made, Progress& progress) const {
    const int wanted = options.carve.half_width_vox;
    const FairResult covered =
        cover_again(*to_fair_band(hull, wanted, progress), *to_fair_band(made.grid, wanted, progress), fair_views(shoot, masks), progress);
    const double volume = made.filter.at("volume");
    progress.note(text_of("silhouettes are covered again after the filter: volume %+.3f %%", 100 * (covered.volume / volume - 1)));
    if (covered.uncovered > 0)
        progress.warn(text_of("the filter leaves %zu of %zu lines of sight uncovered. Remedy: a weaker --filter", covered.uncovered, covered.lines_of_sight));
    made.filter["covered_volume"] = covered.volume;
    made.filter["uncovered"] = covered.uncovered;
    made.grid = from_fair_band(covered.surface, wanted, progress);
}

json Filter::summary(const FilterResult& result, Progress& progress) const {
    const double change = result.volume_filtered / result.volume_before - 1, left = result.volume / result.volume_before - 1;
    std::string line = text_of("filter %s: volume %+.3f %%", filters_text(filter_.steps).c_str(), 100 * change);
    if (filter_.repair_volume) line += text_of(", moved by %+.4f voxel to %+.4f %% (tolerance %g %%)", result.offset_vox, 100 * left, 100 * kVolumeTolerance);
    progress.note(line);
    const bool repaired = filter_.repair_volume && std::fabs(left) <= kVolumeTolerance;
    if (filter_.repair_volume && !repaired)
        progress.warn(text_of("the filter's change of volume could be repaired to %+.3f %% only (%d steps, %+.3f voxel)", 100 * left, result.repair_steps,
                              result.offset_vox));
    if (std::fabs(change) > 0.01)
        progress.warn(text_of("the filter takes %.1f %% of the volume (%.4g of %.4g)", -100 * change, result.volume_before - result.volume_filtered,
                              result.volume_before) +
                      (filter_.repair_volume ? ", which the repair gives back to what is left" : "") +
                      ". Remedy: a higher --resolution, --keep-thin, a weaker --filter");
    if (result.components < result.components_before)
        progress.warn("the filter leaves " + std::to_string(result.components) + " pieces of " + std::to_string(result.components_before) +
                      ": thin ones are gone, or grown together. Remedy: --keep-thin, or --filter none");
    json ms, out = chosen_;
    for (const auto& [name, value] : result.milliseconds) ms[name] = value;
    out.update({{"volume_before", result.volume_before},
                {"volume_filtered", result.volume_filtered},
                {"volume", result.volume},
                {"repair_offset_vox", result.offset_vox},
                {"repair_steps", result.repair_steps},
                {"pieces_before", result.components_before},
                {"pieces", result.components},
                {"repaired", repaired},
                {"milliseconds", ms}});
    return out;
}

void Filter::save(Slot& slot, const Surface& made) const {
    write_vdb(slot.file(kFile), {made.grid}, metadata_of(shoot, masks, grid.voxel_size));
    json said = made.filter;
    said.erase("milliseconds");  // of this run
    slot.note = {{"filter", said}};
}

Surface Filter::load(const Slot& slot) const {
    Surface out = surface;
    out.grid = read_float_grid(slot.file(kFile), "surface");
    out.filter = slot.note.at("filter");
    out.filter.update(chosen_);
    out.filter_chain = out.filter.at("chain");
    out.filter_volumes = {out.filter.at("volume_before"), out.filter.at("volume_filtered")};
    return out;
}

}  // namespace vdbcarve::pipeline
