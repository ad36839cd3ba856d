// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/views.h"

#include "align/align_options.h"
#include "align/align_scale.h"
#include "check/camera_doubts.h"
#include "pipeline/advice.h"
#include "pipeline/output_check.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// A video's frames, kept in OUT/stages.
struct Frames {
    VideoFrames frames;
    fs::path folder;
};

struct ExtractFrames {
    static constexpr const char* kName = "frames";
    static constexpr bool kReadBack = true;
    using Result = Frames;

    const fs::path& file;
    const VideoOptions& options;

    Key key() const { return Key(kName).of(sha256_of_file(file)).of(options); }
    Frames run(Run& run) {
        Frames out;
        out.folder = run.store().folder() / ".frames.part";
        try {
            out.frames = extract_frames(file, out.folder, options, run.progress());
        } catch (const InputError&) {  // nothing was made: what was opened for it goes
            fs::remove_all(out.folder);
            run.forget_new_output();
            throw;
        }
        return out;
    }
    void save(Slot& slot, const Frames& made) const {
        for (const auto& entry : fs::directory_iterator(made.folder)) fs::rename(entry.path(), slot.file(entry.path().filename().string()));
        fs::remove_all(made.folder);
    }
    Frames load(const Slot& slot) const { return {read_video_json(slot.file("frames.json")), slot.folder()}; }
};

/// What the scene must have for the options to mean something.
void check_cameras(const ReconstructOptions& o, const Shoot& shoot, Progress& progress) {
    const Views& views = shoot.views;
    const bool finds = finds_cameras(o, views), refines = o.align.method == AlignMethod::Refine, mask_only = o.run.last_stage == LastStage::Mask;
    if (!views.posed && refines)
        throw UsageError("--method refine improves cameras, and " + shoot.folder.string() + " has none. Remedy: --cameras FILE, or --method coherence");
    std::error_code not_there;
    if (!o.run.dry_run && fs::equivalent(views.camera_file.parent_path(), o.run.output / kUnverified, not_there))
        throw UsageError("--cameras " + views.camera_file.string() + ": this run would replace it, or take it away. Remedy: another -o");
    if (finds && o.run.dry_run)
        throw UsageError(
            "--dry-run: cameras are to be found first, and what is to be carved is known then. Remedy: vdbcarve align, then --cameras OUT/cameras.json");
    // Without sittings of the camera file's: they are found, or refined with everything else in the scene's frame.
    if (o.cameras.find_again && views.sittings.size() > 1)
        throw UsageError("align: the camera file's sittings would be lost. Remedy: --cameras none --sittings N,N");
    if (views.posed && !o.cameras.find_again) {
        if (const std::vector<std::string> given = given_options(o.align); !given.empty())
            throw UsageError(some_of(given) + ": the cameras of " + views.camera_file.string() +
                             " are used as they are, so this would be ignored. Remedy: --method refine to improve them, --cameras none to find others, or "
                             "without it, also in config.toml");
    } else if (!mask_only) {
        check_align_options(o.align, views, views.views.size());
        const bool by_silhouettes = o.align.method == AlignMethod::Coherence || o.align.method == AlignMethod::Paper;
        const bool scaled = o.align.known_distance > 0 || o.align.known_height > 0 || o.align.known_length;
        if (by_silhouettes && !scaled && !o.views.units.empty())
            throw UsageError("--units " + o.views.units +
                             ": cameras found from silhouettes know no scale, so their unit is arbitrary. Remedy: --known-height, --known-distance or "
                             "--known-length, or a marker mat (--method mat)");
        if (o.align.known_length) check_known_length(views, {}, *o.align.known_length);
    }
    if (finds && !refines && !o.views.up.empty() && o.views.up != "z")
        throw UsageError("--up " + o.views.up +
                         ": cameras that are found have z up, along the axis (or out of the mat). Remedy: without it; --dcc turns results into another "
                         "program's axes");
    if (views.posed && o.cameras.find_again && (o.align.method == AlignMethod::Coherence || o.align.method == AlignMethod::Paper))
        progress.note("of " + views.camera_file.string() +
                      " focal lengths, principal points and lenses are taken, its poses are not looked at (--method refine starts from them)");
}

/// What needs an up axis or a unit must have it.
void check_axes(const ReconstructOptions& o, const Shoot& shoot, Progress& progress) {
    const Views& views = shoot.views;
    const std::string up = shoot.up();
    const bool finds = finds_cameras(o, views), mask_only = o.run.last_stage == LastStage::Mask;
    const bool mat = o.align.method == AlignMethod::Mat;  // which says both
    if (o.floor.from != FloorOptions::From::File && !mask_only && up.empty() && !finds)
        throw UsageError("--floor: the scene does not say which way is up. Remedy: --up");
    if (o.floor.from == FloorOptions::From::Found && o.run.dry_run) throw UsageError("--dry-run: the floor is to be found first. Remedy: --floor HEIGHT");
    if (views.posed && !finds && !mask_only)
        if (const std::string doubted = doubt_of_up(views.cameras(), up); !doubted.empty()) progress.warn(doubted);
    if (o.floor.flat_base && up.empty() && !mat) throw UsageError("--base flat: the scene does not say which way is up. Remedy: --up");
    if (o.result.stl_mm && !mat) file_frame(".stl", {up, views.units, o.result.dcc, o.result.stl_mm});  // refuses where the unit is not known
}

}  // namespace

bool finds_cameras(const ReconstructOptions& options, const Views& views) {
    return options.run.last_stage != LastStage::Mask && (!views.posed || options.cameras.find_again);
}

Shoot LoadViews::run(Run& run) {
    Progress& progress = run.progress();
    Shoot shoot;
    shoot.up_given = options.views.up;
    shoot.folder = options.views.scene;
    if (is_video(options.views.scene)) {
        const fs::path& file = options.views.scene;
        if (run.dry())
            throw UsageError("--dry-run: " + file.string() +
                             " is a video, of which frames are to be taken first. Remedy: vdbcarve mask, then its folder in OUT/stages as the scene");
        if (!options.views.images.empty()) throw UsageError("--images: " + file.string() + " is a video, its frames are the photographs. Remedy: without it");
        refuse_output_among_inputs(run.out(), options.views, options.mask, {});
        run.open(file);
        bool were_there = false;
        Frames found = run.part(ExtractFrames{file, options.video}, &were_there);
        if (were_there) run.say_reused();
        for (const std::string& w : found.frames.warnings) progress.warn(w);
        progress.note(text_of("%zu of %zu frames of %s (%.1f s) are the photographs; they are in %s", found.frames.frames.size(), found.frames.looked_at,
                              file.c_str(), found.frames.duration_s, found.folder.c_str()));
        shoot.video = std::move(found.frames);
        shoot.video_file = file;
        shoot.folder = found.folder;
    }
    ViewsOptions wanted = options.views;
    wanted.scene = shoot.folder;
    wanted.allow_unposed = true;
    wanted.units.clear();
    shoot.views = load_views(wanted, progress);
    Views& views = shoot.views;
    const bool from_given_cameras = !finds_cameras(options, views) || options.align.method == AlignMethod::Refine;
    if (from_given_cameras && !options.views.units.empty() && !views.units.empty() && options.views.units != views.units)
        progress.warn("--units " + options.views.units + ": " + views.camera_file.string() + " says " + views.units + "; its numbers are taken for " +
                      options.views.units + ", none is converted");
    if (!options.views.units.empty()) views.units = options.views.units;
    check_cameras(options, shoot, progress);
    if (!finds_cameras(options, views) && options.run.last_stage != LastStage::Mask && !views.unverified.empty())
        accept_or_refuse(views.unverified, views.camera_file.string() + ": its cameras were found, but are UNVERIFIED", options.cameras.accept_unobservable,
                         progress);
    check_axes(options, shoot, progress);
    progress.note(counted(views.views.size(), "view") + " from " + views.camera_file.string() + " (" + views.format + ")");
    if (!run.dry()) refuse_output_among_inputs(run.out(), wanted, options.mask, views);
    run.open(shoot.folder);
    run.keep_cameras(views);
    return shoot;
}

void LoadViews::report(const Shoot& shoot, json& report) const {
    if (!shoot.video) return;
    report["video"] = json::parse(video_json(*shoot.video));
    report["video"]["file"] = shoot.video_file.string();
}

}  // namespace vdbcarve::pipeline
