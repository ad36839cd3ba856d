// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/align.h"

#include <algorithm>

#include "base/atomic_file.h"
#include "views/formats/camera_formats.h"
#include "image/image_io.h"
#include "pipeline/stages/views.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char *kCameras = "cameras.json", *kOther = "other.json", *kSvg = "orbit.svg", *kPicture = "picture.png";

/// Cameras and sittings from a file of ours about the same views.
void take_cameras(Views& views, const fs::path& file) {
    const io::Imported read = io::read_transforms(file);
    views.sittings = read.sittings;
    views.floor = read.floor;
    views.unverified = read.unverified;
    for (size_t i = 0; i < views.views.size(); ++i) {
        const View& from = read.views.at(i).view;
        views.views[i].unused = from.unused;
        views.views[i].camera = from.camera;
        views.views[i].sitting = from.sitting;
        views.views[i].lens = from.lens;
    }
}

/// Fits tracks of the photographs' features, too. Without texture nothing changes.
void refine_by_texture(AlignResult& found, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress) {
    if (!found.failures.empty()) return;
    constexpr size_t kFewest = 100;
    AlignOptions finer;
    finer.method = AlignMethod::Refine;
    finer.focal_varies = options.focal_varies;
    finer.centre_varies = options.centre_varies;
    finer.points = options.points;
    finer.seed = options.seed;
    AlignResult refined;
    try {
        refined = align(found.views, masks, finer, progress);
    } catch (const UndeterminedError& e) {
        return progress.detail(std::string("stereo: cameras are not refined by texture: ") + e.what());
    } catch (const InputError& e) {
        return progress.detail(std::string("stereo: cameras are not refined by texture: ") + e.what());
    }
    if (refined.features < kFewest || !refined.failures.empty())
        return progress.detail(text_of("stereo: %zu tracks of features are too few to refine the cameras by", refined.features));
    progress.note(text_of("stereo: cameras refined by %zu tracks of features, %.2f px (rms)", refined.features, refined.features_rms_px));
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

}  // namespace

void Align::prepare(Run& run) {
    align_ = options.align;
    AlignOptions& a = align_;
    if (!shoot.video || !finds_cameras(options, shoot.views)) return;
    const std::vector<VideoFrame>& frames = shoot.video->frames;
    if (a.orbit != Orbit::Turntable || a.method != AlignMethod::Coherence || !a.angles_deg.empty() || !a.arc_known || !a.rings.empty() || !a.sittings.empty() ||
        frames.size() != shoot.views.views.size())
        return;
    // A motor turns evenly in time, which is known of each frame. Of a walk, frames an even motion apart are what is known, and their steps are taken for even.
    const double first = frames.front().time_s, steps = static_cast<double>(frames.size());
    const double span = (frames.back().time_s - first) * steps / (steps - 1);
    for (const VideoFrame& f : frames) a.angles_deg.push_back(a.arc_deg * (f.time_s - first) / span);
    if (a.arc_deg == AlignOptions().arc_deg && (options.video.from_s > 0 || options.video.to_s > 0))
        run.progress().note("what --video-range leaves of the video is taken for one whole turn; --arc says how many degrees it is, where it is not");
    a.arc_deg = AlignOptions().arc_deg;  // the angles say it
}

bool Align::refines_for_stereo() const {
    return options.stereo.is_wanted() && options.align.features &&
           (options.align.method == AlignMethod::Coherence || options.align.method == AlignMethod::Paper);
}

Key Align::key() const {
    Key key(kName);
    key.of(align_).of(by_mat() ? "" : masks.key).of(refines_for_stereo());
    key.of(shoot.views.up).of(shoot.views.units).of(shoot.views.floor).of(shoot.views.cameras());
    if (by_mat())
        for (const View& v : shoot.views.views) {
            key.of(v.name).of(v.image_path.empty() ? "" : sha256_of_file(v.image_path)).of(v.orientation).of(v.lens.model);
            for (const double x : v.lens.coefficients) key.of(x);
        }
    return key;
}

Shoot Align::run(Run& run) {
    Progress& progress = run.progress();
    found_ = align(shoot.views, mask_views(), align_, progress);
    if (refines_for_stereo()) refine_by_texture(found_, mask_views(), options.align, progress);
    for (const std::string& w : found_.warnings) progress.warn(w);
    return {};  // see load()
}

void Align::save(Slot& slot, const Shoot&) const {
    write_file(slot.file(kCameras), cameras_json(found_.views));
    if (!found_.other_cameras.empty()) {
        Views other = found_.views;
        for (size_t i = 0; i < other.views.size(); ++i) other.views[i].camera = found_.other_cameras[i];
        write_file(slot.file(kOther), cameras_json(other));
    }
    write_file(slot.file(kSvg), orbit_svg(found_));
    if (!found_.picture.empty()) io::write_png(slot.file(kPicture), found_.picture);
    slot.note = {{"align", json::parse(alignment_json(found_))}, {"up", found_.views.up}, {"units", found_.views.units}};
}

Shoot Align::load(const Slot& slot) const {
    Shoot out = shoot;
    Views& views = out.views;
    Alignment& a = out.alignment.emplace();
    a.said = slot.note.at("align");
    const auto left_out = a.said.at("left_out").get<std::vector<std::string>>();
    views.left_out.insert(views.left_out.end(), left_out.begin(), left_out.end());
    std::erase_if(views.views, [&](const View& v) { return std::find(left_out.begin(), left_out.end(), v.name) != left_out.end(); });
    take_cameras(views, slot.file(kCameras));
    views.posed = true;
    views.format = "align";
    const std::string up = slot.note.at("up"), units = slot.note.at("units");
    views.up = options.views.up.empty() ? up : options.views.up;
    if (views.up != up) views.floor.reset();  // a height along another axis
    views.units = options.views.units.empty() ? units : options.views.units;
    a.direction = a.said.at("direction");
    a.picture_name = a.said.at("picture");
    for (const json& view : a.said.at("views")) a.residual_px.push_back(view.at("residual_px"));
    a.orbit_svg = slot.file(kSvg);
    if (slot.has(kPicture)) a.picture = slot.file(kPicture);
    if (slot.has(kOther)) a.other_cameras = slot.file(kOther);
    return out;
}

Views other_direction(const Shoot& shoot) {
    Views other = shoot.views;
    take_cameras(other, shoot.alignment->other_cameras);
    return other;
}

void Align::say(const Shoot& made, Progress& progress) const {
    const json& a = made.alignment->said;
    const auto number = [&](const char* name) { return a.at(name).get<double>(); };
    const auto word = [&](const char* name) { return a.at(name).get<std::string>(); };
    if (by_mat())
        progress.note(text_of(
            "cameras found from the mat in %s: its corners %.2f px (rms) from where they should be; focal length %.1f +- %.1f px; lengths in %s",
            counted(made.views.views.size(), "view").c_str(), number("residual_rms_px"), number("focal_px"), number("focal_sd_px"), word("units").c_str()));
    else
        progress.note(
            text_of("cameras found: %s, object turning %s; contours %.2f px (rms) outside the others' hull, %.1f %% within half a pixel; focal length "
                    "%.0f px; %s units",
                    word("orbit").c_str(), word("direction").c_str(), number("residual_rms_px"), 100 * number("coherent_share"), number("focal_px"),
                    word("units").c_str()));
}

}  // namespace vdbcarve::pipeline
