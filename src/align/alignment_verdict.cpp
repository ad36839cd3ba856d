// SPDX-License-Identifier: Apache-2.0
// What comes of an alignment, and whether it is to be believed.
#include "align/alignment.h"

#include <algorithm>
#include <cmath>

#include "align/align_join.h"
#include "base/statistics.h"
#include "vdbcarve/caps.h"

namespace vdbcarve {
namespace {

constexpr size_t kFewViews = 12;  ///< fewer may leave angles open by degrees without any of the tests noticing

/// Cameras of a later sitting in that sitting's own world, which is where its first ring stands.
void set_sittings(Views& views, const OrbitModel& m, const std::vector<int>& sitting_of) {
    views.sittings.clear();
    for (size_t i = 0; i < views.views.size(); ++i) {
        const int sitting = sitting_of[i];
        if (static_cast<size_t>(sitting) == views.sittings.size()) {
            const auto r = static_cast<size_t>(m.ring_of(i));
            Sitting s;
            s.id = std::to_string(sitting);
            // The first sitting's world is the scene.
            if (sitting > 0) s.scene_from_sitting = m.scene_from_ring(r);
            views.sittings.push_back(s);
        }
        View& v = views.views[i];
        v.sitting = std::to_string(sitting);
        v.camera.camera_from_world = v.camera.camera_from_world * views.sittings[static_cast<size_t>(sitting)].scene_from_sitting;
    }
}

}  // namespace

void Alignment::describe() {
    // Residuals before: of the start that the photographer's word gives.
    const OrbitModel start =
        o_.method == AlignMethod::Refine ? aligner_.given_cameras(world_from_given_) : aligner_.start(c_.orbit, c_.turn, aligner_.starts().front());
    const std::vector<AlignedView> before = judge_.views_of(start, aligner_.coarse());
    for (size_t i = 0; i < before.size(); ++i) out_.aligned[i].residual_before_px = before[i].residual_px;
    const size_t first = silhouettes_.seen().front();
    out_.focal_start_px = start.focal_px(first);

    const OrbitModel& m = c_.fit.model;
    out_.orbit = c_.orbit;
    out_.direction = c_.turn;
    double sum = 0, coherent = 0;
    const std::vector<size_t> judged_by = silhouettes_.good();
    for (size_t i : judged_by) sum += square(out_.aligned[i].residual_px), coherent += out_.aligned[i].coherent;
    const auto good = static_cast<double>(judged_by.size());
    out_.rms_px = std::sqrt(sum / good);
    out_.coherent = coherent / good;
    out_.focal_px = m.focal_px(first);
    // Of the camera above the object's middle; the model's own counts from the axis at any height.
    const Outline outline = outline_of(c_.fit);
    std::vector<double> elevations;
    for (size_t i : silhouettes_.seen()) {
        const Vec3d to = m.camera(i).centre - outline.middle;
        elevations.push_back(std::asin(to.z() / to.norm()) / kRadians);
    }
    out_.elevation_deg = median(elevations);
    out_.principal_x_px = m.camera(first).cx;
    out_.principal_y_px = m.camera(first).cy;
    for (const auto& [turn, other] : best_)
        if (turn != c_.turn) out_.other_direction_px = other.typical_px();
    if (c_.fit.tracks) {
        const std::vector<double> left = rms_of_tracks(c_.fit);
        out_.features = left.size();
        out_.features_rms_px = rms(left);
    }
    out_.views = with_cameras(given_, m);
    for (size_t i = 0; i < given_.views.size(); ++i)
        if (silhouettes_.bad(i)) out_.views.views[i].unused = "its silhouette contradicts the others'";
        else if (o_.method != AlignMethod::Refine && std::find(silhouettes_.seen().begin(), silhouettes_.seen().end(), i) == silhouettes_.seen().end())
            out_.views.views[i].unused = "it has no silhouette: its camera was not found";
    if (!sitting_of_.empty()) set_sittings(out_.views, m, sitting_of_);
    const Similarity& to_ring = world_from_given_;
    if (o_.method == AlignMethod::Refine) {
        out_.views.up = given_.up;
        out_.views.units = given_.units;
        out_.views.floor = given_.floor;
        for (View& v : out_.views.views) {
            Rigid3& pose = v.camera.camera_from_world;
            // Back to where they came from: x = (x' - translation) / scale.
            pose.translation = (pose.translation + pose.rotation * to_ring.translation) / to_ring.scale;
        }
        const std::vector<Camera> cameras = out_.views.cameras();
        const std::vector<double> azimuths = azimuths_rad(cameras, -to_ring.translation / to_ring.scale, up_direction(given_.up, cameras));
        for (size_t i = 0; i < azimuths.size(); ++i) out_.aligned[i].azimuth_deg = azimuths[i] / kRadians;
        out_.direction = turned_rad(azimuths) > 0 ? Turn::Clockwise : Turn::Counterclockwise;  // a camera that walks one way sees it turn the other
    }
    for (size_t p = 0; p < c_.fit.touches.size(); ++p) {
        const Touch& t = c_.fit.touches[p];
        if (std::isnan(t.residual_px) || t.residual_px > 1) continue;
        const Vec3d x = touch_position(m.camera(static_cast<size_t>(c_.fit.points[p].view)), c_.fit.points[p], t.depth);
        const Vec3d back = (x - to_ring.translation) / to_ring.scale;
        out_.touches_world.push_back({static_cast<float>(back.x()), static_cast<float>(back.y()), static_cast<float>(back.z())});
    }
}

void Alignment::judge() {
    // A pixel for an object of 300: what masks of that size are usually off by, unless these are seen to be rougher.
    const double allowed_px = std::max({0.3, silhouettes_.size_px() / 300, 1.5 * out_.mask_noise_px});
    // Cameras for which next to nothing was in the others' frames would fit anything. Of those that do not fit, the other findings are consequences.
    const bool fits = out_.rms_px <= allowed_px && !out_.touches_world.empty();
    if (!fits)
        out_.failures.push_back(
            text_of("the silhouettes do not fit together: contours stay %.2f px (rms) outside the hull of the other views, at most %.2f px may; farthest "
                    "those of %s. %s",
                    out_.rms_px, allowed_px, some_of(worst_views()).c_str(), why_not().c_str()));
    std::vector<size_t> bad = silhouettes_.seen();
    std::erase_if(bad, [&](size_t i) { return !silhouettes_.bad(i); });
    if (!bad.empty())
        out_.warnings.push_back(
            text_of("%s: they contradict the others, so cameras were found without them and they are neither carved with nor coloured from: %s. Remedy: "
                    "look at their masks",
                    counted(bad.size(), "silhouette").c_str(), some_of(names_of(bad)).c_str()));
    if (6 * bad.size() >= silhouettes_.seen().size() && bad.size() > 1)
        out_.failures.push_back(
            text_of("%zu of %zu silhouettes contradict the others: which ones are wrong cannot be told. Remedy: look at the masks; masks of one object, in "
                    "the order in which it turned?",
                    bad.size(), silhouettes_.seen().size()));
    const bool few = silhouettes_.seen().size() < kFewViews;
    if (!out_.angles_observable && o_.method == AlignMethod::Refine)
        out_.warnings.push_back(
            text_of("the silhouettes%s leave each view's angle open by %.1f degrees: the given cameras decide. Remedy: texture, or a marker mat",
                    c_.fit.tracks ? " and the features" : "", out_.azimuth_spread_deg));
    else if (!out_.angles_observable && few && o_.orbit != Orbit::Turntable)
        out_.failures.push_back(
            text_of("%s leave each view's angle open by %.1f degrees; whether the shape depends on them cannot be told by so few. Remedy: two dozen "
                    "photographs, or --orbit turntable, where the object was turned by known steps",
                    counted(silhouettes_.seen().size(), "silhouette").c_str(), out_.azimuth_spread_deg));
    else if (!out_.angles_observable)
        out_.warnings.push_back(
            text_of("the object looks the same from all around (or nearly): its silhouettes leave each view's angle open by %.1f degrees; the %s angles "
                    "are kept. The shape does not depend on them, only the colours do. "
                    "Remedy: texture with --method refine, or a marker mat",
                    out_.azimuth_spread_deg, o_.angles_deg.empty() ? "even" : "given"));
    else if (fits && mirrored_alike(c_)) undecided_direction();
    if (fits && out_.angles_observable && o_.method == AlignMethod::Coherence && c_.orbit != Orbit::Turntable) loose_views();
    if (out_.symmetry > 1)
        out_.warnings.push_back(
            text_of("the object looks nearly the same after 1/%d of a turn: angles that are wrong by that much would not be noticed. The shape hardly "
                    "depends on it, the colours do",
                    out_.symmetry));
    if (few && o_.method == AlignMethod::Coherence && out_.failures.empty())
        out_.warnings.push_back(text_of("%s are few to find cameras by: angles may be off by degrees. Remedy: two dozen photographs",
                                        counted(silhouettes_.seen().size(), "silhouette").c_str()));
    const double ln_focal = c_.fit.model.global(OrbitModel::LnFocal).value;
    if (fits && std::fabs(ln_focal) > kMostLnFocal && o_.method != AlignMethod::Paper)
        out_.failures.push_back(
            text_of("the focal length ran away, to %.0f px (started from %.0f): the silhouettes do not say how strong perspective is. Remedy: --fov",
                    out_.focal_px, out_.focal_start_px));
    else if (fits && aligner_.focal_known() && std::fabs(ln_focal) > 0.2 && o_.method != AlignMethod::Paper)
        out_.warnings.push_back(
            text_of("the focal length given, %.0f px, is not what the silhouettes say: %.0f px is taken. Remedy: check --fov, or the camera file or EXIF "
                    "that says it",
                    out_.focal_start_px, out_.focal_px));
    else if (out_.focal_spread > 0.05)
        out_.warnings.push_back(
            text_of("the focal length is uncertain by %.0f %%: perspective is weak; the shape is hardly affected. Remedy: --fov", 100 * out_.focal_spread));
}

std::vector<std::string> Alignment::worst_views() const {
    std::vector<size_t> order = silhouettes_.seen();
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return out_.aligned[a].residual_px > out_.aligned[b].residual_px; });
    order.resize(std::min<size_t>(3, order.size()));
    return names_of(order);
}

std::vector<std::string> Alignment::names_of(const std::vector<size_t>& views) const {
    std::vector<std::string> out;
    for (size_t i : views) out.push_back(given_.views[i].name);
    return out;
}

std::string Alignment::why_not() const {
    if (o_.method == AlignMethod::Paper) return "The paper's method rarely does better on an unsteady camera. Remedy: --method coherence";
    if (o_.method == AlignMethod::Refine)
        return "The cameras given are too far from the truth, or masks and cameras do not belong together. Remedy: --cameras none --method coherence, "
               "where the views go around the object";
    std::string out =
        "Remedy: is it one of these? Not one turn of the object at even steps (--angles, --arc), several rings or sittings (--rings, --sittings), masks of "
        "different objects, or an orbit too far from what was assumed (--orbit, --fov)";
    if (o_.principal_point_px) out += text_of(", or --principal-point %g,%g", o_.principal_point_px->x(), o_.principal_point_px->y());
    if (o_.direction != Turn::Auto) out += text_of(", or it turned the other way than --direction %s says", name_of(o_.direction));
    return out;
}

void Alignment::loose_views() {
    constexpr double kLoose_deg = 3;
    std::vector<size_t> loose;
    double widest = 0;
    for (size_t i : silhouettes_.seen()) {
        const double spread = out_.aligned[i].azimuth_spread_deg;
        if (silhouettes_.bad(i) || spread < kLoose_deg) continue;
        widest = std::max(widest, spread);
        loose.push_back(i);
    }
    if (!loose.empty())
        out_.failures.push_back(
            text_of("the silhouettes leave the angles of %s open by up to %.0f degrees, and the shape depends on them: %s. Remedy: --orbit turntable, "
                    "where the object was turned by known steps; cameras from elsewhere and --method refine; a marker "
                    "mat",
                    counted(loose.size(), "view").c_str(), widest, some_of(names_of(loose)).c_str()));
}

void Alignment::undecided_direction() {
    out_.failures.push_back(
        text_of("which way the object turned cannot be told from the silhouettes (%.2f px %s, %.2f px %s), and the wrong one gives its mirror image. "
                "Remedy: --direction cw or ccw (seen from above)",
                out_.rms_px, name_of(c_.turn), out_.other_direction_px, name_of(c_.turn == Turn::Clockwise ? Turn::Counterclockwise : Turn::Clockwise)));
    const OrbitModel& m = c_.fit.model;
    for (const auto& [turn, other] : best_)
        if (turn != c_.turn && whole(other))
            for (size_t i = 0; i < given_.views.size(); ++i)
                out_.other_cameras.push_back(other.fit.model.camera(i).camera(m.view(i).width_px, m.view(i).height_px));
}

}  // namespace vdbcarve
