// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/carve.h"

#include <algorithm>
#include <cmath>

#include "base/atomic_file.h"
#include "carve/carve_plan.h"
#include "pipeline/advice.h"
#include "pipeline/stages/distance.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;

namespace {

constexpr const char* kHull = "hull.vdb";

/// The multiple of `step` at or below x.
int down_to(int x, int step) { return (x >= 0 ? x / step : -((step - 1 - x) / step)) * step; }

}  // namespace

/// A slab of the hull across x, kept when it is done: a run that is stopped goes on with the next.
struct CarveBrick {
    static constexpr const char* kName = "brick";
    static constexpr bool kReadBack = true;
    struct Result {
        CarveStatistics statistics;
        fs::path file;  ///< not there where the slab is empty
    };

    Carve& whole;
    std::string name;  ///< says place and thickness: a run under another limit cuts otherwise
    IndexBox box;
    openvdb::FloatGrid::Ptr hull{};

    Key key() const { return Key(kName).of(whole.key().hex()).of(name); }
    Result run(Run& run) {
        const CarveResult part = whole.carve_part(box, run);
        hull = part.hull;
        return {part.statistics, {}};
    }
    void save(Slot& slot, const Result& made) const {
        if (made.statistics.leaves) write_vdb(slot.file(name + ".vdb"), {hull}, metadata_of(whole.shoot, whole.masks, whole.plan.grid.voxel_size));
        slot.note = statistics_json(made.statistics);
        slot.note["inside_voxels"] = made.statistics.inside_voxels;
    }
    Result load(const Slot& slot) const {
        Result out{statistics_of(slot.note), slot.file(name + ".vdb")};
        out.statistics.inside_voxels = slot.note.at("inside_voxels");
        return out;
    }
};

Key Carve::key() const {
    const Views& views = shoot.views;
    Key key(kName);
    key.of(masks.key).of(views.units).of(views.up).of(views.floor).of(views.cameras()).of(masks.used).of(options.grid).of(options.carve);
    if (kept) key.of(kept->bounds).of(kept->origin).of(kept->voxel_size);
    return key;
}

bool Carve::is_there(Run& run) const { return run.find(*this, key().hex()).has_value(); }

Hull Carve::run(Run& run) {
    Hull made = with_advice(options, shoot, [&] {
        known_whole_ = plan.known_whole();
        if (known_whole_) {
            // Under another key: the same voxels were asked for in other words.
            Hull known = load(plan.known->slot);
            known.key = plan.hull_id;
            known.grid.bounds_automatic = plan.grid.bounds_automatic;
            run.say_reused();
            return known;
        }
        return plan.memory.bricks > 1 ? carve_bricks(run) : carve_whole(run);
    });
    if (made.grid.statistics->clipped_share > 0 && !made.grid.floor_clips)  // what a floor clips is cut off anyway
        run.progress().warn("the bounds cut the object: " + std::to_string(100 * made.grid.statistics->clipped_share).substr(0, 4) +
                            " % of the surface is their flat cap");
    made.extend_seconds = plan.extend_seconds;
    made.added_views = added_views_;
    plan.fields.clear();
    plan.inputs.clear();
    return made;
}

Hull Carve::carve_whole(Run& run) {
    CarveResult result = carve_part({}, run);
    Hull made;
    made.key = plan.hull_id;
    made.grid = plan.grid;
    made.grid.statistics = result.statistics;
    made.backend = result.backend_used;
    made.level = result.hull;
    made.occupancy = result.occupancy;
    if (made.backend == "cuda") run.set_on_device(made.level);
    return made;
}

CarveResult Carve::extend(const FieldSource& source, Run& run) {
    openvdb::FloatGrid::Ptr hull = read_float_grid(plan.known->file, "hull");
    const auto start = std::chrono::steady_clock::now();
    const size_t known = plan.known->views.size();
    CarveResult result = extend_hull(std::move(hull), known, plan.inputs, source, plan.carve, run.progress());
    plan.extend_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    added_views_ = plan.inputs.size() - known;
    std::vector<std::string> names;
    for (size_t u = known; u < plan.inputs.size(); ++u) names.push_back(plan.inputs[u].name);
    run.progress().note(text_of("the hull of %s is extended by %s (%s) in %.0f ms", counted(known, "view").c_str(), counted(added_views_, "view").c_str(),
                                some_of(names).c_str(), 1e3 * plan.extend_seconds));
    return result;
}

CarveResult Carve::carve_part(const std::optional<IndexBox>& brick, Run& run) {
    CarveOptions part = plan.carve;
    part.brick = brick;
    if (run.on_gpu()) {
        CarveResult result;
        const bool done = run.device().run("carve", [&](Device& device) {
            result.statistics = device.carve(plan.inputs, part, run.progress());
            if (part.occupancy) result.occupancy = device.occupancy();
            else result.hull = device.hull();
        });
        if (done) {
            result.backend_used = "cuda";
            measure_tree(result);
            return result;
        }
        share_out(plan, run);
        if (plan.memory.batch >= plan.inputs.size()) {
            plan.fields = distance_fields(plan.masks, plan.field_options, run.progress());
            for (size_t u = 0; u < plan.inputs.size(); ++u) plan.inputs[u].field = &plan.fields[u];
        }
    }
    if (plan.memory.batch >= plan.inputs.size() && !plan.known) return carve(plan.inputs, part, run.progress());
    const FieldSource source = [&](size_t first, size_t last) {
        Progress quiet;
        return distance_fields({plan.masks.begin() + static_cast<long>(first), plan.masks.begin() + static_cast<long>(last)}, plan.field_options, quiet);
    };
    if (plan.known) return extend(source, run);
    return carve_in_batches(plan.inputs, plan.memory.batch, source, part, run.progress());
}

Hull Carve::carve_bricks(Run& run) {
    const IndexBox whole = voxels_in_bounds(plan.carve.lattice, plan.carve.bounds_world, plan.carve.half_width_vox + 1);
    const int first = down_to(whole.min[0], 8), length = whole.max[0] - first;
    const int thickness = std::max(64, down_to(length / plan.memory.bricks, 64));
    Hull made;
    made.key = plan.hull_id;
    CarveStatistics sum;
    double capped = 0, surface = 0;
    for (int i = first, n = 0; i < whole.max[0]; i += thickness, ++n) {
        run.progress().check();
        const IndexBox box{{i, down_to(whole.min[1], 8), down_to(whole.min[2], 8)},
                           {i + thickness, down_to(whole.max[1] + 7, 8), down_to(whole.max[2] + 7, 8)}};
        const std::string name = text_of("brick-%04d-x%d-%d", n, i, thickness);
        bool was_there = false;
        const CarveBrick::Result brick = run.part(CarveBrick{*this, name, box}, &was_there);
        const CarveStatistics& s = brick.statistics;
        if (!was_there) run.progress().note(name + " of " + std::to_string((length + thickness - 1) / thickness) + ": " + std::to_string(s.leaves) + " leaves");
        sum.inside_voxels += s.inside_voxels;
        sum.leaves += s.leaves;
        sum.active_voxels += s.active_voxels;
        sum.bytes += s.bytes;
        sum.node_tests += s.node_tests;
        sum.voxel_lookups += s.voxel_lookups;
        capped += s.clipped_share * static_cast<double>(s.leaves);
        surface += static_cast<double>(s.leaves);
        if (s.leaves) made.brick_files.push_back(brick.file);
    }
    if (sum.inside_voxels == 0)
        throw ContradictionError(
            "the hull is empty: the silhouettes contradict each other. Remedy: a lower --resolution carves all at once and names the views");
    sum.clipped_share = surface > 0 ? capped / surface : 0;
    made.grid = plan.grid;
    made.grid.statistics = sum;
    for (const fs::path& file : made.brick_files) made.grid.bricks.push_back(file.filename().string());
    made.backend = name_of(run.device().backend());
    return made;
}

void Carve::save(Slot& slot, Hull& made) const {
    std::vector<std::string> brick_slots;
    for (const fs::path& file : made.brick_files) brick_slots.push_back(file.parent_path().filename().string());
    if (made.brick_files.empty()) {
        if (known_whole_) {  // units and what it was made from may be others
            const openvdb::GridPtrVec grids = read_vdb(made.file);
            write_vdb(slot.file(kHull), {grids.begin(), grids.end()}, metadata_of(shoot, masks, made.grid.voxel_size));
        } else
            write_vdb(slot.file(kHull), made.occupancy ? openvdb::GridCPtrVec{made.occupancy} : openvdb::GridCPtrVec{made.level},
                      metadata_of(shoot, masks, made.grid.voxel_size));
        made.file = slot.later(kHull);
    }
    slot.note = {{"grid", made.grid}, {"backend", made.backend}, {"base", plan.base_key}, {"views", plan.view_keys}, {"id", made.key}, {"bricks", brick_slots}};
}

Hull Carve::load(const Slot& slot) const {
    Hull out;
    out.key = slot.note.at("id");
    out.grid = slot.note.at("grid").get<GridFacts>();
    out.backend = slot.note.at("backend");
    if (out.grid.bricks.empty()) {
        out.file = slot.file(kHull);
        if (!slot.has(kHull)) throw InputError(out.file.string() + ": is not there");
        return out;
    }
    if (options.run.last_stage != LastStage::Carve) throw InputError(slot.folder().string() + ": the hull is in bricks, and is needed whole");
    const auto slots = slot.note.at("bricks").get<std::vector<std::string>>();
    for (size_t n = 0; n < out.grid.bricks.size(); ++n) {
        const std::optional<Slot> brick = slot.beside(slots.at(n));
        if (!brick || !brick->has(out.grid.bricks[n])) throw InputError(slots.at(n) + ": is not there, or damaged");
        out.brick_files.push_back(brick->file(out.grid.bricks[n]));
    }
    return out;
}

}  // namespace vdbcarve::pipeline
