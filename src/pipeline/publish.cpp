// SPDX-License-Identifier: Apache-2.0
#include "pipeline/publish.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "base/atomic_file.h"
#include "surface/coarse_hull.h"
#include "image/image_io.h"
#include "pipeline/advice.h"
#include "pipeline/kept_grid.h"
#include "pipeline/placed_masks.h"
#include "pipeline/preview.h"
#include "pipeline/stages/align.h"
#include "result/result_json.h"
#include "base/text.h"
#include "vdbcarve/config.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/app/report.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Where an alignment's preview has this many views.
constexpr size_t kMostTiles = 12;

/// What an earlier run that was refused left.
void clear_unverified(ResultSet& set, const fs::path& folder) {
    for (const char* file : {"cameras.json", "report.json", "config.toml", "orbit.svg", "preview.png", "preview_direction_cw.png", "preview_direction_ccw.png",
                             "mat.png", "energy_map.png"})
        set.remove(folder / file);
}

/// The report and the configuration that repeats the run join the set, which then takes the old one's place.
Reconstruction finish(Run& run, ResultSet* set, const Shoot& shoot, size_t used, const std::string& backend, const std::optional<KeptGrid>& kept = {}) {
    json report = run.finished_report(shoot.views);
    report["backend"] = backend;
    Reconstruction out;
    out.report_json = dumped(report, 1) + "\n";
    out.views = used;
    if (!set) return out;
    write_file(set->make("config.toml"), config_text(repeatable(run.options(), kept)));
    write_file(set->make("report.json"), out.report_json);
    const bool refused = set->place() != run.out();  // then the run goes on to fail
    if (!refused) set->remove("report.html");        // of another result
    set->commit();
    if (!refused) run.forget_failure();
    return out;
}

/// A command that ends before the mesh leaves what an earlier run made of other cameras or masks beside its own files.
void warn_of_older_results(Run& run) {
    for (const char* older : {"volume.vdb", "mesh.ply", "mesh.glb", "mesh.obj", "mesh.stl"})
        if (fs::exists(run.out() / older)) {
            run.progress().warn((run.out() / older).string() +
                                " is of an earlier run, and need not fit what this one leaves beside it. Remedy: reconstruct into " + run.out().string() +
                                " again, or another -o");
            return;
        }
}

/// The hull's outline over the views that fit worst; nothing where there is no hull of these cameras.
bool draw_alignment(ResultSet& set, const fs::path& file, Run& run, const Shoot& shoot, const Silhouettes& masks) {
    Mesh mesh;
    try {
        const auto hull =
            coarse_hull(shoot.views.names(), shoot.views.cameras(), used_mask_views(shoot, masks), 192, run.options().carve.min_seen, run.progress());
        mesh = extract_mesh(*hull, {}, run.progress());
    } catch (const Interrupted&) {
        throw;
    } catch (const Error& e) {  // there may be no hull, of cameras that are wrong
        run.progress().warn(std::string("no preview: ") + e.what());
        set.remove(file);
        return false;
    }
    // Cameras of a file that are used as they are have no residuals.
    const std::vector<double> residual = shoot.alignment ? shoot.alignment->residual_px : std::vector<double>(shoot.views.views.size());
    std::vector<size_t> worst = masks.used;
    std::stable_sort(worst.begin(), worst.end(), [&](size_t a, size_t b) { return residual[a] > residual[b]; });
    worst.resize(std::min(worst.size(), kMostTiles));
    Progress quiet;
    const auto agreement = compare_with_masks(mesh, shoot.views.cameras(), masks, worst, quiet);
    io::write_png(set.make(file), draw_preview(mesh, shoot, masks, worst, agreement, run.progress()));
    return true;
}

void place_alignment(ResultSet& set, Run& run, const Shoot& shoot, const Silhouettes& masks) {
    write_file(set.make("cameras.json"), cameras_json(shoot.views));
    place_align_pictures(set, shoot);
    if (masks.used.empty()) return set.remove("preview.png");  // found without masks: there is no hull to be shown
    const bool shown = draw_alignment(set, "preview.png", run, shoot, masks);
    if (shoot.views.unverified.empty() || !shoot.alignment || shoot.alignment->other_cameras.empty()) return;
    Shoot other = shoot;
    other.views = other_direction(shoot);
    const std::string turned = shoot.alignment->direction, opposite = turned == "cw" ? "ccw" : "cw";
    if (!draw_alignment(set, "preview_direction_" + opposite + ".png", run, other, masks) || !shown) return;  // said above
    set.copy(set.made("preview.png"), "preview_direction_" + turned + ".png");
    run.progress().note(
        "both ways are shown: preview_direction_cw.png is --direction cw, preview_direction_ccw.png is --direction ccw; the wrong one is a mirror image");
}

/// Every mask over its photograph, to be looked at.
void place_overlays(ResultSet& set, Run& run, const Shoot& shoot, const Silhouettes& masks) {
    std::vector<fs::path> files;
    for (const size_t i : masks.used) files.push_back(set.make(fs::path("overlays") / masks.names[i]));
    tbb::parallel_for(size_t{0}, files.size(), [&](size_t u) {
        const size_t i = masks.used[u];
        io::write_png(files[u], mask_overlay(photo_to_show(shoot.views.views[i], run.progress()), masks.masks.masks[i]));
    });
}

/// The page for people. Where it fails, the result stands all the same.
void write_page(Run& run, const Mesh& mesh) {
    try {
        write_report(run.out(), run.out() / "report.html", {}, run.progress(), &mesh);
    } catch (const Interrupted&) {
        throw;
    } catch (const std::exception& e) {
        run.progress().note(std::string("no report.html: ") + e.what());
    }
}

}  // namespace

void show_masks(Run& run, const Silhouettes& masks) {
    if (!run.is_open()) return;
    refuse_foreign_masks(run.out(), masks);  // now, not when everything else is done
    if (run.had_result()) {
        json where = json::object();
        for (size_t i = 0; i < masks.names.size(); ++i)
            if (!masks.files[i].empty()) where[masks.names[i]] = masks.files[i].lexically_relative(run.out()).generic_string();
        return write_file(run.out() / kUnfinishedMasks, dumped(where, 1) + "\n");
    }
    ResultSet set(run.out(), run.out());
    place_masks(set, masks, run.progress());
    set.commit();
}

Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks) {
    if (run.dry()) return finish(run, nullptr, shoot, masks.used.size(), "cpu");
    ResultSet set(run.out(), run.out());
    place_overlays(set, run, shoot, masks);
    place_masks(set, masks, run.progress());
    warn_of_older_results(run);
    Reconstruction out = finish(run, &set, shoot, masks.used.size(), "cpu");
    run.progress().note((run.out() / "overlays").string() + " shows the masks over their photographs");
    return out;
}

Reconstruction publish_cameras(Run& run, const Shoot& shoot, const Silhouettes& masks) {
    if (run.dry()) return finish(run, nullptr, shoot, masks.used.size(), "cpu");
    ResultSet set(run.out(), run.out());
    place_alignment(set, run, shoot, masks);
    place_masks(set, masks, run.progress());
    warn_of_older_results(run);
    clear_unverified(set, kUnverified);
    return finish(run, &set, shoot, masks.used.size(), "cpu");
}

Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks, const Plan&) { return finish(run, nullptr, shoot, masks.used.size(), "cpu"); }

Reconstruction publish(Run& run, const Shoot& shoot, const Silhouettes& masks, const std::optional<KeptGrid>& kept, const Hull& hull) {
    const fs::path whole = run.options().carve.occupancy ? "volume.vdb" : "hull.vdb", bricks = "hull_bricks";
    ResultSet set(run.out(), run.out());
    set.remove(bricks);
    if (run.options().carve.occupancy) set.remove("hull.vdb");
    else warn_of_older_results(run);
    if (hull.brick_files.empty()) {
        set.copy(hull.file, whole);
    } else {
        set.remove(whole);
        for (const fs::path& file : hull.brick_files) set.copy(file, bricks / file.filename());
        run.progress().warn("the hull did not fit the memory limit whole: it lies in " + (run.out() / bricks).string() +
                            ", bricks that share one lattice and do not overlap");
    }
    clear_unverified(set, kUnverified);
    place_masks(set, masks, run.progress());
    Reconstruction out = finish(run, &set, shoot, masks.used.size(), hull.backend, kept);
    out.added_views = hull.added_views;
    out.extend_seconds = hull.extend_seconds;
    return out;
}

Reconstruction publish(Run& run, const Made& made) {
    const ReconstructOptions& options = run.options();
    ResultSet set(run.out(), run.out());
    const Exported exported = run(Export{options, made, set});
    place_masks(set, made.masks, run.progress());  // last: what was edited meanwhile is left alone
    clear_unverified(set, kUnverified);
    Reconstruction out = finish(run, &set, made.shoot, made.masks.used.size(), made.hull.backend, made.kept);
    out.mesh = made.mesh.measures;
    out.median_iou = exported.median_iou;
    out.minimum_iou = exported.minimum_iou;
    out.contradiction = exported.contradiction;
    out.added_views = made.hull.added_views;
    out.extend_seconds = made.hull.extend_seconds;
    if (options.result.report) write_page(run, made.mesh.mesh);
    if (!options.views.added.empty())
        run.store().forget_others({"mask", "align", "floor", "repair", "brick", "carve", "level_set", "fair", "stereo", "color", "filter", "mesh", "smooth"});
    return out;
}

void refuse_or_warn(Run& run, const Shoot& shoot, const Silhouettes& masks) {
    const std::vector<std::string>& why = shoot.views.unverified;
    if (why.empty()) return;
    const bool accept = run.options().cameras.accept_unobservable;
    std::string shown;
    if (!accept) {
        const fs::path place = run.out() / kUnverified;
        ResultSet set(run.out(), place);
        clear_unverified(set, "");
        place_alignment(set, run, shoot, masks);
        finish(run, &set, shoot, masks.used.size(), "cpu");
        shown = ". " + place.string() + " holds them" + (fs::exists(place / "preview.png") ? ", its preview.png shows what they would make" : "");
    }
    accept_or_refuse(why, "the cameras found are UNVERIFIED" + shown, accept, run.progress());
}

}  // namespace vdbcarve::pipeline
