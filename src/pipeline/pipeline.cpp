// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/pipeline.h"

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>

#include "align/align_options.h"
#include "align/align_scale.h"
#include "base/atomic_file.h"
#include "check/camera_doubts.h"
#include "carve/carve_plan.h"
#include "surface/coarse_hull.h"
#include "device/device_session.h"
#include "surface/floor.h"
#include "views/formats/camera_formats.h"
#include "image/image_io.h"
#include "pipeline/known_hull.h"
#include "mask/mask_consensus.h"
#include "base/memory.h"
#include "volume/same_transform.h"
#include "pipeline/mesh_store.h"
#include "base/sha256.h"
#include "base/statistics.h"
#include "result/result_json.h"
#include "stereo/stereo_sheet.h"
#include "base/text.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/decimate.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/volume.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/app/report.h"
#include "vdbcarve/version.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kWritten = ".written_by_vdbcarve.json";  ///< in masks/: what of it is ours
constexpr const char* kUnverified = "unverified";              ///< folder of the result for cameras that align() does not stand behind

/// The note of a finished stage, or nothing where it is missing, damaged or lacks a key: then the stage counts as
/// not done.
std::optional<json> stage_note(const fs::path& file, std::initializer_list<const char*> keys) {
    json note = parse_or_empty(file);
    for (const char* key : keys)
        if (!note.is_object() || !note.contains(key)) return std::nullopt;
    return note;
}

bool made_by_us(const fs::path& output) { return fs::exists(output / kMarker); }

/// Files of finished stages, named by what they were made from.
class StageStore {
  public:
    explicit StageStore(fs::path folder) : folder_(std::move(folder)) {}
    fs::path path(const std::string& stage, const std::string& key, const std::string& extension) const {
        const std::string name = stage + "-" + key.substr(0, 24);
        asked_for_.insert(name);
        return folder_ / (name + extension);
    }
    const fs::path& folder() const { return folder_; }

    /// Removes what stages made of this run's did in earlier ones, and is not this one's.
    void forget_others(const std::set<std::string>& stages) const {
        std::vector<fs::path> old;
        for (const auto& entry : fs::directory_iterator(folder_)) {
            const std::string name = entry.path().filename().string(), stage = name.substr(0, name.find('-'));
            if (stages.count(stage) && !asked_for_.count(name.substr(0, name.find('.')))) old.push_back(entry.path());
        }
        for (const fs::path& path : old) fs::remove_all(path);
    }

  private:
    fs::path folder_;
    mutable std::set<std::string> asked_for_;
};

void add_camera(Sha256& hash, const Camera& c) {
    const Intrinsics& k = c.intrinsics;
    for (double v : {k.fx, k.fy, k.skew, k.cx, k.cy}) hash.add_value(v);
    hash.add_value(k.width_px).add_value(k.height_px).add_value(k.orthographic);
    for (int i = 0; i < 9; ++i) hash.add_value(c.camera_from_world.rotation(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) hash.add_value(c.camera_from_world.translation[i]);
}

std::string grid_text(const std::array<int, 3>& d) { return std::to_string(d[0]) + "x" + std::to_string(d[1]) + "x" + std::to_string(d[2]); }

class Job {
  public:
    Job(const ReconstructOptions& options, Progress& progress)
        : o_(options), progress_(progress), store_(options.run.output / "stages"), warnings_at_start_(progress.warnings().size()) {}

    Reconstruction run() {
        try {
            return run_stages();
        } catch (const Error& e) {
            leave_failure(e);
            throw;
        }
    }

  private:
    Reconstruction run_stages() {
        check_options();
        const bool film = is_video(o_.views.scene);
        stage("views", [&] {
            const bool reused = film && film_to_photographs();
            load();
            if (film) angles_of_film();
            return reused;
        });
        if (!o_.run.dry_run && !film) open_output();
        keep_views();
        // A mat is found in the photographs; masks then come from pictures whose lens is known.
        const bool aligned_by_mat = o_.align.method == AlignMethod::Mat && o_.run.last_stage != LastStage::Mask;
        if (aligned_by_mat) stage("align", [&] { return align_views(); });
        if (!aligned_by_mat || o_.run.last_stage != LastStage::Align) stage("mask", [&] { return masks(); });
        if (o_.run.last_stage == LastStage::Mask) {
            if (!o_.run.dry_run) place_overlays();
            return finish();
        }
        if (!aligned_by_mat && (!views_.posed || o_.cameras.find_again)) stage("align", [&] { return align_views(); });
        keep_views();
        if (o_.floor.from != FloorFrom::File) stage("floor", [&] { return find_floor(); });
        if (o_.run.last_stage == LastStage::Align) {
            place_alignment();
            return finish();
        }
        if (o_.mask.repair && !o_.run.dry_run) stage("repair", [&] { return repair(); });
        plan_key();
        const bool have_hull = hull_is_there();
        try {
            stage("distance", [&] {
                if (have_hull && !o_.run.dry_run) return true;  // the hull made from them is there
                distances();
                return false;
            });
            if (o_.run.dry_run) return finish();
            stage("carve", [&] { return carve_hull(); });
        } catch (const ContradictionError& e) {
            throw ContradictionError(std::string(e.what()) + "; " + ask_check());
        }
        if (o_.run.last_stage == LastStage::Carve) {
            place_hull();
            return finish();
        }
        stage("level_set", [&] { return make_surface(); });
        if (o_.stereo.on) stage("stereo", [&] { return carve_by_depth(); });
        else if (o_.stereo.options != StereoOptions() || o_.stereo.maps)
            progress_.warn("--stereo-scale, --stereo-depth, --stereo-levels and --stereo-maps do nothing without --stereo on");
        if (o_.color.options.mode != ColorMode::None) stage("color", [&] { return make_color(); });
        stage("filter", [&] { return filter_surface(); });
        stage("mesh", [&] { return make_mesh(); });
        stage("smooth", [&] { return smooth_mesh(); });
        stage("export", [&] {
            export_all();
            return false;
        });
        return finish();
    }

    fs::path failure_file() const { return store_.folder() / "failure.json"; }

    /// What a run ended with, for whoever looks into it later (bundle).
    void leave_failure(const Error& e) const {
        if (o_.run.dry_run || !made_by_us(o_.run.output)) return;
        json failure = report_.is_object() ? report_ : json::object();
        failure["failure"] = {{"stage", stage_name_}, {"text", e.what()}, {"exit_code", static_cast<int>(e.code())}};
        failure["version"] = kVersion;
        failure["warnings"] = warnings_since(warnings_at_start_);
        failure["scene"] = scene_json();  // for whoever reads it elsewhere
        try {
            write_file(failure_file(), failure.dump(1) + "\n");
            if (!o_.run.config_text.empty()) write_file(store_.folder() / "failure.toml", o_.run.config_text);
        } catch (const Error&) {
            // The error itself is what matters.
        }
    }

    /// The cameras that a run goes on with: should it fail, they are nowhere else.
    void keep_views() const {
        if (!o_.run.dry_run && views_.posed) write_file(store_.folder() / "cameras.json", cameras_json(views_));
    }

    json scene_json() const {
        json out{{"folder", fs::absolute(o_.views.scene).string()}, {"images", o_.views.images.string()}};
        for (const fs::path& scene : o_.views.added) out["added"].push_back(fs::absolute(scene).string());
        return out;
    }

    template <class Work>
    void stage(const char* name, const Work& work) {
        progress_.check();
        stage_name_ = name;
        const auto start = std::chrono::steady_clock::now();
        reset_peak_memory();
        if (device_) device_->begin_stage();
        const bool reused = work();
        peak_bytes_ = std::max(peak_bytes_, peak_memory_bytes());
        json entry{{"name", name},
                   {"seconds", std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()},
                   {"peak_rss_bytes", peak_memory_bytes()},
                   {"backend", name_of(device_ ? device_->used_last() : Backend::Cpu)},
                   {"reused", reused}};
        report_["stages"].push_back(entry);
        if (o_.run.on_stage) {
            entry["event"] = "stage";
            o_.run.on_stage(entry.dump());
        }
    }

    /// Where cameras and masks contradict each other.
    std::string ask_check() const {
        const std::string scene = o_.views.scene.string() + (o_.views.cameras.empty() ? "" : " --cameras " + o_.views.cameras.string());
        return "`vdbcarve check " + scene + "`, with the options for masks given here, says what fits" +
               (aligned_ ? "" : ", tries other readings of the poses and writes the one that fits (--write-cameras FILE)");
    }

    /// Warnings since there were so many, to be kept in a stage's note; and said again when the stage is found done.
    std::vector<std::string> warnings_since(size_t before) const {
        std::vector<std::string> all = progress_.warnings();
        all.erase(all.begin(), all.begin() + static_cast<long>(before));
        return all;
    }
    void warn_again(const json& note) {
        for (const std::string& w : note["warnings"].get<std::vector<std::string>>()) progress_.warn(w);
    }

    void check_options() {
        device_.emplace(o_.run.backend, o_.run.device, progress_);
        std::string bad;
        const auto need = [&](bool ok, const std::string& what) {
            if (!ok) bad += (bad.empty() ? "" : "; ") + what;
        };
        need(o_.floor.from != FloorFrom::Found || o_.align.method != AlignMethod::Mat, "--floor auto: the mat says where the floor is");
        need(std::isfinite(o_.floor.height), "--floor is not finite");
        need(is_video(o_.views.scene) || o_.video == VideoOptions(), "--video-frames and --video-range are of films; " + o_.views.scene.string() + " is none");
        need(o_.views.units.empty() || metres_per(o_.views.units), "--units " + o_.views.units + ": is none of m, cm, mm, km, inch, ft");
        const MaskOptions& m = o_.mask;
        const bool by_threshold = m.method == MaskMethod::Threshold || (m.method == MaskMethod::GrabCut && m.grabcut.from_threshold);
        need(by_threshold || m.threshold == ThresholdOptions(), "--threshold, --threshold-channel and --threshold-invert are of --mask threshold");
        need(m.method == MaskMethod::Chroma || m.chroma == ChromaOptions(), "--chroma-key and --chroma-level are of --mask chroma");
        need(m.method == MaskMethod::CleanPlate || m.plate == PlateOptions(), "--clean-plate and --plate-… are of --mask clean-plate");
        need(m.method == MaskMethod::GrabCut || m.grabcut == GrabCutOptions(), "--grabcut-… is of --mask grabcut");
        const bool from_photographs = by_threshold || m.method == MaskMethod::Chroma || m.method == MaskMethod::CleanPlate || m.method == MaskMethod::GrabCut;
        need(from_photographs || m.clean_up == MaskCleanUp(),
             "--mask-open, --mask-close, --mask-fill-holes and --mask-all-components are of masks made from photographs (--mask threshold, chroma, "
             "clean-plate, grabcut)");
        need((o_.grid.resolution > 0) + (o_.grid.voxel_size > 0) + o_.grid.dims.has_value() <= 1, "give one of --resolution, --voxel-size and --grid");
        need(o_.grid.resolution >= 0, "--resolution is " + std::to_string(o_.grid.resolution) + ", must be > 0");
        need(std::isfinite(o_.grid.voxel_size) && o_.grid.voxel_size >= 0, "--voxel-size is " + std::to_string(o_.grid.voxel_size) + ", must be > 0");
        need(o_.carve.max_misses >= 0 && o_.carve.max_misses <= 15, "--max-misses is " + std::to_string(o_.carve.max_misses) + ", must be 0..15");
        need(std::isfinite(o_.carve.silhouette_offset_px), "--silhouette-offset is not finite");
        need(o_.carve.field_scale >= 0, "--field-scale is " + std::to_string(o_.carve.field_scale) + ", must be >= 1, or auto");
        need(o_.carve.half_width_vox >= 2 && o_.carve.half_width_vox <= 100,
             "the half-width is " + std::to_string(o_.carve.half_width_vox) + " voxels, must be 2..100");
        need(o_.carve.min_seen >= 0 && o_.carve.min_seen <= 1, "--min-seen is " + std::to_string(o_.carve.min_seen) + ", must be 0..1");
        need(!o_.mesh.normals || o_.mesh.mesher == Mesher::MarchingCubes, "--normals are made by --mesher marching-cubes only");
        need(o_.mesh.mesher == Mesher::Dual || o_.mesh.adaptivity == 0, "--adaptivity is of --mesher dual; marching cubes has none");
        need(o_.mesh.adaptivity >= 0 && o_.mesh.adaptivity <= 1, "--adaptivity is " + std::to_string(o_.mesh.adaptivity) + ", must be 0..1");
        if (o_.grid.dims)
            for (int d : *o_.grid.dims) need(d > 0, "--grid has a side of " + std::to_string(d) + " voxels");
        if (o_.grid.bounds) {
            const Vec3d size = o_.grid.bounds->max() - o_.grid.bounds->min();
            need(size.allFinite() && size.minCoeff() > 0, "--bounds has no volume: every maximum must exceed its minimum");
        }
        need(o_.color.options.depth_vox >= 1 && o_.color.options.depth_vox <= 1000,
             "--color-depth is " + std::to_string(o_.color.options.depth_vox) + " layers, must be 1..1000");
        need(o_.color.options.normal_radius_vox >= 0 && o_.color.options.normal_radius_vox <= kMaxNormalRadius_vox,
             "--color-normal-radius is " + std::to_string(o_.color.options.normal_radius_vox) + ", must be 0.." + std::to_string(kMaxNormalRadius_vox));
        need(!o_.stereo.on || !o_.carve.occupancy, "--stereo on carves a level set, and --occupancy makes none");
        need(!o_.color.options.skip_upright || o_.color.options.mode == ColorMode::Best, "--paper is of --color best");
        need(o_.color.leave_out == 0 || o_.color.leave_out >= 2,
             "--color-leave-out is " + std::to_string(o_.color.leave_out) + ", must be 0 (none) or at least 2 (every second)");
        need(!o_.mesh.quads || o_.mesh.mesher == Mesher::Dual, "--quads are made by --mesher dual only");
        need(o_.mesh.min_piece_share >= 0 && o_.mesh.min_piece_share <= 1, "--min-piece is " + std::to_string(o_.mesh.min_piece_share) + ", must be 0..1");
        need(o_.filter.keep_thin_vox >= 0, "--keep-thin is " + std::to_string(o_.filter.keep_thin_vox) + ", must be >= 0");
        need(std::isfinite(o_.smooth.max_error) && o_.smooth.max_error >= 0, "--max-error is " + std::to_string(o_.smooth.max_error) + ", must be > 0");
        need(std::isfinite(o_.floor.cap_tolerance) && o_.floor.cap_tolerance >= 0,
             "--cap-tolerance is " + std::to_string(o_.floor.cap_tolerance) + ", must be >= 0");
        need(!o_.smooth.iterations || (*o_.smooth.iterations >= 0 && *o_.smooth.iterations <= 10000), "--smooth must be 0..10000 iterations");
        need(o_.smooth.factors.lambda > 0 && o_.smooth.factors.lambda < 1 && o_.smooth.factors.mu < -o_.smooth.factors.lambda && o_.smooth.factors.mu > -2,
             "--smooth-lambda must be within 0..1 and --smooth-mu less than its negative");
        for (const std::string& f : o_.result.mesh_formats)
            need(f == "ply" || f == "obj" || f == "stl" || f == "glb", "--mesh-formats: '" + f + "' is none of ply, obj, stl, glb");
        if (!bad.empty()) throw UsageError(bad);
    }

    void open_output() {
        if (fs::exists(o_.run.output) && !fs::is_directory(o_.run.output)) throw OutputError(o_.run.output.string() + ": is a file, a folder is needed");
        if (fs::is_directory(o_.run.output) && !fs::is_empty(o_.run.output) && !made_by_us(o_.run.output) && !o_.run.force)
            throw OutputError(o_.run.output.string() + ": is not empty and was not made by vdbcarve. Remedy: another -o, or --force to write into it");
        make_folder(o_.run.output / "stages");
        // Of runs that were killed.
        for (const char* folder : {"", "stages", "masks", "depth", "overlays", kUnverified}) remove_left_overs(o_.run.output / folder);
        for (const char* part : {".frames.part", ".masks.part", ".repaired.part"}) fs::remove_all(store_.folder() / part);
        fs::remove(store_.folder() / "cameras.json");
        mark_as_ours();
        // A finished result keeps its configuration until the new one is finished too.
        if (!fs::exists(o_.run.output / "report.json")) write_config();
    }
    void mark_as_ours() const { write_file(o_.run.output / kMarker, json{{"made_by", "vdbcarve"}, {"scene", scene_json()}}.dump() + "\n"); }
    void write_config() {
        if (!o_.run.config_text.empty()) write_file(place_ / "config.toml", config());
    }
    /// As given; where a grid was kept, with that instead of what led to it.
    std::string config() const {
        if (!kept_) return o_.run.config_text;
        std::istringstream lines(o_.run.config_text);
        std::string out, command;
        for (std::string line; std::getline(lines, line);) {
            const size_t dot = line.find('.'), equals = line.find('=');
            const std::string option = dot < equals ? line.substr(dot + 1, equals - dot - 1) : "";
            if (dot < equals) command = line.substr(0, dot);
            if (option != "resolution" && option != "grid" && option != "bounds" && option != "voxel-size" && option != "origin") out += line + "\n";
        }
        const auto number = [](double x) { return text_of("%.17g", x); };
        std::string bounds, origin;
        for (const Vec3d& corner : {kept_->bounds.min(), kept_->bounds.max()})
            for (int a = 0; a < 3; ++a) bounds += (bounds.empty() ? "" : ",") + number(corner[a]);
        for (int a = 0; a < 3; ++a) origin += (a ? "," : "") + number(kept_->origin[a]);
        return out + command + ".bounds=\"" + bounds + "\"\n" + command + ".voxel-size=" + number(kept_->voxel_size) + "\n" + command + ".origin=\"" + origin +
               "\"\n";
    }

    /// The scene is a film: its frames, in stages/, are the scene from here on.
    bool film_to_photographs() {
        const fs::path file = o_.views.scene;
        if (o_.run.dry_run)
            throw UsageError("--dry-run: " + file.string() +
                             " is a film, of which frames are to be taken first. Remedy: vdbcarve mask, then its folder in OUT/stages as the scene");
        if (!o_.views.images.empty()) throw UsageError("--images: " + file.string() + " is a film, its frames are the photographs. Remedy: without it");
        const bool fresh = !made_by_us(o_.run.output);
        open_output();
        Sha256 h;
        h.add("frames").add_value(kCodeVersion).add(sha256_of_file(file)).add_value(o_.video.frames).add_value(o_.video.from_s).add_value(o_.video.to_s);
        const fs::path folder = store_.path("frames", h.hex(), ""), said = folder / "frames.json";
        bool reused = fs::exists(said);
        if (reused) {
            film_ = read_video_json(said);
            for (const VideoFrame& f : film_.frames) reused = reused && fs::exists(folder / f.name);
        }
        if (!reused) {
            const fs::path part = o_.run.output / "stages" / ".frames.part";
            try {
                film_ = extract_frames(file, part, o_.video, progress_);
            } catch (const InputError&) {  // nothing was made: what was opened for it goes
                fs::remove_all(part);
                if (fresh) {
                    fs::remove(o_.run.output / "config.toml");
                    fs::remove_all(o_.run.output / "stages");
                    std::error_code others_are_in_it;
                    fs::remove(o_.run.output, others_are_in_it);
                }
                throw;
            }
            fs::remove_all(folder);
            fs::rename(part, folder);
        }
        for (const std::string& w : film_.warnings) progress_.warn(w);
        progress_.note(text_of("%zu of %zu frames of %s (%.1f s) are the photographs; they are in %s", film_.frames.size(), film_.looked_at, file.c_str(),
                               film_.duration_s, folder.c_str()));
        report_["video"] = json::parse(video_json(film_));
        report_["video"]["file"] = file.string();
        o_.views.scene = folder;
        mark_as_ours();
        return reused;
    }

    /// A motor turns evenly in time, which is known of each frame. Of a walk, frames an even motion apart are what is known, and their steps are
    /// taken for even.
    void angles_of_film() {
        AlignOptions& a = o_.align;
        if (!finds_cameras() || a.orbit != Orbit::Turntable || a.method != AlignMethod::Coherence || !a.angles_deg.empty() || !a.arc_known ||
            !a.rings.empty() || !a.sittings.empty() || film_.frames.size() != views_.views.size())
            return;
        const double first = film_.frames.front().time_s, steps = static_cast<double>(film_.frames.size());
        const double span = (film_.frames.back().time_s - first) * steps / (steps - 1);
        for (const VideoFrame& f : film_.frames) a.angles_deg.push_back(a.arc_deg * (f.time_s - first) / span);
        if (o_.video != VideoOptions() && a.arc_deg == AlignOptions().arc_deg && (o_.video.from_s > 0 || o_.video.to_s > 0))
            progress_.note("what --video-range leaves of the film is taken for one whole turn; --arc says how many degrees it is, where it is not");
        a.arc_deg = AlignOptions().arc_deg;  // the angles say it
    }

    void load() {
        ViewsOptions wanted = o_.views;
        wanted.allow_unposed = true;
        wanted.units.clear();
        views_ = load_views(wanted, progress_);
        if (!views_.posed && o_.align.method == AlignMethod::Refine)
            throw UsageError("--method refine improves cameras, and " + o_.views.scene.string() + " has none. Remedy: --cameras FILE, or --method coherence");
        const bool from_given_cameras = !finds_cameras() || o_.align.method == AlignMethod::Refine;
        if (from_given_cameras && !o_.views.units.empty() && !views_.units.empty() && o_.views.units != views_.units)
            progress_.warn("--units " + o_.views.units + ": " + views_.camera_file.string() + " says " + views_.units + "; its numbers are taken for " +
                           o_.views.units + ", none is converted");
        if (!o_.views.units.empty()) views_.units = o_.views.units;
        std::error_code not_there;
        if (!o_.run.dry_run && fs::equivalent(views_.camera_file.parent_path(), o_.run.output / kUnverified, not_there))
            throw UsageError("--cameras " + views_.camera_file.string() + ": this run would write it anew, or take it away. Remedy: another -o");
        if (finds_cameras() && o_.run.dry_run)
            throw UsageError(
                "--dry-run: cameras are to be found first, and what is to be carved is known then. Remedy: vdbcarve align, then --cameras OUT/cameras.json");
        // Without sittings of the camera file's: they are found anew, or refined with everything else in the scene's frame.
        if (o_.cameras.find_again && views_.sittings.size() > 1)
            throw UsageError("align: the camera file's sittings would be lost. Remedy: --cameras none --sittings N,N");
        const bool mat = o_.align.method == AlignMethod::Mat;  // which says both
        if (views_.posed && !o_.cameras.find_again) {
            if (const std::vector<std::string> given = given_options(o_.align); !given.empty())
                throw UsageError(some_of(given) + ": the cameras of " + views_.camera_file.string() +
                                 " are used as they are, so this would be ignored. Remedy: --method refine to improve them, --cameras none to find others, or "
                                 "without it, also in config.toml");
        } else if (o_.run.last_stage != LastStage::Mask) {
            check_align_options(o_.align, views_, views_.views.size());
            const bool by_silhouettes = o_.align.method == AlignMethod::Coherence || o_.align.method == AlignMethod::Paper,
                       scaled = o_.align.known_distance > 0 || o_.align.known_height > 0 || o_.align.known_length;
            if (by_silhouettes && !scaled && !o_.views.units.empty())
                throw UsageError("--units " + o_.views.units +
                                 ": cameras found from silhouettes know no scale, so their unit is arbitrary. Remedy: --known-height, --known-distance or "
                                 "--known-length, or a marker mat (--method mat)");
            if (o_.align.known_length) check_known_length(views_, {}, *o_.align.known_length);
        }
        if (finds_cameras() && o_.align.method != AlignMethod::Refine && !o_.views.up.empty() && o_.views.up != "z")
            throw UsageError(
                "--up " + o_.views.up +
                ": cameras that are found have z up, along the axis (or out of the mat). Remedy: without it; --dcc turns results into another program's axes");
        if (!finds_cameras() && o_.run.last_stage != LastStage::Mask && !views_.unverified.empty())
            doubt(views_.unverified, views_.camera_file.string() + ": its cameras were found, but are UNVERIFIED");
        if (views_.posed && o_.cameras.find_again && (o_.align.method == AlignMethod::Coherence || o_.align.method == AlignMethod::Paper))
            progress_.note("of " + views_.camera_file.string() +
                           " focal lengths, principal points and lenses are taken, its poses are not looked at (--method refine starts from them)");
        if (o_.floor.from != FloorFrom::File && o_.run.last_stage != LastStage::Mask && up().empty() && !finds_cameras())
            throw UsageError("--floor: the scene does not say which way is up. Remedy: --up");
        if (o_.floor.from == FloorFrom::Found && o_.run.dry_run) throw UsageError("--dry-run: the floor is to be found first. Remedy: --floor HEIGHT");
        if (views_.posed && !finds_cameras() && o_.run.last_stage != LastStage::Mask)
            if (const std::string doubted = doubt_of_up(views_.cameras(), up()); !doubted.empty()) progress_.warn(doubted);
        if (o_.floor.flat_base && up().empty() && !mat) throw UsageError("--base flat: the scene does not say which way is up. Remedy: --up");
        if (o_.result.stl_mm && !mat) file_frame(".stl", frame_request());  // refuses where the unit is not known
        progress_.note(counted(views_.views.size(), "view") + " from " + views_.camera_file.string() + " (" + views_.format + ")");
    }

    // --------------------------------------------------------------------------------------- masks

    bool masks() {
        const size_t n = views_.views.size();
        mask_names_ = mask_names(views_);
        const fs::path folder = o_.run.output / "masks";
        const json written = parse_or_empty(folder / kWritten);
        std::vector<fs::path>& edited = edited_;
        edited.assign(n, {});
        for (size_t i = 0; i < n; ++i) {
            const fs::path file = folder / mask_names_[i];
            if (!written.contains(mask_names_[i]) || !fs::exists(file)) continue;
            const json& ours = written[mask_names_[i]];
            if (std::find(ours.begin(), ours.end(), sha256_of_file(file)) == ours.end()) {
                edited[i] = file;
                progress_.note("mask edited by hand is used: " + file.string());
            }
        }

        // Every input file is hashed once; the masks depend on what they are made from and how.
        file_hashes_.resize(n);
        std::vector<std::string>& file_hashes = file_hashes_;
        std::vector<json> per_file(n, json::object());
        tbb::parallel_for(size_t{0}, n, [&](size_t i) {
            Sha256 h;
            std::vector<fs::path> files = mask_files(views_.views[i], o_.views.scene, o_.mask);
            if (!edited[i].empty()) files.push_back(edited[i]);
            if (!views_.views[i].image_path.empty() && files.front() != views_.views[i].image_path) files.push_back(views_.views[i].image_path);
            for (const fs::path& f : files) {
                const std::string hash = sha256_of_file(f);
                h.add(hash);
                per_file[i][f.string()] = hash;
            }
            file_hashes[i] = h.hex();
        });
        Sha256 everything;
        for (size_t i = 0; i < n; ++i) {
            everything.add(file_hashes[i]);
            add_camera(everything, views_.views[i].camera);
            report_["inputs"][views_.views[i].name]["sha256"] = per_file[i];
        }
        inputs_sha256_ = everything.hex();
        if (fs::is_regular_file(views_.camera_file)) report_["camera_file_sha256"] = sha256_of_file(views_.camera_file);
        Sha256 h;
        add_mask_options(h, o_.mask);
        h.add_value(o_.mask.allow_missing);
        for (size_t i = 0; i < n; ++i) {
            const View& v = views_.views[i];
            h.add(v.name).add(file_hashes[i]).add_value(v.orientation).add_value(v.lens.model).add_value(!edited[i].empty());
            for (double c : v.lens.coefficients) h.add_value(c);
            if (v.lens.distorts()) add_camera(h, v.camera);
            h.add_value(v.camera.intrinsics.width_px).add_value(v.camera.intrinsics.height_px);
        }
        mask_key_ = h.hex();

        const auto key_of_view = [&](size_t i, const MaskOptions& settled) {
            const View& v = views_.views[i];
            Sha256 key;
            add_mask_options(key, settled);
            for (const auto& [path, hash] : per_file[i].items()) key.add(path);  // two photographs may be alike; their masks' origins are not
            key.add(v.name).add(file_hashes[i]).add_value(v.orientation).add_value(v.lens.model).add_value(!edited[i].empty());
            for (double c : v.lens.coefficients) key.add_value(c);
            if (v.lens.distorts()) add_camera(key, v.camera);
            key.add_value(v.camera.intrinsics.width_px).add_value(v.camera.intrinsics.height_px);
            return key.hex();
        };
        const fs::path stored = store_.path("masks", mask_key_, "");
        const auto note_found = stage_note(stored / "masks.json", {"origins", "left_out", "warnings", "files"});
        bool reused = !o_.run.dry_run && note_found;
        if (reused)
            for (const json& f : (*note_found)["files"]) reused = reused && fs::exists(stored / f.get<std::string>());
        if (reused) {
            const json& note = *note_found;
            masks_.masks.resize(n);
            masks_.origins = note["origins"].get<std::vector<std::string>>();
            masks_.left_out = note["left_out"].get<std::vector<size_t>>();
            tbb::parallel_for(size_t{0}, n, [&](size_t i) {
                const std::string stem = std::to_string(i);
                if (fs::exists(stored / (stem + ".png"))) masks_.masks[i].coverage = io::read_image8(stored / (stem + ".png"));
                if (fs::exists(stored / (stem + "_ignore.png"))) masks_.masks[i].ignore = io::read_image8(stored / (stem + "_ignore.png"));
            });
            warn_again(note);
        } else {
            const size_t warnings_before = progress_.warnings().size();
            MaskOptions cached = o_.mask;
            if (!o_.run.dry_run) cached.cache = o_.run.output / "stages" / "mask_command";
            const MaskOptions settled = settle(views_, cached, edited, progress_);
            std::vector<std::string> keys(n);
            for (size_t i = 0; i < n; ++i) keys[i] = key_of_view(i, settled);
            masks_ =
                make_masks(views_, o_.views.scene, settled, edited, progress_, o_.run.dry_run ? std::vector<std::optional<KnownMask>>() : known_masks(keys));
            if (!o_.run.dry_run) {
                const fs::path part = o_.run.output / "stages" / ".masks.part";
                fs::remove_all(part);
                make_folder(part);
                std::vector<std::vector<uint8_t>> encoded(n);
                tbb::parallel_for(size_t{0}, n, [&](size_t i) {
                    const Mask& mask = masks_.masks[i];
                    if (mask.coverage.empty()) return;
                    encoded[i] = io::encode_png(mask.coverage);
                    write_file(part / (std::to_string(i) + ".png"), encoded[i].data(), encoded[i].size());
                    if (mask.ignore.empty()) return;
                    const auto ignore = io::encode_png(mask.ignore);
                    write_file(part / (std::to_string(i) + "_ignore.png"), ignore.data(), ignore.size());
                });
                std::vector<std::string> files;
                for (const auto& entry : fs::directory_iterator(part)) files.push_back(entry.path().filename().string());
                std::sort(files.begin(), files.end());
                const json note{{"origins", masks_.origins},
                                {"files", files},
                                {"left_out", masks_.left_out},
                                {"keys", keys},
                                {"warnings", warnings_since(warnings_before)}};
                write_file(part / "masks.json", note.dump(1) + "\n");
                fs::remove_all(stored);
                fs::rename(part, stored);
            }
        }
        if (!o_.run.dry_run) place_masks(stored);
        choose_used();
        return reused;
    }

    static void add_mask_options(Sha256& h, const MaskOptions& m) {
        h.add("mask").add_value(kCodeVersion).add_value(m.method).add_value(m.invert);
        h.add_value(m.threshold.level).add_value(m.threshold.channel).add_value(m.threshold.invert);
        h.add_value(m.clean_up.open_px).add_value(m.clean_up.close_px).add_value(m.clean_up.largest_component).add_value(m.clean_up.fill_holes);
        h.add_value(m.chroma.key_rgb.has_value()).add_value(m.grabcut.box_px.has_value()).add_value(m.chroma.level);
        for (const uint8_t c : m.chroma.key_rgb.value_or(std::array<uint8_t, 3>{})) h.add_value(c);
        for (const int x : m.grabcut.box_px.value_or(std::array<int, 4>{})) h.add_value(x);
        h.add_value(m.plate.level).add_value(m.plate.shadows);
        h.add_value(m.grabcut.from_threshold).add_value(m.grabcut.iterations).add(m.command);
    }

    /// Masks that earlier runs made, of fewer photographs, by what they were made from.
    std::vector<std::optional<KnownMask>> known_masks(const std::vector<std::string>& keys) const {
        struct Place {
            fs::path folder;
            size_t number;
            std::string origin;
        };
        std::map<std::string, Place> places;
        for (const auto& entry : fs::directory_iterator(store_.folder())) {
            if (entry.path().filename().string().rfind("masks-", 0) != 0) continue;
            const auto note = stage_note(entry.path() / "masks.json", {"origins", "keys"});
            if (!note) continue;
            try {
                const auto theirs = (*note)["keys"].get<std::vector<std::string>>(), origins = (*note)["origins"].get<std::vector<std::string>>();
                for (size_t i = 0; i < std::min(theirs.size(), origins.size()); ++i) places[theirs[i]] = {entry.path(), i, origins[i]};
            } catch (const json::exception&) {
                continue;  // damaged
            }
        }
        std::vector<std::optional<KnownMask>> out(keys.size());
        tbb::parallel_for(size_t{0}, keys.size(), [&](size_t i) {
            const auto found = places.find(keys[i]);
            if (found == places.end()) return;
            const fs::path stem = found->second.folder / std::to_string(found->second.number), coverage = fs::path(stem) += ".png",
                           ignore = fs::path(stem) += "_ignore.png";
            if (!fs::exists(coverage)) return;  // one that was left out is made, and left out, again
            try {
                out[i] = KnownMask{{io::read_image8(coverage), fs::exists(ignore) ? io::read_image8(ignore) : Image8()}, found->second.origin};
            } catch (const InputError&) {
                // Damaged: it is made again.
            }
        });
        return out;
    }

    /// Views with a mask, but for those that cameras.json or align() says not to use.
    void choose_used() {
        const std::set<size_t> without(masks_.left_out.begin(), masks_.left_out.end());
        const bool all = o_.run.last_stage == LastStage::Mask || (finds_cameras() && !aligned_);  // every silhouette is made, and asked for cameras
        used_.clear();
        std::vector<std::string> unused;
        for (size_t i = 0; i < views_.views.size(); ++i) {
            const View& v = views_.views[i];
            if (without.count(i)) continue;
            if (v.unused.empty() || all) used_.push_back(i);
            else unused.push_back(v.name + " (" + v.unused + ")");
        }
        if (used_.empty()) throw InputError(views_.camera_file.string() + ": no view is left to carve with");
        if (!unused.empty() && !aligned_)  // align() has said it
            progress_.warn(counted(unused.size(), "view") + " not used, as " + views_.camera_file.string() + " says: " + some_of(unused) +
                           ". Remedy: mend the masks and align again");
    }

    // --------------------------------------------------------------------------------------- repair

    /// Broken masks by name: for a warning, or to be mended.
    std::vector<size_t> broken_masks() { return find_broken_masks(views_.names(), views_.cameras(), used_mask_views(), progress_); }

    /// Silhouettes that nobody else bears out carve all the same, unless they are mended: one view may know what no other can.
    void warn_of_broken_masks() {
        std::vector<std::string> names;
        for (const size_t i : broken_masks()) names.push_back(views_.views[i].name);
        if (!names.empty())
            progress_.warn(counted(names.size(), "mask") + " against all others: " + some_of(names) +
                           ". Where such a mask is wrong, the object loses what it leaves out. Remedy: look at " + (names.size() == 1 ? "it" : "them") +
                           ", and mend or delete what is wrong, or --repair-masks");
    }

    bool repair() {
        Sha256 h;
        h.add("repair").add_value(kCodeVersion).add(mask_key_);
        for (const Camera& c : views_.cameras()) add_camera(h, c);
        for (const size_t i : used_) h.add_value(i);
        const std::string key = h.hex();
        const fs::path stored = store_.path("repaired", key, "");
        const auto note = stage_note(stored / "repaired.json", {"views", "warnings"});
        mask_key_ = key;
        const auto take = [&](size_t i, const char* what) {
            const fs::path file = stored / (std::to_string(i) + what);
            return fs::exists(file) ? io::read_image8(file) : Image8();
        };
        if (note) {
            for (const size_t i : (*note)["views"].get<std::vector<size_t>>()) {
                masks_.masks[i] = {take(i, ".png"), take(i, "_ignore.png")};
                masks_.origins[i] += " (repaired)";
            }
            warn_again(*note);
            place_masks(stored);
            return true;
        }
        const size_t before = progress_.warnings().size();
        std::vector<size_t> broken = broken_masks();
        for (const size_t i : broken)
            if (!edited_[i].empty())
                progress_.warn(edited_[i].string() +
                               ": is against all others, but was edited by hand and is left as it is. Remedy: delete it to have it made anew");
        std::erase_if(broken, [&](size_t i) { return !edited_[i].empty(); });  // the user's word
        const fs::path part = o_.run.output / "stages" / ".repaired.part";
        fs::remove_all(part);
        make_folder(part);
        if (!broken.empty()) {
            std::vector<Mask> masks(views_.views.size());
            for (const size_t u : used_) masks[u] = masks_.masks[u];
            Progress quiet;
            const std::vector<std::string> done = repair_masks(
                views_.names(), views_.cameras(), masks, broken, [&](size_t i) { return photo_to_show(views_.views[i]); }, quiet);
            progress_.warn(counted(broken.size(), "mask") + " against all others, mended: " + some_of(done) + ". Remedy: look at " +
                           (o_.run.output / "masks").string());
            for (const size_t i : broken) {
                masks_.masks[i] = std::move(masks[i]);
                masks_.origins[i] += " (repaired)";
                for (const auto& [image, what] : {std::pair{&masks_.masks[i].coverage, ".png"}, {&masks_.masks[i].ignore, "_ignore.png"}}) {
                    if (image->empty()) continue;
                    const auto png = io::encode_png(*image);
                    write_file(part / (std::to_string(i) + what), png.data(), png.size());
                }
            }
        }
        write_file(part / "repaired.json", json{{"views", broken}, {"warnings", warnings_since(before)}}.dump(1) + "\n");
        fs::remove_all(stored);
        fs::rename(part, stored);
        place_masks(stored);
        return false;
    }

    /// Cameras that may be wrong are not carved with, unless that is wanted.
    void doubt(const std::vector<std::string>& why, const std::string& what) {
        std::string list;
        for (const std::string& w : why) list += "\n  - " + w;
        if (!o_.cameras.accept_unobservable)
            throw UndeterminedError(what + ". Remedy: as each finding says, or --accept-unobservable to go on with them" + list);
        progress_.warn(what + ", and used all the same (--accept-unobservable)" + list);
    }

    /// What an earlier run that was refused left.
    void clear_unverified() {
        const fs::path folder = o_.run.output / kUnverified;
        for (const char* file : {"cameras.json", "report.json", "config.toml", "orbit.svg", "preview.png", "preview_direction_cw.png",
                                 "preview_direction_ccw.png", "mat.png", "energy_map.png"})
            fs::remove(folder / file);
        std::error_code others_are_in_it;
        fs::remove(folder, others_are_in_it);
    }

    /// Cameras are to be found in this run, or are being found.
    bool finds_cameras() const { return o_.run.last_stage != LastStage::Mask && (!views_.posed || o_.cameras.find_again); }

    /// Copies of the masks for the user to look at and to edit. An edited one is left alone.
    void place_masks(const fs::path& stored) {
        const fs::path folder = o_.run.output / "masks";
        json written = parse_or_empty(folder / kWritten);
        make_folder(folder);
        std::vector<std::pair<fs::path, fs::path>> copies;
        for (size_t i = 0; i < mask_names_.size(); ++i) {
            const fs::path from = stored / (std::to_string(i) + ".png");
            if (!edited_[i].empty() || !fs::exists(from)) continue;
            const std::string hash = sha256_of_file(from);
            json& ours = written[mask_names_[i]];
            if (fs::exists(folder / mask_names_[i]) && !ours.empty() && ours.back() == hash) continue;
            copies.emplace_back(from, folder / mask_names_[i]);
            // The one before is still ours, should a run end between the note and the copy.
            ours = ours.empty() ? json{hash} : json{ours.back(), hash};
        }
        write_file(folder / kWritten, written.dump(1) + "\n");
        for (const auto& [from, to] : copies) place_copy(from, to);
    }

    // --------------------------------------------------------------------------------------- floor

    using FloorFrom = FloorOptions::From;

    /// Where the object stands, into views_.floor.
    bool find_floor() {
        if (up().empty()) throw UsageError("--floor: which way is up? Remedy: --up");
        if (o_.floor.from == FloorFrom::Given) {
            views_.floor = o_.floor.height;
            report_["floor"] = {{"height", o_.floor.height}, {"from", "given"}};
            return false;
        }
        Sha256 h;
        h.add("floor").add_value(kCodeVersion).add(mask_key_).add(up()).add_value(o_.carve.min_seen);
        for (const Camera& c : views_.cameras()) add_camera(h, c);
        for (const size_t i : used_) h.add_value(i);
        const fs::path file = store_.path("floor", h.hex(), ".json");
        auto note = stage_note(file, {"floor", "warnings"});
        const bool reused = note.has_value();
        if (reused) {
            warn_again(*note);
        } else {
            const size_t before = progress_.warnings().size();
            const std::vector<MaskView> masks = used_mask_views();
            const std::vector<Camera> cameras = views_.cameras();
            const auto hull = coarse_hull(views_.names(), cameras, masks, 192, o_.carve.min_seen, progress_);
            const std::optional<Floor> table = find_table(
                *hull, cameras, masks, [&](size_t i) { return photo_to_show(views_.views[i]); }, up_direction(), progress_);
            json found;
            if (table) {
                found = {{"height", table->height}, {"from", "photographs"}, {"likeness", table->likeness}, {"next_best", table->next_best}};
            } else {
                const SeenExtent seen = seen_extent(*hull, cameras, masks, up_direction());
                if (!seen.bottom_seen)
                    throw UndeterminedError(
                        "--floor auto: the photographs show no table (a pattern on it is needed), and every silhouette is cut by its frame below. Remedy: "
                        "--floor HEIGHT");
                found = {{"height", seen.lowest}, {"from", "lowest contour"}};
                progress_.warn(
                    text_of("--floor auto: the photographs show no table (a pattern on it is needed); the floor is put where the lowest contour was seen, at "
                            "%.5g. A reflection in the masks would lower it. Remedy: --floor HEIGHT, where that is wrong",
                            seen.lowest));
            }
            write_file(file, json{{"floor", found}, {"warnings", warnings_since(before)}}.dump(1) + "\n");
            note = stage_note(file, {"floor", "warnings"});
        }
        report_["floor"] = (*note)["floor"];
        views_.floor = report_["floor"]["height"].get<double>();
        progress_.note(text_of("the floor is at %.5g along %s (%s)", *views_.floor, up().c_str(), report_["floor"]["from"].get<std::string>().c_str()));
        return reused;
    }

    // --------------------------------------------------------------------------------------- align

    bool align_views() {
        const AlignOptions& a = o_.align;
        Sha256 h;
        h.add("align").add_value(kCodeVersion).add(mask_key_);
        const bool by_mat = a.method == AlignMethod::Mat;
        if (by_mat) {  // before there are masks
            for (const View& v : views_.views) {
                h.add(v.name).add(v.image_path.empty() ? "" : sha256_of_file(v.image_path)).add_value(v.orientation).add_value(v.lens.model);
                for (double x : v.lens.coefficients) h.add_value(x);
            }
            h.add_value(a.mat->kind)
                .add_value(a.mat->columns)
                .add_value(a.mat->rows)
                .add_value(a.mat->marker_m)
                .add_value(a.mat->step_m)
                .add(a.mat->dictionary);
        }
        h.add(views_.up)
            .add(views_.units)
            .add_value(views_.floor.has_value())
            .add_value(views_.floor.value_or(0))
            .add_value(a.features)
            .add(a.paper_views[0])
            .add(a.paper_views[1])
            .add_value(a.known_length.has_value());
        if (a.known_length)
            h.add(a.known_length->view)
                .add_value(a.known_length->from_px.x())
                .add_value(a.known_length->from_px.y())
                .add_value(a.known_length->to_px.x())
                .add_value(a.known_length->to_px.y())
                .add_value(a.known_length->length);
        h.add_value(a.method).add_value(a.orbit).add_value(a.direction);
        for (double angle : a.angles_deg) h.add_value(angle);
        h.add_value(a.arc_deg).add_value(a.arc_known).add_value(a.rings.size());
        for (int r : a.rings) h.add_value(r);
        h.add_value(a.sittings.size());
        for (int s : a.sittings) h.add_value(s);
        h.add_value(a.fov_deg).add_value(a.principal_point_px.has_value());
        if (a.principal_point_px) h.add_value(a.principal_point_px->x()).add_value(a.principal_point_px->y());
        h.add_value(a.focal_varies)
            .add_value(a.centre_varies)
            .add_value(a.known_distance)
            .add_value(a.known_height)
            .add(a.units)
            .add_value(a.points)
            .add_value(a.restarts)
            .add_value(a.seed);
        h.add_value(refines_for_stereo());
        for (const Camera& c : views_.cameras()) add_camera(h, c);
        align_key_ = h.hex();
        const fs::path note_file = store_.path("align", align_key_, ".json"), cameras_file = store_.path("align", align_key_, ".cameras.json"),
                       other_file = store_.path("align", align_key_, ".other.json"), svg_file = store_.path("align", align_key_, ".svg"),
                       picture_file = store_.path("align", align_key_, ".png");
        const auto note = stage_note(note_file, {"align", "warnings"});
        const bool reused = note && fs::exists(cameras_file) && fs::exists(svg_file);
        if (!reused) {
            const size_t before = progress_.warnings().size();
            const std::vector<MaskView> masks = by_mat ? std::vector<MaskView>() : used_mask_views();
            AlignResult found = align(views_, masks, a, progress_);
            if (refines_for_stereo()) refine_by_texture(found, masks);
            for (const std::string& w : found.warnings) progress_.warn(w);
            write_file(cameras_file, cameras_json(found.views));
            fs::remove(other_file);
            if (!found.other_cameras.empty()) {
                Views other = found.views;
                for (size_t i = 0; i < other.views.size(); ++i) other.views[i].camera = found.other_cameras[i];
                write_file(other_file, cameras_json(other));
            }
            write_file(svg_file, orbit_svg(found));
            if (!found.picture.empty()) {
                const auto png = io::encode_png(found.picture);
                write_file(picture_file, png.data(), png.size());
            }
            write_file(
                note_file,
                json{{"align", json::parse(alignment_json(found))}, {"warnings", warnings_since(before)}, {"up", found.views.up}, {"units", found.views.units}}
                        .dump(1) +
                    "\n");
        } else {
            warn_again(*note);
        }
        // Read back, also when just written: a run that goes on must see the bits that a run in one go saw.
        const json written = reused ? *note : parse_or_empty(note_file);
        report_["align"] = written["align"];
        const auto left_out = report_["align"]["left_out"].get<std::vector<std::string>>();
        views_.left_out.insert(views_.left_out.end(), left_out.begin(), left_out.end());
        std::erase_if(views_.views, [&](const View& v) { return std::find(left_out.begin(), left_out.end(), v.name) != left_out.end(); });
        take_cameras(views_, cameras_file);
        align_picture_ = picture_file;
        views_.posed = true;
        views_.format = "align";
        views_.up = o_.views.up.empty() ? written.value("up", "") : o_.views.up;
        if (views_.up != written.value("up", "")) views_.floor.reset();  // a height along another axis
        views_.units = o_.views.units.empty() ? written.value("units", "") : o_.views.units;
        orbit_svg_ = svg_file;
        aligned_ = true;
        if (!by_mat) choose_used();
        say_alignment();
        if (views_.unverified.empty()) return reused;
        std::string shown;
        if (!o_.cameras.accept_unobservable) {  // beside what an earlier run made, which stays
            clear_unverified();
            place_ = o_.run.output / kUnverified;
            make_folder(place_);
            place_alignment(fs::exists(other_file) ? other_file : fs::path());
            finish();
            shown = ". " + place_.string() + " holds them" + (fs::exists(place_ / "preview.png") ? ", its preview.png shows what they would make" : "");
        }
        doubt(views_.unverified, "the cameras found are UNVERIFIED" + shown);
        return reused;
    }

    /// What silhouettes alone leave open, a few tenths of a pixel, is what depths would be wrong by. (A mat's cameras are better than silhouettes can make
    /// them.)
    bool refines_for_stereo() const {
        return o_.stereo.on && o_.align.features && (o_.align.method == AlignMethod::Coherence || o_.align.method == AlignMethod::Paper);
    }

    /// Fits tracks of the photographs' features, too. Without texture nothing changes.
    void refine_by_texture(AlignResult& found, const std::vector<MaskView>& masks) {
        if (!found.failures.empty()) return;
        constexpr size_t kFewest = 100;
        AlignOptions finer;
        finer.method = AlignMethod::Refine;
        finer.focal_varies = o_.align.focal_varies;
        finer.centre_varies = o_.align.centre_varies;
        finer.points = o_.align.points;
        finer.seed = o_.align.seed;
        AlignResult refined;
        try {
            refined = align(found.views, masks, finer, progress_);
        } catch (const UndeterminedError& e) {
            return progress_.detail(std::string("stereo: cameras are not refined by texture: ") + e.what());
        } catch (const InputError& e) {
            return progress_.detail(std::string("stereo: cameras are not refined by texture: ") + e.what());
        }
        if (refined.features < kFewest || !refined.failures.empty()) {
            progress_.detail(text_of("stereo: %zu tracks of features are too few to refine the cameras by", refined.features));
            return;
        }
        progress_.note(text_of("stereo: cameras refined by %zu tracks of features, %.2f px (rms)", refined.features, refined.features_rms_px));
        found.views = std::move(refined.views);
        found.rms_px = refined.rms_px;
        found.coherent = refined.coherent;
        found.focal_px = refined.focal_px;
        found.aligned = std::move(refined.aligned);
        found.touches_world = std::move(refined.touches_world);
        found.features = refined.features;
        found.features_rms_px = refined.features_rms_px;
        found.features_near = refined.features_near;
        found.warnings.insert(found.warnings.end(), refined.warnings.begin(), refined.warnings.end());
    }

    /// Cameras and sittings from a file of ours about the same views.
    static void take_cameras(Views& views, const fs::path& file) {
        const io::Imported read = io::read_transforms(file);
        views.sittings = read.sittings;
        views.floor = read.floor;
        views.unverified = read.unverified;
        for (size_t i = 0; i < views.views.size(); ++i) {
            views.views[i].unused = read.views.at(i).view.unused;
            views.views[i].camera = read.views.at(i).view.camera;
            views.views[i].sitting = read.views[i].view.sitting;
            views.views[i].lens = read.views[i].view.lens;
        }
    }

    void say_alignment() {
        const json& a = report_["align"];
        if (o_.align.method == AlignMethod::Mat) {
            progress_.note(
                text_of("cameras found from the mat in %s: its corners %.2f px (rms) from where they should be; focal length %.1f +- %.1f px; lengths in %s",
                        counted(views_.views.size(), "view").c_str(), a["residual_rms_px"].get<double>(), a["focal_px"].get<double>(),
                        a["focal_sd_px"].get<double>(), a["units"].get<std::string>().c_str()));
            return;
        }
        progress_.note(
            text_of("cameras found: %s, object turning %s; contours %.2f px (rms) outside the others' hull, %.1f %% within half a pixel; focal length %.0f px; "
                    "%s units",
                    a["orbit"].get<std::string>().c_str(), a["direction"].get<std::string>().c_str(), a["residual_rms_px"].get<double>(),
                    100 * a["coherent_share"].get<double>(), a["focal_px"].get<double>(), a["units"].get<std::string>().c_str()));
    }

    /// Masks of the views that have one, by view.
    std::vector<MaskView> used_mask_views() const {
        std::vector<MaskView> masks(views_.views.size());
        for (const size_t u : used_) masks[u] = view_of(masks_.masks[u]);
        return masks;
    }

    /// What the alignment drew; and nothing of an earlier one's.
    void place_align_pictures() {
        if (!aligned_) return;
        for (const char* name : {"orbit.svg", "mat.png", "energy_map.png"}) fs::remove(place_ / name);
        if (!orbit_svg_.empty()) place_copy(orbit_svg_, place_ / "orbit.svg");
        if (fs::exists(align_picture_)) place_copy(align_picture_, place_ / (report_["align"]["picture"].get<std::string>() + ".png"));
    }

    /// cameras.json, orbit.svg, and in preview.png the hull over the views that fit worst.
    void place_alignment(const fs::path& other_cameras = {}) {
        write_file(place_ / "cameras.json", cameras_json(views_));
        place_align_pictures();
        if (used_.empty()) {  // found without masks: there is no hull to be shown
            fs::remove(place_ / "preview.png");
            return;
        }
        std::map<std::string, double> residual;
        for (const json& v : report_["align"]["views"]) residual[v["name"]] = v["residual_px"];
        std::vector<size_t> worst = used_;
        std::stable_sort(worst.begin(), worst.end(), [&](size_t a, size_t b) { return residual[views_.views[a].name] > residual[views_.views[b].name]; });
        worst.resize(std::min<size_t>(worst.size(), 12));
        const std::vector<std::string> names = views_.names();
        const std::vector<MaskView> masks = used_mask_views();
        const auto sheet = [&](const Views& views, const fs::path& file) {
            fs::remove(file);  // an earlier run's
            try {
                mesh_ = extract_mesh(*coarse_hull(names, views.cameras(), masks, 192, o_.carve.min_seen, progress_), {}, progress_);
            } catch (const Interrupted&) {
                throw;
            } catch (const Error& e) {  // there may be no hull, of cameras that are wrong
                progress_.warn(std::string("no preview: ") + e.what());
                return;
            }
            agreement_.assign(views.views.size(), {});
            for (const size_t i : worst) agreement_[i] = compare_silhouettes(silhouette_of(mesh_, views.cameras()[i]), masks[i]);
            preview(views, worst, file);
        };
        sheet(views_, place_ / "preview.png");
        if (!other_cameras.empty()) {
            Views other = views_;
            take_cameras(other, other_cameras);
            const std::string turned = report_["align"]["direction"].get<std::string>(), opposite = turned == "cw" ? "ccw" : "cw";
            sheet(other, place_ / ("preview_direction_" + opposite + ".png"));
            if (!fs::exists(place_ / "preview.png") || !fs::exists(place_ / ("preview_direction_" + opposite + ".png"))) return;  // said above
            place_copy(place_ / "preview.png", place_ / ("preview_direction_" + turned + ".png"));
            progress_.note(
                "both ways are shown: preview_direction_cw.png is --direction cw, preview_direction_ccw.png is --direction ccw; the wrong one is a mirror "
                "image");
        }
    }

    // --------------------------------------------------------------------------------------- carve

    /// The bounds and voxels of the result that views are added to.
    struct KeptGrid {
        Box3d bounds;
        double voxel_size;
        Vec3d origin;
        bool automatic, floor_clips;
    };

    static std::string box_text(const Box3d& b) {
        return text_of("%.9g,%.9g,%.9g,%.9g,%.9g,%.9g", b.min().x(), b.min().y(), b.min().z(), b.max().x(), b.max().y(), b.max().z());
    }

    /// Nothing where nothing is added, where there is no result, and where its cameras were others: then its bounds mean nothing here.
    std::optional<KeptGrid> grid_to_keep() {
        if (o_.views.added.empty() || finds_cameras()) return std::nullopt;
        if (!fs::exists(o_.run.output / "report.json")) return std::nullopt;  // nothing is there yet
        const json report = parse_or_empty(o_.run.output / "report.json");
        std::map<std::string, Camera> before;
        KeptGrid kept{};
        try {
            const json& g = report.at("grid");
            const auto b = g.at("bounds").get<std::array<double, 6>>();
            kept.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
            kept.voxel_size = g.at("voxel_size").get<double>();
            const auto o = g.at("origin").get<std::array<double, 3>>();
            kept.origin = Vec3d(o[0], o[1], o[2]);
            kept.automatic = g.value("bounds_automatic", true);
            kept.floor_clips = g.value("floor_clips", false);
            for (const io::ImportedView& v : io::read_transforms(o_.run.output / "cameras.json").views) before.emplace(v.view.name, v.view.camera);
        } catch (const std::exception& e) {  // of nlohmann::json or an InputError
            progress_.warn("the bounds are found anew: " + (o_.run.output / "report.json").string() + " does not say which they were (" + e.what() +
                           "). It is of mask, align, or an older vdbcarve");
            return std::nullopt;
        }
        std::vector<std::string> moved, gone;
        std::set<std::string> same;
        for (const View& v : views_.views) {
            auto found = before.find(v.name);
            if (found == before.end()) found = before.find(fs::path(v.name).filename().string());
            if (found == before.end()) continue;
            const Camera &a = v.camera, &b = found->second;
            const auto numbers = [](const Camera& c) {
                const Intrinsics& k = c.intrinsics;
                return Eigen::Matrix<double, 7, 1>{k.fx, k.fy, k.skew, k.cx, k.cy, static_cast<double>(k.width_px), static_cast<double>(k.height_px)};
            };
            const Vec3d &ta = a.camera_from_world.translation, &tb = b.camera_from_world.translation;
            const bool near = (a.camera_from_world.rotation - b.camera_from_world.rotation).norm() < 1e-9 && (ta - tb).norm() <= 1e-9 * (1 + ta.norm()) &&
                              (numbers(a) - numbers(b)).norm() <= 1e-9 * numbers(a).norm();
            if (near) same.insert(found->first);
            else moved.push_back(v.name);
        }
        for (const auto& [name, camera] : before)
            if (!same.count(name)) gone.push_back(name);
        if (moved.empty() && !same.empty()) {
            if (const std::vector<std::string> scenes = scenes_left_away(report); !gone.empty() && !scenes.empty())
                throw UsageError("--add: " + o_.run.output.string() + " was made of " + some_of(scenes) + ", too, whose views (" + some_of(gone) +
                                 ") it would lose. Remedy: --add " + scenes.front() + " besides, or another -o");
            if (!gone.empty())
                progress_.warn("the result in " + o_.run.output.string() + " was made of " + counted(gone.size(), "view") + " more, which " +
                               (gone.size() == 1 ? "is" : "are") + " not here any more: " + some_of(gone));
            return kept;
        }
        progress_.warn("the result in " + o_.run.output.string() + " is replaced, not extended, and its bounds are found anew: its cameras are others" +
                       (moved.empty() ? "" : " (" + some_of(moved) + ")"));
        return std::nullopt;
    }

    /// Scenes that the result was made of and this run is not.
    std::vector<std::string> scenes_left_away(const json& report) const {
        std::set<fs::path> here{fs::weakly_canonical(o_.views.scene)};
        for (const fs::path& scene : o_.views.added) here.insert(fs::weakly_canonical(scene));
        std::vector<std::string> out;
        const json scene = report.value("scene", json::object());
        for (const auto& folder : scene.value("added", std::vector<std::string>()))
            if (!here.count(fs::weakly_canonical(folder))) out.push_back(folder);
        return out;
    }

    void plan_key() {
        kept_ = grid_to_keep();
        Sha256 h;
        h.add("carve")
            .add_value(kCodeVersion)
            .add(mask_key_)
            .add(views_.units)
            .add(views_.up)
            .add_value(views_.floor.has_value())
            .add_value(views_.floor.value_or(0))
            .add_value(o_.carve.silhouette_offset_px);
        for (const Camera& c : views_.cameras()) add_camera(h, c);
        for (const size_t i : used_) h.add_value(i);
        h.add_value(o_.grid.resolution).add_value(o_.grid.voxel_size).add_value(o_.carve.max_misses).add_value(o_.carve.min_seen);
        h.add_value(o_.carve.outside_is_background).add_value(o_.carve.occupancy).add_value(o_.carve.half_width_vox).add_value(o_.carve.field_scale);
        if (o_.grid.dims)
            for (int d : *o_.grid.dims) h.add_value(d);
        h.add_value(o_.grid.bounds.has_value()).add_value(o_.grid.origin.has_value());
        if (o_.grid.bounds)
            for (int a = 0; a < 3; ++a) h.add_value(o_.grid.bounds->min()[a]).add_value(o_.grid.bounds->max()[a]);
        if (o_.grid.origin)
            for (int a = 0; a < 3; ++a) h.add_value((*o_.grid.origin)[a]);
        if (kept_)
            for (int a = 0; a < 3; ++a)
                h.add_value(kept_->bounds.min()[a]).add_value(kept_->bounds.max()[a]).add_value(kept_->origin[a]).add_value(kept_->voxel_size);
        hull_key_ = h.hex();
    }
    fs::path hull_file() const { return store_.path("hull", hull_key_, ".vdb"); }
    /// The hull, whole or in bricks, of an earlier run. Stages after it want it whole.
    bool hull_is_there() const {
        const auto note = stage_note(hull_json(), {"grid", "warnings", "backend", "id"});
        if (!note) return false;
        if (fs::exists(hull_file())) return true;
        if (o_.run.last_stage != LastStage::Carve || !(*note)["grid"].contains("bricks")) return false;
        for (const json& name : (*note)["grid"]["bricks"])
            if (!fs::exists(brick_folder() / name.get<std::string>())) return false;
        return true;
    }
    fs::path hull_json() const { return store_.path("hull", hull_key_, ".json"); }

    /// Bounds, grid, and the distance fields that suit them.
    void distances() {
        const std::vector<Camera> cameras = views_.cameras();
        for (size_t i : used_) {
            inputs_.push_back({views_.views[i].name, cameras[i], nullptr});
            used_masks_.push_back(view_of(masks_.masks[i]));
        }
        warnings_before_grid_ = progress_.warnings().size();  // the hull's note keeps those from here on
        if (!o_.mask.repair && !o_.run.dry_run) warn_of_broken_masks();
        plan_grid();
        if (o_.run.dry_run) return;
        find_known();
        if (known_whole()) return;
        if (on_cuda() && on_device("distance", [&](Device& device) {
                device.upload(used_masks_);
                device.distance(field_options_);
                device.wait();
            }))
            return;
        if (known_) {
            const auto start = std::chrono::steady_clock::now();
            // Of known views only what they ignore is asked for.
            std::vector<size_t> wanted;
            for (size_t u = 0; u < inputs_.size(); ++u)
                if (u >= known_->views.size() || !used_masks_[u].ignore.empty()) wanted.push_back(u);
            std::vector<MaskView> masks;
            for (const size_t u : wanted) masks.push_back(used_masks_[u]);
            fields_ = distance_fields(masks, field_options_, progress_);
            for (size_t w = 0; w < wanted.size(); ++w) inputs_[wanted[w]].field = &fields_[w];
            extend_seconds_ = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
            return;
        }
        if (batch_ < inputs_.size()) return;  // made in batches while carving
        fields_ = distance_fields(used_masks_, field_options_, progress_);
        for (size_t u = 0; u < inputs_.size(); ++u) inputs_[u].field = &fields_[u];
    }

    /// The very hull is there, under another name.
    bool known_whole() const { return known_ && known_->views.size() == inputs_.size(); }

    /// What a hull depends on, but for its views; and each of those.
    void find_known() {
        Sha256 h;
        h.add("hull of any views")
            .add_value(kCodeVersion)
            .add_value(carve_.max_misses)
            .add_value(carve_.min_seen)
            .add_value(carve_.outside)
            .add_value(carve_.half_width_vox)
            .add_value(carve_.occupancy);
        for (int a = 0; a < 3; ++a) h.add_value(carve_.bounds_world.min()[a]).add_value(carve_.bounds_world.max()[a]).add_value(carve_.lattice.origin_world[a]);
        h.add_value(carve_.lattice.voxel_size)
            .add_value(field_options_.silhouette_offset_px)
            .add_value(field_options_.scale)
            .add_value(field_options_.reach_samples);
        base_key_ = h.hex();
        view_keys_.resize(inputs_.size());
        tbb::parallel_for(size_t{0}, inputs_.size(), [&](size_t u) {
            Sha256 view;
            add_camera(view, inputs_[u].camera);
            const MaskView& m = used_masks_[u];
            view.add(m.coverage.data, m.coverage.pixels()).add(m.ignore.data, m.ignore.pixels());
            view_keys_[u] = view.hex();
        });
        std::vector<std::string> sorted = view_keys_;
        std::sort(sorted.begin(), sorted.end());
        Sha256 id;
        id.add(base_key_);
        for (const std::string& key : sorted) id.add(key);
        hull_id_ = id.hex();
        if (carve_.occupancy || bricks_ > 1) return;
        known_ = find_known_hull(store_.folder(), base_key_, view_keys_);
        if (!known_ || known_whole()) return;  // of all of them: taken as it is
        // A device carves anew sooner than it is told of a hull; many new views, or fields that do not fit into memory together, are for a carve, too.
        if (on_cuda() || 2 * known_->views.size() < inputs_.size() || batch_ < inputs_.size()) {
            known_.reset();
            return;
        }
        // Those that made it first, as extend_hull wants them.
        std::vector<size_t> order = known_->views;
        for (size_t u = 0, k = 0; u < inputs_.size(); ++u) {
            if (k < known_->views.size() && known_->views[k] == u) ++k;
            else order.push_back(u);
        }
        const auto in_order = [&](const auto& all) {
            auto out = all;
            for (size_t n = 0; n < order.size(); ++n) out[n] = all[order[n]];
            return out;
        };
        inputs_ = in_order(inputs_);
        used_masks_ = in_order(used_masks_);
        view_keys_ = in_order(view_keys_);
    }

    bool on_cuda() const { return device_->backend() == Backend::Cuda; }

    /// DeviceSession::run(). Where the device is left, memory is shared out for the CPU.
    template <class Work>
    bool on_device(const char* stage, const Work& work) {
        const bool was_there = on_cuda(), done = device_->run(stage, work);
        if (was_there && !on_cuda() && !inputs_.empty()) share_out_memory();
        return done;
    }

    // --------------------------------------------------------------------------------------- memory

    double memory_limit() const { return o_.run.memory_limit ? static_cast<double>(o_.run.memory_limit) : 0.9 * static_cast<double>(machine_memory_bytes()); }

    /// Leaves of the hull at the planned resolution: those of two coarse hulls, continued. The surface's leaves grow with the
    /// square of the resolution, with a linear part from its creases and ends.
    double predict_leaves() {
        const double target = carve_.bounds_world.sizes().maxCoeff() / carve_.lattice.voxel_size;
        const auto leaves_at = [&](double side) {
            CarveOptions o = carve_;
            o.occupancy = false;
            o.allow_empty = true;
            o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / side;
            std::vector<Camera> cameras;
            for (const CarveInput& input : inputs_) cameras.push_back(input.camera);
            const FieldPlan plan = plan_fields(cameras, o);
            DistanceOptions d;
            d.silhouette_offset_px = o_.carve.silhouette_offset_px;
            d.scale = plan.scale;
            d.reach_samples = plan.reach_samples;
            Progress quiet;
            const std::vector<DistanceField> fields = distance_fields(used_masks_, d, quiet);
            std::vector<CarveInput> inputs = inputs_;
            for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
            return static_cast<double>(carve(inputs, o, quiet).statistics.leaves);
        };
        const double fine = std::min(target, 320.0), coarse = 0.5 * fine;
        const double a = leaves_at(coarse), b = leaves_at(fine);
        const double square = (b / fine - a / coarse) / (fine - coarse), linear = a / coarse - square * coarse;
        return std::max({1.0, b * target / fine, square * target * target + linear * target});
    }

    // Bytes a leaf of the surface, measured on the dragon at 512 to 2048 (BENCHMARKS.md): values, masks and nodes; the
    // level set's second set of values and its bookkeeping; the mesh with what OpenVDB needs to extract it (47 vertices a
    // leaf); two volumes, one mesh and compressed buffers while files are written.
    static constexpr double kTreePerLeaf = 2215, kHullPerLeaf = 2270, kLevelSetPerLeaf = 4450, kExportPerLeaf = 8300, kGlbPerLeaf = 7200, kColorPerLeaf = 17000,
                            kColorGridPerLeaf = 6300, kFilterPerLeaf = 9000;
    // On the device: candidate leaves (1.35 for each that stays) with values, views and cells, and the grid; the level set's two sets
    // of values, its grid and neighbours; edges, vertices with normals and triangles.
    static constexpr double kDeviceHullPerLeaf = 1.35 * (2048 + 64 + 240) + 2148, kDeviceSurfacePerLeaf = 2 * 2048 + 64 + 24 + 2148,
                            kDeviceMeshPerLeaf = 256 + 50 * 24 + 100 * 12;
    // Colours and layers of all voxels in leaves, candidates and the fill's cells of those of the contour.
    static constexpr double kDeviceColorPerLeaf = 14000, kDeviceFilterPerLeaf = 1.3 * (4 * 2048 + 2148 + 176);
    static constexpr double kMostSlabs = 64, kProgramBase = 120e6;
    static constexpr double kCarveBase = 20e6, kMeshBase = 40e6, kExportBase = 70e6;

    /// Peak memory of the run from here, by stage, into the report; then batches, bricks, or a clear no.
    void plan_memory() {
        const double limit = memory_limit();
        const auto longest = carve_.bounds_world.sizes().maxCoeff() / carve_.lattice.voxel_size;
        batch_ = inputs_.size();
        bricks_ = 1;
        // A small job on a whole machine needs no prophecy.
        if (!o_.run.dry_run && !o_.run.memory_limit && longest <= 1100) return;
        const double leaves = predict_leaves();
        release_memory();
        const double resident = static_cast<double>(resident_memory_bytes());
        double fields = 0;
        double largest = 0;
        for (const MaskView& m : used_masks_) {
            const auto bytes = static_cast<double>(planned_field_bytes(m, field_options_));
            fields += bytes;
            largest = std::max(largest, bytes);
        }
        // While a field is made it takes 16 bytes a sample besides its two, on every thread.
        fields += 8 * largest * static_cast<double>(tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
        const double hull = leaves * (o_.carve.occupancy ? 200 : kHullPerLeaf);
        const double carve_peak = resident + kCarveBase + fields + hull;
        const bool colored = o_.color.options.mode != ColorMode::None;
        const double color_grid = colored ? kColorGridPerLeaf : 0;
        // The mesher can go in slabs.
        const double mesher = o_.mesh.mesher == Mesher::Dual && o_.mesh.adaptivity == 0 ? kMesherBytesPerLeaf / kMostSlabs : kMesherBytesPerLeaf;
        const double glb = std::find(o_.result.mesh_formats.begin(), o_.result.mesh_formats.end(), "glb") != o_.result.mesh_formats.end() ? kGlbPerLeaf : 0;
        const double later_peak =
            std::max({resident + leaves * kLevelSetPerLeaf, colored ? resident + leaves * kColorPerLeaf : 0.0,
                      resident + leaves * (kFilterPerLeaf + color_grid), resident + kMeshBase + leaves * (kMeshBytesPerLeaf + mesher + color_grid),
                      resident + kExportBase + leaves * (kExportPerLeaf + glb + 1.5 * color_grid)});
        const double peak = o_.run.last_stage == LastStage::Export ? std::max(carve_peak, later_peak) : carve_peak;
        json& g = report_["grid"];
        g["expected_leaves"] = std::llround(leaves);
        g["expected_bytes"] = std::llround(leaves * kTreePerLeaf);
        g["expected_field_bytes"] = std::llround(fields);
        g["expected_peak_bytes"] = std::llround(peak);
        g["memory_limit_bytes"] = std::llround(limit);
        const auto gb = [](double bytes) { return std::to_string(bytes / 1e9).substr(0, 5) + " GB"; };
        progress_.note("expected: " + std::to_string(std::llround(leaves)) + " leaves, " + gb(leaves * kTreePerLeaf) + " of volume, peak memory " + gb(peak));
        if (o_.run.last_stage == LastStage::Export && later_peak > limit) {
            const double fits = longest * std::sqrt(std::max(0.0, (limit - resident - kExportBase) / (later_peak - resident)));
            throw UsageError("this resolution needs about " + gb(later_peak) + " of memory, the limit is " + gb(limit) + " (--memory-limit). Remedy: " +
                             (fits >= 16 ? "--resolution " + std::to_string(static_cast<long>(0.97 * fits)) + " fits; " : std::string()) +
                             "`carve` alone goes further, in bricks");
        }
        field_bytes_ = fields;
        hull_bytes_ = o_.carve.occupancy ? 0 : hull;
        memory_limit_bytes_ = limit;
        if (on_cuda() && !o_.carve.occupancy && !fits_device(leaves)) return;
        share_out_memory();
    }

    /// Bricks for a device that cannot hold the hull whole; the CPU instead for what cannot be done in bricks. True when the job goes
    /// on where it was.
    bool fits_device(double leaves) {
        double masks = 0;
        for (const MaskView& m : used_masks_) masks += static_cast<double>(m.coverage.pixels()) * (m.ignore.empty() ? 1 : 4);
        // A sample takes two bytes, and twelve more while fields are made.
        double samples = 0;
        for (const MaskView& m : used_masks_) samples += 0.5 * static_cast<double>(planned_field_bytes(m, field_options_));
        const double base = masks + 14 * samples;
        const double per_leaf =
            kDeviceHullPerLeaf +
            (o_.run.last_stage == LastStage::Export ? kDeviceSurfacePerLeaf + (o_.color.options.mode != ColorMode::None ? kDeviceColorPerLeaf : 0) +
                                                          (o_.filter.steps && o_.filter.steps->empty() ? 0 : kDeviceFilterPerLeaf)
                                                    : 0) +
            (o_.mesh.mesher == Mesher::MarchingCubes ? kDeviceMeshPerLeaf : 0);
        double room = 0;
        if (!on_device("carve", [&](Device& device) { room = 0.95 * static_cast<double>(device.free_bytes()) - base; })) return false;
        if (leaves * per_leaf <= room) return true;
        const std::string needed = std::to_string((leaves * per_leaf + base) / 1e9).substr(0, 5) + " GB on the device, more than is free there";
        if (o_.run.last_stage == LastStage::Carve && room > 1e8) {
            device_bricks_ = static_cast<int>(std::ceil(leaves * per_leaf * 1.3 / room));
            return true;
        }
        if (device_->demanded())
            throw BackendError("this resolution needs about " + needed + ". Remedy: --backend cpu, a lower --resolution, or `carve` alone, in bricks");
        device_->leave("this resolution needs about " + needed);
        share_out_memory();
        return false;
    }

    /// Batches of fields and bricks of the hull, so that the host keeps within the limit. On the device fields need no room here.
    void share_out_memory() {
        batch_ = inputs_.size();
        bricks_ = on_cuda() ? device_bricks_ : 1;
        if (memory_limit_bytes_ <= 0 || o_.carve.occupancy) return;  // the binary model is small: a bit a voxel
        const double resident = static_cast<double>(resident_memory_bytes()), limit = memory_limit_bytes_;
        const double fields = on_cuda() ? 0 : field_bytes_;
        if (resident + kCarveBase + fields + hull_bytes_ <= limit) return;
        // Half of the room for fields, half for leaves.
        const double room = std::max(limit - resident - kCarveBase, 2e6);
        if (fields > 0.5 * room)
            batch_ = static_cast<size_t>(
                std::clamp(std::floor(0.5 * room / (fields / static_cast<double>(inputs_.size()))), 1.0, static_cast<double>(inputs_.size())));
        const double held = std::min(fields, 0.5 * room);
        if (hull_bytes_ > room - held) bricks_ = std::max(bricks_, static_cast<int>(std::ceil(hull_bytes_ * 1.3 / (room - held))));
        if (batch_ < inputs_.size())
            progress_.note("distance fields of " + std::to_string(batch_) + " views at a time, to stay within " + std::to_string(limit / 1e9).substr(0, 5) +
                           " GB");
    }

    /// What the fields in memory, or those made batch after batch, say about the grid or one brick of it.
    CarveResult carve_part(const std::optional<IndexBox>& brick) {
        CarveOptions options = carve_;
        options.brick = brick;
        if (on_cuda()) {
            CarveResult result;
            if (on_device("carve", [&](Device& device) {
                    result.statistics = device.carve(inputs_, options, progress_);
                    if (options.occupancy) result.occupancy = device.occupancy();
                    else result.hull = device.hull();
                })) {
                result.backend_used = "cuda";
                measure_tree(result);
                return result;
            }
            if (batch_ >= inputs_.size()) {
                fields_ = distance_fields(used_masks_, field_options_, progress_);
                for (size_t u = 0; u < inputs_.size(); ++u) inputs_[u].field = &fields_[u];
            }
        }
        if (batch_ >= inputs_.size() && !known_) return carve(inputs_, options, progress_);
        const FieldSource source = [&](size_t first, size_t last) {
            Progress quiet;
            return distance_fields({used_masks_.begin() + static_cast<long>(first), used_masks_.begin() + static_cast<long>(last)}, field_options_, quiet);
        };
        if (known_) {
            openvdb::FloatGrid::Ptr hull = read_float_grid(known_->file, "hull");
            const auto start = std::chrono::steady_clock::now();
            CarveResult result = extend_hull(std::move(hull), known_->views.size(), inputs_, source, options, progress_);
            extend_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
            added_views_ = inputs_.size() - known_->views.size();
            std::vector<std::string> names;
            for (size_t u = known_->views.size(); u < inputs_.size(); ++u) names.push_back(inputs_[u].name);
            progress_.note(text_of("the hull of %s is extended by %s (%s) in %.0f ms", counted(known_->views.size(), "view").c_str(),
                                   counted(added_views_, "view").c_str(), some_of(names).c_str(), 1e3 * extend_seconds_));
            return result;
        }
        return carve_in_batches(inputs_, batch_, source, options, progress_);
    }

    fs::path brick_folder() const { return store_.path("hull", hull_key_, ".bricks"); }

    /// Slabs across x, each a file that appears when it is done; those of an earlier run are kept.
    CarveStatistics carve_bricks() {
        const IndexBox whole = voxels_in_bounds(carve_.lattice, carve_.bounds_world, carve_.half_width_vox + 1);
        const auto down = [](int x, int step) { return (x >= 0 ? x / step : -((step - 1 - x) / step)) * step; };
        const int first = down(whole.min[0], 8), length = whole.max[0] - first;
        const int thickness = std::max(64, down(length / bricks_, 64));
        make_folder(brick_folder());
        CarveStatistics sum;
        double capped = 0, surface = 0;
        std::vector<std::string> files;
        for (int i = first, n = 0; i < whole.max[0]; i += thickness, ++n) {
            progress_.check();
            // Place and thickness are in the name: a run under another limit cuts otherwise and must not mix with this one.
            char name[64];
            std::snprintf(name, sizeof name, "brick-%04d-x%d-%d", n, i, thickness);
            const fs::path file = brick_folder() / (std::string(name) + ".vdb"), note_file = brick_folder() / (std::string(name) + ".json");
            auto note = stage_note(note_file, {"leaves", "active_voxels", "bytes", "node_tests", "voxel_lookups", "clipped_share", "inside_voxels"});
            if (!note || (note->at("leaves") != 0 && !fs::exists(file))) {
                IndexBox brick{{i, down(whole.min[1], 8), down(whole.min[2], 8)}, {i + thickness, down(whole.max[1] + 7, 8), down(whole.max[2] + 7, 8)}};
                const CarveResult part = carve_part(brick);
                const CarveStatistics& s = part.statistics;
                if (s.leaves) write_vdb(file, {part.hull}, metadata());
                note = json{{"leaves", s.leaves},
                            {"active_voxels", s.active_voxels},
                            {"bytes", s.bytes},
                            {"node_tests", s.node_tests},
                            {"voxel_lookups", s.voxel_lookups},
                            {"clipped_share", s.clipped_share},
                            {"inside_voxels", s.inside_voxels}};
                write_file(note_file, note->dump(1) + "\n");
                progress_.note(std::string(name) + " of " + std::to_string((length + thickness - 1) / thickness) + ": " + std::to_string(s.leaves) + " leaves");
            }
            sum.inside_voxels += note->at("inside_voxels").get<size_t>();
            sum.leaves += note->at("leaves").get<size_t>();
            sum.active_voxels += note->at("active_voxels").get<size_t>();
            sum.bytes += note->at("bytes").get<size_t>();
            sum.node_tests += note->at("node_tests").get<size_t>();
            sum.voxel_lookups += note->at("voxel_lookups").get<size_t>();
            capped += note->at("clipped_share").get<double>() * note->at("leaves").get<double>();
            surface += note->at("leaves").get<double>();
            if (note->at("leaves") != 0) files.push_back(file.filename().string());
        }
        if (sum.inside_voxels == 0)
            throw ContradictionError(
                "the hull is empty: the silhouettes contradict each other. Remedy: a lower --resolution carves all at once and names the views");
        sum.clipped_share = surface > 0 ? capped / surface : 0;
        report_["grid"]["bricks"] = files;
        return sum;
    }

    /// Size of one pixel on the object, world units: the median over views at the bounds' centre.
    double pixel_footprint(const Vec3d& centre) const {
        std::vector<double> sizes;
        for (const CarveInput& input : inputs_) {
            const Intrinsics& k = input.camera.intrinsics;
            const double depth = k.orthographic ? 1.0 : (input.camera.camera_from_world * centre).z();
            if (depth > 0) sizes.push_back(depth / std::sqrt(k.fx * k.fy));
        }
        return median(sizes);
    }

    /// Below the floor cones go on to where they end; that is cut off the surface, and need not be carved. A little below stays, for the cut to lie within.
    bool clip_at_floor(Box3d& box) const {
        const Vec3d axis = up_direction();
        int along = 0;
        if (axis.cwiseAbs().maxCoeff(&along) < 1 - 1e-9) return false;
        const double below = *views_.floor * axis[along] - 0.03 * axis[along] * box.sizes().maxCoeff();
        double& end = axis[along] > 0 ? box.min()[along] : box.max()[along];
        const double clipped = axis[along] > 0 ? std::max(end, below) : std::min(end, below);
        if (clipped == end || (axis[along] > 0 ? clipped >= box.max()[along] : clipped <= box.min()[along])) return false;
        end = clipped;
        return true;
    }

    /// Fills carve_ and the report's grid from bounds, resolution and the like.
    void plan_grid() {
        carve_.max_misses = o_.carve.max_misses;
        carve_.min_seen = o_.carve.min_seen;
        carve_.outside = o_.carve.outside_is_background ? Outside::Background : Outside::Unknown;
        carve_.occupancy = o_.carve.occupancy;
        carve_.half_width_vox = o_.carve.half_width_vox;
        const auto start = std::chrono::steady_clock::now();
        Box3d box = kept_            ? kept_->bounds
                    : o_.grid.bounds ? *o_.grid.bounds
                                     : automatic_bounds(inputs_, used_masks_, o_.carve.silhouette_offset_px, carve_, progress_);
        floor_clips_ = kept_ ? kept_->floor_clips : views_.floor && !o_.grid.bounds && clip_at_floor(box);
        if (kept_ && o_.grid.bounds &&
            !(kept_->bounds.min().isApprox(o_.grid.bounds->min(), 1e-9) && kept_->bounds.max().isApprox(o_.grid.bounds->max(), 1e-9)))
            throw UsageError("--bounds " + box_text(*o_.grid.bounds) + ": views are added to " + o_.run.output.string() + ", whose bounds are " +
                             box_text(kept_->bounds) + ". Remedy: without --bounds, or another -o");
        const double bounds_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        const Vec3d size = box.sizes();
        const double footprint = pixel_footprint(box.center());
        double voxel = 0;
        Vec3d origin = o_.grid.origin.value_or(Vec3d::Zero());
        if (o_.grid.voxel_size > 0) {
            voxel = o_.grid.voxel_size;
        } else if (o_.grid.dims) {
            const Vec3d sides(size[0] / (*o_.grid.dims)[0], size[1] / (*o_.grid.dims)[1], size[2] / (*o_.grid.dims)[2]);
            if (o_.grid.bounds) {
                if (sides.maxCoeff() - sides.minCoeff() > 1e-6 * sides.maxCoeff())
                    throw UsageError("--bounds and --grid give voxels of " + std::to_string(sides[0]) + " x " + std::to_string(sides[1]) + " x " +
                                     std::to_string(sides[2]) + ", which are not cubes. Remedy: change either, or give --resolution");
                voxel = sides[0];
                if (!o_.grid.origin) origin = box.min();
            } else {
                // The smallest cubic voxel with which that many hold the object.
                voxel = sides.maxCoeff();
                const Vec3d whole = voxel * Vec3d((*o_.grid.dims)[0], (*o_.grid.dims)[1], (*o_.grid.dims)[2]);
                const Vec3d centre = box.center();
                box = Box3d(centre - 0.5 * whole, centre + 0.5 * whole);
                if (!o_.grid.origin) origin = box.min();
            }
        } else if (o_.grid.resolution > 0) {
            voxel = size.maxCoeff() / o_.grid.resolution;
        } else {
            if (footprint <= 0) throw ContradictionError("no camera has the bounds in front of it. Remedy: check --bounds and the cameras");
            const double fine = size.maxCoeff() / footprint;
            const int n = static_cast<int>(std::clamp(std::round(fine), 64.0, 1024.0));
            voxel = size.maxCoeff() / n;
            if (!kept_)
                progress_.note("resolution " + std::to_string(n) + ": a voxel for a pixel" +
                               (fine > 1024 ? " would be " + std::to_string(std::lround(fine)) + "; --resolution sets another" : ""));
        }
        if (kept_) {
            const bool given = o_.grid.resolution > 0 || o_.grid.voxel_size > 0 || o_.grid.dims;
            if ((given && std::fabs(voxel / kept_->voxel_size - 1) > 1e-9) || (o_.grid.origin && !o_.grid.origin->isApprox(kept_->origin, 1e-9)))
                throw UsageError(
                    text_of("%s: gives voxels of %.9g, and views are added to %s, whose voxels of %.9g lie otherwise. Remedy: without it, or another -o",
                            o_.grid.resolution > 0   ? "--resolution"
                            : o_.grid.voxel_size > 0 ? "--voxel-size"
                            : o_.grid.dims           ? "--grid"
                                                     : "--origin",
                            voxel, o_.run.output.c_str(), kept_->voxel_size));
            box = kept_->bounds;
            voxel = kept_->voxel_size;
            origin = kept_->origin;
        }
        if (footprint > 0 && voxel < 0.98 * footprint)
            progress_.warn("voxels of " + std::to_string(voxel) + " are finer than a pixel on the object (" + std::to_string(footprint) +
                           "): more than the photographs can show. About " + std::to_string(std::lround(size.maxCoeff() / footprint)) +
                           " voxels along the longest side would do");
        carve_.lattice = {origin, voxel};
        carve_.bounds_world = box;
        const std::array<int, 3> dims{static_cast<int>(std::ceil(box.sizes()[0] / voxel - 1e-6)), static_cast<int>(std::ceil(box.sizes()[1] / voxel - 1e-6)),
                                      static_cast<int>(std::ceil(box.sizes()[2] / voxel - 1e-6))};
        json& g = report_["grid"];
        g["dims"] = dims;
        g["voxel_size"] = voxel;
        g["origin"] = {origin.x(), origin.y(), origin.z()};
        g["bounds"] = {box.min()[0], box.min()[1], box.min()[2], box.max()[0], box.max()[1], box.max()[2]};
        g["bounds_automatic"] = kept_ ? kept_->automatic : !o_.grid.bounds;
        if (floor_clips_) g["floor_clips"] = true;
        g["bounds_seconds"] = bounds_seconds;
        g["pixel_footprint"] = footprint;
        plan_distance();
        progress_.note("grid " + grid_text(dims) + ", voxel " + std::to_string(voxel) + (views_.units.empty() ? "" : " " + views_.units));
    }

    void plan_distance() {
        std::vector<Camera> cameras;
        for (const CarveInput& input : inputs_) cameras.push_back(input.camera);
        const FieldPlan plan = plan_fields(cameras, carve_, o_.carve.field_scale);
        field_options_ = {};
        field_options_.silhouette_offset_px = o_.carve.silhouette_offset_px;
        field_options_.scale = plan.scale;
        field_options_.reach_samples = plan.reach_samples;
        json& g = report_["grid"];
        g["px_per_voxel"] = plan.px_per_voxel;
        g["field_scale"] = plan.scale;
        if (plan.scale > 1)
            progress_.note("the photographs have " + std::to_string(plan.px_per_voxel).substr(0, 4) + " pixels to a voxel: distance fields take a sample for " +
                           std::to_string(plan.scale) + "x" + std::to_string(plan.scale) + " of them (--field-scale 1: every pixel)");
        if (const FileFrame frame = file_frame(".vdb", frame_request()); frame.scale * carve_.lattice.voxel_size < kLeastVoxel)
            throw UsageError("voxels of " + std::to_string(1e6 * frame.scale * carve_.lattice.voxel_size) + "e-6 " + frame.units +
                             " are too small for OpenVDB. Remedy: another --dcc, or none, or --units in which the object is larger");
        plan_memory();
    }

    /// The raw hull as a result: one file, or a folder of bricks where it did not fit.
    void place_hull() {
        const fs::path whole = o_.run.output / (o_.carve.occupancy ? "volume.vdb" : "hull.vdb"), bricks = o_.run.output / "hull_bricks";
        fs::remove_all(bricks);
        if (!report_["grid"].contains("bricks")) {
            place_copy(hull_file(), whole);
            return;
        }
        fs::remove(whole);
        make_folder(bricks);
        for (const json& name : report_["grid"]["bricks"]) place_copy(brick_folder() / name.get<std::string>(), bricks / name.get<std::string>());
        progress_.warn("the hull did not fit the memory limit whole: it lies in " + bricks.string() + ", bricks that share one lattice and do not overlap");
    }

    bool carve_hull() {
        if (hull_is_there()) {
            const auto note = stage_note(hull_json(), {"grid", "warnings", "backend", "id"});
            report_["grid"] = (*note)["grid"];
            backend_used_ = (*note)["backend"];
            hull_id_ = (*note)["id"];
            warn_again(*note);
            return true;
        }
        if (known_whole()) {  // under another name: the same voxels were asked for in other words
            const fs::path note_file = fs::path(known_->file).replace_extension(".json");
            if (const auto note = stage_note(note_file, {"grid", "warnings", "backend", "id"})) {
                place_copy(known_->file, hull_file());
                place_copy(note_file, hull_json());
                report_["grid"] = (*note)["grid"];
                backend_used_ = (*note)["backend"];
                fields_.clear();
                inputs_.clear();
                return true;
            }
            known_.reset();
        }
        CarveResult result;
        if (bricks_ > 1) result.statistics = carve_bricks();
        else result = carve_part({});
        const CarveStatistics& s = result.statistics;
        backend_used_ = bricks_ > 1 ? name_of(device_->backend()) : result.backend_used;
        json& g = report_["grid"];
        g["active_voxels"] = s.active_voxels;
        g["leaves"] = s.leaves;
        g["bytes"] = s.bytes;
        g["node_tests"] = s.node_tests;
        g["voxel_lookups"] = s.voxel_lookups;
        g["clipped_share"] = s.clipped_share;
        if (s.clipped_share > 0 && !floor_clips_)  // what a floor clips is cut off anyway
            progress_.warn("the bounds cut the object: " + std::to_string(100 * s.clipped_share).substr(0, 4) + " % of the surface is their flat cap");
        hull_ = result.hull;
        occupancy_ = result.occupancy;
        fields_.clear();
        inputs_.clear();
        if (bricks_ == 1) write_vdb(hull_file(), o_.carve.occupancy ? openvdb::GridCPtrVec{occupancy_} : openvdb::GridCPtrVec{hull_}, metadata());
        json note{{"grid", g},         {"backend", backend_used_}, {"warnings", warnings_since(warnings_before_grid_)},
                  {"base", base_key_}, {"views", view_keys_},      {"id", hull_id_}};
        write_file(hull_json(), note.dump(1) + "\n");
        return false;
    }

    std::string up() const { return o_.views.up.empty() ? views_.up : o_.views.up; }
    FrameRequest frame_request() const { return {up(), views_.units, o_.result.dcc, o_.result.stl_mm}; }
    std::vector<Camera> used_cameras() const {
        const std::vector<Camera> all = views_.cameras();
        std::vector<Camera> out;
        for (const size_t u : used_) out.push_back(all[u]);
        return out;
    }
    /// Up as a direction; the axis of the orbit where it is not known.
    Vec3d up_direction() const { return vdbcarve::up_direction(up(), used_cameras()); }

    VdbMetadata metadata() const { return {views_.units, views_.up, used_.size(), report_["grid"]["voxel_size"].get<double>(), inputs_sha256_}; }

    // --------------------------------------------------------------------------------------- surface

    bool make_surface() {
        Sha256 h;
        surface_key_ = h.add("level_set")
                           .add_value(kCodeVersion)
                           .add(hull_id_)
                           .add_value(o_.floor.flat_base)
                           .add_value(views_.floor.has_value())
                           .add_value(views_.floor.value_or(0))
                           .add_value(o_.floor.clear)
                           .add_value(o_.floor.from != FloorFrom::File)
                           .add(o_.floor.flat_base || views_.floor ? up() : "")
                           .hex();
        const fs::path file = store_.path("surface", surface_key_, ".vdb"), note_file = store_.path("surface", surface_key_, ".json");
        if (const auto note = stage_note(note_file, {"warnings"}); note && fs::exists(file)) {
            surface_ = read_float_grid(file, "surface");
            warn_again(*note);
            return true;
        }
        const size_t warnings_before = progress_.warnings().size();
        LevelSetOptions options;
        options.half_width_vox = o_.carve.half_width_vox;
        if (o_.carve.occupancy) {
            if (!occupancy_) occupancy_ = openvdb::gridPtrCast<openvdb::MaskGrid>(read_vdb(hull_file()).at(0));
            surface_ = level_set_of_occupancy(*occupancy_, options, progress_);
        } else {
            const bool on_there = hull_ && device_->device();
            if (!hull_) hull_ = read_float_grid(hull_file(), "hull");
            const bool done = on_cuda() && on_device("level_set", [&](Device& device) {
                                  if (!on_there) device.set_hull(*hull_);
                                  device.level_set(options);
                                  surface_ = device.surface();
                                  surface_on_device_ = true;
                              });
            if (!done) surface_ = level_set(std::move(hull_), options, progress_);
        }
        hull_.reset();
        if (views_.floor) {
            surface_ = cut_flat(std::move(surface_), up_direction(), *views_.floor, progress_);
            if (o_.floor.clear > 0 || (o_.floor.clear < 0 && o_.floor.from != FloorFrom::File)) {
                const double clear = o_.floor.clear > 0 ? o_.floor.clear : kFloorClear * height_above_floor();
                surface_ = clear_floor(std::move(surface_), up_direction(), *views_.floor, clear,
                                       1.25 * slope_of_views(*surface_, used_cameras(), up_direction(), *views_.floor), progress_);
                if (report_.contains("floor")) report_["floor"]["clear"] = clear;
            }
            surface_on_device_ = false;
        }
        if (o_.floor.flat_base) {
            const SeenExtent seen = seen_silhouettes();
            if (seen.bottom_seen) {
                surface_ = cut_flat(std::move(surface_), up_direction(), seen.lowest, progress_);
                surface_on_device_ = false;
            } else {
                progress_.warn("--base flat: every silhouette is cut by its frame below; the foot stays as it is");
            }
        }
        write_vdb(file, {surface_}, metadata());
        write_file(note_file, json{{"warnings", warnings_since(warnings_before)}}.dump(1) + "\n");
        return false;
    }

    /// Points along the mesh's outline just above a floor, a few to each face that it crosses.
    static std::vector<Vec3d> section(const Mesh& mesh, const Vec3d& axis, double floor) {
        double highest = floor;
        const auto at = [&](uint32_t v) { return Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
        for (uint32_t v = 0; v < mesh.vertices.size(); ++v) highest = std::max(highest, at(v).dot(axis));
        const double height = floor + 0.004 * (highest - floor);
        std::vector<Vec3d> out;
        for (const auto& t : mesh.triangles) {
            std::vector<Vec3d> ends;
            for (size_t c = 0; c < 3; ++c) {
                const Vec3d a = at(t[c]), b = at(t[(c + 1) % 3]);
                const double da = a.dot(axis) - height, db = b.dot(axis) - height;
                if ((da < 0) != (db < 0)) ends.push_back(a + da / (da - db) * (b - a));
            }
            if (ends.size() == 2)
                for (int k = 0; k < 4; ++k) out.push_back(ends[0] + 0.25 * k * (ends[1] - ends[0]));
        }
        return out;
    }

    static constexpr double kFloorClear = 0.01;  ///< of the object's height

    /// Of the surface, along up.
    double height_above_floor() const {
        double highest = *views_.floor;
        const Vec3d axis = up_direction();
        for (auto leaf = surface_->tree().cbeginLeaf(); leaf; ++leaf)
            for (auto v = leaf->cbeginValueOn(); v; ++v)
                if (*v < 0) {
                    const openvdb::Vec3d x = surface_->indexToWorld(v.getCoord());
                    highest = std::max(highest, Vec3d(x.x(), x.y(), x.z()).dot(axis));
                }
        return highest - *views_.floor;
    }

    SeenExtent seen_silhouettes() const { return seen_extent(*surface_, views_.cameras(), used_mask_views(), up_direction()); }

    // --------------------------------------------------------------------------------------- filter

    /// Of the masks that are carved with, the median.
    double mask_softness() const {
        std::vector<double> all(used_.size());
        tbb::parallel_for(size_t{0}, used_.size(), [&](size_t u) { all[u] = contour_softness(masks_.masks[used_[u]].coverage); });
        return median(all);
    }

    FilterOptions filter_options() {
        FilterOptions options;
        options.repair_volume = o_.filter.repair_volume;
        options.keep_thin_vox = std::min(o_.filter.keep_thin_vox, most_keep_thin_vox(o_.carve.half_width_vox));
        if (options.keep_thin_vox < o_.filter.keep_thin_vox && o_.filter.steps)
            progress_.note("--keep-thin is " + std::to_string(options.keep_thin_vox).substr(0, 4) + " voxels at most with this band");
        json& said = report_["filter"];
        if (o_.filter.steps) {
            options.steps = *o_.filter.steps;
        } else {
            const double softness = mask_softness();
            options.steps = default_filters(o_.carve.occupancy ? -1 : softness);
            said["mask_softness"] = softness;
        }
        said["chain"] = filters_text(options.steps);
        return options;
    }

    bool filter_surface() {
        const FilterOptions options = filter_options();
        Sha256 h;
        h.add("filter")
            .add_value(kCodeVersion)
            .add(surface_key_)
            .add(filters_text(options.steps))
            .add_value(options.repair_volume)
            .add_value(options.keep_thin_vox);
        if (options.steps.empty()) {
            filtered_key_ = surface_key_;
            return false;
        }
        filtered_key_ = h.hex();
        const fs::path file = store_.path("filtered", filtered_key_, ".vdb"), note_file = store_.path("filtered", filtered_key_, ".json");
        if (const auto note = stage_note(note_file, {"filter", "warnings"}); note && fs::exists(file)) {
            surface_ = read_float_grid(file, "surface");
            surface_on_device_ = false;
            report_["filter"].update((*note)["filter"]);
            warn_again(*note);
            return true;
        }
        const size_t warnings_before = progress_.warnings().size();
        FilterResult result;
        const bool done = on_cuda() && on_device("filter", [&](Device& device) {
                              if (!surface_on_device_) device.set_surface(*surface_);
                              surface_on_device_ = false;  // until it is whole again
                              result = device.filter(options, progress_);
                              result.components_before = count_pieces(*surface_);
                              surface_ = device.surface();
                              surface_on_device_ = true;
                              result.components = count_pieces(*surface_);
                          });
        if (!done) {
            result = filter(std::move(surface_), options, progress_);
            surface_ = result.surface;
            surface_on_device_ = false;
        }
        json ms, said;
        for (const auto& [name, value] : result.milliseconds) ms[name] = value;
        const double change = result.volume_filtered / result.volume_before - 1, left = result.volume / result.volume_before - 1;
        said = {{"volume_before", result.volume_before},
                {"volume_filtered", result.volume_filtered},
                {"volume", result.volume},
                {"repair_offset_vox", result.offset_vox},
                {"repair_steps", result.repair_steps},
                {"pieces_before", result.components_before},
                {"pieces", result.components}};
        char text[200];
        std::snprintf(text, sizeof text, "filter %s: volume %+.3f %%", filters_text(options.steps).c_str(), 100 * change);
        std::string line = text;
        if (options.repair_volume) {
            std::snprintf(text, sizeof text, ", moved by %+.4f voxel to %+.4f %% (tolerance %g %%)", result.offset_vox, 100 * left, 100 * kVolumeTolerance);
            line += text;
        }
        progress_.note(line);
        said["repaired"] = options.repair_volume && std::fabs(left) <= kVolumeTolerance;
        if (options.repair_volume && std::fabs(left) > kVolumeTolerance) {
            std::snprintf(text, sizeof text, "the filter's change of volume could be repaired to %+.3f %% only (%d steps, %+.3f voxel)", 100 * left,
                          result.repair_steps, result.offset_vox);
            progress_.warn(text);
        }
        if (std::fabs(change) > 0.01) {
            std::snprintf(text, sizeof text, "the filter takes %.1f %% of the volume (%.4g of %.4g)", -100 * change,
                          result.volume_before - result.volume_filtered, result.volume_before);
            progress_.warn(std::string(text) + (options.repair_volume ? ", which the repair gives back to what is left" : "") +
                           ". Remedy: a higher --resolution, --keep-thin, a weaker --filter");
        }
        if (result.components < result.components_before)
            progress_.warn("the filter leaves " + std::to_string(result.components) + " pieces of " + std::to_string(result.components_before) +
                           ": thin ones are gone, or grown together. Remedy: --keep-thin, or --filter none");
        write_vdb(file, {surface_}, metadata());
        write_file(note_file, json{{"filter", said}, {"warnings", warnings_since(warnings_before)}}.dump(1) + "\n");
        report_["filter"].update(said);
        report_["filter"]["milliseconds"] = ms;
        return false;
    }

    // --------------------------------------------------------------------------------------- stereo

    /// What silhouettes cannot see, from the photographs' depths.
    bool carve_by_depth() {
        Sha256 h;
        StereoOptions options = o_.stereo.options;
        if (!options.scale) options.scale = on_cuda() ? 1 : 2;
        const StereoTrust& t = options.trust;
        h.add("stereo")
            .add_value(kCodeVersion)
            .add(surface_key_)
            .add_value(options.pairs)
            .add_value(options.least_angle_deg)
            .add_value(options.most_angle_deg)
            .add_value(options.scale)
            .add_value(options.levels)
            .add_value(options.passes)
            .add_value(options.depth_share);
        h.add_value(t.most_cost)
            .add_value(t.least_contrast)
            .add_value(t.least_margin)
            .add_value(t.agreeing)
            .add_value(t.agreement_px)
            .add_value(t.normal_deg)
            .add_value(t.rim_px);
        h.add_value(options.truncation_vox)
            .add_value(options.reach_share)
            .add_value(options.coarser_weight)
            .add_value(options.least_weight)
            .add_value(options.least_piece)
            .add_value(o_.color.leave_out);
        for (size_t i : used_) h.add(file_hashes_[i]);
        if (photos_are_masks()) {
            progress_.warn("--stereo on: the images are the silhouettes themselves, which have no texture; the hull stands");
            return false;
        }
        surface_key_ = h.hex();
        const fs::path file = store_.path("stereo", surface_key_, ".vdb"), note_file = store_.path("stereo", surface_key_, ".json"),
                       maps = store_.path("stereo", surface_key_, ".maps");
        stereo_sheet_ = store_.path("stereo", surface_key_, ".png");
        if (o_.stereo.maps) stereo_maps_ = maps;
        if (const auto note = stage_note(note_file, {"stereo", "warnings"});
            note && fs::exists(file) && fs::exists(stereo_sheet_) && (!o_.stereo.maps || fs::exists(maps))) {
            surface_.reset();
            for (const openvdb::GridBase::Ptr& grid : read_vdb(file)) {
                if (grid->getName() == "surface") surface_ = openvdb::gridPtrCast<openvdb::FloatGrid>(grid);
                if (grid->getName() == "stereo_confidence") stereo_confidence_ = grid;
            }
            if (!surface_) throw InputError(file.string() + ": holds no surface. Remedy: vdbcarve clean " + o_.run.output.string());
            surface_on_device_ = false;
            report_["stereo"] = (*note)["stereo"];
            warn_again(*note);
            return true;
        }
        const size_t warnings_before = progress_.warnings().size();
        check_stereo_memory(options);
        StereoResult result;
        const std::vector<ColorInput> inputs = color_inputs();
        const bool done = on_cuda() && on_device("stereo", [&](Device& device) {
                              if (!surface_on_device_) device.set_surface(*surface_);
                              surface_on_device_ = true;
                              result = device.stereo(*surface_, inputs, photo_source(), options, progress_);
                          });
        if (!done) result = stereo(*surface_, inputs, photo_source(), options, progress_);
        const openvdb::FloatGrid::Ptr hull = std::exchange(surface_, result.surface);
        surface_on_device_ = surface_on_device_ && done;
        stereo_confidence_ = result.confidence;
        json ms, of_views;
        size_t object = 0, trusted = 0, with_photo = 0, without = 0;
        for (size_t u = 0; u < inputs.size(); ++u) {
            const StereoViewStatistics& v = result.views[u];
            object += v.object_pixels;
            trusted += v.trusted_pixels;
            with_photo += inputs[u].use;
            without += inputs[u].use && v.pairs == 0;
            of_views.push_back({{"name", inputs[u].name},
                                {"compared_with", v.pairs},
                                {"matched_share", share_of(v.matched_pixels, v.object_pixels)},
                                {"trusted_share", share_of(v.trusted_pixels, v.object_pixels)}});
        }
        for (const auto& [name, value] : result.milliseconds) ms[name] = value;
        report_["stereo"] = {{"scale", result.scale},
                             {"trusted_share", share_of(trusted, object)},
                             {"volume_before", result.volume_before},
                             {"volume", result.volume},
                             {"fragments_dropped", result.fragments},
                             {"voids_filled", result.voids},
                             {"milliseconds", ms},
                             {"views", of_views}};
        progress_.note(text_of("stereo: %.0f %% of the object's pixels have a depth that other views bear out; volume %+.2f %%",
                               100 * share_of(trusted, object), 100 * (result.volume / result.volume_before - 1)));
        if (without)
            progress_.warn(text_of(
                "stereo: %zu of %zu views have no two others at %.0f to %.0f degrees from them, and give no depth. Remedy: photographs nearer to each other",
                without, with_photo, options.least_angle_deg, options.most_angle_deg));
        if (without < with_photo && share_of(trusted, object) < 0.05)
            progress_.warn(
                text_of("stereo: only %.1f %% of the object's pixels have a depth that other views bear out: the hull stands nearly everywhere. It needs "
                        "texture, and cameras right to a pixel (--method refine)",
                        100 * share_of(trusted, object)));
        draw_stereo(*hull, result);
        if (o_.stereo.maps) keep_depth_maps(maps, result.maps);
        write_vdb(file, {surface_, stereo_confidence_}, metadata());
        write_file(note_file, json{{"stereo", report_["stereo"]}, {"warnings", warnings_since(warnings_before)}}.dump(1) + "\n");
        return false;
    }

    /// Photographs and depths of all views are in memory at once.
    void check_stereo_memory(const StereoOptions& options) {
        const bool gpu = on_cuda();  // keeps planes itself
        const double pixels = largest_photo_bytes() / kPhotoBytesPerPixel, views = static_cast<double>(used_.size());
        const auto bytes_at = [&](int scale) {
            return views * pixels * (kPhotoBytesPerPixel + (gpu ? kStereoPerPixelBesideGpu : kStereoPerPixel) * 4 / 3 / (scale * scale));
        };
        const double room = memory_limit() - static_cast<double>(resident_memory_bytes()), bytes = bytes_at(options.scale);
        if (bytes <= room) return;
        int smaller = 2 * options.scale;
        while (smaller < 16 && bytes_at(smaller) > room) smaller *= 2;
        const std::string remedy =
            smaller <= 16 && bytes_at(smaller) <= room ? text_of("--stereo-scale %d, fewer photographs", smaller) : "fewer photographs (--views)";
        throw InputError(
            text_of("--stereo on: %zu photographs and their depths take %.1f GB at 1/%d of their size, and %.1f GB of --memory-limit are left. Remedy: %s, or "
                    "a larger --memory-limit",
                    used_.size(), bytes / 1e9, options.scale, std::max(room, 0.0) / 1e9, remedy.c_str()));
    }

    /// Four views, spread evenly.
    void draw_stereo(const openvdb::FloatGrid& hull, const StereoResult& result) {
        std::vector<size_t> with_map;
        for (size_t u = 0; u < result.maps.size(); ++u)
            if (!result.maps[u].depth.data.empty()) with_map.push_back(u);
        std::vector<StereoTile> tiles;
        for (size_t n = with_map.size(), shown = std::min<size_t>(n, 4), s = 0; s < shown; ++s) {
            const size_t u = with_map[s * n / shown];
            const View& v = views_.views[used_[u]];
            tiles.push_back({v.name, v.camera, photo_to_show(v), &result.maps[u]});
        }
        const auto png = io::encode_png(stereo_sheet(hull, *result.surface, tiles).view());
        write_file(stereo_sheet_, png.data(), png.size());
    }

    void keep_depth_maps(const fs::path& folder, const std::vector<DepthMap>& maps) {
        const fs::path part = folder.string() + ".part";
        fs::remove_all(part);
        make_folder(part);
        std::vector<std::string> names;
        for (const size_t u : used_) names.push_back(fs::path(mask_names_[u]).replace_extension("").string());
        for (const std::string& name : names) make_folder((part / name).parent_path());
        write_depth_maps(part, names, maps);
        fs::remove_all(folder);
        fs::rename(part, folder);
    }

    /// stereo.png and depth/; and nothing of an earlier run's.
    void place_stereo_pictures() {
        fs::remove(place_ / "stereo.png");
        if (fs::exists(stereo_sheet_)) place_copy(stereo_sheet_, place_ / "stereo.png");
        const fs::path folder = place_ / "depth";
        std::vector<fs::path> old;
        if (fs::exists(folder))
            for (const auto& entry : fs::recursive_directory_iterator(folder))
                for (const char* ours : {".depth.tiff", ".confidence.png"})
                    if (entry.path().string().ends_with(ours)) old.push_back(entry.path());
        for (const fs::path& file : old) {
            fs::remove(file);
            for (fs::path at = file.parent_path(); at != place_ && fs::is_empty(at); at = at.parent_path()) fs::remove(at);
        }
        if (stereo_maps_.empty() || !fs::exists(stereo_maps_)) return;
        for (const auto& entry : fs::recursive_directory_iterator(stereo_maps_)) {
            if (!entry.is_regular_file()) continue;
            const fs::path to = folder / fs::relative(entry.path(), stereo_maps_);
            make_folder(to.parent_path());
            place_copy(entry.path(), to);
        }
    }
    static double share_of(size_t part, size_t whole) { return whole ? static_cast<double>(part) / static_cast<double>(whole) : 0; }
    static constexpr double kStereoPerPixel = 40,
                            kStereoPerPixelBesideGpu =
                                14;  ///< bytes of a working pixel: grey, object, plane, cost, confidence, depths; of the coarser ones a third more

    // --------------------------------------------------------------------------------------- colour

    /// Photographs that are silhouettes themselves, or copies of them, have no colour to give.
    bool photos_are_masks() const {
        const bool own =
            std::all_of(used_.begin(), used_.end(), [&](size_t i) { return masks_.origins[i].rfind(views_.views[i].image_path.string() + " (", 0) == 0; });
        if (own) return true;
        const View& first = views_.views[used_.front()];
        if (first.image_path.empty() || first.lens.distorts()) return false;
        try {
            const Image8 photo = io::read_photo8(first.image_path, first.orientation);
            return photo.channels == 1 && photo.data == masks_.masks[used_.front()].coverage.data;
        } catch (const InputError&) {
            return false;
        }
    }

    std::vector<ColorInput> color_inputs() {
        const std::vector<Camera> cameras = views_.cameras();
        std::vector<ColorInput> out;
        for (size_t u = 0; u < used_.size(); ++u) {
            const size_t i = used_[u];
            const bool held_back = o_.color.leave_out >= 2 && u % static_cast<size_t>(o_.color.leave_out) == static_cast<size_t>(o_.color.leave_out) / 2;
            out.push_back({views_.views[i].name, cameras[i], view_of(masks_.masks[i]), {}, !held_back && !views_.views[i].image_path.empty()});
        }
        return out;
    }

    /// Photographs of the used views first <= u < last.
    PhotoSource photo_source() {
        return [this](size_t first, size_t last) {
            std::vector<Photo> out(last - first);
            tbb::parallel_for(first, last, [&](size_t u) {
                const View& v = views_.views[used_[u]];
                if (v.image_path.empty()) return;
                try {
                    out[u - first] = load_photo(v);
                } catch (const InputError& e) {
                    // Carving needed its mask only.
                    const std::lock_guard lock(missing_mutex_);
                    if (missing_photos_.insert(v.name).second) progress_.warn(std::string(e.what()) + "; it gives no colour");
                }
            });
            return out;
        };
    }

    static constexpr double kPhotoBytesPerPixel = 12;
    /// A photograph, its field and what making both needs besides.
    double largest_photo_bytes() const {
        double largest = 1;
        for (const size_t i : used_) {
            const Intrinsics& k = views_.views[i].camera.intrinsics;
            largest = std::max(largest, kPhotoBytesPerPixel * k.width_px * k.height_px);
        }
        return largest;
    }

    ColorOptions color_options() {
        ColorOptions options = o_.color.options;
        options.gains.clear();
        if (o_.carve.occupancy && options.normal_radius_vox == 0) options.normal_radius_vox = 3;
        const std::string& up = views_.up;
        if (!up.empty()) {
            options.up = Vec3d::Unit(up.back() - 'x');
            if (up.front() == '-') options.up = -options.up;
        }
        const double largest = largest_photo_bytes();
        const double limit = memory_limit();
        const double room = limit - static_cast<double>(resident_memory_bytes()) - static_cast<double>(surface_->tree().leafCount()) * kColorPerLeaf;
        const double wanted = o_.color.options.batch ? static_cast<double>(o_.color.options.batch) : static_cast<double>(used_.size());
        options.batch = static_cast<size_t>(std::clamp(room / largest, 1.0, wanted));
        if (static_cast<double>(options.batch) < wanted)
            progress_.note("photographs of " + std::to_string(options.batch) + " views at a time, to stay within " + std::to_string(limit / 1e9).substr(0, 5) +
                           " GB");
        return options;
    }

    bool make_color() {
        Sha256 h;
        const ColorOptions& c = o_.color.options;
        h.add("color").add_value(kCodeVersion).add(surface_key_).add_value(c.mode).add_value(c.test_occlusion).add_value(c.skip_upright).add_value(c.exposure);
        h.add_value(c.exposure_options.per_channel).add_value(c.depth_vox).add_value(c.normal_radius_vox).add_value(o_.color.leave_out);
        h.add_value(c.exposure_options.noise).add_value(c.exposure_options.spread).add_value(c.exposure_options.iterations);
        for (size_t i : used_) h.add(file_hashes_[i]);
        color_key_ = h.hex();
        if (photos_are_masks()) {
            progress_.note("the images are the silhouettes themselves: there is no colour to take");
            color_key_ += "none";
            return false;
        }
        const fs::path file = store_.path("color", color_key_, ".vdb"), note_file = store_.path("color", color_key_, ".json");
        if (const auto note = stage_note(note_file, {"color", "views", "warnings"}); note && fs::exists(file)) {
            for (const openvdb::GridBase::Ptr& grid : read_vdb(file)) {
                if (grid->getName() == "color") color_ = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grid);
                if (grid->getName() == "views") views_grid_ = grid;
                if (grid->getName() == "confidence") confidence_grid_ = grid;
            }
            if (color_) {
                report_["color"] = (*note)["color"];
                color_views_ = (*note)["views"];
                for (const auto& [name, said] : color_views_.items())
                    if (!said["color_used"].get<bool>()) missing_photos_.insert(name);  // named by the note's warnings
                warn_again(*note);
                return true;
            }
        }
        const size_t warnings_before = progress_.warnings().size();
        const std::vector<ColorInput> inputs = color_inputs();
        ColorOptions options = color_options();
        ColorResult result;
        try {
            const bool done = on_cuda() && on_device("color", [&](Device& device) {
                                  if (!surface_on_device_) device.set_surface(*surface_);
                                  surface_on_device_ = true;
                                  ColorOptions there = options;
                                  const double room =
                                      0.9 * static_cast<double>(device.free_bytes()) - static_cast<double>(surface_->tree().leafCount()) * kDeviceColorPerLeaf;
                                  there.batch = static_cast<size_t>(std::clamp(room / (2 * largest_photo_bytes()), 1.0, static_cast<double>(options.batch)));
                                  result = device.color(*surface_, inputs, photo_source(), there, progress_);
                              });
            if (!done) result = color_in_batches(*surface_, inputs, photo_source(), options, progress_);
        } catch (const ContradictionError& e) {
            // The shape stands without its colours.
            progress_.warn(std::string(e.what()) + "; the result has no colour");
            color_key_ += "none";
            return false;
        }
        color_ = result.color;
        views_grid_ = result.views;
        confidence_grid_ = result.confidence;
        const ColorStatistics& s = result.statistics;
        const auto of_surface = [&](size_t n) { return static_cast<double>(n) / static_cast<double>(s.surface_voxels); };
        json ms;
        for (const auto& [name, value] : result.milliseconds) ms[name] = value;
        report_["color"] = {{"surface_voxels", s.surface_voxels},
                            {"seen_share", of_surface(s.colored)},
                            {"synthesised_share", of_surface(s.synthesised)},
                            {"milliseconds", ms}};
        if (options.exposure) {
            report_["color"]["exposure_disagreement_before"] = result.exposure.disagreement_before;
            report_["color"]["exposure_disagreement"] = result.exposure.disagreement;
        }
        color_views_ = json::object();
        for (size_t u = 0; u < inputs.size(); ++u)
            color_views_[inputs[u].name] = {{"color_used", inputs[u].use && !missing_photos_.count(inputs[u].name)},
                                            {"exposure_gain", result.exposure.gains[u]},
                                            {"first_choice_share", of_surface(s.voxels_of_view[u])}};
        if (of_surface(s.synthesised) > 0.25)
            progress_.warn(
                std::to_string(std::lround(100 * of_surface(s.synthesised))) +
                " % of the surface is seen by no photograph (6 degrees or more above it, 3 px inside its mask): its colour is made up from around it");
        write_vdb(file, {color_, views_grid_, confidence_grid_}, metadata());
        write_file(note_file, json{{"color", report_["color"]}, {"views", color_views_}, {"warnings", warnings_since(warnings_before)}}.dump(1) + "\n");
        return false;
    }

    /// Colours of the mesh's vertices.
    void color_mesh() {
        if (!color_) return;
        size_t missed = 0;
        if (o_.color.from_photos) {
            ColorOptions options = color_options();
            for (size_t u : used_) options.gains.push_back(color_views_[views_.views[u].name]["exposure_gain"].get<std::array<double, 3>>());
            report_["color"]["vertices_seen_share"] = color_vertices_from_photos(mesh_, *surface_, *color_, color_inputs(), photo_source(), options, progress_);
        } else {
            missed = color_vertices(mesh_, *color_);
        }
        if (missed) progress_.warn(std::to_string(missed) + " vertices of the mesh have no coloured voxel around and are black");
    }

    /// How many slabs the mesher goes through the grid in, so that it stays within the limit. Not by what is resident now, which differs from run to run:
    /// vertices come in another order.
    int mesh_pieces() {
        const double leaves = static_cast<double>(surface_->tree().leafCount());
        const double held = kProgramBase + leaves * (kTreePerLeaf + (color_ ? kColorGridPerLeaf : 0));
        const double room = memory_limit() - held - leaves * kMeshBytesPerLeaf, wanted = leaves * kMesherBytesPerLeaf;
        report_["mesh_step"]["expected_bytes"] = std::llround(leaves * (kMeshBytesPerLeaf + kMesherBytesPerLeaf));
        if (wanted <= room || o_.mesh.mesher != Mesher::Dual) return 1;
        if (o_.mesh.adaptivity > 0) {
            progress_.warn("an adaptive mesh is made in one piece, which may exceed the memory limit. Remedy: --adaptivity 0, then --max-error");
            return 1;
        }
        return static_cast<int>(std::clamp(std::ceil(wanted / std::max(room, 1.0)), 2.0, kMostSlabs));
    }

    bool make_mesh() {
        Sha256 h;
        const int pieces = mesh_pieces();
        h.add("mesh")
            .add_value(kCodeVersion)
            .add_value(pieces)
            .add(filtered_key_)
            .add_value(o_.mesh.adaptivity)
            .add_value(o_.mesh.mesher)
            .add_value(o_.mesh.normals)
            .add_value(o_.mesh.min_piece_share)
            .add(color_key_);
        const fs::path file = store_.path("mesh", mesh_key_ = h.add_value(o_.color.from_photos && color_).hex(), ".bin");
        const fs::path note_file = store_.path("mesh", mesh_key_, ".json");
        const auto note = stage_note(note_file, {"vertices_seen_share", "mesh_step", "warnings"});
        if (auto stored = note ? stored_mesh(file) : std::nullopt) {
            mesh_ = std::move(*stored);
            if (!(*note)["vertices_seen_share"].is_null()) report_["color"]["vertices_seen_share"] = (*note)["vertices_seen_share"];
            report_["mesh_step"] = (*note)["mesh_step"];
            warn_again(*note);
            if (!o_.mesh.quads) mesh_.quads = 0;
            return true;
        }
        const size_t warnings_before = progress_.warnings().size();
        MeshOptions options;
        options.adaptivity = o_.mesh.adaptivity;
        options.mesher = o_.mesh.mesher;
        options.normals = o_.mesh.normals;
        options.quads = o_.mesh.mesher == Mesher::Dual;
        options.pieces = pieces;
        if (options.pieces > 1) progress_.note("the mesh is made in " + std::to_string(options.pieces) + " slabs, to stay within the memory limit");
        report_["mesh_step"]["slabs"] = options.pieces;
        bool meshed = false;
        const bool done = on_cuda() && o_.mesh.mesher == Mesher::MarchingCubes && on_device("mesh", [&](Device& device) {
                              if (!surface_on_device_) device.set_surface(*surface_);
                              meshed = device.extract_mesh(o_.mesh.normals);
                              if (meshed) mesh_ = device.fetch_mesh(o_.mesh.normals);
                          });
        if (!done || !meshed) mesh_ = extract_mesh(*surface_, options, progress_);
        const DroppedPieces dropped = drop_small_pieces(mesh_, o_.mesh.min_piece_share);
        report_["mesh_step"]["dropped_pieces"] = dropped.pieces;
        report_["mesh_step"]["dropped_volume_share"] = dropped.volume_share;
        if (dropped.pieces) {
            char text[200];
            std::snprintf(text, sizeof text, "%s of the mesh left out, %s of the volume; %s kept (--min-piece 0 keeps all)",
                          counted(dropped.pieces, "small piece").c_str(),
                          dropped.volume_share < 1e-5 ? "less than 0.001 %" : text_of("%.3g %%", 100 * dropped.volume_share).c_str(),
                          counted(dropped.kept, "piece").c_str());
            progress_.note(text);
        }
        color_mesh();
        const bool direct = o_.color.from_photos && color_;
        store_mesh(file, mesh_);
        write_file(note_file, json{{"vertices_seen_share", direct ? report_["color"]["vertices_seen_share"] : json()},
                                   {"mesh_step", report_["mesh_step"]},
                                   {"warnings", warnings_since(warnings_before)}}
                                      .dump(1) +
                                  "\n");
        if (!o_.mesh.quads) mesh_.quads = 0;
        return false;
    }

    // --------------------------------------------------------------------------------------- smooth

    /// Taubin's smoothing, then fewer faces.
    bool smooth_mesh() {
        SmoothOptions options = o_.smooth.factors;
        // A binary model has steps of a voxel. The default filter takes them away (normals of a ball of 35 voxels 2.0 degrees off; ten iterations of this
        // alone: 5.2), and after it there is nothing left to gain here.
        options.iterations = o_.smooth.iterations.value_or(o_.carve.occupancy && report_["filter"]["chain"] == "none" ? 10 : 0);
        report_["smooth"] = {{"iterations", options.iterations}};
        const bool fewer = o_.smooth.faces > 0 || o_.smooth.max_error > 0;
        bool reused = false;
        if (options.iterations > 0 || fewer) {
            Sha256 h;
            h.add("smooth")
                .add_value(kCodeVersion)
                .add(mesh_key_)
                .add_value(options.iterations)
                .add_value(options.lambda)
                .add_value(options.mu)
                .add_value(o_.smooth.faces)
                .add_value(o_.smooth.max_error);
            const fs::path file = store_.path("smooth", h.add_value(o_.mesh.quads).hex(), ".bin");
            const double volume_before = measure(mesh_).volume;
            if (auto stored = stored_mesh(file)) {
                mesh_ = std::move(*stored);
                reused = true;
            } else {
                smooth(mesh_, options, progress_);
                if (fewer) decimate(mesh_, {o_.smooth.faces, o_.smooth.max_error}, progress_);
                store_mesh(file, mesh_);
            }
            if (o_.smooth.faces > 0 && mesh_.triangles.size() > o_.smooth.faces)
                progress_.warn("the mesh keeps " + std::to_string(mesh_.triangles.size()) + " faces, not " + std::to_string(o_.smooth.faces) +
                               ": fewer would turn faces too far" + (o_.smooth.max_error > 0 ? ", or stray by more than --max-error" : ""));
            report_["smooth"]["volume_before"] = volume_before;
        }
        measures_ = measure(mesh_);
        report_["mesh"] = {{"vertices", measures_.vertices},
                           {"faces", measures_.faces},
                           {"components", measures_.components},
                           {"closed", measures_.closed},
                           {"manifold", measures_.manifold},
                           {"boundary_edges", measures_.boundary_edges},
                           {"non_manifold_edges", measures_.non_manifold_edges},
                           {"non_manifold_vertices", measures_.non_manifold_vertices},
                           {"zero_area_faces", measures_.zero_area_faces},
                           {"genus", measures_.genus},
                           {"volume", measures_.volume},
                           {"area", measures_.area}};
        report_["mesh"].update(report_["mesh_step"]);
        report_.erase("mesh_step");
        if (!measures_.manifold) progress_.warn("the mesh is not a closed manifold");
        return reused;
    }

    // --------------------------------------------------------------------------------------- export

    /// Names the part of the surface that no photograph supports.
    void mark_extrapolation() {
        const double tolerance = o_.floor.cap_tolerance > 0 ? o_.floor.cap_tolerance : 2 * surface_->voxelSize()[0];
        const Vec3d axis = up_direction();
        const SeenExtent seen = seen_silhouettes();
        const Extrapolation e = mark_extrapolated(mesh_, used_cameras(), seen, axis, tolerance);
        json& said = report_["extrapolated"];
        said = {{"axis", {axis.x(), axis.y(), axis.z()}},
                {"highest_contour", seen.top_seen ? json(seen.highest) : json()},
                {"lowest_contour", seen.bottom_seen ? json(seen.lowest) : json()},
                {"top_beyond", e.top_beyond},
                {"bottom_beyond", e.bottom_beyond},
                {"tolerance", tolerance},
                {"area_share", e.capped_share + e.unseen_share},
                {"capped_share", e.capped_share},
                {"unseen_share", e.unseen_share}};
        const std::optional<double> metres = metres_per(views_.units);
        if (metres) {
            said["top_beyond_mm"] = 1e3 * *metres * e.top_beyond;
            said["bottom_beyond_mm"] = 1e3 * *metres * e.bottom_beyond;
        }
        if (e.capped_share + e.unseen_share < 0.01) return;
        char text[300];
        const double unit = metres ? 1e3 * *metres : 1;
        std::snprintf(
            text, sizeof text,
            "%.1f %% of the surface is extrapolated: %.1f %% lies beyond the contours that were seen (top %.3g, bottom %.3g %s), %.1f %% faces no camera",
            100 * (e.capped_share + e.unseen_share), 100 * e.capped_share, unit * e.top_beyond, unit * e.bottom_beyond, metres ? "mm" : "units",
            100 * e.unseen_share);
        progress_.note(text);
    }

    openvdb::GridCPtrVec result_grids() {
        openvdb::GridCPtrVec grids{surface_, density_of(*surface_)};
        if (o_.carve.occupancy) {
            if (!occupancy_) occupancy_ = openvdb::gridPtrCast<openvdb::MaskGrid>(read_vdb(hull_file()).at(0));
            grids.push_back(occupancy_);
        }
        if (stereo_confidence_) grids.push_back(stereo_confidence_);
        if (color_) {
            openvdb::Vec3SGrid::Ptr named = openvdb::Vec3SGrid::create(color_->treePtr());
            named->openvdb::MetaMap::operator=(*color_);
            named->setTransform(same_transform(color_->transform()));
            named->setName(color_grid_name(o_.result.dcc));
            grids.push_back(named);
            if (o_.result.views_grid) grids.push_back(views_grid_);
            if (o_.result.confidence_grid) grids.push_back(confidence_grid_);
        }
        return grids;
    }

    /// Says in the report which frame a file is in.
    FileFrame frame_of(const fs::path& name) {
        const FileFrame frame = file_frame(name.extension().string(), frame_request());
        report_["files"][name.string()] = {{"up", frame.up}, {"units", frame.units}, {"scale", frame.scale}, {"axes", frame.axes}};
        return frame;
    }

    void warn_of_unknown_frame() {
        std::set<std::string> said;
        for (const std::string& format : o_.result.mesh_formats)
            if (const std::string unknown = unknown_frame("." + format, frame_request()); !unknown.empty() && said.insert(unknown).second)
                progress_.warn("mesh." + format + ": " + unknown);
        if (o_.result.dcc != Dcc::None && said.empty())
            if (const std::string unknown = unknown_frame(".vdb", frame_request()); !unknown.empty()) progress_.warn("volume.vdb: " + unknown);
        if (views_.units.empty() && said.empty())
            progress_.note(std::string("the unit of length is unknown: files carry the scene's own units") +
                           (aligned_ ? ". Remedy: --known-height, --known-distance or --known-length with --units" : ""));
    }

    /// Bounds that were fixed by few views may be wide, and voxels are then coarser than was meant.
    void warn_of_wide_bounds() {
        if (!kept_ || !kept_->automatic) return;
        Box3d object;
        for (const auto& v : mesh_.vertices) object.extend(Vec3d(v[0], v[1], v[2]));
        const double share = object.sizes().maxCoeff() / kept_->bounds.sizes().maxCoeff();
        if (share < 0.75)
            progress_.warn(
                text_of("the object takes %.0f %% of the bounds that were fixed when there were fewer views, so voxels are %.1f times as large as they might "
                        "be. Remedy: reconstruct with another -o, which finds the bounds of all views; or --bounds and --voxel-size from the start",
                        100 * share, 1 / share));
    }

    void export_all() {
        progress_.begin("export", views_.views.size() + o_.result.mesh_formats.size() + 2);  // views are compared, files written
        mark_extrapolation();
        warn_of_wide_bounds();
        warn_of_unknown_frame();
        const FileFrame volume = frame_of("volume.vdb");
        openvdb::GridCPtrVec grids;
        for (openvdb::GridCPtrVec own = result_grids(); !own.empty(); own.erase(own.begin())) grids.push_back(in_frame(own.front(), volume));
        VdbMetadata described = metadata();
        described.up = volume.up;
        described.units = volume.units;
        described.voxel_size *= volume.scale;
        write_vdb(o_.run.output / "volume.vdb", grids, described, o_.result.vdb_half);
        grids.clear();
        progress_.step();
        // A mesh of an earlier run in a format not asked for now would no longer fit the rest.
        for (const char* format : {"ply", "obj", "stl", "glb", "mtl"})
            if (std::find(o_.result.mesh_formats.begin(), o_.result.mesh_formats.end(), format) == o_.result.mesh_formats.end())
                fs::remove(o_.run.output / (std::string("mesh.") + format));
        for (const std::string& format : o_.result.mesh_formats) {
            const fs::path name = "mesh." + format;
            const FileFrame frame = frame_of(name);
            if (frame.moves()) write_mesh(o_.run.output / name, in_frame(mesh_, frame));
            else write_mesh(o_.run.output / name, mesh_);
            progress_.step();
        }
        write_file(o_.run.output / "cameras.json", cameras_json(views_));
        place_align_pictures();
        place_stereo_pictures();
        agreement();
        preview();
        progress_.step();
    }

    void agreement() {
        const size_t n = views_.views.size();
        const std::vector<Camera> cameras = views_.cameras();
        std::vector<SilhouetteAgreement> a(n);
        tbb::parallel_for(size_t{0}, n, [&](size_t i) {
            if (!masks_.masks[i].coverage.empty()) a[i] = compare_silhouettes(silhouette_of(mesh_, cameras[i]), view_of(masks_.masks[i]));
            progress_.step();
        });
        std::vector<double> ious;
        const std::set<size_t> taken(used_.begin(), used_.end());
        std::string weak;
        size_t weak_count = 0;
        for (size_t i = 0; i < n; ++i) {
            const bool used = taken.count(i) > 0;
            report_["views"].push_back({{"name", views_.views[i].name},
                                        {"used", used},
                                        {"silhouette_iou", a[i].iou},
                                        {"contour_p95_px", a[i].contour_p95_px},
                                        {"contour_p99_px", a[i].contour_p99_px},
                                        {"missed_px", a[i].missed_px},
                                        {"largest_missed_blob_px", a[i].largest_missed_blob_px},
                                        {"thin_length_lost_px", a[i].thin_length_lost_px},
                                        {"extra_px", a[i].extra_px},
                                        {"mask", masks_.origins[i]}});
            if (!used) continue;
            ious.push_back(a[i].iou);
            if (a[i].iou < kFits_iou && weak_count++ < 5)
                weak += (weak.empty() ? "" : ", ") + views_.views[i].name + " (" + std::to_string(a[i].iou).substr(0, 5) + ")";
        }
        if (weak_count)
            progress_.warn(std::to_string(weak_count) + " views agree with the result by less than 0.9 (silhouette IoU): " + weak +
                           (weak_count > 5 ? " …" : "") +
                           (report_.contains("floor")
                                ? ": shadows and reflections that masks took for the object count as missed below --floor; else look at their masks and cameras"
                                : ": look at their masks and cameras"));
        if (o_.floor.from == FloorFrom::Given) warn_of_high_floor(a);
        for (json& view : report_["views"])
            if (const auto found = color_views_.find(view["name"].get<std::string>()); found != color_views_.end()) view.update(*found);
        for (const std::string& name : views_.left_out)
            report_["views"].push_back({{"name", name}, {"used", false}, {"silhouette_iou", 0.0}, {"contour_p95_px", 0.0}, {"mask", ""}});
        minimum_iou_ = *std::min_element(ious.begin(), ious.end());
        median_iou_ = median(ious);
        agreement_ = std::move(a);
        report_["silhouette_iou"] = {{"median", median_iou_}, {"minimum", minimum_iou_}};
        if (median_iou_ < kFits_iou && !shape_was_changed())
            contradiction_ = text_of(
                                 "most views contradict the result: %zu of %zu agree with it by less than %.1f (silhouette IoU, median %.3f). It was written, "
                                 "but cameras and masks do not fit together; ",
                                 weak_count, ious.size(), kFits_iou, median_iou_) +
                             ask_check();
    }

    /// What was asked for takes parts of the hull away, which silhouettes show: no contradiction of theirs.
    bool shape_was_changed() {
        if (!report_["grid"].value("bounds_automatic", true) || report_.contains("floor")) return true;
        const auto lost = [](const json& from, const char* before, double after) {
            return from.contains(before) && std::fabs(after / from[before].get<double>() - 1) > 0.02;
        };
        const json filter = report_.value("filter", json::object());
        return lost(filter, "volume_before", filter.value("volume_filtered", 0.0)) ||
               lost(report_.value("smooth", json::object()), "volume_before", measures_.volume);
    }

    /// A height that was typed wrongly takes a leg off.
    void warn_of_high_floor(const std::vector<SilhouetteAgreement>& agreement) {
        std::vector<double> left_out;
        for (const size_t i : used_) {
            const SilhouetteAgreement& a = agreement[i];
            const double missed = static_cast<double>(a.missed_px), wrong = missed + static_cast<double>(a.extra_px);
            const double both = a.iou < 1 ? wrong * a.iou / (1 - a.iou) : 1;
            left_out.push_back(both + missed > 0 ? missed / (both + missed) : 0);
        }
        const double share = median(left_out);
        if (share > 0.05)
            progress_.warn(
                text_of("--floor %g leaves out %.0f %% of what the masks show (median of the views): a reflection or shadow, or a part of the object? Remedy: "
                        "look at the cut in preview.png; --floor auto finds a table that has a pattern",
                        o_.floor.height, 100 * share));
    }

    static constexpr double kFits_iou = 0.9;  ///< median, where cameras and masks belong together

    /// The photograph without its lens's distortion, or nothing.
    Image8 photo_to_show(const View& v) {
        if (v.image_path.empty()) return {};
        try {
            return load_photo8(v);
        } catch (const InputError& e) {
            progress_.warn(std::string(e.what()) + "; the preview shows it black");  // carving needed its mask only
            return {};
        }
    }

    /// Every mask over its photograph, to be looked at.
    void place_overlays() {
        make_folder(o_.run.output / "overlays");
        tbb::parallel_for(size_t{0}, used_.size(), [&](size_t u) {
            const size_t i = used_[u];
            const auto png = io::encode_png(mask_overlay(photo_to_show(views_.views[i]), masks_.masks[i]));
            const fs::path file = o_.run.output / "overlays" / mask_names_[i];
            make_folder(file.parent_path());
            write_file(file, png.data(), png.size());
        });
        progress_.note((o_.run.output / "overlays").string() + " shows the masks over their photographs");
    }

    /// Views spread evenly.
    void preview() {
        std::vector<size_t> which;
        for (size_t n = used_.size(), shown = std::min<size_t>(n, 12), s = 0; s < shown; ++s) which.push_back(used_[s * n / shown]);
        preview(views_, which, o_.run.output / "preview.png");
    }

    void preview(const Views& views, const std::vector<size_t>& which, const fs::path& file) {
        const size_t shown = which.size();
        const std::vector<Camera> cameras = views.cameras();
        const std::vector<Vec3d> cut = views.floor && !up().empty() ? section(mesh_, up_direction(), *views.floor) : std::vector<Vec3d>();
        std::vector<PreviewView> tiles(shown);
        tbb::parallel_for(size_t{0}, shown, [&](size_t s) {
            const size_t i = which[s];
            const View& v = views.views[i];
            tiles[s].name = v.name;
            tiles[s].camera = cameras[i];
            tiles[s].mask = masks_.masks[i].coverage;
            tiles[s].thin_lost = agreement_[i].thin_lost;
            tiles[s].missed_blob = agreement_[i].missed_blob;
            tiles[s].photo = photo_to_show(v);
            tiles[s].cut_world = cut;
        });
        Image8 sheet = preview_sheet(mesh_, tiles);
        if (!views_.unverified.empty()) io::stamp(sheet, "UNVERIFIED");
        const auto png = io::encode_png(sheet);
        write_file(file, png.data(), png.size());
    }

    Reconstruction finish() {
        report_["version"] = kVersion;
        report_["peak_rss_bytes"] = peak_bytes_;
        report_["backend"] = backend_used_;
        report_["warnings"] = warnings_since(warnings_at_start_);
        if (!contradiction_.empty()) report_["contradiction"] = contradiction_;
        report_["scene"] = scene_json();
        report_["cameras"] = {{"file", views_.camera_file.string()}, {"format", views_.format}, {"up", views_.up}, {"units", views_.units}};
        Reconstruction out;
        out.report_json = report_.dump(1) + "\n";
        out.mesh = measures_;
        out.median_iou = median_iou_;
        out.minimum_iou = minimum_iou_;
        out.contradiction = contradiction_;
        out.views = used_.size();
        out.added_views = added_views_;
        out.extend_seconds = extend_seconds_;
        if (!o_.run.dry_run) {
            write_config();
            write_file(place_ / "report.json", out.report_json);
            for (const char* gone : {"failure.json", "failure.toml"}) fs::remove(store_.folder() / gone);
            if (place_ == o_.run.output && o_.run.last_stage != LastStage::Mask) clear_unverified();
            if (o_.run.last_stage == LastStage::Export && place_ == o_.run.output) write_page();
            if (!o_.views.added.empty() && o_.run.last_stage == LastStage::Export)
                store_.forget_others({"masks", "repaired", "hull", "surface", "stereo", "color", "filtered", "mesh", "smooth"});
        }
        return out;
    }

    /// The page for people. Where it fails, the result stands all the same.
    void write_page() {
        const fs::path file = o_.run.output / "report.html";
        if (!o_.result.report) {
            fs::remove(file);  // it would be about another result
            return;
        }
        try {
            write_report(o_.run.output, file, {}, progress_, &mesh_);
        } catch (const Interrupted&) {
            throw;
        } catch (const std::exception& e) {
            progress_.note(std::string("no report.html: ") + e.what());
        }
    }

    ReconstructOptions o_;  ///< as given; of a film, about its frames
    Progress& progress_;
    StageStore store_;
    size_t warnings_at_start_;  ///< one context may serve several jobs
    std::string stage_name_ = "options";
    json report_;
    VideoFrames film_;
    Views views_;
    Masks masks_;
    std::vector<std::string> mask_names_;
    std::vector<fs::path> edited_;  ///< masks that the user changed, by view
    std::vector<size_t> used_;      ///< indices of views that are carved with
    std::string align_key_;
    bool aligned_ = false;           ///< cameras were found in this run
    fs::path place_{o_.run.output};  ///< where files of the result appear
    fs::path align_picture_;
    bool floor_clips_ = false;  ///< the bounds end at the floor
    fs::path orbit_svg_;        ///< of the cameras that were found
    std::vector<DistanceField> fields_;
    std::vector<MaskView> used_masks_;  ///< of inputs_
    std::optional<KeptGrid> kept_;
    std::string base_key_, hull_id_;      ///< what a hull depends on but for its views, and with them
    std::vector<std::string> view_keys_;  ///< of inputs_, by camera and mask
    std::optional<KnownHull> known_;      ///< made of the first inputs_, to be extended by the others
    size_t added_views_ = 0;
    double extend_seconds_ = 0;
    DistanceOptions field_options_;
    size_t warnings_before_grid_ = 0;
    size_t peak_bytes_ = 0;
    size_t batch_ = 0;  ///< views whose fields are in memory together
    int bricks_ = 1;
    std::vector<CarveInput> inputs_;
    CarveOptions carve_;
    openvdb::FloatGrid::Ptr hull_, surface_;
    openvdb::Vec3SGrid::Ptr color_;
    fs::path stereo_sheet_, stereo_maps_;  ///< of this run, in the store
    openvdb::GridBase::Ptr views_grid_, confidence_grid_, stereo_confidence_;
    json color_views_ = json::object();  ///< what colouring says of each view
    std::set<std::string> missing_photos_;
    std::mutex missing_mutex_;
    std::vector<std::string> file_hashes_;  ///< of everything a view is made from
    openvdb::MaskGrid::Ptr occupancy_;
    Mesh mesh_;
    MeshMeasures measures_;
    std::string backend_used_ = "cpu", inputs_sha256_;
    double field_bytes_ = 0, hull_bytes_ = 0, memory_limit_bytes_ = 0;  ///< planned; 0: not planned
    int device_bricks_ = 1;
    std::optional<DeviceSession> device_;  ///< from check_options() on
    bool surface_on_device_ = false;
    std::string mask_key_, hull_key_, surface_key_, color_key_, filtered_key_, mesh_key_;
    double median_iou_ = 0, minimum_iou_ = 0;
    std::string contradiction_;
    std::vector<SilhouetteAgreement> agreement_;  ///< of views_
};

}  // namespace

Reconstruction reconstruct(const ReconstructOptions& options, Progress& progress) {
    openvdb::initialize();
    return Job(options, progress).run();
}

size_t clean(const fs::path& output) {
    if (!fs::is_directory(output)) throw InputError(output.string() + ": no such folder");
    if (!made_by_us(output)) throw InputError(output.string() + ": was not made by vdbcarve");
    size_t bytes = 0;
    for (const auto& entry : fs::directory_iterator(output / "stages")) {
        if (entry.path() == output / kMarker) continue;
        for (const auto& file : entry.is_directory() ? fs::recursive_directory_iterator(entry.path()) : fs::recursive_directory_iterator())
            if (file.is_regular_file()) bytes += file.file_size();
        if (entry.is_regular_file()) bytes += entry.file_size();
        std::error_code error;
        fs::remove_all(entry.path(), error);
        if (error) throw OutputError(entry.path().string() + ": cannot be removed: " + error.message());
    }
    return bytes;
}

}  // namespace vdbcarve
