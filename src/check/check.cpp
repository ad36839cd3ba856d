// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/check.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>

#include "check/camera_doubts.h"
#include "surface/coarse_hull.h"
#include "image/exif.h"
#include "image/image_io.h"
#include "mask/mask_consensus.h"
#include "align/orbit_model.h"
#include "base/sha256.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

using Severity = Finding::Severity;

std::string fixed(double v, int digits = 2) { return text_of("%.*f", digits, v); }

/// A sentence as messages have them: what follows "Remedy: " is the remedy.
void find(CheckResult& out, Severity severity, const char* part, const std::string& sentence, ExitCode code = ExitCode::Contradiction) {
    const std::string word = "Remedy: ";
    const size_t at = sentence.find(word);
    std::string text = sentence.substr(0, at), remedy = at == std::string::npos ? "" : sentence.substr(at + word.size());
    while (!text.empty() && (text.back() == ' ' || text.back() == '.')) text.pop_back();
    out.findings.push_back({severity, part, text, remedy, severity == Severity::Error ? code : ExitCode::Done});
}

constexpr double kFits = 0.9;   ///< median IoU of the hull with its own silhouettes, where cameras and masks belong together
constexpr double kGood = 0.96;  ///< below it other readings of the cameras are tried all the same: half the focal length leaves 0.92

/// Which way is up, where the file does not say it, or says another.
void guess_up(const Views& views, CheckResult& out) {
    out.up_guessed = axis_near(out.up_world);
    if (views.up.empty() && !out.up_guessed.empty())
        find(out, Severity::Note, "cameras",
             "the file does not say which way is up; the cameras stand upright along " + out.up_guessed + ". Remedy: --up " + out.up_guessed);
    if (const std::string doubted = doubt_of_up(views.cameras(), views.up); !doubted.empty()) find(out, Severity::Warning, "cameras", doubted);
}

void check_cameras(const Views& views, CheckResult& out) {
    const std::vector<Camera> cameras = views.cameras();
    std::vector<double> fov;
    for (const Camera& c : cameras)
        if (!c.intrinsics.orthographic) fov.push_back(2 * std::atan(0.5 * c.intrinsics.width_px / c.intrinsics.fx) * kDegrees);
    if (!fov.empty()) out.fov_deg = median(fov);
    const auto target = look_at_point(cameras);
    if (!target) throw UndeterminedError("all cameras look along the same line, so how deep the object is cannot be told. Remedy: views from other directions");
    out.look_at_world = *target;
    std::vector<double> distance, miss;
    std::vector<std::string> away;
    for (size_t i = 0; i < cameras.size(); ++i) {
        const Vec3d to = *target - cameras[i].centre_world();
        distance.push_back(to.norm());
        miss.push_back(to.cross(cameras[i].forward_world()).norm());
        if (to.dot(cameras[i].forward_world()) <= 0) away.push_back(views.views[i].name);
    }
    out.distance_median = median(distance);
    const auto [nearest, farthest] = std::minmax_element(distance.begin(), distance.end());
    out.distance_spread = (*farthest - *nearest) / out.distance_median;
    out.look_at_miss = median(miss) / out.distance_median;
    if (!away.empty()) {
        const bool most = away.size() * 2 > cameras.size();
        find(out, most ? Severity::Error : Severity::Warning, "cameras",
             std::to_string(away.size()) + " of " + std::to_string(cameras.size()) + " cameras look away from where the others look (" + some_of(away) + ")" +
                 (most ? ": the camera file's axes are probably another program's. Remedy: look at which way round the poses are and which axes they have; "
                         "check with masks tries other readings"
                       : ". Remedy: look at their poses"));
    }
    out.up_world = mean_up(cameras);
    if (out.up_world.isZero()) {
        find(out, Severity::Warning, "cameras",
             "the images' up directions cancel each other: cameras all around, or turned upside down by turns; azimuths are not judged");
        return;
    }
    std::vector<double> azimuths = azimuths_rad(cameras, *target, out.up_world);
    for (double& a : azimuths) a *= kDegrees;
    out.elevation_min_deg = 90;
    out.elevation_max_deg = -90;
    for (const Camera& c : cameras) {
        const Vec3d from = (c.centre_world() - *target).normalized();
        const double elevation = std::asin(std::clamp(from.dot(out.up_world), -1.0, 1.0)) * kDegrees;
        out.elevation_min_deg = std::min(out.elevation_min_deg, elevation);
        out.elevation_max_deg = std::max(out.elevation_max_deg, elevation);
    }
    std::sort(azimuths.begin(), azimuths.end());
    out.largest_gap_deg = azimuths.front() + 360 - azimuths.back();
    for (size_t i = 1; i < azimuths.size(); ++i) out.largest_gap_deg = std::max(out.largest_gap_deg, azimuths[i] - azimuths[i - 1]);
    // A view and the one from behind show the same silhouette (but for perspective), so half a turn may suffice.
    if (out.largest_gap_deg > 200)
        find(out, Severity::Warning, "cameras",
             "no view within " + fixed(out.largest_gap_deg, 0) + " degrees of azimuth: the hull will bulge there. Remedy: views from that side");
    if (out.elevation_max_deg - out.elevation_min_deg < 5)
        find(out, Severity::Warning, "cameras",
             "all views are at one height (" + fixed(out.elevation_min_deg, 0) + " to " + fixed(out.elevation_max_deg, 0) +
                 " degrees): top and bottom are bounded by cones only. Remedy: a second ring from above, which helps more than twice as many views");
    if (out.look_at_miss > 0.2)
        find(out, Severity::Warning, "cameras",
             "the optical axes miss their common point by " + fixed(100 * out.look_at_miss, 0) +
                 " % of the distance: views of different scenes, or wrong poses?");
    guess_up(views, out);
}

/// The hull of masks that do not fit their cameras: what else the file may mean. False where no other reading fits.
bool try_readings(const Views& views, const std::vector<MaskView>& seen, const std::string& what, Severity severity, CheckResult& out, Progress& progress) {
    std::vector<Reading> readings = readings_of(views.cameras());
    judge(readings, seen, progress);
    const Reading& own = readings.front();
    const Reading* best = &own;
    for (const Reading& r : readings)
        if (r.overlap > best->overlap) best = &r;
    constexpr double kBetter = 0.03;
    if (best->overlap < kFits || best->overlap < own.overlap + kBetter) return false;
    std::string words;
    for (const Reading& r : readings)
        if (r.overlap > best->overlap - 0.005 && r.overlap > own.overlap + kBetter) words += (words.empty() ? "" : ", or ") + r.words;
    const bool of_cameras = !best->mirrored && std::is_sorted(best->silhouette.begin(), best->silhouette.end());
    find(out, severity, "cameras",
         what + "; they fit " + words + " (median IoU " + fixed(best->overlap, 3) + " instead of " + fixed(own.overlap, 3) + "). Remedy: " +
             (of_cameras       ? "--write-cameras FILE writes them so, for --cameras FILE"
              : best->mirrored ? "mirror the images back, or, where their order may be wrong, put that right"
                               : "give each image the name that the camera file has for it"));
    if (!of_cameras) return true;
    out.better = views;
    out.better->sittings = {Sitting{}};
    for (size_t i = 0; i < views.views.size(); ++i) {
        out.better->views[i].camera = best->cameras[i];
        out.better->views[i].sitting = "0";
    }
    return true;
}

/// The hull of silhouettes, and how it agrees with each of them.
struct Hull {
    Mesh mesh;
    std::vector<SilhouetteAgreement> agreements;  ///< by view
    double median_iou = 0;                        ///< of the views that have a mask
};

/// Nothing where they leave no hull; `died` says why.
std::optional<Hull> hull_of(const Views& views, const std::vector<MaskView>& seen, const CheckOptions& options, std::string& died, Progress& progress) {
    const std::vector<Camera> cameras = views.cameras();
    Hull out;
    try {
        out.mesh = extract_mesh(*coarse_hull(views.names(), cameras, seen, options.resolution, options.min_seen, progress), {}, progress);
    } catch (const Interrupted&) {
        throw;
    } catch (const Error& e) {
        died = e.what();
        died = died.substr(0, died.find(". Remedy"));
        return std::nullopt;
    }
    out.agreements.resize(seen.size());
    tbb::parallel_for(size_t{0}, seen.size(), [&](size_t i) {
        if (!seen[i].coverage.empty())
            out.agreements[i] = compare_silhouettes(out.mesh, cameras[i], seen[i], contour_softness(seen[i].coverage) >= kSoftContours);
    });
    std::vector<double> ious;
    for (size_t i = 0; i < seen.size(); ++i)
        if (!seen[i].coverage.empty()) ious.push_back(out.agreements[i].iou);
    out.median_iou = median(ious);
    return out;
}

double overlap_of(ImageView<uint8_t> a, ImageView<uint8_t> b) {
    if (a.width != b.width || a.height != b.height) return 0;
    size_t both = 0, either = 0;
    for (int y = 0; y < a.height; ++y)
        for (int x = 0; x < a.width; ++x) {
            const bool in_a = a.at(x, y) >= 128, in_b = b.at(x, y) >= 128;
            both += in_a && in_b, either += in_a || in_b;
        }
    return either ? static_cast<double>(both) / static_cast<double>(either) : 0.0;
}

/// Views that contradict all others: by name, and with the view whose mask would fit in the place of their own.
void blame(const std::vector<size_t>& broken, const std::optional<Hull>& rest, const Views& views, const std::vector<MaskView>& seen, const std::string& more,
           Severity severity, CheckResult& out) {
    std::vector<std::string> names;
    bool other_fits = false;
    for (const size_t i : broken) {
        names.push_back(views.views[i].name);
        if (!rest) continue;
        const Image8 silhouette = silhouette_of(rest->mesh, views.cameras()[i]);
        std::vector<double> overlap(seen.size());
        tbb::parallel_for(size_t{0}, seen.size(), [&](size_t j) { overlap[j] = overlap_of(silhouette.view(), seen[j].coverage); });
        const size_t best = static_cast<size_t>(std::max_element(overlap.begin(), overlap.end()) - overlap.begin());
        if (best == i || overlap[best] < 0.85 || overlap[best] < overlap[i] + 0.03) continue;
        names.back() += " (whose camera the mask of " + views.views[best].name + " fits)";
        other_fits = true;
    }
    find(out, severity, "masks",
         counted(broken.size(), "mask") + " against all others: " + some_of(names) + more +
             ". Remedy: " + (other_fits ? "give each image and mask the name that the camera file has for it; else " : "") +
             "mend or delete what is wrong, or reconstruct --repair-masks; where a mask is right, its view's camera is wrong (moved, or another view's)");
}

constexpr double kFarOff_focal = 0.1;  ///< a hull made with such a focal length is not the object's any more

/// Half a pixel everywhere, or a wrong focal length, leaves a hull that looks good and is a little too small.
void check_common_error(const Views& views, const std::vector<MaskView>& seen, CheckResult& out, Progress& progress) {
    const std::optional<CommonError> e = common_error(views.cameras(), seen, progress);
    if (!e) return;
    out.contour_off_px = e->rms_before_px;
    const double nan = std::nan("");
    const bool open[2] = {e->sd[0] > 0.1, e->sd[1] > 0.1};
    out.shift_px[0] = open[0] ? nan : e->shift_x_px;
    out.shift_px[1] = open[1] ? nan : e->shift_y_px;
    out.focal_factor = e->sd[2] > 0.01 ? nan : e->focal_factor;
    if (e->rms_after_px > 0.85 * e->rms_before_px || e->rms_before_px < 0.05) return;
    const auto off = [&](int a) { return !open[a] && std::fabs(out.shift_px[a]) > std::max(0.2, 4 * e->sd[static_cast<size_t>(a)]); };
    const std::string better = " (contours " + fixed(e->rms_before_px) + " px off, " + fixed(e->rms_after_px) + " px then)";
    if (off(0) || off(1)) {
        const double d = off(0) ? out.shift_px[0] : out.shift_px[1];
        const bool half = std::fabs(std::fabs(d) - 0.5) < 0.15 && (!(off(0) && off(1)) || std::fabs(out.shift_px[0] - out.shift_px[1]) < 0.2);
        const auto said = [&](int a) { return open[a] ? std::string("?") : fixed(out.shift_px[a]); };
        find(out, Severity::Warning, "cameras",
             "silhouettes fit better with all principal points moved by (" + said(0) + ", " + said(1) + ") px" + better +
                 (half ? ": half a pixel, as where the first pixel's centre is counted otherwise" : "") +
                 ". Remedy: " + (half ? std::string("--pixel-centre ") + (d > 0 ? "integer" : "corner") : "`vdbcarve align SCENE --method refine`"));
    }
    if (std::isfinite(out.focal_factor) && std::fabs(out.focal_factor - 1) > std::max(0.01, 4 * e->sd[2]))
        find(out, std::fabs(out.focal_factor - 1) > kFarOff_focal ? Severity::Error : Severity::Warning, "cameras",
             "silhouettes fit better with all focal lengths times " + fixed(out.focal_factor, 3) + better +
                 ": were images scaled or cropped after calibration? Remedy: cameras for these images, or `vdbcarve align SCENE --method refine`");
}

void check_size(const Views& views, const Mesh& mesh, CheckResult& out) {
    Box3d box;
    for (const auto& v : mesh.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    out.object_size = box.sizes();
    const std::optional<double> metres = views.units.empty() ? std::nullopt : metres_per(views.units);
    if (!metres) {
        find(out, Severity::Note, "cameras", "the unit of length is not said. Remedy: --units, where it is known");
        return;
    }
    const double largest_m = out.object_size.maxCoeff() * *metres;
    if (largest_m < 1e-3 || largest_m > 50)
        find(out, Severity::Warning, "cameras",
             "an object of " + text_of("%.3g %s", out.object_size.maxCoeff(), views.units.c_str()) +
                 (largest_m < 1e-3 ? " is hardly visible" : " is a building") + ": is the unit meant? Remedy: --units");
}

void check_masks(const CheckOptions& options, const Views& views, CheckResult& out, Progress& progress) {
    Masks masks;
    try {
        masks = make_masks(views, options.views.scene, options.mask, std::vector<std::filesystem::path>(views.views.size()), progress);
    } catch (const InputError& e) {
        find(out, Severity::Error, "masks", e.what(), e.code());
        return;
    }
    const std::vector<Camera> all = views.cameras();
    std::vector<MaskView> seen;
    std::vector<std::string> hard;
    size_t used = 0;
    for (size_t i = 0; i < views.views.size(); ++i) {
        seen.push_back(views.views[i].unused.empty() ? view_of(masks.masks[i]) : MaskView());  // as reconstruct does
        if (seen.back().coverage.empty()) continue;
        ++used;
        if (contour_softness(masks.masks[i].coverage) < kSoftContours) hard.push_back(views.views[i].name);
    }
    if (used == 0) return;
    out.looked_at.push_back("masks");
    out.soft_share = 1 - static_cast<double>(hard.size()) / static_cast<double>(used);
    if (!hard.empty())
        find(out, Severity::Note, "masks",
             (hard.size() == used ? std::string("all masks are")
                                  : counted(hard.size(), "mask") + " of " + std::to_string(used) + (hard.size() == 1 ? " is" : " are")) +
                 " hard, black and white: contours are known to half a pixel, and surfaces are filtered. Remedy: masks with grey edges, where they can be had");
    if (!views.posed) return;
    std::string died;
    const std::optional<Hull> hull = hull_of(views, seen, options, died, progress);
    if (hull) {
        check_size(views, hull->mesh, out);
        for (size_t i = 0; i < seen.size(); ++i)
            if (!seen[i].coverage.empty()) out.agreements.push_back({views.views[i].name, hull->agreements[i]});
        std::stable_sort(out.agreements.begin(), out.agreements.end(),
                         [](const ViewCheck& a, const ViewCheck& b) { return a.agreement.iou < b.agreement.iou; });
        out.median_iou = hull->median_iou;
    }
    const bool fits = out.median_iou >= kFits;
    const Severity severity = fits ? Severity::Warning : Severity::Error;
    const std::string what =
        hull ? "the hull of all views covers its own silhouettes poorly (median IoU " + fixed(out.median_iou, 3) + "): cameras and masks do not fit together"
             : died;
    if (out.median_iou < kGood && try_readings(views, seen, what, severity, out, progress)) return;
    const std::vector<size_t> broken = find_broken_masks(views.names(), all, seen, progress);
    if (!broken.empty()) {
        // A few that are wrong may ruin everything.
        std::vector<MaskView> others = seen;
        for (const size_t i : broken) others[i] = {};
        std::string why;
        const std::optional<Hull> rest = hull_of(views, others, options, why, progress);
        const bool theirs = rest && rest->median_iou >= kFits;
        blame(broken, rest, views, seen,
              fits     ? ""
              : theirs ? "; without " + std::string(broken.size() == 1 ? "it" : "them") + " the others fit (median IoU " + fixed(rest->median_iou, 3) + ")"
                       : "",
              !fits && theirs ? Severity::Error : Severity::Warning, out);
        if (!fits && theirs) return;
    }
    if (!fits) {
        find(out, Severity::Error, "cameras",
             what +
                 "; no other reading of the poses fits either. Remedy: check poses, focal length and which mask belongs to which view; `vdbcarve align SCENE "
                 "--method refine` where cameras are nearly right, --cameras none to find them");
        return;
    }
    std::vector<std::string> weak;
    for (const ViewCheck& v : out.agreements)
        if (v.agreement.iou < std::min(0.95, out.median_iou - 0.02)) weak.push_back(v.name + " (IoU " + fixed(v.agreement.iou, 3) + ")");
    if (!weak.empty())
        find(out, Severity::Warning, "masks",
             "views whose silhouettes the others contradict: " + some_of(weak) +
                 ". Remedy: mend the worst first; one bad mask also eats into its neighbours' agreement");
    std::vector<std::string> thin;
    for (const ViewCheck& v : out.agreements)
        if (v.agreement.thin_length_lost_px > 20) thin.push_back(v.name + " (" + std::to_string(v.agreement.thin_length_lost_px) + " px)");
    if (!thin.empty())
        find(out, Severity::Warning, "masks",
             "thin parts of these masks are carved away by other views: " + some_of(thin) + ". Remedy: mend the masks there, or --max-misses 1");
    if (broken.empty()) check_common_error(views, seen, out, progress);
}

/// Every photograph is decoded once.
void check_images(const Views& views, CheckResult& out, Progress& progress) {
    struct Seen {
        bool there = false, decoded = false, grey = false;
        std::string error, sha256;
        int said_orientation = 1;
        double sharpness = 0, brightness = 0;
    };
    std::vector<Seen> seen(views.views.size());
    progress.begin("images", seen.size());
    tbb::parallel_for(size_t{0}, seen.size(), [&](size_t i) {
        const View& v = views.views[i];
        Seen& s = seen[i];
        progress.step();
        if (v.image_path.empty()) return;
        s.there = true;
        s.said_orientation = io::exif_orientation(v.image_path);
        try {
            s.sha256 = sha256_of_file(v.image_path);
            const Image8 photo = io::read_photo8(v.image_path, v.orientation);
            const Intrinsics& k = v.camera.intrinsics;
            s.decoded = true;
            s.grey = photo.channels == 1;
            if (photo.width != k.width_px || photo.height != k.height_px)
                s.error = other_size(v.image_path.string(), photo.width, photo.height, v.name, k.width_px, k.height_px);
            s.sharpness = io::sharpness(photo);
            double sum = 0;
            for (const uint8_t p : photo.data) sum += p;
            s.brightness = sum / static_cast<double>(photo.data.size());
        } catch (const InputError& e) {
            s.error = e.what();
        }
    });
    std::vector<std::string> turned, as_stored, blurred, exposed;
    std::vector<double> sharpness, brightness;
    std::map<std::string, std::string> known;
    std::vector<std::string> errors;
    size_t grey = 0;
    for (size_t i = 0; i < seen.size(); ++i) {
        const Seen& s = seen[i];
        const std::string& name = views.views[i].name;
        if (!s.there) continue;
        ++out.images_read;
        if (!s.error.empty()) errors.push_back(s.error);
        if (s.said_orientation != 1) (views.views[i].orientation != 1 ? turned : as_stored).push_back(name);
        if (!s.decoded) continue;
        sharpness.push_back(s.sharpness);
        brightness.push_back(s.brightness);
        grey += s.grey;
        const auto [other, fresh] = known.emplace(s.sha256, name);
        if (!fresh) find(out, Severity::Warning, "images", name + " is the very same picture as " + other->second + ". Remedy: take one of them away");
    }
    // One line for what is wrong with all in the same way.
    if (errors.size() > 3)
        find(out, Severity::Error, "images", counted(errors.size(), "image") + " cannot be used, the first: " + errors.front(), ExitCode::Input);
    else
        for (const std::string& e : errors) find(out, Severity::Error, "images", e, ExitCode::Input);
    const double sharp = median(sharpness), bright = median(brightness);
    for (size_t i = 0; i < seen.size(); ++i) {
        if (!seen[i].decoded) continue;
        if (seen[i].sharpness < 0.2 * sharp) blurred.push_back(views.views[i].name);
        if (seen[i].brightness > 1.5 * bright || seen[i].brightness < bright / 1.5) exposed.push_back(views.views[i].name);
    }
    if (!blurred.empty())
        find(out, Severity::Warning, "images",
             counted(blurred.size(), "image") + " much less sharp than the others: " + some_of(blurred) +
                 ". Remedy: take them away, or --color-leave-out views of them");
    if (!exposed.empty())
        find(out, Severity::Note, "images",
             counted(exposed.size(), "image") + " much brighter or darker than the others: " + some_of(exposed) + "; colours are evened out (--exposure)");
    if (!turned.empty()) find(out, Severity::Note, "images", counted(turned.size(), "image") + " turned as EXIF says: " + some_of(turned));
    if (!as_stored.empty())
        find(out, Severity::Note, "images",
             "EXIF says that " + counted(as_stored.size(), "image") +
                 " should be turned, but the cameras have the size of the pixels as stored, which are taken: " + some_of(as_stored));
    if (grey && grey < out.images_read) find(out, Severity::Note, "images", counted(grey, "image") + " of " + std::to_string(out.images_read) + " in grey");
}

}  // namespace

std::vector<std::string> CheckResult::of(Finding::Severity severity) const {
    std::vector<std::string> out;
    for (const Finding& f : findings)
        if (f.severity == severity) out.push_back(f.text + (f.remedy.empty() ? "" : ". Remedy: " + f.remedy));
    return out;
}

CheckResult check(const CheckOptions& options, Progress& progress) {
    openvdb::initialize();
    CheckResult out;
    ViewsOptions vo = options.views;
    vo.cameras_only = !options.masks && !options.images;
    vo.allow_unposed = options.masks || options.images;
    Views views;
    try {
        views = load_views(vo, progress);
    } catch (const InputError& e) {
        find(out, Severity::Error, "cameras", e.what(), e.code());
        out.exit_code = e.code();
        return out;
    }
    out.views = views.views.size();
    out.up_said = views.up;
    out.units_said = views.units;
    if (!views.posed) find(out, Severity::Note, "cameras", "there are no cameras yet. Remedy: vdbcarve align, or reconstruct, which finds them");
    if (options.images) check_images(views, out, progress);
    if (out.images_read) out.looked_at.push_back("images");
    const bool readable =
        std::none_of(out.findings.begin(), out.findings.end(), [](const Finding& f) { return f.severity == Severity::Error && f.code == ExitCode::Input; });
    if (options.masks && readable) check_masks(options, views, out, progress);
    // Of poses that are to be read in another way, what they are then.
    if (options.cameras && views.posed) {
        check_cameras(out.better ? *out.better : views, out);
        out.looked_at.push_back("cameras");
    }
    if (!out.agreements.empty()) out.looked_at.push_back("how they fit together");
    for (const std::string& w : progress.warnings()) find(out, Severity::Warning, "masks", w);
    for (const std::string& w : views.unverified) find(out, Severity::Error, "cameras", "UNVERIFIED cameras: " + w, ExitCode::Undetermined);
    std::vector<std::string> unused;
    for (const View& v : views.views)
        if (!v.unused.empty()) unused.push_back(v.name + " (" + v.unused + ")");
    if (!unused.empty())
        find(out, Severity::Warning, "cameras",
             counted(unused.size(), "view") + " not used, as the camera file says: " + some_of(unused) + ". Remedy: mend the masks and align again");
    std::stable_sort(out.findings.begin(), out.findings.end(), [](const Finding& a, const Finding& b) { return a.severity > b.severity; });
    for (const ExitCode code : {ExitCode::Undetermined, ExitCode::Contradiction, ExitCode::Input})
        for (const Finding& f : out.findings)
            if (f.severity == Severity::Error && f.code == code) out.exit_code = code;
    return out;
}

namespace {

const char* name_of(Severity severity) { return severity == Severity::Error ? "error" : severity == Severity::Warning ? "warning" : "note"; }

nlohmann::json number_or_null(double v) { return std::isfinite(v) ? nlohmann::json(v) : nlohmann::json(); }

}  // namespace

std::string check_json(const CheckResult& r) {
    nlohmann::ordered_json j{{"views", r.views},
                             {"cameras",
                              {{"look_at", {r.look_at_world.x(), r.look_at_world.y(), r.look_at_world.z()}},
                               {"look_at_miss", r.look_at_miss},
                               {"up", {r.up_world.x(), r.up_world.y(), r.up_world.z()}},
                               {"up_guessed", r.up_guessed},
                               {"up_said", r.up_said},
                               {"units_said", r.units_said},
                               {"distance_median", r.distance_median},
                               {"distance_spread", r.distance_spread},
                               {"elevation_deg", {r.elevation_min_deg, r.elevation_max_deg}},
                               {"largest_gap_deg", r.largest_gap_deg},
                               {"fov_deg", r.fov_deg},
                               {"contour_off_px", r.contour_off_px},
                               {"principal_point_shift_px", {number_or_null(r.shift_px[0]), number_or_null(r.shift_px[1])}},
                               {"focal_factor", number_or_null(r.focal_factor)}}},
                             {"object_size", {r.object_size.x(), r.object_size.y(), r.object_size.z()}},
                             {"median_iou", r.median_iou},
                             {"soft_masks", r.soft_share},
                             {"images_read", r.images_read},
                             {"looked_at", r.looked_at},
                             {"agreement", nlohmann::json::array()},
                             {"findings", nlohmann::json::array()},
                             {"errors", r.of(Severity::Error)},
                             {"warnings", r.of(Severity::Warning)},
                             {"exit_code", static_cast<int>(r.exit_code)}};
    for (const Finding& f : r.findings) j["findings"].push_back({{"severity", name_of(f.severity)}, {"part", f.part}, {"text", f.text}, {"remedy", f.remedy}});
    for (const ViewCheck& v : r.agreements)
        j["agreement"].push_back({{"name", v.name},
                                  {"silhouette_iou", v.agreement.iou},
                                  {"contour_p95_px", v.agreement.contour_p95_px},
                                  {"contour_p99_px", v.agreement.contour_p99_px},
                                  {"largest_missed_blob_px", v.agreement.largest_missed_blob_px},
                                  {"thin_length_lost_px", v.agreement.thin_length_lost_px}});
    return j.dump(1);
}

std::string check_text(const CheckResult& r) {
    std::string out = std::to_string(r.views) + " views";
    if (r.distance_median > 0) {
        out += "; they look at (" + fixed(r.look_at_world.x(), 3) + ", " + fixed(r.look_at_world.y(), 3) + ", " + fixed(r.look_at_world.z(), 3) +
               "), missing it by " + fixed(100 * r.look_at_miss, 1) + " % of their distance\n";
        out += "distance " + fixed(r.distance_median, 3) + " (spread " + fixed(100 * r.distance_spread, 0) + " %), horizontal field of view " +
               fixed(r.fov_deg, 1) + " degrees\n";
        if (r.up_world.norm() > 0)
            out += "up (" + fixed(r.up_world.x()) + ", " + fixed(r.up_world.y()) + ", " + fixed(r.up_world.z()) + "), elevations " +
                   fixed(r.elevation_min_deg, 0) + " to " + fixed(r.elevation_max_deg, 0) + " degrees, largest gap between azimuths " +
                   fixed(r.largest_gap_deg, 0) + " degrees\n";
    } else {
        out += "\n";
    }
    if (r.object_size.maxCoeff() > 0)
        out += text_of("the object is %.4g x %.4g x %.4g %s along x, y, z\n", r.object_size.x(), r.object_size.y(), r.object_size.z(),
                       r.units_said.empty() ? "units (which is not said)" : r.units_said.c_str());
    if (!r.agreements.empty()) {
        out += "silhouettes of the hull against the masks: median IoU " + fixed(r.median_iou, 4) +
               (r.contour_off_px > 0 ? ", contours " + fixed(r.contour_off_px) + " px off the others' hull" : "") + "; worst:\n";
        for (size_t i = 0; i < r.agreements.size() && i < 5; ++i) {
            const SilhouetteAgreement& a = r.agreements[i].agreement;
            out += "  " + r.agreements[i].name + "  IoU " + fixed(a.iou, 4) + ", contour p95 " + fixed(a.contour_p95_px, 1) + " px, p99 " +
                   fixed(a.contour_p99_px, 1) + " px, largest missed blob " + std::to_string(a.largest_missed_blob_px) + " px, thin length lost " +
                   std::to_string(a.thin_length_lost_px) + " px\n";
        }
    }
    bool wrong = false;
    for (const Finding& f : r.findings) {
        wrong |= f.severity != Severity::Note;
        out += std::string(f.severity == Severity::Error ? (f.code == ExitCode::Contradiction  ? "CONTRADICTION"
                                                            : f.code == ExitCode::Undetermined ? "UNDETERMINED"
                                                                                               : "ERROR")
                                                         : name_of(f.severity)) +
               ": " + f.text + "\n";
        if (!f.remedy.empty()) out += "  remedy: " + f.remedy + "\n";
    }
    if (!wrong) {
        out += "nothing wrong was found; looked at:";
        for (size_t i = 0; i < r.looked_at.size(); ++i) out += (i ? ", " : " ") + r.looked_at[i];
        out += "\n";
    }
    return out;
}

}  // namespace vdbcarve
