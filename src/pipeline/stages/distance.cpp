// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/distance.h"

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "base/memory.h"
#include "base/pixel_size.h"
#include "pipeline/advice.h"
#include "pipeline/stages/repair.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

namespace {

std::string grid_text(const std::array<int, 3>& d) { return std::to_string(d[0]) + "x" + std::to_string(d[1]) + "x" + std::to_string(d[2]); }

std::string box_text(const Box3d& b) {
    return text_of("%.9g,%.9g,%.9g,%.9g,%.9g,%.9g", b.min().x(), b.min().y(), b.min().z(), b.max().x(), b.max().y(), b.max().z());
}

std::vector<Camera> cameras_of(const std::vector<CarveInput>& inputs) {
    std::vector<Camera> out;
    for (const CarveInput& input : inputs) out.push_back(input.camera);
    return out;
}

/// Below the floor cones go on to where they end; that is cut off the surface, and need not be carved. A little below stays, for the cut to lie within.
bool clip_at_floor(Box3d& box, const Vec3d& up, double floor) {
    int along = 0;
    if (up.cwiseAbs().maxCoeff(&along) < 1 - 1e-9) return false;
    const double below = floor * up[along] - 0.03 * up[along] * box.sizes().maxCoeff();
    double& end = up[along] > 0 ? box.min()[along] : box.max()[along];
    const double clipped = up[along] > 0 ? std::max(end, below) : std::min(end, below);
    if (clipped == end || (up[along] > 0 ? clipped >= box.max()[along] : clipped <= box.min()[along])) return false;
    end = clipped;
    return true;
}

struct VoxelChoice {
    double voxel = 0;
    Vec3d origin = Vec3d::Zero();
};

/// The edge of a voxel and where the lattice starts; --grid without --bounds makes the box larger.
VoxelChoice choose_voxels(const GridOptions& o, Box3d& box, double footprint, bool say, Progress& progress) {
    const Vec3d size = box.sizes();
    VoxelChoice out{0, o.origin.value_or(Vec3d::Zero())};
    if (o.voxel_size > 0) {
        out.voxel = o.voxel_size;
    } else if (o.dims) {
        const Vec3d sides(size[0] / (*o.dims)[0], size[1] / (*o.dims)[1], size[2] / (*o.dims)[2]);
        if (o.bounds) {
            if (sides.maxCoeff() - sides.minCoeff() > 1e-6 * sides.maxCoeff())
                throw UsageError("--bounds and --grid give voxels of " + std::to_string(sides[0]) + " x " + std::to_string(sides[1]) + " x " +
                                 std::to_string(sides[2]) + ", which are not cubes. Remedy: change either, or give --resolution");
            out.voxel = sides[0];
        } else {
            // The smallest cubic voxel with which that many hold the object.
            out.voxel = sides.maxCoeff();
            const Vec3d whole = out.voxel * Vec3d((*o.dims)[0], (*o.dims)[1], (*o.dims)[2]);
            const Vec3d centre = box.center();
            box = Box3d(centre - 0.5 * whole, centre + 0.5 * whole);
        }
        if (!o.origin) out.origin = box.min();
    } else if (o.resolution > 0) {
        out.voxel = size.maxCoeff() / o.resolution;
    } else {
        if (footprint <= 0) throw ContradictionError("no camera has the bounds in front of it. Remedy: check --bounds and the cameras");
        const double fine = size.maxCoeff() / footprint;
        const int n = static_cast<int>(std::clamp(std::round(fine), 64.0, 1024.0));
        out.voxel = size.maxCoeff() / n;
        if (say)
            progress.note("resolution " + std::to_string(n) + ": a voxel for a pixel" +
                          (fine > 1024 ? " would be " + std::to_string(std::lround(fine)) + "; --resolution sets another" : ""));
    }
    return out;
}

/// Leaves of the hull at the planned resolution: those of two coarse hulls, continued. The surface's leaves grow with the
/// square of the resolution, with a linear part from its creases and ends.
double predict_leaves(const Plan& plan) {
    const double target = plan.carve.bounds_world.sizes().maxCoeff() / plan.carve.lattice.voxel_size;
    const auto leaves_at = [&](double side) {
        CarveOptions o = plan.carve;
        o.occupancy = false;
        o.allow_empty = true;
        o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / side;
        const FieldPlan fields_plan = plan_fields(cameras_of(plan.inputs), o);
        DistanceOptions d;
        d.silhouette_offset_px = plan.field_options.silhouette_offset_px;
        d.scale = fields_plan.scale;
        d.reach_samples = fields_plan.reach_samples;
        Progress quiet;
        const std::vector<DistanceField> fields = distance_fields(plan.masks, d, quiet);
        std::vector<CarveInput> inputs = plan.inputs;
        for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
        return static_cast<double>(carve(inputs, o, quiet).statistics.leaves);
    };
    const double fine = std::min(target, 320.0), coarse = 0.5 * fine;
    const double a = leaves_at(coarse), b = leaves_at(fine);
    const double square = (b / fine - a / coarse) / (fine - coarse), linear = a / coarse - square * coarse;
    return std::max({1.0, b * target / fine, square * target * target + linear * target});
}

JobSize size_of(const ReconstructOptions& o, const Plan& plan) {
    JobSize job;
    job.longest_vox = plan.carve.bounds_world.sizes().maxCoeff() / plan.carve.lattice.voxel_size;
    job.views = plan.inputs.size();
    double largest = 0, samples = 0;
    for (const MaskView& m : plan.masks) {
        const auto bytes = static_cast<double>(planned_field_bytes(m, plan.field_options));
        job.field_bytes += bytes;
        largest = std::max(largest, bytes);
        job.device_base_bytes += static_cast<double>(m.coverage.pixels()) * (m.ignore.empty() ? 1 : 4);
        samples += 0.5 * bytes;
    }
    // While a field is made it takes 16 bytes a sample besides its two, on every thread; on a device twelve more.
    job.field_bytes += 8 * largest * static_cast<double>(tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
    job.device_base_bytes += 14 * samples;
    job.whole = o.run.last_stage == LastStage::Export;
    job.occupancy = o.carve.occupancy;
    job.fair = makes_fair(o);
    job.colored = o.color.options.mode != ColorMode::None;
    job.filtered = !o.filter.steps || !o.filter.steps->empty();
    job.glb = std::find(o.result.mesh_formats.begin(), o.result.mesh_formats.end(), "glb") != o.result.mesh_formats.end();
    job.slabs = o.mesh.mesher == Mesher::Dual && o.mesh.adaptivity == 0;
    job.device_mesh = o.mesh.mesher == Mesher::MarchingCubes;
    return job;
}

/// What a hull depends on, but for its views; and each of those.
void name_hull(Plan& plan) {
    const CarveOptions& c = plan.carve;
    plan.base_key = Key("hull of any views")
                        .of(c.max_misses)
                        .of(c.min_seen)
                        .of(c.outside)
                        .of(c.half_width_vox)
                        .of(c.occupancy)
                        .of(c.bounds_world)
                        .of(c.lattice.origin_world)
                        .of(c.lattice.voxel_size)
                        .of(plan.field_options.silhouette_offset_px)
                        .of(plan.field_options.scale)
                        .of(plan.field_options.reach_samples)
                        .hex();
    plan.view_keys.resize(plan.inputs.size());
    tbb::parallel_for(size_t{0}, plan.inputs.size(), [&](size_t u) {
        const MaskView& m = plan.masks[u];
        Sha256 mask;
        mask.add(m.coverage.data, m.coverage.pixels()).add(m.ignore.data, m.ignore.pixels());
        plan.view_keys[u] = Key("view").of(plan.inputs[u].camera).of(mask.hex()).hex();
    });
    std::vector<std::string> sorted = plan.view_keys;
    std::sort(sorted.begin(), sorted.end());
    plan.hull_id = Key("hull").of(plan.base_key).of(sorted).hex();
}

/// A hull of the same, or of some of these views that is worth extending; its views first, as extend_hull() wants them.
void find_known(Plan& plan, Run& run) {
    if (plan.carve.occupancy || plan.memory.bricks > 1) return;
    plan.known = find_known_hull(run.store(), plan.base_key, plan.view_keys);
    if (!plan.known || plan.known_whole()) return;
    // A device carves sooner than it is told of a hull; many new views, or fields that do not fit into memory together, are for a carve, too.
    if (run.on_gpu() || 2 * plan.known->views.size() < plan.inputs.size() || plan.memory.batch < plan.inputs.size()) {
        plan.known.reset();
        return;
    }
    std::vector<size_t> order = plan.known->views;
    for (size_t u = 0, k = 0; u < plan.inputs.size(); ++u) {
        if (k < plan.known->views.size() && plan.known->views[k] == u) ++k;
        else order.push_back(u);
    }
    const auto in_order = [&](const auto& all) {
        auto out = all;
        for (size_t n = 0; n < order.size(); ++n) out[n] = all[order[n]];
        return out;
    };
    plan.inputs = in_order(plan.inputs);
    plan.masks = in_order(plan.masks);
    plan.view_keys = in_order(plan.view_keys);
}

/// The fields that carving or extending will ask for, where they are in memory together.
void make_fields(Plan& plan, Run& run) {
    if (run.on_gpu()) {
        const bool done = run.device().run("distance", [&](Device& device) {
            device.upload(plan.masks);
            device.distance(plan.field_options);
            device.wait();
        });
        if (done) return;
        share_out(plan, run);
    }
    if (plan.known) {
        const auto start = std::chrono::steady_clock::now();
        // Of known views only what they ignore is asked for.
        std::vector<size_t> wanted;
        for (size_t u = 0; u < plan.inputs.size(); ++u)
            if (u >= plan.known->views.size() || !plan.masks[u].ignore.empty()) wanted.push_back(u);
        std::vector<MaskView> of_wanted;
        for (const size_t u : wanted) of_wanted.push_back(plan.masks[u]);
        plan.fields = distance_fields(of_wanted, plan.field_options, run.progress());
        for (size_t w = 0; w < wanted.size(); ++w) plan.inputs[wanted[w]].field = &plan.fields[w];
        plan.extend_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        return;
    }
    if (plan.memory.batch < plan.inputs.size()) return;  // made in batches while carving
    plan.fields = distance_fields(plan.masks, plan.field_options, run.progress());
    for (size_t u = 0; u < plan.inputs.size(); ++u) plan.inputs[u].field = &plan.fields[u];
}

}  // namespace

void share_out(Plan& plan, Run& run) {
    share_out(plan.memory, plan.job, static_cast<double>(resident_memory_bytes()), run.on_gpu());
    if (plan.memory.batch < plan.inputs.size())
        run.progress().note("distance fields of " + std::to_string(plan.memory.batch) + " views at a time, to stay within " +
                            gigabytes(plan.memory.limit_bytes));
}

Plan Distance::run(Run& run) {
    if (have_hull) {
        run.say_reused();
        return {};
    }
    return with_advice(options, shoot, [&] {
        const size_t warnings_before = run.progress().warnings().size();
        if (!options.mask.repair && !run.dry()) warn_of_broken_masks(shoot, masks, run.progress());
        Plan plan = plan_grid(run);
        plan.warnings_before = warnings_before;
        plan_fields_of(plan, run);
        plan_memory_of(plan, run);
        run.progress().note("grid " + grid_text(plan.grid.dims) + ", voxel " + std::to_string(plan.grid.voxel_size) +
                            (shoot.views.units.empty() ? "" : " " + shoot.views.units));
        if (run.dry()) return plan;
        name_hull(plan);
        find_known(plan, run);
        if (!plan.known_whole()) make_fields(plan, run);
        return plan;
    });
}

Plan Distance::plan_grid(Run& run) const {
    Progress& progress = run.progress();
    Plan plan;
    plan.needed = true;
    const std::vector<Camera> cameras = shoot.views.cameras();
    for (const size_t i : masks.used) {
        plan.inputs.push_back({shoot.views.views[i].name, cameras[i], nullptr});
        plan.masks.push_back(view_of(masks.masks.masks[i]));
    }
    CarveOptions& c = plan.carve;
    c.max_misses = options.carve.max_misses;
    c.min_seen = options.carve.min_seen;
    c.outside = options.carve.outside_is_background ? Outside::Background : Outside::Unknown;
    c.occupancy = options.carve.occupancy;
    c.half_width_vox = options.carve.half_width_vox;
    const GridOptions& o = options.grid;
    const auto start = std::chrono::steady_clock::now();
    Box3d box = kept ? kept->bounds : o.bounds ? *o.bounds : automatic_bounds(plan.inputs, plan.masks, options.carve.silhouette_offset_px, c, progress);
    GridFacts& g = plan.grid;
    g.floor_clips = kept ? kept->floor_clips : shoot.views.floor && !o.bounds && clip_at_floor(box, up_direction(shoot, masks), *shoot.views.floor);
    if (kept && o.bounds && !(kept->bounds.min().isApprox(o.bounds->min(), 1e-9) && kept->bounds.max().isApprox(o.bounds->max(), 1e-9)))
        throw UsageError("--bounds " + box_text(*o.bounds) + ": views are added to " + run.out().string() + ", whose bounds are " + box_text(kept->bounds) +
                         ". Remedy: without --bounds, or another -o");
    g.bounds_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const double longest = box.sizes().maxCoeff();
    g.pixel_footprint = pixel_size_at(cameras_of(plan.inputs), box.center());
    auto [voxel, origin] = choose_voxels(o, box, g.pixel_footprint, !kept, progress);
    if (kept) {
        const bool given = o.resolution > 0 || o.voxel_size > 0 || o.dims;
        if ((given && std::fabs(voxel / kept->voxel_size - 1) > 1e-9) || (o.origin && !o.origin->isApprox(kept->origin, 1e-9)))
            throw UsageError(
                text_of("%s: gives voxels of %.9g, and views are added to %s, whose voxels of %.9g lie otherwise. Remedy: without it, or another -o",
                        o.resolution > 0   ? "--resolution"
                        : o.voxel_size > 0 ? "--voxel-size"
                        : o.dims           ? "--grid"
                                           : "--origin",
                        voxel, run.out().c_str(), kept->voxel_size));
        box = kept->bounds;
        voxel = kept->voxel_size;
        origin = kept->origin;
    }
    if (g.pixel_footprint > 0 && voxel < 0.98 * g.pixel_footprint)
        progress.warn("voxels of " + std::to_string(voxel) + " are finer than a pixel on the object (" + std::to_string(g.pixel_footprint) +
                      "): more than the photographs can show. About " + std::to_string(std::lround(longest / g.pixel_footprint)) +
                      " voxels along the longest side would do");
    c.lattice = {origin, voxel};
    c.bounds_world = box;
    for (int a = 0; a < 3; ++a) g.dims[static_cast<size_t>(a)] = static_cast<int>(std::ceil(box.sizes()[a] / voxel - 1e-6));
    g.voxel_size = voxel;
    g.origin = {origin.x(), origin.y(), origin.z()};
    g.bounds = {box.min()[0], box.min()[1], box.min()[2], box.max()[0], box.max()[1], box.max()[2]};
    g.bounds_automatic = kept ? kept->automatic : !o.bounds;
    return plan;
}

void Distance::plan_fields_of(Plan& plan, Run& run) const {
    const FieldPlan fields = plan_fields(cameras_of(plan.inputs), plan.carve, options.carve.field_scale);
    plan.field_options.silhouette_offset_px = options.carve.silhouette_offset_px;
    plan.field_options.scale = fields.scale;
    plan.field_options.reach_samples = fields.reach_samples;
    plan.grid.px_per_voxel = fields.px_per_voxel;
    plan.grid.field_scale = fields.scale;
    if (fields.scale > 1)
        run.progress().note("the photographs have " + std::to_string(fields.px_per_voxel).substr(0, 4) +
                            " pixels to a voxel: distance fields take a sample for " + std::to_string(fields.scale) + "x" + std::to_string(fields.scale) +
                            " of them (--field-scale 1: every pixel)");
    const FileFrame frame = file_frame(".vdb", {shoot.up(), shoot.views.units, options.result.dcc, options.result.stl_mm});
    if (frame.scale * plan.carve.lattice.voxel_size < kLeastVoxel)
        throw UsageError("voxels of " + std::to_string(1e6 * frame.scale * plan.carve.lattice.voxel_size) + "e-6 " + frame.units +
                         " are too small for OpenVDB. Remedy: another --dcc, or none, or --units in which the object is larger");
}

void Distance::plan_memory_of(Plan& plan, Run& run) const {
    plan.memory = unlimited_memory(plan.inputs.size());
    plan.job = size_of(options, plan);
    // A small job on a whole machine skips the memory estimate.
    if (!run.dry() && !options.run.memory_limit && plan.job.longest_vox <= 1100) return;
    plan.job.leaves = predict_leaves(plan);
    release_memory();
    plan.memory = plan_memory(plan.job, static_cast<double>(resident_memory_bytes()), run.memory_limit());
    const MemoryExpected& e = *plan.memory.expected;
    plan.grid.expected = e;
    run.progress().note("expected: " + std::to_string(std::llround(e.leaves)) + " leaves, " + gigabytes(e.bytes) + " of volume, peak memory " +
                        gigabytes(e.peak_bytes));
    if (run.on_gpu() && !plan.job.occupancy) {
        double free_bytes = 0;
        if (run.device().run("carve", [&](Device& device) { free_bytes = static_cast<double>(device.free_bytes()); })) {
            const DeviceFit fit = fit_device(plan.job, free_bytes);
            const std::string needed = gigabytes(fit.needed_bytes) + " on the device, more than is free there";
            if (!fit.fits && fit.bricks > 0) plan.memory.device_bricks = fit.bricks;
            else if (!fit.fits && options.run.backend == Backend::Cuda)
                throw BackendError("this resolution needs about " + needed + ". Remedy: --backend cpu, a lower --resolution, or `carve` alone, in bricks");
            else if (!fit.fits) run.device().leave("this resolution needs about " + needed);
        }
    }
    share_out(plan, run);
}

void Distance::report(const Plan& plan, json& report) const {
    if (plan.needed) report["grid"] = plan.grid;
}

}  // namespace vdbcarve::pipeline
