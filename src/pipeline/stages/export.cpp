// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/export.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "pipeline/advice.h"
#include "pipeline/preview.h"
#include "pipeline/stages/level_set.h"
#include "volume/same_transform.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr double kFits_iou = 0.9;  ///< median, where cameras and masks belong together

/// Bounds that were fixed by few views may be wide, and voxels are then coarser than was meant.
void warn_of_wide_bounds(const Made& made, Progress& progress) {
    if (!made.kept || !made.kept->automatic) return;
    Box3d object;
    for (const auto& v : made.mesh.mesh.vertices) object.extend(Vec3d(v[0], v[1], v[2]));
    const double share = object.sizes().maxCoeff() / made.kept->bounds.sizes().maxCoeff();
    if (share < 0.75)
        progress.warn(
            text_of("the object takes %.0f %% of the bounds that were fixed when there were fewer views, so voxels are %.1f times as large as they might "
                    "be. Remedy: reconstruct with another -o, which finds the bounds of all views; or --bounds and --voxel-size from the start",
                    100 * share, 1 / share));
}

/// stereo.png and depth/; and nothing of an earlier run's.
void place_stereo_pictures(ResultSet& set, const Surface& surface) {
    if (surface.stereo_sheet.empty()) set.remove("stereo.png");
    else set.copy(surface.stereo_sheet, "stereo.png");
    const fs::path there = set.place() / "depth";
    if (fs::exists(there))
        for (const auto& entry : fs::recursive_directory_iterator(there))
            for (const char* ours : {".depth.tiff", ".confidence.png"})
                if (entry.path().string().ends_with(ours)) set.remove(entry.path().lexically_relative(set.place()));
    if (surface.depth_maps.empty()) return;
    for (const auto& entry : fs::recursive_directory_iterator(surface.depth_maps))
        if (entry.is_regular_file()) set.copy(entry.path(), fs::path("depth") / entry.path().lexically_relative(surface.depth_maps));
}

openvdb::GridCPtrVec result_grids(const Made& made, const ResultOptions& options, bool with_occupancy) {
    const Surface& surface = made.surface;
    openvdb::GridCPtrVec grids{surface.grid, density_of(*surface.grid)};
    if (with_occupancy) grids.push_back(occupancy_of(made.hull));
    if (surface.hull) grids.push_back(surface.hull);
    if (surface.slack) grids.push_back(surface.slack);
    if (surface.stereo_confidence) grids.push_back(surface.stereo_confidence);
    if (const openvdb::Vec3SGrid::Ptr& color = made.colors.grid) {
        openvdb::Vec3SGrid::Ptr named = openvdb::Vec3SGrid::create(color->treePtr());
        named->openvdb::MetaMap::operator=(*color);
        named->setTransform(same_transform(color->transform()));
        named->setName(color_grid_name(options.dcc));
        grids.push_back(named);
        if (options.views_grid) grids.push_back(made.colors.views);
        if (options.confidence_grid) grids.push_back(made.colors.confidence);
    }
    return grids;
}

}  // namespace

void place_align_pictures(ResultSet& set, const Shoot& shoot) {
    if (!shoot.alignment) return;
    for (const char* name : {"orbit.svg", "mat.png", "energy_map.png"}) set.remove(name);
    set.copy(shoot.alignment->orbit_svg, "orbit.svg");
    if (!shoot.alignment->picture.empty()) set.copy(shoot.alignment->picture, shoot.alignment->picture_name + ".png");
}

Exported Export::run(Run& run) {
    Progress& progress = run.progress();
    progress.begin("export", made.shoot.views.views.size() + options.result.mesh_formats.size() + 2);  // views are compared, files written
    Exported e;
    mark_extrapolation(e, run);
    measure_slack(e, run.progress());
    warn_of_wide_bounds(made, progress);
    warn_of_frames(progress);
    write_volume(e);
    progress.step();
    write_meshes(e, progress);
    write_file(set.make("cameras.json"), cameras_json(made.shoot.views));
    place_align_pictures(set, made.shoot);
    place_stereo_pictures(set, made.surface);
    compare(e, run);
    io::write_png(set.make("preview.png"), draw_preview(made.mesh.mesh, made.shoot, made.masks, spread_evenly(made.masks.used, 12), e.agreement, progress));
    progress.step();
    return e;
}

void Export::mark_extrapolation(Exported& e, Run& run) const {
    e.tolerance = options.floor.cap_tolerance > 0 ? options.floor.cap_tolerance : 2 * made.surface.grid->voxelSize()[0];
    const Vec3d axis = up_direction(made.shoot, made.masks);
    e.seen = seen_extent(*made.surface.grid, made.shoot.views.cameras(), used_mask_views(made.shoot, made.masks), axis);
    e.extrapolation = mark_extrapolated(made.mesh.mesh, used_cameras(made.shoot, made.masks), e.seen, axis, e.tolerance);
    const Extrapolation& x = e.extrapolation;
    if (x.capped_share + x.unseen_share < 0.01) return;
    const std::optional<double> metres = metres_per(made.shoot.views.units);
    const double unit = metres ? 1e3 * *metres : 1;
    run.progress().note(
        text_of("%.1f %% of the surface is extrapolated: %.1f %% lies beyond the contours that were seen (top %.3g, bottom %.3g %s), %.1f %% faces no camera",
                100 * (x.capped_share + x.unseen_share), 100 * x.capped_share, unit * x.top_beyond, unit * x.bottom_beyond, metres ? "mm" : "units",
                100 * x.unseen_share));
}

void Export::measure_slack(Exported& e, Progress& progress) const {
    if (!made.surface.slack) return;
    set_slack(made.mesh.mesh, *made.surface.slack);
    e.slack = slack_shares(made.mesh.mesh);
    const std::optional<double> metres = metres_per(made.shoot.views.units);
    const double unit = metres ? 1e3 * *metres : 1;
    if (std::isfinite(e.slack->half))
        progress.note(text_of("half of the surface lies within %.2g %s of the hull, %.0f %% of it within %.2g %s: so much the silhouettes leave open",
                              unit * e.slack->half, metres ? "mm" : "units", 100 * e.slack->most_share, unit * e.slack->most, metres ? "mm" : "units"));
}

void Export::warn_of_frames(Progress& progress) const {
    std::set<std::string> said;
    for (const std::string& format : options.result.mesh_formats)
        if (const std::string unknown = unknown_frame("." + format, frame_request()); !unknown.empty() && said.insert(unknown).second)
            progress.warn("mesh." + format + ": " + unknown);
    if (options.result.dcc != Dcc::None && said.empty())
        if (const std::string unknown = unknown_frame(".vdb", frame_request()); !unknown.empty()) progress.warn("volume.vdb: " + unknown);
    if (made.shoot.views.units.empty() && said.empty())
        progress.note(std::string("the unit of length is unknown: files carry the scene's own units") +
                      (made.shoot.alignment ? ". Remedy: --known-height, --known-distance or --known-length with --units" : ""));
}

void Export::write_volume(Exported& e) const {
    const FileFrame frame = file_frame(".vdb", frame_request());
    e.frames.emplace_back("volume.vdb", frame);
    openvdb::GridCPtrVec grids;
    for (openvdb::GridCPtrVec own = result_grids(made, options.result, options.carve.occupancy); !own.empty(); own.erase(own.begin()))
        grids.push_back(in_frame(own.front(), frame));
    VdbMetadata described = metadata_of(made.shoot, made.masks, made.hull.grid.voxel_size);
    described.up = frame.up;
    described.units = frame.units;
    described.voxel_size *= frame.scale;
    write_vdb(set.make("volume.vdb"), grids, described, options.result.vdb_half);
}

void Export::write_meshes(Exported& e, Progress& progress) const {
    const std::vector<std::string>& wanted = options.result.mesh_formats;
    // A mesh of an earlier run in a format not asked for now would no longer fit the rest.
    for (const char* format : {"ply", "obj", "stl", "glb", "mtl"})
        if (std::find(wanted.begin(), wanted.end(), format) == wanted.end()) set.remove(std::string("mesh.") + format);
    for (const std::string& format : wanted) {
        const std::string name = "mesh." + format;
        const FileFrame frame = file_frame("." + format, frame_request());
        e.frames.emplace_back(name, frame);
        const Mesh& mesh = made.mesh.mesh;
        if (frame.moves()) write_mesh(set.make(name), in_frame(mesh, frame));
        else write_mesh(set.make(name), mesh);
        if (format == "obj" && fs::exists(set.made("mesh.mtl"))) set.make("mesh.mtl");  // written beside it
        progress.step();
    }
}

void Export::compare(Exported& e, Run& run) const {
    const Views& views = made.shoot.views;
    std::vector<size_t> all(views.views.size());
    for (size_t i = 0; i < all.size(); ++i) all[i] = i;
    e.agreement = compare_with_masks(made.mesh.mesh, views.cameras(), made.masks, all, run.progress());
    std::vector<double> ious;
    std::string weak;
    size_t weak_count = 0;
    for (const size_t i : made.masks.used) {
        const double iou = e.agreement[i].iou;
        ious.push_back(iou);
        if (iou < kFits_iou && weak_count++ < 5) weak += (weak.empty() ? "" : ", ") + views.views[i].name + " (" + std::to_string(iou).substr(0, 5) + ")";
    }
    if (weak_count)
        run.progress().warn(
            std::to_string(weak_count) + " views agree with the result by less than 0.9 (silhouette IoU): " + weak + (weak_count > 5 ? " …" : "") +
            (made.shoot.floor ? ": shadows and reflections that masks took for the object count as missed below --floor; else look at their masks and cameras"
                              : ": look at their masks and cameras"));
    if (options.floor.from == FloorOptions::From::Given) warn_of_high_floor(e, run.progress());
    e.minimum_iou = *std::min_element(ious.begin(), ious.end());
    e.median_iou = median(ious);
    if (e.median_iou < kFits_iou && !shape_was_changed())
        e.contradiction = text_of(
                              "most views contradict the result: %zu of %zu agree with it by less than %.1f (silhouette IoU, median %.3f). It was written, but "
                              "cameras and masks do not fit together; ",
                              weak_count, ious.size(), kFits_iou, e.median_iou) +
                          ask_check(options, made.shoot);
}

/// What was asked for takes parts of the hull away, which silhouettes show: no contradiction of theirs.
bool Export::shape_was_changed() const {
    if (!made.hull.grid.bounds_automatic || made.shoot.floor) return true;
    const auto lost = [](double before, double after) { return std::fabs(after / before - 1) > 0.02; };
    const auto& filtered = made.surface.filter_volumes;
    return (filtered && lost((*filtered)[0], (*filtered)[1])) ||
           (made.mesh.volume_before_smooth && lost(*made.mesh.volume_before_smooth, made.mesh.measures.volume));
}

/// A height that was typed wrongly takes a leg off.
void Export::warn_of_high_floor(const Exported& e, Progress& progress) const {
    std::vector<double> left_out;
    for (const size_t i : made.masks.used) {
        const SilhouetteAgreement& a = e.agreement[i];
        const double missed = static_cast<double>(a.missed_px), wrong = missed + static_cast<double>(a.extra_px);
        const double both = a.iou < 1 ? wrong * a.iou / (1 - a.iou) : 1;
        left_out.push_back(both + missed > 0 ? missed / (both + missed) : 0);
    }
    const double share = median(left_out);
    if (share > 0.05)
        progress.warn(
            text_of("--floor %g leaves out %.0f %% of what the masks show (median of the views): a reflection or shadow, or a part of the object? Remedy: look "
                    "at the cut in preview.png; --floor auto finds a table that has a pattern",
                    options.floor.height, 100 * share));
}

void Export::report(const Exported& e, json& report) const {
    const Vec3d axis = up_direction(made.shoot, made.masks);
    const Extrapolation& x = e.extrapolation;
    json& said = report["extrapolated"];
    said = {{"axis", {axis.x(), axis.y(), axis.z()}},
            {"highest_contour", e.seen.top_seen ? json(e.seen.highest) : json()},
            {"lowest_contour", e.seen.bottom_seen ? json(e.seen.lowest) : json()},
            {"top_beyond", x.top_beyond},
            {"bottom_beyond", x.bottom_beyond},
            {"tolerance", e.tolerance},
            {"area_share", x.capped_share + x.unseen_share},
            {"capped_share", x.capped_share},
            {"unseen_share", x.unseen_share}};
    if (const std::optional<double> metres = metres_per(made.shoot.views.units)) {
        said["top_beyond_mm"] = 1e3 * *metres * x.top_beyond;
        said["bottom_beyond_mm"] = 1e3 * *metres * x.bottom_beyond;
    }
    if (e.slack) {
        const auto finite = [](double value) { return std::isfinite(value) ? json(value) : json(); };
        report["slack"] = {{"mean", e.slack->mean},
                           {"half", finite(e.slack->half)},
                           {"most", finite(e.slack->most)},
                           {"most_share", e.slack->most_share},
                           {"known_share", e.slack->known_share}};
    }
    for (const auto& [name, frame] : e.frames) report["files"][name] = {{"up", frame.up}, {"units", frame.units}, {"scale", frame.scale}, {"axes", frame.axes}};
    std::vector<const ViewColor*> colors(e.agreement.size());
    std::vector<bool> used(e.agreement.size());
    for (size_t u = 0; u < made.masks.used.size(); ++u) {
        used[made.masks.used[u]] = true;
        if (u < made.colors.of_view.size()) colors[made.masks.used[u]] = &made.colors.of_view[u];
    }
    report["views"] = json::array();
    for (size_t i = 0; i < e.agreement.size(); ++i) {
        const SilhouetteAgreement& a = e.agreement[i];
        json view{{"name", made.shoot.views.views[i].name},
                  {"used", static_cast<bool>(used[i])},
                  {"silhouette_iou", a.iou},
                  {"contour_p95_px", a.contour_p95_px},
                  {"contour_p99_px", a.contour_p99_px},
                  {"missed_px", a.missed_px},
                  {"largest_missed_blob_px", a.largest_missed_blob_px},
                  {"thin_length_lost_px", a.thin_length_lost_px},
                  {"extra_px", a.extra_px},
                  {"mask", made.masks.masks.origins[i]}};
        if (const ViewColor* c = colors[i]) view.update({{"color_used", c->used}, {"exposure_gain", c->gain}, {"first_choice_share", c->first_choice_share}});
        report["views"].push_back(view);
    }
    for (const std::string& name : made.shoot.views.left_out)
        report["views"].push_back({{"name", name}, {"used", false}, {"silhouette_iou", 0.0}, {"contour_p95_px", 0.0}, {"mask", ""}});
    report["silhouette_iou"] = {{"median", e.median_iou}, {"minimum", e.minimum_iou}};
    if (!e.contradiction.empty()) report["contradiction"] = e.contradiction;
}

}  // namespace vdbcarve::pipeline
