// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/check.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "coarse_hull.h"
#include "mask_consensus.h"
#include "orbit_model.h"
#include "statistics.h"
#include "text.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

std::string text_of(double v, int digits = 2) {
    char text[40];
    std::snprintf(text, sizeof text, "%.*f", digits, v);
    return text;
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
    Vec3d up = Vec3d::Zero();
    std::vector<std::string> away;
    for (size_t i = 0; i < cameras.size(); ++i) {
        const Vec3d to = *target - cameras[i].centre_world();
        distance.push_back(to.norm());
        miss.push_back(to.cross(cameras[i].forward_world()).norm());
        up -= cameras[i].camera_from_world.rotation.row(1).transpose();
        if (to.dot(cameras[i].forward_world()) <= 0) away.push_back(views.views[i].name);
    }
    out.distance_median = median(distance);
    const auto [nearest, farthest] = std::minmax_element(distance.begin(), distance.end());
    out.distance_spread = (*farthest - *nearest) / out.distance_median;
    out.look_at_miss = median(miss) / out.distance_median;
    if (!away.empty()) {
        const bool most = away.size() * 2 > cameras.size();
        (most ? out.errors : out.warnings)
            .push_back(std::to_string(away.size()) + " of " + std::to_string(cameras.size()) + " cameras look away from where the others look (" + some_of(away) + ")" +
                       (most ? ": the camera file's axes are probably another program's (OpenGL cameras in an OpenCV format, or the reverse)" : ": look at their poses"));
    }
    if (up.norm() < 0.1 * static_cast<double>(cameras.size())) {
        out.warnings.push_back("the images' up directions cancel each other: cameras all around, or turned upside down by turns; azimuths are not judged");
        return;
    }
    out.up_world = up.normalized();
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
        out.warnings.push_back("no view within " + text_of(out.largest_gap_deg, 0) + " degrees of azimuth: the hull will bulge there. Remedy: views from that side");
    if (out.elevation_max_deg - out.elevation_min_deg < 5)
        out.warnings.push_back("all views are at one height (" + text_of(out.elevation_min_deg, 0) + " to " + text_of(out.elevation_max_deg, 0) +
                               " degrees): top and bottom are bounded by cones only. A second ring from above helps more than twice as many views");
    if (out.look_at_miss > 0.2)
        out.warnings.push_back("the optical axes miss their common point by " + text_of(100 * out.look_at_miss, 0) + " % of the distance: views of different scenes, or wrong poses?");
}

void check_masks(const CheckOptions& options, const Views& views, CheckResult& out, Progress& progress) {
    Masks masks = make_masks(views, options.views.scene, options.mask, std::vector<std::filesystem::path>(views.views.size()), progress);
    const std::vector<Camera> all = views.cameras();
    std::vector<std::string> view_names, used_names;
    std::vector<MaskView> seen, used;
    std::vector<Camera> cameras;
    for (size_t i = 0; i < views.views.size(); ++i) {
        view_names.push_back(views.views[i].name);
        seen.push_back(views.views[i].unused.empty() ? view_of(masks.masks[i]) : MaskView());  // as reconstruct does
        if (seen.back().coverage.empty()) continue;
        used_names.push_back(view_names.back());
        cameras.push_back(all[i]);
        used.push_back(seen.back());
    }
    Mesh mesh;
    try {
        mesh = extract_mesh(*coarse_hull(view_names, all, seen, options.resolution, options.min_seen, progress), {}, progress);
    } catch (const ContradictionError& e) {
        out.errors.push_back(e.what());
        return;
    }
    std::vector<std::string> broken;
    for (const size_t i : find_broken_masks(view_names, all, seen, progress)) broken.push_back(view_names[i]);
    if (!broken.empty()) out.warnings.push_back(counted(broken.size(), "mask") + " against all others: " + some_of(broken) + ". Remedy: mend or delete what is wrong, or --repair-masks");
    out.agreements.resize(used.size());
    tbb::parallel_for(size_t{0}, used.size(), [&](size_t i) { out.agreements[i] = {used_names[i], compare_silhouettes(silhouette_of(mesh, cameras[i]), used[i])}; });
    std::vector<double> ious;
    for (const ViewCheck& v : out.agreements) ious.push_back(v.agreement.iou);
    out.median_iou = median(ious);
    std::stable_sort(out.agreements.begin(), out.agreements.end(), [](const ViewCheck& a, const ViewCheck& b) { return a.agreement.iou < b.agreement.iou; });
    if (out.median_iou < 0.9)
        out.errors.push_back("the hull of all views covers its own silhouettes poorly (median IoU " + text_of(out.median_iou, 3) +
                             "): cameras and masks do not fit together. Remedy: check poses, focal length and which mask belongs to which view");
    std::vector<std::string> weak;
    for (const ViewCheck& v : out.agreements)
        if (v.agreement.iou < std::min(0.95, out.median_iou - 0.02)) weak.push_back(v.name + " (IoU " + text_of(v.agreement.iou, 3) + ")");
    if (!weak.empty() && out.median_iou >= 0.9)
        out.warnings.push_back("views whose silhouettes the others contradict: " + some_of(weak) + ". One bad mask also eats into its neighbours' agreement; mend the worst first");
    std::vector<std::string> thin;
    for (const ViewCheck& v : out.agreements)
        if (v.agreement.thin_length_lost_px > 20) thin.push_back(v.name + " (" + std::to_string(v.agreement.thin_length_lost_px) + " px)");
    if (!thin.empty()) out.warnings.push_back("thin parts of these masks are carved away by other views: " + some_of(thin) + ". Remedy: mend the masks there, or --max-misses 1");
}

}  // namespace

CheckResult check(const CheckOptions& options, Progress& progress) {
    openvdb::initialize();
    CheckResult out;
    ViewsOptions vo = options.views;
    vo.cameras_only = !options.masks;
    const Views views = load_views(vo, progress);
    out.views = views.views.size();
    if (options.cameras) check_cameras(views, out);
    if (options.masks && out.errors.empty()) check_masks(options, views, out, progress);
    for (const std::string& w : progress.warnings()) out.warnings.push_back(w);
    for (const std::string& w : views.unverified) out.warnings.push_back("UNVERIFIED cameras: " + w);
    std::vector<std::string> unused;
    for (const View& v : views.views)
        if (!v.unused.empty()) unused.push_back(v.name + " (" + v.unused + ")");
    if (!unused.empty()) out.warnings.push_back(counted(unused.size(), "view") + " not used, as the camera file says: " + some_of(unused));
    if (!views.unverified.empty()) out.exit_code = ExitCode::Undetermined;
    if (!out.errors.empty()) out.exit_code = ExitCode::Contradiction;
    return out;
}

std::string check_json(const CheckResult& r) {
    nlohmann::ordered_json j{{"views", r.views},
                             {"cameras",
                              {{"look_at", {r.look_at_world.x(), r.look_at_world.y(), r.look_at_world.z()}},
                               {"look_at_miss", r.look_at_miss},
                               {"up", {r.up_world.x(), r.up_world.y(), r.up_world.z()}},
                               {"distance_median", r.distance_median},
                               {"distance_spread", r.distance_spread},
                               {"elevation_deg", {r.elevation_min_deg, r.elevation_max_deg}},
                               {"largest_gap_deg", r.largest_gap_deg},
                               {"fov_deg", r.fov_deg}}},
                             {"median_iou", r.median_iou},
                             {"agreement", nlohmann::json::array()},
                             {"errors", r.errors},
                             {"warnings", r.warnings},
                             {"exit_code", static_cast<int>(r.exit_code)}};
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
        out += "; they look at (" + text_of(r.look_at_world.x(), 3) + ", " + text_of(r.look_at_world.y(), 3) + ", " + text_of(r.look_at_world.z(), 3) + "), missing it by " +
               text_of(100 * r.look_at_miss, 1) + " % of their distance\n";
        out += "distance " + text_of(r.distance_median, 3) + " (spread " + text_of(100 * r.distance_spread, 0) + " %), horizontal field of view " + text_of(r.fov_deg, 1) + " degrees\n";
        if (r.up_world.norm() > 0)
            out += "up (" + text_of(r.up_world.x()) + ", " + text_of(r.up_world.y()) + ", " + text_of(r.up_world.z()) + "), elevations " + text_of(r.elevation_min_deg, 0) + " to " +
                   text_of(r.elevation_max_deg, 0) + " degrees, largest gap between azimuths " + text_of(r.largest_gap_deg, 0) + " degrees\n";
    } else {
        out += "\n";
    }
    if (!r.agreements.empty()) {
        out += "silhouettes of the hull against the masks: median IoU " + text_of(r.median_iou, 4) + "; worst:\n";
        for (size_t i = 0; i < r.agreements.size() && i < 5; ++i) {
            const SilhouetteAgreement& a = r.agreements[i].agreement;
            out += "  " + r.agreements[i].name + "  IoU " + text_of(a.iou, 4) + ", contour p95 " + text_of(a.contour_p95_px, 1) + " px, p99 " + text_of(a.contour_p99_px, 1) + " px, largest missed blob " +
                   std::to_string(a.largest_missed_blob_px) + " px, thin length lost " + std::to_string(a.thin_length_lost_px) + " px\n";
        }
    }
    for (const std::string& e : r.errors) out += "CONTRADICTION: " + e + "\n";
    for (const std::string& w : r.warnings) out += "warning: " + w + "\n";
    if (r.errors.empty() && r.warnings.empty()) out += "nothing wrong was found\n";
    return out;
}

}  // namespace vdbcarve
