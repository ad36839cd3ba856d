// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/align.h"

#include <openvdb/tools/RayIntersector.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <random>

#include "align_mat.h"
#include "coarse_hull.h"
#include "coherence_fit.h"
#include "feature_tracks.h"
#include "paper/align_paper.h"
#include "statistics.h"
#include "text.h"
#include "view_called.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/render.h"

namespace vdbcarve {

namespace {

constexpr double kRadians = std::numbers::pi / 180;
constexpr double kMostLnFocal = 1.5;  ///< a focal length 4.5 times its start's is no lens but a flight from perspective

double square(double x) { return x * x; }

/// Signed distance to a silhouette at a place of its image; `scale`: pixels a side of the field's samples.
double distance_px(const kernel::FieldView& field, int scale, double x_px, double y_px) {
    return kernel::interpolate(kernel::fetch_patch(field, static_cast<float>(x_px / scale), static_cast<float>(y_px / scale))) * scale / kernel::kFieldUnits;
}

/// A way to explain the views, and how well it does.
struct Candidate {
    CoherenceFit fit;
    Orbit orbit = Orbit::HandHeld;
    Turn turn = Turn::Counterclockwise;
    int misses = 0;  ///< silhouettes that may be wrong
    double rms_px() const { return fit.rms_px(); }
    double typical_px() const { return fit.typical_px(); }
};

/// Aligns views that all stand in one ring.
class RingAligner {
  public:
    RingAligner(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress) : given_(views), o_(options), progress_(progress), silhouettes_(masks), n_(masks.size()) {
        if (silhouettes_.seen().size() < 4) throw InputError("align: " + std::to_string(silhouettes_.seen().size()) + " views with a silhouette; at least 4 are needed, a dozen make sense");
        mask_noise_px_ = find_mask_noise_px();
    }

    Silhouettes& silhouettes() { return silhouettes_; }

    // ------------------------------------------------------------------------------------- passes

    CoherencePass coarse() const {
        const int scale = scale_for(110);
        return {scale, 40, std::max(6.0, silhouettes_.size_px() / 30), 20, 2.0, 3e-3, 0, 2.0 * scale, 2.0 * scale, 1};
    }
    CoherencePass middle() const {
        const int scale = scale_for(250);
        return {scale, 80, std::max(3.0, silhouettes_.size_px() / 100), 25, 1.0, 1e-3, 0.5 * scale, 1.0 * scale, 1.5 * scale, 8};
    }
    /// Weighs residuals by what they turned out to be.
    CoherencePass fine(double rms_px) const {
        return {scale_for(700), static_cast<size_t>(o_.points), std::max(1.0, 2 * rms_px), 25, std::clamp(1.5 * rms_px, 0.1, 3.0), 1e-3, 0.5, 0.75, 1.0, 8};
    }
    /// A coarse pass that ends below this has found its way.
    double good_coarse_px() const { return 0.15 * coarse().scale + mask_noise_px_; }
    double mask_noise_px() const { return mask_noise_px_; }

    // ------------------------------------------------------------------------------------- models

    /// Nominal views, the object turning counterclockwise (cameras clockwise) or the other way.
    std::vector<OrbitView> nominal(Turn direction, double arc_deg) const {
        std::vector<OrbitView> out(n_);
        const double sign = direction == Turn::Counterclockwise ? -1 : 1;
        const bool closed = std::fabs(std::remainder(arc_deg, 360)) < 1e-9;
        for (size_t i = 0; i < n_; ++i) {
            OrbitView& v = out[i];
            const Intrinsics& k = given_.views[i].camera.intrinsics;
            v.turn = static_cast<double>(i) / static_cast<double>(closed ? n_ : n_ - 1);
            v.azimuth_rad = sign * kRadians * (o_.angles_deg.empty() ? arc_deg * v.turn : o_.angles_deg[i] - o_.angles_deg[0]);
            v.width_px = silhouettes_.width_px(i) ? silhouettes_.width_px(i) : k.width_px;
            v.height_px = silhouettes_.height_px(i) ? silhouettes_.height_px(i) : k.height_px;
            const bool known = k.fx > 0;
            v.aspect = known ? k.fy / k.fx : 1;
            v.focal_px = o_.fov_deg > 0 ? 0.5 * v.width_px / std::tan(0.5 * o_.fov_deg * kRadians) : known ? k.fx : kStartFocal * std::max(v.width_px, v.height_px);
            v.cx = o_.principal_point_px ? o_.principal_point_px->x() : known ? k.cx : 0.5 * v.width_px;
            v.cy = o_.principal_point_px ? o_.principal_point_px->y() : known ? k.cy : 0.5 * v.height_px;
        }
        return out;
    }
    static constexpr double kStartFocal = 1.4;  ///< of the longer side: 39 degrees, the middle of what phones and cameras have at objects

    bool focal_known() const { return o_.fov_deg > 0 || given_.views[silhouettes_.seen().front()].camera.intrinsics.fx > 0; }
    double focal_sigma() const { return focal_known() ? 0.15 : 0.6; }

    struct Start {
        double arc_deg, ln_focal, elevation_rad;
        bool uneven;  ///< the speed may change smoothly over the turn
    };

    OrbitModel start(Orbit orbit, Turn direction, const Start& from) const {
        OrbitModel m(nominal(direction, from.arc_deg), 1);
        m.global(OrbitModel::LnFocal).value = from.ln_focal;
        m.ring(0, OrbitModel::Elevation).value = from.elevation_rad;
        aim(m, orbit);
        free_parts(m, orbit);
        if (from.uneven)
            for (int h = 0; h < OrbitModel::kHarmonics; ++h) m.harmonic(h).release(0, 20 * kRadians);
        return m;
    }

    /// Pan and tilt that bring the origin to the silhouettes' middles: of each where the camera is carried, of all together where it is fixed.
    void aim(OrbitModel& m, Orbit orbit) const {
        std::vector<double> pan, tilt;
        for (size_t i : silhouettes_.seen()) {
            const OrbitCamera c = m.camera(i);
            pan.push_back(std::atan2(silhouettes_.extent(i).cx - c.cx, c.fx));
            tilt.push_back(-std::atan2(silhouettes_.extent(i).cy - c.cy, c.fx * c.aspect));
            if (orbit == Orbit::HandHeld) m.of(i, OrbitModel::Pan).value = pan.back(), m.of(i, OrbitModel::Tilt).value = tilt.back();
        }
        if (orbit == Orbit::HandHeld) return;
        m.ring(0, OrbitModel::RingPan).value = median(pan);
        m.ring(0, OrbitModel::RingTilt).value = median(tilt);
    }

    /// What may move, with priors: a hand's unsteadiness, a turntable's unevenness, a lens's tolerance. Priors of aims are around where they are.
    void free_parts(OrbitModel& m, Orbit orbit) const {
        m.global(OrbitModel::LnFocal).release(0, focal_sigma());
        const size_t first = silhouettes_.seen().front();
        const double diagonal = std::hypot(m.view(first).width_px, m.view(first).height_px), width_rad = m.view(first).width_px / m.focal_px(first);
        if (!o_.principal_point_px) {
            m.global(OrbitModel::CentreX).release(0, 0.01 * diagonal);
            m.global(OrbitModel::CentreY).release(0, 0.01 * diagonal);
        }
        if (orbit != Orbit::Turntable && o_.angles_deg.empty()) m.global(OrbitModel::LnArc).release(0, 0.1);
        for (size_t r = 0; r < m.rings(); ++r) {
            m.ring(r, OrbitModel::Elevation).release(0.2, 0.4);
            if (orbit != Orbit::HandHeld) {
                for (const auto part : {OrbitModel::RingPan, OrbitModel::RingTilt}) m.ring(r, part).release(m.ring(r, part).value, 0.3 * width_rad);
                m.ring(r, OrbitModel::RingRoll).release(0, 6 * kRadians);
            }
            if (r > 0) free_ring(m, r);
        }
        for (size_t i : silhouettes_.seen()) {
            if (orbit != Orbit::Turntable) m.of(i, OrbitModel::Azimuth).release(0, 9 * kRadians);
            if (orbit == Orbit::HandHeld) {
                for (const auto part : {OrbitModel::Pan, OrbitModel::Tilt}) m.of(i, part).release(m.of(i, part).value, 0.09 * width_rad);
                m.of(i, OrbitModel::Roll).release(0, 6 * kRadians);
                m.of(i, OrbitModel::LnDistance).release(0, 0.03);
                m.of(i, OrbitModel::Height).release(0, 0.03);
            }
            if (o_.focal_varies) m.of(i, OrbitModel::ViewLnFocal).release(0, 0.015);
            if (o_.centre_varies)
                for (const auto part : {OrbitModel::ViewCentreX, OrbitModel::ViewCentreY}) m.of(i, part).release(0, 0.01 * diagonal);
        }
    }

    /// Where a ring lies to the first: priors so wide that they only keep the numbers finite.
    static void free_ring(OrbitModel& m, size_t r) {
        m.ring(r, OrbitModel::RingAzimuth).release(m.ring(r, OrbitModel::RingAzimuth).value, 1);
        m.ring(r, OrbitModel::RingDistance).release(m.ring(r, OrbitModel::RingDistance).value, 0.2);
        for (int a = 0; a < 3; ++a) {
            Parameter& turn = m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingTurn + a));
            Parameter& shift = m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingShift + a));
            turn.release(turn.value, 0.3);
            shift.release(shift.value, 0.1);
        }
    }

    /// The same cameras on a higher rung.
    Candidate climbed(const Candidate& c, Orbit orbit) const {
        Candidate out = c;
        out.orbit = orbit;
        OrbitModel& m = out.fit.model;
        if (orbit == Orbit::HandHeld)
            for (const auto& [shared, own] : {std::pair{OrbitModel::RingPan, OrbitModel::Pan}, {OrbitModel::RingTilt, OrbitModel::Tilt}, {OrbitModel::RingRoll, OrbitModel::Roll}}) {
                for (size_t i = 0; i < n_; ++i) m.of(i, own).value += m.ring(0, shared).value;
                m.ring(0, shared).hold(0);
            }
        free_parts(m, orbit);
        return out;
    }

    /// The views' own cameras, in a world where the object is near the origin and cameras at distance 1; what they may be wrong by.
    OrbitModel given_cameras(const Similarity& world_from_given) const {
        std::vector<OrbitView> views = nominal(Turn::Clockwise, 360);
        const std::vector<Camera> cameras = given_.cameras();
        for (size_t i = 0; i < n_; ++i) {
            Rigid3 pose = cameras[i].camera_from_world;
            pose.translation = world_from_given.scale * (cameras[i].camera_from_world * (-world_from_given.translation / world_from_given.scale));
            views[i].camera_from_world = pose;
        }
        OrbitModel m(std::move(views), 1);
        const size_t first = silhouettes_.seen().front();
        const double diagonal = std::hypot(m.view(first).width_px, m.view(first).height_px);
        m.global(OrbitModel::LnFocal).release(0, 0.1);
        for (const auto which : {OrbitModel::CentreX, OrbitModel::CentreY})
            if (!o_.principal_point_px) m.global(which).release(0, 0.005 * diagonal);
        for (size_t i : silhouettes_.seen()) {
            for (const auto part : {OrbitModel::Pan, OrbitModel::Tilt, OrbitModel::Roll}) m.of(i, part).release(0, 3 * kRadians);
            for (const auto part : {OrbitModel::Azimuth, OrbitModel::LnDistance, OrbitModel::Height}) m.of(i, part).release(0, 0.05);
            if (o_.focal_varies) m.of(i, OrbitModel::ViewLnFocal).release(0, 0.015);
        }
        return m;
    }

    // ------------------------------------------------------------------------------------- search

    /// Where to start from, the likeliest first; what comes later is tried where these lead nowhere.
    std::vector<Start> starts() const {
        std::vector<Start> out;
        const std::vector<double> focals = focal_known() ? std::vector<double>{0} : std::vector<double>{0, -0.7, 0.6};
        for (const double elevation : {8.0, 30.0, 52.0})
            for (const double focal : focals) out.push_back({o_.arc_deg, focal, elevation * kRadians, false});
        if (!o_.angles_deg.empty()) return out;
        out.push_back({o_.arc_deg, 0, 12 * kRadians, true});
        if (!o_.arc_known)
            for (const double arc : {330.0, 300.0, 390.0, 270.0, 420.0, 240.0, 450.0, 210.0, 480.0, 180.0, 510.0, 540.0, 150.0})
                if (std::fabs(arc - o_.arc_deg) > 5) out.push_back({arc, 0, 12 * kRadians, false});
        return out;
    }

    void fit(Candidate& c, const CoherencePass& pass, uint64_t seed) {
        c.fit.points = silhouettes_.contour(pass.scale, pass.points, seed);
        refine(c.fit, silhouettes_, pass, progress_);
    }

    std::vector<Turn> turns() const {
        if (o_.direction != Turn::Auto) return {o_.direction};
        return {Turn::Counterclockwise, Turn::Clockwise};
    }

    using Best = std::map<Turn, Candidate>;
    static bool settled(const Best& best, double good_px) {
        std::vector<double> found;
        for (const auto& [turn, c] : best) found.push_back(c.typical_px());
        std::sort(found.begin(), found.end());
        return !found.empty() && found.front() < good_px && (found.size() == 1 || found.back() > 2 * found.front() + 0.5 * good_px);
    }
    static Candidate& lead(Best& best) {
        return std::min_element(best.begin(), best.end(), [](const auto& a, const auto& b) { return a.second.typical_px() < b.second.typical_px(); })->second;
    }

    /// Tries a range of starts in each direction until one has clearly found its way, then in that direction until two have found the same.
    /// Returns how many did.
    int search(Orbit orbit, const std::vector<Start>& from, Best& best, int misses = 0) {
        std::vector<std::pair<Turn, double>> found;
        const auto agreeing = [&] {
            const Candidate& c = lead(best);
            return static_cast<int>(std::count_if(found.begin(), found.end(), [&](const auto& f) { return f.first == c.turn && f.second < 1.2 * c.typical_px() + 0.01 * coarse().scale; }));
        };
        for (const Start& s : from) {
            const bool decided = settled(best, good_coarse_px());
            if (decided && agreeing() >= 2) break;
            for (Turn turn : turns()) {
                if (decided && turn != lead(best).turn) continue;
                Candidate c{{}, orbit, turn, misses};
                c.fit.model = start(orbit, turn, s);
                CoherencePass pass = coarse();
                pass.misses = misses;
                if (!best.empty()) pass.give_up_px = 10 * lead(best).rms_px() + good_coarse_px();
                fit(c, pass, 1);
                trace("%s %s%s arc %.0f f x%.2f e %.0f%s: %.3f px, f x%.3f", name_of(orbit), name_of(turn), misses ? " robust" : "", s.arc_deg, std::exp(s.ln_focal), s.elevation_rad / kRadians, s.uneven ? " uneven" : "", c.typical_px(),
                      std::exp(c.fit.model.global(OrbitModel::LnFocal).value));
                found.emplace_back(turn, c.typical_px());
                const auto known = best.find(turn);
                if (known == best.end() || c.typical_px() < known->second.typical_px()) best[turn] = std::move(c);
            }
        }
        return agreeing();
    }

    void polish(Candidate& c) {
        const auto robust = [&](CoherencePass pass) {
            pass.misses = c.misses;
            return pass;
        };
        // Where the speed changed smoothly is now known well enough for single views to take over.
        fit(c, robust(middle()), 2);
        const double after_middle = c.rms_px();
        fit(c, robust(fine(c.misses ? c.typical_px() : after_middle)), 3);
        trim(c.fit);
        const double rms = c.rms_px();
        if (rms < 0.5 * after_middle) refine(c.fit, silhouettes_, robust(fine(rms)), progress_);
        trace("%s %s polished: %.4f px after %.4f, f %.1f", name_of(c.orbit), name_of(c.turn), c.rms_px(), after_middle, c.fit.model.focal_px(silhouettes_.seen().front()));
    }

    /// Optimises anew after silhouettes were taken out or in.
    void settle(Candidate& c) {
        CoherencePass pass = coarse();
        pass.misses = c.misses;
        fit(c, pass, 6);
        polish(c);
        place_bad(c);
    }

    /// Cameras of bad silhouettes, from what of their contours is right: they move alone.
    void place_bad(Candidate& c) {
        CoherencePass pass = middle();
        Candidate alone = c;
        alone.fit.points = silhouettes_.contour(pass.scale, 2 * pass.points, 7, 0, Silhouettes::Which::Bad);
        if (alone.fit.points.empty()) return;
        OrbitModel& m = alone.fit.model;
        for (const size_t p : m.free()) m.at(p).sigma = 0;
        for (size_t i : silhouettes_.seen())
            if (silhouettes_.bad(i))
                for (int part = 0; part < OrbitModel::kViewParts; ++part) m.of(i, static_cast<OrbitModel::ViewPart>(part)).sigma = c.fit.model.of(i, static_cast<OrbitModel::ViewPart>(part)).sigma;
        if (m.free().empty()) return;
        refine(alone.fit, silhouettes_, pass, progress_);
        for (size_t i : silhouettes_.seen())
            if (silhouettes_.bad(i))
                for (int part = 0; part < OrbitModel::kViewParts; ++part) c.fit.model.of(i, static_cast<OrbitModel::ViewPart>(part)).value = m.of(i, static_cast<OrbitModel::ViewPart>(part)).value;
    }

    /// Leaves out points that fit so badly that their silhouette, not the cameras, must be wrong.
    static void trim(CoherenceFit& f) {
        std::vector<double> positive;
        for (const Touch& t : f.touches)
            if (t.residual_px > 0) positive.push_back(t.residual_px);
        const double limit = std::max(1.0, 6 * median(positive));
        std::vector<ContourPoint> points;
        std::vector<Touch> touches;
        for (size_t p = 0; p < f.points.size(); ++p)
            if (!(f.touches[p].residual_px > limit)) points.push_back(f.points[p]), touches.push_back(f.touches[p]);
        f.points = std::move(points);
        f.touches = std::move(touches);
    }

    /// What a rung makes of contour sectors that it was not fitted to: errors of a mask are alike along its contour, so that freedom which only follows
    /// them gains nothing there.
    double held_out_px(const Candidate& c) {
        Candidate half = c;
        CoherencePass pass = fine(c.rms_px());
        pass.points = std::min<size_t>(pass.points, 100);
        pass.iterations = 8;
        half.fit.points = silhouettes_.contour(pass.scale, pass.points, 11, 1);
        refine(half.fit, silhouettes_, pass, progress_);
        CoherenceFit rest = half.fit;
        rest.points = silhouettes_.contour(pass.scale, pass.points, 12, 2);
        rest.touches = touches_of(silhouettes_, rest.model, rest.points, pass);
        trim(rest);
        return rest.rms_px();
    }

    /// So many silhouettes may be wrong and the rest still bounds the object from all sides.
    int robust_misses() const { return n_ < 14 ? 0 : static_cast<int>(std::lround(0.08 * static_cast<double>(n_))); }

    /// The best explanation in each direction; the rungs that were tried.
    Best run(std::vector<AlignRung>& rungs) {
        const std::vector<Start> all = starts();
        Best table, hand;
        const bool any = o_.orbit == Orbit::Auto;
        if (any || o_.orbit != Orbit::HandHeld) agreeing_ = search(Orbit::Turntable, {all.front()}, table);
        if (any || o_.orbit == Orbit::HandHeld) {
            if (any && settled(table, good_coarse_px())) {
                Candidate up = climbed(lead(table), Orbit::HandHeld);
                fit(up, coarse(), 1);
                hand[up.turn] = std::move(up);
            } else {
                agreeing_ = search(Orbit::HandHeld, {all.front()}, hand);
                if (!settled(hand, good_coarse_px()) && robust_misses() > 0) {
                    // A few silhouettes may be wrong: does it work without listening to all of them?
                    Best robust;
                    const int agree = search(Orbit::HandHeld, {all.begin(), all.begin() + std::min<long>(3, static_cast<long>(all.size()))}, robust, robust_misses());
                    if (settled(robust, good_coarse_px())) hand = robust, agreeing_ = agree;
                }
                if (lead(hand).misses == 0 && (!settled(hand, good_coarse_px()) || agreeing_ < 2)) agreeing_ += search(Orbit::HandHeld, {all.begin() + 1, all.end()}, hand);
            }
        }
        progress_.step(3);
        if (!table.empty() && !settled(table, good_coarse_px()) && (hand.empty() || !settled(hand, good_coarse_px()))) agreeing_ = search(Orbit::Turntable, {all.begin() + 1, all.end()}, table);
        progress_.step(1);

        // The rungs, each from the one below or from its own search, whichever is better.
        const auto unknowns = [](const Candidate& c) { return static_cast<int>(c.fit.model.free().size()); };
        std::vector<Candidate> ladder;
        const double best_coarse = std::min(table.empty() ? INFINITY : lead(table).typical_px(), hand.empty() ? INFINITY : lead(hand).typical_px());
        const auto in_the_race = [&](double rms) { return rms < 5 * best_coarse + 0.1 * coarse().scale; };
        if (!table.empty()) {
            Candidate& c = lead(table);
            if (o_.orbit == Orbit::Turntable || in_the_race(c.typical_px())) {
                if (o_.orbit != Orbit::FixedCamera) {
                    polish(c);
                    ladder.push_back(c);
                }
            } else {
                rungs.push_back({c.orbit, c.turn, c.rms_px(), 0, unknowns(c)});
            }
            if (any || o_.orbit == Orbit::FixedCamera) {
                Best fixed;
                for (auto& [turn, t] : table) {
                    if (any && turn != c.turn) continue;
                    fixed[turn] = climbed(t, Orbit::FixedCamera);
                    fit(fixed[turn], coarse(), 1);
                }
                if (o_.orbit == Orbit::FixedCamera || in_the_race(lead(fixed).typical_px())) {
                    polish(lead(fixed));
                    ladder.push_back(lead(fixed));
                }
                if (o_.orbit == Orbit::FixedCamera) table = fixed;
            }
        }
        if (!hand.empty()) {
            polish(lead(hand));
            ladder.push_back(lead(hand));
        }
        progress_.step(3);
        size_t chosen = 0;
        std::vector<double> held_out(ladder.size(), 0);
        if (ladder.size() > 1) {
            for (size_t r = 0; r < ladder.size(); ++r) held_out[r] = held_out_px(ladder[r]);
            // More unknowns have to earn their place, by more than the scatter of such comparisons.
            for (size_t r = 1; r < ladder.size(); ++r)
                if (held_out[r] < 0.85 * held_out[chosen] - 0.005) chosen = r;
        }
        for (size_t r = 0; r < ladder.size(); ++r) {
            rungs.push_back({ladder[r].orbit, ladder[r].turn, ladder[r].rms_px(), held_out[r], unknowns(ladder[r])});
            trace("rung %s: %.4f px, held out %.4f", name_of(ladder[r].orbit), ladder[r].rms_px(), held_out[r]);
        }
        Best out;
        const Candidate& winner = ladder[chosen];
        out[winner.turn] = winner;
        // The other direction gets as fair a chance as it has earned.
        for (Best* tried : {&hand, &table})
            for (auto& [turn, c] : *tried)
                if (turn != winner.turn && !out.count(turn) && (c.orbit == winner.orbit || hand.empty() || table.empty())) {
                    if (c.typical_px() < 4 * best_coarse + good_coarse_px()) polish(c);
                    out[turn] = c;
                }
        if (o_.direction == Turn::Auto && out.size() == 1) {
            const Turn other = winner.turn == Turn::Clockwise ? Turn::Counterclockwise : Turn::Clockwise;
            Candidate c{{}, winner.orbit, other};
            c.fit.model = start(winner.orbit, other, {o_.arc_deg, winner.fit.model.global(OrbitModel::LnFocal).value, winner.fit.model.ring(0, OrbitModel::Elevation).value, false});
            fit(c, coarse(), 1);
            if (c.typical_px() < 4 * best_coarse + good_coarse_px()) polish(c);
            out[other] = c;
        }
        progress_.step(1);
        return out;
    }

    /// Said with --verbose.
    template <class... Arguments>
    void trace(const char* format, Arguments... arguments) const {
        progress_.detail(text_of(format, arguments...));
    }

  private:
    /// Standard deviation of the contours around their own smooth course, pixels.
    double find_mask_noise_px() {
        const int smooth = 6;
        std::vector<double> distances;
        const std::vector<ContourPoint> points = silhouettes_.contour(1, 200, 31);
        const std::vector<CoherenceView> views = silhouettes_.at_scale(smooth);
        for (const ContourPoint& p : points) {
            const CoherenceView& v = views[static_cast<size_t>(p.view)];
            if (!v.field) continue;
            distances.push_back(std::fabs(distance_px(v.field->silhouette.view(), smooth, p.x_px, p.y_px)));
        }
        return 1.4826 * median(distances);
    }

    int scale_for(double samples) const { return std::max(1, static_cast<int>(std::lround(silhouettes_.size_px() / samples))); }

    const Views& given_;
    const AlignOptions& o_;
    Progress& progress_;
    Silhouettes silhouettes_;
    size_t n_;
    double mask_noise_px_ = 0;
    int agreeing_ = 0;  ///< starts that led to the same cameras
};

void check_options(const AlignOptions& o, size_t views, size_t masks) {
    std::string wrong;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) wrong += (wrong.empty() ? "" : "; ") + what;
    };
    need(masks == views || o.method == AlignMethod::Mat, "align: as many masks as views are needed");
    need((o.method == AlignMethod::Mat) == o.mat.has_value(), o.mat ? "--mat is of --method mat" : "--method mat: which mat? Remedy: --mat FILE, the layout that was written beside the print");
    need(o.angles_deg.empty() || o.angles_deg.size() == views, "--angles: " + std::to_string(o.angles_deg.size()) + " angles for " + std::to_string(views) + " views");
    for (const auto& [name, counts] : {std::pair{"--rings", &o.rings}, {"--sittings", &o.sittings}}) {
        int sum = 0;
        for (int c : *counts) {
            need(c >= 4, std::string(name) + ": " + std::to_string(c) + " views together, at least 4 are needed");
            sum += c;
        }
        need(counts->empty() || static_cast<size_t>(sum) == views, std::string(name) + ": " + std::to_string(sum) + " views, the scene has " + std::to_string(views));
    }
    need(o.arc_deg >= 20 && o.arc_deg <= 3600, text_of("--arc: %g degrees, must be 20..3600", o.arc_deg));
    need(o.fov_deg >= 0 && o.fov_deg < 170, text_of("--fov: %g degrees, must be within 0..170", o.fov_deg));
    need(o.points >= 10 && o.points <= 5000, text_of("align: %d contour points a view, must be 10..5000", o.points));
    need(o.restarts >= 0 && o.restarts <= 20, text_of("--restarts: %d, must be 0..20", o.restarts));
    const bool from_motion = o.method == AlignMethod::Coherence || o.method == AlignMethod::Paper;
    need(from_motion || (o.orbit == Orbit::Auto && o.direction == Turn::Auto && o.angles_deg.empty() && o.rings.empty() && o.sittings.empty()),
         text_of("--method %s: --orbit, --direction, --angles, --rings and --sittings are of --method coherence", name_of(o.method)));
    need(o.method != AlignMethod::Paper || (o.orbit == Orbit::Auto && o.rings.empty() && o.sittings.empty()), "--method paper knows one turn of an object before a camera that stands: --orbit, --rings and --sittings are of --method coherence");
    need(from_motion || o.arc_deg == 360, "--arc is of --method coherence and paper");
    need(o.method == AlignMethod::Coherence || o.method == AlignMethod::Refine || !(o.focal_varies || o.centre_varies), text_of("--method %s knows one focal length and one principal point: --focal-varies and --centre-varies are of --method coherence", name_of(o.method)));
    need(o.method != AlignMethod::Paper || o.fov_deg == 0, "--method paper finds the field of view by itself: --fov is of --method coherence");
    need(o.method == AlignMethod::Paper || (o.paper_views[0].empty() && o.paper_views[1].empty()), "--paper-views is of --method paper");
    const int lengths = (o.known_distance != 0) + (o.known_height != 0) + o.known_length.has_value();
    need(o.known_distance >= 0 && o.known_height >= 0 && lengths <= 1 && (!o.known_length || (o.known_length->length > 0 && o.known_length->from_px.allFinite() && o.known_length->to_px.allFinite())), "give one of --known-distance, --known-height and --known-length, > 0");
    need(o.method != AlignMethod::Mat || lengths == 0, "--method mat: the mat gives the scale; --known-... would give another");
    if (!wrong.empty()) throw UsageError(wrong);
}

/// Everything that is known about an alignment, once cameras are found.
class Judge {
  public:
    Judge(RingAligner& aligner, const Views& views, const AlignOptions& options, Progress& progress) : aligner_(aligner), s_(aligner.silhouettes()), given_(views), o_(options), progress_(progress) {}

    /// Residuals by view, of points drawn anew.
    std::vector<AlignedView> views_of(const OrbitModel& model, const CoherencePass& pass) {
        const std::vector<ContourPoint> points = s_.contour(pass.scale, pass.points, 21, 0, Silhouettes::Which::All);
        const std::vector<Touch> touches = touches_of(s_, model, points, pass);
        const std::vector<CoherenceView>& views = s_.at_scale(pass.scale);
        const std::vector<OrbitCamera> cameras = model.cameras();
        const size_t n = s_.count();
        std::vector<AlignedView> out(n);
        std::vector<std::vector<double>> residuals(n);
        std::vector<double> dissents(n, 0);
        for (size_t p = 0; p < points.size(); ++p) {
            const double r = touches[p].residual_px;
            if (std::isnan(r)) continue;
            residuals[static_cast<size_t>(points[p].view)].push_back(std::max(0.0, r));
            if (r <= -pass.margin_px && pass.misses == 0) continue;
            // Whose silhouettes keep the line of sight out of the hull.
                for (const Support& x : supports_of(views, cameras, points[p], touches[p], 1e9, 8))
                if (x.distance_px > dissent_limit_px()) dissents[static_cast<size_t>(x.view)] += 1;
        }
        for (size_t i = 0; i < n; ++i) {
            AlignedView& v = out[i];
            v.name = given_.views[i].name;
            v.bad = s_.bad(i);
            v.azimuth_deg = std::remainder(model.azimuth(i) / kRadians, 360);
            if (residuals[i].empty()) continue;
            double sum = 0;
            size_t near = 0;
            for (double r : residuals[i]) sum += r * r, near += r < 0.5;
            v.residual_px = std::sqrt(sum / static_cast<double>(residuals[i].size()));
            v.residual_p95_px = percentile(residuals[i], 0.95);
            v.coherent = static_cast<double>(near) / static_cast<double>(residuals[i].size());
            v.dissent = dissents[i] / static_cast<double>(points.size());
        }
        return out;
    }

    double dissent_limit_px() const { return std::max(2.0, s_.size_px() / 200); }

    /// Views whose silhouettes contradict the others': those that are not much less bad than the worst, for a bad silhouette drags its
    /// neighbours along. At most a quarter of all.
    std::vector<size_t> contradicting(const std::vector<AlignedView>& views, const std::vector<size_t>& known, bool robust) const {
        std::vector<double> own, dissent;
        for (size_t i : s_.seen()) own.push_back(views[i].residual_px), dissent.push_back(views[i].dissent);
        // Real masks stray by a pixel here and there; that is what trimming points is for.
        const double own_limit = std::max({2.0, s_.size_px() / 200, 5 * median(own)}), dissent_limit = std::clamp(5 * median(dissent), 0.008, robust ? 0.02 : 1.0);
        std::vector<std::pair<double, size_t>> worst;
        for (size_t i : s_.seen())
            if (!std::count(known.begin(), known.end(), i) && (views[i].residual_px > own_limit || views[i].dissent > dissent_limit)) worst.push_back({std::max(views[i].residual_px / own_limit, views[i].dissent / dissent_limit), i});
        std::sort(worst.rbegin(), worst.rend());
        for (const auto& [how, i] : worst) aligner_.trace("contradicts: %zu own %.2f (limit %.2f) dissent %.4f (limit %.4f)", i, views[i].residual_px, own_limit, views[i].dissent, dissent_limit);
        std::vector<size_t> out = known;
        for (const auto& [how, i] : worst)
            if (how >= 0.3 * worst.front().first && out.size() < s_.seen().size() / 4) out.push_back(i);
        std::sort(out.begin(), out.end());
        return out;
    }

  private:
    RingAligner& aligner_;
    Silhouettes& s_;
    const Views& given_;
    const AlignOptions& o_;
    Progress& progress_;
};

Views with_cameras(const Views& given, const OrbitModel& model) {
    Views out = given;
    for (size_t i = 0; i < out.views.size(); ++i) {
        out.views[i].camera = model.camera(i).camera(model.view(i).width_px, model.view(i).height_px);
        out.views[i].lens = given.views[i].lens;
        out.views[i].sitting = "0";
    }
    out.sittings = {Sitting{}};
    out.up = "z";
    out.floor.reset();
    out.format = "align";
    out.metric = true;
    return out;
}

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

/// Brings the point that cameras look at to the origin, and their median distance to 1.
Similarity normalising(const std::vector<Camera>& cameras) {
    const auto target = look_at_point(cameras);
    if (!target) throw UndeterminedError("align: the given cameras look along one line: they are no start. Remedy: --cameras none");
    std::vector<double> distances;
    for (const Camera& c : cameras) distances.push_back((c.centre_world() - *target).norm());
    Similarity out;
    out.scale = 1 / median(distances);
    out.translation = -out.scale * *target;
    return out;
}

// ------------------------------------------------------------------------------------- several rings and sittings

/// Views that stand in one ring: they are aligned by themselves first.
struct Group {
    size_t first, count;
    int sitting;
};

std::vector<Group> groups_of(const AlignOptions& o, size_t views) {
    std::vector<size_t> ring_ends, sitting_ends;
    const auto ends = [views](const std::vector<int>& counts) {
        std::vector<size_t> out;
        for (int c : counts) out.push_back((out.empty() ? 0 : out.back()) + static_cast<size_t>(c));
        if (out.empty()) out.push_back(views);
        return out;
    };
    ring_ends = ends(o.rings.empty() ? o.sittings : o.rings);
    sitting_ends = ends(o.sittings);
    std::vector<Group> out;
    size_t first = 0;
    int sitting = 0;
    for (size_t end : ring_ends) {
        while (sitting_ends[static_cast<size_t>(sitting)] <= first) ++sitting;
        if (end > sitting_ends[static_cast<size_t>(sitting)]) throw UsageError("--rings and --sittings: a ring goes over the end of sitting " + std::to_string(sitting));
        out.push_back({first, end - first, sitting});
        first = end;
    }
    return out;
}

/// What was seen of the object in a ring's own world.
struct Outline {
    Vec3d middle = Vec3d::Zero();
    double radius = 0;  ///< rms
};
Outline outline_of(const CoherenceFit& f) {
    std::vector<Vec3d> all;
    for (size_t p = 0; p < f.points.size(); ++p)
        if (f.touches[p].residual_px < 2) all.push_back(touch_position(f.model.camera(static_cast<size_t>(f.points[p].view)), f.points[p], f.touches[p].depth));
    Outline out;
    for (const Vec3d& x : all) out.middle += x / static_cast<double>(all.size());
    for (const Vec3d& x : all) out.radius += (x - out.middle).squaredNorm() / static_cast<double>(all.size());
    out.radius = std::sqrt(out.radius);
    return out;
}

/// Places ring `r` of the joint model by a turn of its world around its outline's middle, onto the outline of the first.
void place_ring(OrbitModel& m, size_t r, const std::vector<Group>& groups, const Mat3d& scene_from_ring, const Outline& scene, const Outline& ring, const OrbitModel& own) {
    const double scale = scene.radius / ring.radius;
    m.ring(r, OrbitModel::RingDistance).value = std::log(scale);
    m.ring(r, OrbitModel::RingHeight).value = scale * own.ring(0, OrbitModel::RingHeight).value;
    for (size_t k = 0; k < groups[r].count; ++k) m.of(groups[r].first + k, OrbitModel::Height).value = scale * own.of(k, OrbitModel::Height).value;
    const Eigen::AngleAxisd turn(scene_from_ring);
    const Vec3d shift = scene.middle - scene_from_ring * (scale * ring.middle);
    for (int a = 0; a < 3; ++a) {
        m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingTurn + a)).value = turn.angle() * turn.axis()[a];
        m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingShift + a)).value = shift[a];
    }
}

/// Aligns each ring alone, finds how their worlds lie to each other by trying turns (about the axis within a sitting, all of them between sittings),
/// then everything together.
RingAligner::Best join_groups(const Views& given, const std::vector<MaskView>& masks, const AlignOptions& o, const std::vector<Group>& groups, RingAligner& joint, std::vector<AlignRung>& rungs,
                              std::vector<std::string>& failures, Progress& progress) {
    std::vector<RingAligner::Best> parts;
    std::vector<Candidate> leads;
    Turn direction = o.direction;
    for (const Group& g : groups) {
        Views views = given;
        views.views = {given.views.begin() + static_cast<long>(g.first), given.views.begin() + static_cast<long>(g.first + g.count)};
        const std::vector<MaskView> some(masks.begin() + static_cast<long>(g.first), masks.begin() + static_cast<long>(g.first + g.count));
        AlignOptions own = o;
        own.rings.clear();
        own.sittings.clear();
        own.direction = direction;
        if (!o.angles_deg.empty()) own.angles_deg = {o.angles_deg.begin() + static_cast<long>(g.first), o.angles_deg.begin() + static_cast<long>(g.first + g.count)};
        RingAligner aligner(views, some, own, progress);
        std::vector<AlignRung> tried;
        parts.push_back(aligner.run(tried));
        leads.push_back(RingAligner::lead(parts.back()));
        if (leads.back().rms_px() > std::max(1.5, aligner.silhouettes().size_px() / 250))
            failures.push_back(text_of("the ring of %s to %s does not fit together by itself (%.2f px)", views.views.front().name.c_str(), views.views.back().name.c_str(), leads.back().rms_px()));
        direction = leads.back().turn;
    }
    // One model of all views: angles as found, everything else where it was.
    std::vector<OrbitView> views;
    for (size_t r = 0; r < groups.size(); ++r)
        for (size_t k = 0; k < groups[r].count; ++k) {
            OrbitView v = leads[r].fit.model.view(k);
            v.azimuth_rad = leads[r].fit.model.azimuth(k);
            v.ring = static_cast<int>(r);
            views.push_back(v);
        }
    Candidate all = leads[0];
    OrbitModel& m = all.fit.model = OrbitModel(views, static_cast<int>(groups.size()));
    for (const Candidate& c : leads)
        if (c.orbit > all.orbit) all.orbit = c.orbit;
    const double share = 1.0 / static_cast<double>(groups.size());
    for (size_t r = 0; r < groups.size(); ++r) {
        const OrbitModel& own = leads[r].fit.model;
        for (const auto which : {OrbitModel::LnFocal, OrbitModel::CentreX, OrbitModel::CentreY}) m.global(which).value += share * own.global(which).value;
        for (const auto part : {OrbitModel::Elevation, OrbitModel::RingHeight, OrbitModel::RingPan, OrbitModel::RingTilt, OrbitModel::RingRoll}) m.ring(r, part).value = own.ring(0, part).value;
        for (size_t k = 0; k < groups[r].count; ++k)
            for (int part = OrbitModel::Pan; part < OrbitModel::kViewParts; ++part) {
                const auto p = static_cast<OrbitModel::ViewPart>(part);
                m.of(groups[r].first + k, p).value = own.of(k, p).value;
                if (all.orbit == Orbit::HandHeld && leads[r].orbit != Orbit::HandHeld)
                    for (const auto& [shared, mine] : {std::pair{OrbitModel::RingPan, OrbitModel::Pan}, {OrbitModel::RingTilt, OrbitModel::Tilt}, {OrbitModel::RingRoll, OrbitModel::Roll}})
                        if (p == mine) m.of(groups[r].first + k, p).value += own.ring(0, shared).value;
            }
        if (all.orbit == Orbit::HandHeld)
            for (const auto part : {OrbitModel::RingPan, OrbitModel::RingTilt, OrbitModel::RingRoll}) m.ring(r, part).hold(0);
    }
    // How the others lie to the first.
    Silhouettes& s = joint.silhouettes();
    const CoherencePass pass = joint.coarse();
    const Outline scene = outline_of(leads[0].fit);
    std::mt19937_64 random(o.seed);
    for (size_t r = 1; r < groups.size(); ++r) {
        const Outline own = outline_of(leads[r].fit);
        std::vector<Mat3d> turns;
        if (groups[r].sitting == groups[0].sitting)
            for (int k = 0; k < 90; ++k) turns.push_back(Eigen::AngleAxisd(4 * k * kRadians, Vec3d::UnitZ()).toRotationMatrix());
        else
            for (int k = 0; k < 1200; ++k) {  // about 18 degrees apart
                std::normal_distribution<double> normal;
                const Eigen::Quaterniond q(normal(random), normal(random), normal(random), normal(random));
                turns.push_back(q.normalized().toRotationMatrix());
            }
        // Contours of each of the two against the other's silhouettes.
        const auto mixed = [&](size_t looking, size_t asked, size_t count) {
            std::vector<ContourPoint> points = s.contour(pass.scale, count, 51);
            const Group& g = groups[looking];
            std::erase_if(points, [&](const ContourPoint& p) { return static_cast<size_t>(p.view) < g.first || static_cast<size_t>(p.view) >= g.first + g.count; });
            std::vector<CoherenceView> some = s.at_scale(pass.scale);
            for (size_t i = 0; i < some.size(); ++i)
                if (i < groups[asked].first || i >= groups[asked].first + groups[asked].count) some[i].field = nullptr;
            return std::pair{points, some};
        };
        const size_t few = std::max<size_t>(2, 60 / groups[r].count);
        const auto [from_ring, first_views] = mixed(r, 0, few);
        const auto [from_first, ring_views] = mixed(0, r, std::max<size_t>(2, 60 / groups[0].count));
        const auto score = [&, &from_ring = from_ring, &first_views = first_views, &from_first = from_first, &ring_views = ring_views](const OrbitModel& model) {
            const std::vector<OrbitCamera> cameras = model.cameras();
            double sum = 0;
            for (const auto& [points, some] : {std::pair{&from_ring, &first_views}, {&from_first, &ring_views}})
                for (const Touch& t : find_touches(*some, cameras, *points, {ball_radius(s, model), 0, 2 * pass.resolution_px}, {}))
                    if (!std::isnan(t.residual_px)) sum += std::min(std::max(0.0, t.residual_px), 4 * pass.huber_px) / static_cast<double>(points->size());
            return sum;
        };
        std::vector<std::pair<double, size_t>> scored;
        for (size_t k = 0; k < turns.size(); ++k) {
            place_ring(m, r, groups, turns[k], scene, own, leads[r].fit.model);
            scored.emplace_back(score(m), k);
            progress.check();
        }
        std::sort(scored.begin(), scored.end());
        // The best few, each led to its own optimum with only the ring's place free.
        Candidate best;
        double least = INFINITY, second = INFINITY;
        Mat3d best_turn = Mat3d::Identity();
        for (size_t k = 0; k < std::min<size_t>(8, scored.size()); ++k) {
            Candidate c = all;
            place_ring(c.fit.model, r, groups, turns[scored[k].second], scene, own, leads[r].fit.model);
            RingAligner::free_ring(c.fit.model, r);
            c.fit.points = s.contour(pass.scale, 20, 52);
            std::erase_if(c.fit.points, [&](const ContourPoint& p) {
                const int ring = c.fit.model.ring_of(static_cast<size_t>(p.view));
                return ring != 0 && ring != static_cast<int>(r);
            });
            std::vector<bool> was(s.count());
            for (size_t i = 0; i < s.count(); ++i) {
                was[i] = s.bad(i);
                const int ring = c.fit.model.ring_of(i);
                if (ring != 0 && ring != static_cast<int>(r)) s.set_bad(i, true);
            }
            refine(c.fit, s, pass, progress);
            for (size_t i = 0; i < s.count(); ++i) s.set_bad(i, was[i]);
            const double rms = c.rms_px();
            joint.trace("ring %zu: score %.3f, then %.3f px", r, scored[k].first, rms);
            const Mat3d turn = c.fit.model.camera(groups[r].first).camera_from_world;
            const bool same = k > 0 && Eigen::AngleAxisd(turn * best_turn.transpose()).angle() < 5 * kRadians;
            if (rms < least) {
                if (!same) second = least;
                least = rms, best = c, best_turn = turn;
            } else if (!same) {
                second = std::min(second, rms);
            }
        }
        if (second < 1.3 * least + 0.05 * pass.scale)
            failures.push_back(text_of("how the views from %s on lie to the first ones cannot be told: two ways fit alike (%.2f and %.2f px)", given.views[groups[r].first].name.c_str(), least, second));
        for (int part = 0; part < OrbitModel::kRingParts; ++part) {
            const auto p = static_cast<OrbitModel::RingPart>(part);
            if (best.fit.model.views() > 0) m.ring(r, p).value = best.fit.model.ring(r, p).value;
        }
        if (best.fit.model.views() > 0)
            for (size_t k = 0; k < groups[r].count; ++k) m.of(groups[r].first + k, OrbitModel::Height).value = best.fit.model.of(groups[r].first + k, OrbitModel::Height).value;
    }
    joint.free_parts(m, all.orbit);
    m.global(OrbitModel::LnArc).hold(0);
    joint.fit(all, joint.coarse(), 1);
    joint.polish(all);
    rungs.push_back({all.orbit, all.turn, all.rms_px(), 0, static_cast<int>(m.free().size())});
    RingAligner::Best out;
    out[all.turn] = all;
    for (auto& [turn, c] : parts.front())
        if (turn != all.turn) out[turn] = c;  // for its residual: the others were only tried in the first one's direction
    return out;
}

std::vector<std::string> names_of(const Views& views) {
    std::vector<std::string> out;
    for (const View& v : views.views) out.push_back(v.name);
    return out;
}

/// Which of a direction's cameras make texture lie where it can be seen from.
struct NearSide {
    size_t matches = 0;
    double share = 0;
};
NearSide near_side(const CoherenceFit& f, const std::vector<FeatureTrack>& tracks) {
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    const Outline outline = outline_of(f);
    NearSide out;
    size_t near = 0;
    for (const FeatureTrack& t : tracks) {
        const TrackedPlace at = place_of(cameras, t);
        if (!at.in_front || at.rms_px() > 3 || (at.place - outline.middle).norm() > 2.5 * outline.radius) continue;
        Vec3d looking = Vec3d::Zero();
        for (const Sighting& s : t.sightings) looking += cameras[static_cast<size_t>(s.view)].camera_from_world.row(2).transpose();
        ++out.matches;
        near += (at.place - outline.middle).dot(looking) < 0;
    }
    if (out.matches) out.share = static_cast<double>(near) / static_cast<double>(out.matches);
    return out;
}

/// Masks without those of bad views.
std::vector<MaskView> trusted_masks(const AlignResult& r, std::vector<MaskView> masks) {
    for (size_t i = 0; i < masks.size(); ++i)
        if (r.aligned[i].bad) masks[i] = {};
    return masks;
}

/// How far each of a fit's tracks is from its place, pixels.
std::vector<double> rms_of_tracks(const CoherenceFit& f) {
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    std::vector<double> out;
    for (const FeatureTrack& t : *f.tracks) out.push_back(place_of(cameras, t).rms_px());
    return out;
}

/// One alignment by silhouettes, from what is given to the verdict.
class Alignment {
  public:
    Alignment(const Views& given, const std::vector<MaskView>& masks, const AlignOptions& o, Progress& progress)
        : given_(given), masks_(masks), o_(o), progress_(progress), aligner_(given, masks, o, progress), silhouettes_(aligner_.silhouettes()), judge_(aligner_, given, o, progress) {}

    AlignResult run() {
        progress_.begin("align", 12);
        out_.method = o_.method;
        find();
        out_.mask_noise_px = aligner_.mask_noise_px();
        if (o_.method == AlignMethod::Paper) {
            out_.aligned = judged();
            progress_.step(3);
        } else {
            name_bad();
            disturb();
            hold_unobservable();
            find_symmetry();
        }
        describe();
        judge();
        progress_.step(1);
        return std::move(out_);
    }

  private:
    using Best = RingAligner::Best;

    // ------------------------------------------------------------------------------------- cameras

    void find() {
        if (o_.method == AlignMethod::Refine) {
            world_from_given_ = normalising(given_.cameras());
            Candidate near;
            near.fit.model = aligner_.given_cameras(world_from_given_);
            out_.rungs.push_back({near.orbit, near.turn, 0, 0, static_cast<int>(near.fit.model.free().size())});
            aligner_.fit(near, aligner_.coarse(), 1);
            aligner_.polish(near);
            if (o_.features) fit_features(near);
            out_.rungs.back().rms_px = near.rms_px();
            best_[near.turn] = std::move(near);
            progress_.step(8);
        } else if (o_.method == AlignMethod::Paper) {
            for (const Turn turn : aligner_.turns()) {
                Candidate c{{}, Orbit::FixedCamera, turn, 0};
                const std::vector<OrbitView> nominal = aligner_.nominal(turn, o_.arc_deg);
                PaperFit paper = fit_like_the_paper(masks_, silhouettes_, nominal, paper_views(given_, silhouettes_, nominal, o_.paper_views), progress_);
                c.fit.model = paper.model;
                const CoherencePass pass = aligner_.fine(1);
                c.fit.points = silhouettes_.contour(pass.scale, pass.points, 3);
                c.fit.touches = touches_of(silhouettes_, c.fit.model, c.fit.points, pass);
                aligner_.trace("paper, %s: energy of the path %.4f, contours %.2f px outside", name_of(turn), paper.path_energy, c.rms_px());
                if (best_.empty() || c.typical_px() < RingAligner::lead(best_).typical_px()) out_.picture = std::move(paper.energy_map);
                out_.picture_name = "energy_map";
                out_.rungs.push_back({c.orbit, turn, c.rms_px(), 0, static_cast<int>(4 * silhouettes_.seen().size() + 5)});
                best_[turn] = std::move(c);
                progress_.step(aligner_.turns().size() == 1 ? 8 : 4);
            }
        } else if (const std::vector<Group> groups = groups_of(o_, given_.views.size()); groups.size() > 1) {
            best_ = join_groups(given_, masks_, o_, groups, aligner_, out_.rungs, out_.failures, progress_);
            for (const Group& g : groups) sitting_of_.insert(sitting_of_.end(), g.count, g.sitting);
        } else {
            best_ = aligner_.run(out_.rungs);
        }
        Turn turn = RingAligner::lead(best_).turn;
        if (o_.method == AlignMethod::Coherence && o_.features && mirrored_alike(RingAligner::lead(best_))) turn = direction_by_features(turn);
        c_ = best_[turn];
    }

    /// The other direction explains the silhouettes nearly as well.
    bool mirrored_alike(const Candidate& c) const {
        if (o_.method == AlignMethod::Refine || o_.direction != Turn::Auto || by_features_) return false;
        return std::any_of(best_.begin(), best_.end(), [&](const auto& b) { return b.first != c.turn && b.second.typical_px() < 3 * c.typical_px() + 0.1; });
    }

    /// Texture moves with the side of the object that is seen, the near one: cameras that put it on the far side turn the wrong way.
    Turn direction_by_features(Turn lead) {
        std::vector<std::pair<size_t, size_t>> neighbours;
        const std::vector<size_t>& seen = silhouettes_.seen();
        for (size_t k = 0; k + 1 < seen.size(); ++k) neighbours.emplace_back(seen[k], seen[k + 1]);
        const std::vector<FeatureTrack> tracks = find_tracks(given_, masks_, neighbours, progress_);
        std::map<Turn, NearSide> votes;
        for (const auto& [turn, c] : best_) votes[turn] = near_side(c.fit, tracks);
        for (const auto& [turn, v] : votes) aligner_.trace("%s: %zu features of %zu fit, %.0f %% of them on the near side", name_of(turn), v.matches, tracks.size(), 100 * v.share);
        const auto votes_for = [](const NearSide& v) { return static_cast<double>(v.matches) * v.share; };
        for (const auto& [turn, v] : votes) {
            const double others = std::accumulate(votes.begin(), votes.end(), 0.0, [&, t = turn](double sum, const auto& w) { return w.first == t ? sum : sum + votes_for(w.second); });
            if (v.matches < 30 || v.share < 0.85 || votes_for(v) < 4 * others) continue;
            by_features_ = true;
            out_.features = v.matches;
            out_.features_near = v.share;
            progress_.note(text_of("the object turns %s: %.0f %% of %zu features then lie on the side that is seen", name_of(turn), 100 * v.share, v.matches));
            return turn;
        }
        return lead;
    }

    /// Texture as further residuals: what is left of mismatches is dropped by how far from their places they are, twice.
    void fit_features(Candidate& c) {
        constexpr double kMostApart = 35 * kRadians;  // features look too different beyond
        constexpr size_t kNeighbours = 4;
        std::vector<std::pair<size_t, size_t>> pairs;
        const std::vector<OrbitCamera> cameras = c.fit.model.cameras();
        for (const size_t i : silhouettes_.seen()) {
            std::vector<std::pair<double, size_t>> near;
            for (const size_t j : silhouettes_.seen()) {
                const double apart = std::acos(std::clamp(cameras[i].centre.normalized().dot(cameras[j].centre.normalized()), -1.0, 1.0));
                if (j != i && apart < kMostApart) near.emplace_back(apart, j);
            }
            std::sort(near.begin(), near.end());
            near.resize(std::min(near.size(), kNeighbours));
            for (const auto& [apart, j] : near) pairs.emplace_back(std::min(i, j), std::max(i, j));
        }
        std::sort(pairs.begin(), pairs.end());
        pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
        std::vector<FeatureTrack> tracks = find_tracks(given_, masks_, pairs, progress_);
        const Candidate without = c;
        double limit_px = std::max(5.0, 0.05 * silhouettes_.size_px());
        for (int round = 0; round < 2; ++round) {
            const std::vector<OrbitCamera> now = c.fit.model.cameras();
            std::erase_if(tracks, [&](const FeatureTrack& t) {
                const TrackedPlace at = place_of(now, t);
                return !at.in_front || at.rms_px() > limit_px || at.place.norm() > 2 * c.fit.ball_radius;
            });
            if (tracks.size() < 30) {
                c = without;
                progress_.note(text_of("%zu features follow the cameras: too few to be fitted, silhouettes alone are", tracks.size()));
                return;
            }
            c.fit.tracks = std::make_shared<const std::vector<FeatureTrack>>(tracks);
            CoherencePass pass = aligner_.fine(c.rms_px());
            if (round == 0) pass.track_huber_px = 0.3 * limit_px;
            refine(c.fit, silhouettes_, pass, progress_);
            const std::vector<double> left = rms_of_tracks(c.fit);
            aligner_.trace("%zu tracks of features: median %.2f px, contours %.3f px", tracks.size(), median(left), c.rms_px());
            limit_px = std::max(2.0, 4 * median(left));
        }
    }

    std::vector<AlignedView> judged() {
        CoherencePass pass = aligner_.fine(c_.typical_px());
        pass.misses = c_.misses;
        return judge_.views_of(c_.fit.model, pass);
    }

    // ------------------------------------------------------------------------------------- bad silhouettes

    /// They are named, and then ignored.
    void name_bad() {
        out_.aligned = judged();
        std::vector<size_t> bad = judge_.contradicting(out_.aligned, {}, c_.misses > 0);
        for (int round = 0; round < 6 && !bad.empty(); ++round) {
            for (size_t i : bad) silhouettes_.set_bad(i, true);
            aligner_.settle(c_);
            // Judged anew with all of them: others may fit now, or turn out to be wrong.
            for (size_t i : silhouettes_.seen()) silhouettes_.set_bad(i, false);
            out_.aligned = judged();
            // What contradicts the rest without having taken part stays out.
            std::erase_if(bad, [&](size_t i) { return out_.aligned[i].residual_px < 1 && out_.aligned[i].dissent < 0.004; });
            const std::vector<size_t> now = judge_.contradicting(out_.aligned, bad, c_.misses > 0);
            const bool settled = now == bad;
            bad = now;
            if (settled) break;
        }
        if (!bad.empty() || c_.misses > 0) {
            for (size_t i : bad) silhouettes_.set_bad(i, true);
            c_.misses = 0;
            aligner_.settle(c_);
            const auto with_all = out_.aligned;
            out_.aligned = judged();
            for (size_t i : bad) out_.aligned[i].dissent = with_all[i].dissent;
        }
        name_holes();
        progress_.step(1);
    }

    /// A hole within a silhouette moves no camera and pushes few contours, but carves: what all views but one keep, deep within what that one calls background, is a mistake
    /// of that one.
    void name_holes() {
        const std::vector<size_t>& seen = silhouettes_.seen();
        if (seen.size() < 12 || c_.rms_px() > 0.01 * silhouettes_.size_px()) return;
        const std::vector<MaskView> trusted = trusted_masks(out_, masks_);
        const std::vector<Camera> cameras = with_cameras(given_, c_.fit.model).cameras();
        Progress quiet;
        Mesh kept;
        try {
            kept = extract_mesh(*coarse_hull(names_of(given_), cameras, trusted, 96, 0.6, quiet, 1), {}, quiet);
        } catch (const ContradictionError&) {
            return;  // there is none; other tests say why
        }
        // Without one view the hull bulges between its neighbours, the more the farther they are apart: a round object of radius R by R (1 / cos(step) - 1).
        const double step_rad = 2 * std::numbers::pi / static_cast<double>(seen.size());
        const double deep_px = silhouettes_.size_px() * (0.03 + 0.75 * (1 / std::cos(step_rad) - 1)), factor = std::min(1.0, 250 / silhouettes_.size_px());
        const int scale = aligner_.middle().scale;
        const std::vector<CoherenceView> fields = silhouettes_.at_scale(scale);
        std::vector<double> deep_area(seen.size(), 0);
        tbb::parallel_for(size_t{0}, seen.size(), [&](size_t s) {
            const CoherenceView& view = fields[seen[s]];
            if (!view.field) return;
            const Image8 hit = silhouette_of(kept, scaled(cameras[seen[s]], factor));
            for (int y = 0; y < hit.height; ++y)
                for (int x = 0; x < hit.width; ++x)
                    if (hit.at(x, y) && distance_px(view.field->silhouette.view(), scale, (x + 0.5) / factor, (y + 0.5) / factor) > deep_px) deep_area[s] += 1;
        });
        bool found = false;
        for (size_t s = 0; s < seen.size(); ++s) {
            if (deep_area[s] > 0) aligner_.trace("%zu carves alone: %.0f of 250 x 250", seen[s], deep_area[s]);
            if (deep_area[s] < 25) continue;
            silhouettes_.set_bad(seen[s], true);
            found = true;
        }
        if (!found) return;
        aligner_.settle(c_);
        out_.aligned = judged();
    }

    // ------------------------------------------------------------------------------------- what is left open

    /// The same result from disturbed angles?
    void disturb() {
        const std::vector<size_t>& seen = silhouettes_.seen();
        std::mt19937_64 random(o_.seed);
        std::normal_distribution<double> normal;
        CoherencePass quick = aligner_.middle();
        quick.sigma_px = std::clamp(2 * c_.rms_px(), 0.1, 3.0);
        quick.points = 50;
        quick.iterations = 8;
        Candidate home = c_.orbit == Orbit::Turntable ? aligner_.climbed(c_, Orbit::FixedCamera) : c_;
        aligner_.fit(home, quick, 41);
        std::vector<double> spread_squares(seen.size(), 0);
        double focal_squares = 0;
        int used = 0;
        std::optional<Candidate> better;
        for (int r = 0; r < o_.restarts; ++r) {
            Candidate x = home;
            for (size_t i : seen) x.fit.model.of(i, OrbitModel::Azimuth).value += 2.5 * kRadians * normal(random);
            x.fit.model.global(OrbitModel::LnFocal).value += 0.05 * normal(random);
            refine(x.fit, silhouettes_, quick, progress_);
            aligner_.trace("restart: %.4f px, at home %.4f, f %.1f", x.rms_px(), home.rms_px(), x.fit.model.focal_px(0));
            if (x.rms_px() < 0.8 * home.rms_px() - 0.01) better = x;  // it found a better place than it came from
            if (x.rms_px() > 2 * home.rms_px() + 0.1) continue;       // it did not come home: no evidence of freedom
            ++used;
            std::vector<double> moved;
            for (size_t i : seen) moved.push_back(x.fit.model.azimuth(i) - home.fit.model.azimuth(i));
            const double mean = std::accumulate(moved.begin(), moved.end(), 0.0) / static_cast<double>(moved.size());
            for (size_t k = 0; k < seen.size(); ++k) spread_squares[k] += square((moved[k] - mean) / kRadians);
            focal_squares += square(x.fit.model.global(OrbitModel::LnFocal).value - home.fit.model.global(OrbitModel::LnFocal).value);
        }
        if (better && c_.orbit != Orbit::Turntable) {
            aligner_.polish(*better);
            if (better->rms_px() < c_.rms_px()) {
                c_ = *better;
                out_.aligned = judged();
            }
        }
        if (used > 0) {
            double sum = 0;
            for (size_t k = 0; k < seen.size(); ++k) {
                out_.aligned[seen[k]].azimuth_spread_deg = std::sqrt(spread_squares[k] / used);
                sum += spread_squares[k] / used;
            }
            out_.azimuth_spread_deg = std::sqrt(sum / static_cast<double>(seen.size()));
            out_.focal_spread = std::sqrt(focal_squares / used);
        }
        progress_.step(2);
    }

    /// Where nothing says what the angles are, those that were meant are as good as any.
    void hold_unobservable() {
        const double limit_spread_deg = std::max(0.5, 3 * c_.rms_px() / (0.5 * silhouettes_.size_px()) / kRadians);
        if (out_.azimuth_spread_deg <= limit_spread_deg || std::fabs(c_.fit.model.global(OrbitModel::LnFocal).value) >= kMostLnFocal) return;
        out_.angles_observable = false;
        if (c_.orbit == Orbit::Turntable || o_.method == AlignMethod::Refine) return;
        Candidate held = c_;
        OrbitModel& m = held.fit.model;
        m.global(OrbitModel::LnArc).hold(0);
        for (int h = 0; h < OrbitModel::kHarmonics; ++h) m.harmonic(h).hold(0);
        for (size_t i : silhouettes_.seen()) m.of(i, OrbitModel::Azimuth).hold(0);
        aligner_.polish(held);
        if (held.rms_px() >= 1.5 * c_.rms_px() + 0.05) {
            out_.angles_observable = true;  // uncertain, but the silhouettes do not bear just any
            return;
        }
        c_ = held;
        const auto before = out_.aligned;
        out_.aligned = judged();
        for (size_t i = 0; i < before.size(); ++i) out_.aligned[i].azimuth_spread_deg = before[i].azimuth_spread_deg;
    }

    /// Does the object look the same after half a turn (or a third, a quarter)? Then a view could as well be another one.
    void find_symmetry() {
        if (!out_.angles_observable || o_.method != AlignMethod::Coherence) return;
        CoherencePass pass = aligner_.middle();
        pass.points = 30;
        const std::vector<OrbitCamera> cameras = c_.fit.model.cameras();
        const std::vector<ContourPoint> points = silhouettes_.contour(pass.scale, pass.points, 61);
        const Outline outline = outline_of(c_.fit);
        const auto outside = [&](double turn_rad) {
            // Each view by itself turned on, before the silhouettes of the others as they are.
            const Mat3d turn = Eigen::AngleAxisd(turn_rad, Vec3d::UnitZ()).toRotationMatrix();
            std::vector<double> all;
            for (size_t i : silhouettes_.seen()) {
                if (silhouettes_.bad(i)) continue;
                std::vector<OrbitCamera> moved = cameras;
                moved[i].camera_from_world = cameras[i].camera_from_world * turn.transpose();
                moved[i].centre = turn * (cameras[i].centre - outline.middle) + outline.middle;
                std::vector<ContourPoint> own;
                for (const ContourPoint& p : points)
                    if (static_cast<size_t>(p.view) == i) own.push_back(p);
                for (const Touch& t : find_touches(silhouettes_.at_scale(pass.scale), moved, own, {c_.fit.ball_radius, 0, 2 * pass.resolution_px}, {}))
                    if (!std::isnan(t.residual_px)) all.push_back(std::max(0.0, t.residual_px));
            }
            return percentile(all, 0.85);
        };
        const double here = outside(0);
        for (const int fold : {2, 3, 4}) {
            const double there = outside(2 * std::numbers::pi / fold);
            aligner_.trace("turned by 1/%d: %.3f px outside, as it is %.3f", fold, there, here);
            if (there < 2 * here + 0.004 * silhouettes_.size_px()) out_.symmetry = fold;
        }
    }

    // ------------------------------------------------------------------------------------- result

    void describe() {
        // Residuals before: of the start that the photographer's word gives.
        const OrbitModel start = o_.method == AlignMethod::Refine ? aligner_.given_cameras(world_from_given_) : aligner_.start(c_.orbit, c_.turn, aligner_.starts().front());
        const std::vector<AlignedView> before = judge_.views_of(start, aligner_.coarse());
        for (size_t i = 0; i < before.size(); ++i) out_.aligned[i].residual_before_px = before[i].residual_px;
        const size_t first = silhouettes_.seen().front();
        out_.focal_start_px = start.focal_px(first);

        const OrbitModel& m = c_.fit.model;
        out_.orbit = c_.orbit;
        out_.direction = c_.turn;
        double sum = 0, coherent = 0;
        size_t good = 0;
        for (size_t i : silhouettes_.seen())
            if (!silhouettes_.bad(i)) sum += square(out_.aligned[i].residual_px), coherent += out_.aligned[i].coherent, ++good;
        out_.rms_px = std::sqrt(sum / static_cast<double>(good));
        out_.coherent = coherent / static_cast<double>(good);
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
        }
        for (size_t p = 0; p < c_.fit.touches.size(); ++p) {
            const Touch& t = c_.fit.touches[p];
            if (std::isnan(t.residual_px) || t.residual_px > 1) continue;
            const Vec3d x = touch_position(m.camera(static_cast<size_t>(c_.fit.points[p].view)), c_.fit.points[p], t.depth);
            const Vec3d back = (x - to_ring.translation) / to_ring.scale;
            out_.touches_world.push_back({static_cast<float>(back.x()), static_cast<float>(back.y()), static_cast<float>(back.z())});
        }
    }

    void judge() {
        // A pixel for an object of 300: what masks of that size are usually off by, unless these are seen to be rougher.
        const double allowed_px = std::max({0.3, silhouettes_.size_px() / 300, 1.5 * out_.mask_noise_px});
        // Cameras for which next to nothing was in the others' frames would fit anything.
        if (!(out_.rms_px <= allowed_px) || out_.touches_world.empty())
            out_.failures.push_back(text_of("the silhouettes do not fit together: contours stay %.2f px (rms) outside the hull of the other views, at most %.2f px may. Not one turn of the object at even steps (--angles, --arc), masks of different "
                                            "objects, or an orbit too far from what was assumed (--orbit, --fov)",
                                            out_.rms_px, allowed_px));
        std::vector<std::string> bad;
        for (size_t i : silhouettes_.seen())
            if (silhouettes_.bad(i)) bad.push_back(given_.views[i].name);
        if (!bad.empty()) out_.warnings.push_back(text_of("%zu silhouettes contradict the others and constrain nobody: %s. Remedy: look at their masks", bad.size(), some_of(bad).c_str()));
        if (6 * bad.size() >= silhouettes_.seen().size() && bad.size() > 1) out_.failures.push_back(text_of("%zu of %zu silhouettes contradict the others: which ones are wrong cannot be told", bad.size(), silhouettes_.seen().size()));
        if (!out_.angles_observable && o_.method == AlignMethod::Refine)
            out_.warnings.push_back(text_of("the silhouettes%s leave each view's angle open by %.1f degrees: the given cameras decide. Remedy: texture, or a marker mat", c_.fit.tracks ? " and the features" : "", out_.azimuth_spread_deg));
        else if (!out_.angles_observable)
            out_.warnings.push_back(text_of("the object looks the same from all around (or nearly): its silhouettes leave each view's angle open by %.1f degrees; the %s angles are kept. The shape does not depend on them, only the colours do. "
                                            "Remedy: texture with --method refine, or a marker mat",
                                            out_.azimuth_spread_deg, o_.angles_deg.empty() ? "even" : "given"));
        else if (mirrored_alike(c_))
            undecided_direction();
        if (out_.angles_observable && o_.method == AlignMethod::Coherence && c_.orbit != Orbit::Turntable) loose_views();
        if (out_.symmetry > 1)
            out_.warnings.push_back(text_of("the object looks nearly the same after 1/%d of a turn: angles that are wrong by that much would not be noticed. The shape hardly depends on it, the colours do", out_.symmetry));
        const double ln_focal = c_.fit.model.global(OrbitModel::LnFocal).value;
        if (std::fabs(ln_focal) > kMostLnFocal && o_.method != AlignMethod::Paper)
            out_.failures.push_back(text_of("the focal length ran away, to %.0f px (started from %.0f): the silhouettes do not say how strong perspective is. Remedy: --fov", out_.focal_px, out_.focal_start_px));
        else if (out_.focal_spread > 0.05)
            out_.warnings.push_back(text_of("the focal length is uncertain by %.0f %%: perspective is weak; the shape is hardly affected. Remedy: --fov", 100 * out_.focal_spread));
    }

    /// Not round, but with views among which it looks round (a cup, its handle in front): those may stand anywhere, and carve what they do not see.
    void loose_views() {
        constexpr double kLoose_deg = 3;
        std::vector<std::string> loose;
        double widest = 0;
        for (size_t i : silhouettes_.seen()) {
            const double spread = out_.aligned[i].azimuth_spread_deg;
            if (silhouettes_.bad(i) || spread < kLoose_deg) continue;
            widest = std::max(widest, spread);
            loose.push_back(given_.views[i].name);
        }
        if (!loose.empty())
            out_.failures.push_back(text_of("the silhouettes leave the angles of %zu views open by up to %.0f degrees, and the shape depends on them: %s. Remedy: --orbit turntable, where the object was turned by known steps; cameras from elsewhere and --method refine; a marker "
                                            "mat",
                                            loose.size(), widest, some_of(loose).c_str()));
    }

    void undecided_direction() {
        out_.failures.push_back(text_of("which way the object turned cannot be told from the silhouettes (%.2f px one way, %.2f px the other), and the wrong one gives its mirror image. Remedy: --direction cw or ccw (seen from above)", out_.rms_px,
                                        out_.other_direction_px));
        const OrbitModel& m = c_.fit.model;
        for (const auto& [turn, other] : best_)
            if (turn != c_.turn && other.fit.model.views() == given_.views.size())
                for (size_t i = 0; i < given_.views.size(); ++i) out_.other_cameras.push_back(other.fit.model.camera(i).camera(m.view(i).width_px, m.view(i).height_px));
    }

    const Views& given_;
    const std::vector<MaskView>& masks_;
    const AlignOptions& o_;
    Progress& progress_;
    RingAligner aligner_;
    Silhouettes& silhouettes_;
    Judge judge_;
    Best best_;
    Candidate c_;                    ///< the one that is believed
    bool by_features_ = false;       ///< texture decided the direction
    Similarity world_from_given_;    ///< of Refine
    std::vector<int> sitting_of_;    ///< where there are several rings
    AlignResult out_;
};

/// The distance, in the world found, between the places of the hull that two pixels of one view show.
double seen_length(const AlignResult& r, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, const KnownLength& known) {
    const Camera& camera = cameras[view_called(r.views, known.view, "--known-length")];
    Progress quiet;
    const openvdb::FloatGrid::Ptr hull = coarse_hull(names_of(r.views), cameras, masks, 256, 0.6, quiet);
    using Intersector = openvdb::tools::LevelSetRayIntersector<openvdb::FloatGrid>;
    const Intersector intersector(*hull);
    std::array<Vec3d, 2> places;
    for (size_t k = 0; k < 2; ++k) {
        const Vec2d& pixel = k ? known.to_px : known.from_px;
        const Camera::Ray ray = camera.ray(pixel);
        openvdb::Vec3d hit;
        const Intersector::RayType sight({ray.origin.x(), ray.origin.y(), ray.origin.z()}, {ray.direction.x(), ray.direction.y(), ray.direction.z()});
        if (!intersector.intersectsWS(sight, hit)) throw InputError(text_of("--known-length: pixel %g, %g of %s does not show the object", pixel.x(), pixel.y(), known.view.c_str()));
        places[k] = {hit.x(), hit.y(), hit.z()};
    }
    const double length = (places[1] - places[0]).norm();
    if (!(length > 0)) throw InputError("--known-length: both pixels of " + known.view + " show the same place");
    return length;
}

/// Moves and scales what was found so that one length is known.
void apply_scale(AlignResult& r, const std::vector<MaskView>& masks, const AlignOptions& o, Progress& progress) {
    double scale = 1;
    const std::vector<Camera> cameras = r.views.cameras();
    if (o.known_distance > 0) {
        Box3d outline;
        for (const auto& t : r.touches_world) outline.extend(Vec3d(t[0], t[1], t[2]));
        const Vec3d middle = outline.isEmpty() ? Vec3d::Zero().eval() : Vec3d(outline.center());
        std::vector<double> distances;
        for (size_t i = 0; i < cameras.size(); ++i)
            if (!masks[i].coverage.empty()) distances.push_back((cameras[i].centre_world() - middle).norm());
        scale = o.known_distance / median(distances);
    } else if (o.known_height > 0) {
        const std::vector<MaskView> trusted = trusted_masks(r, masks);
        Progress quiet;
        const openvdb::FloatGrid::Ptr hull = coarse_hull(names_of(r.views), cameras, trusted, 256, 0.6, quiet);
        const SeenExtent seen = seen_extent(*hull, cameras, trusted, up_direction(r.views.up, cameras));
        if (!seen.top_seen || !seen.bottom_seen) throw UndeterminedError("--known-height: every silhouette is cut by its frame above or below, so how high the object is was not seen. Remedy: --known-distance");
        scale = o.known_height / (seen.highest - seen.lowest);
    } else if (o.known_length) {
        scale = o.known_length->length / seen_length(r, cameras, trusted_masks(r, masks), *o.known_length);
    } else {
        if (r.method != AlignMethod::Refine) r.views.units.clear();
        return;
    }
    r.views.units = o.units;
    for (View& v : r.views.views) v.camera.camera_from_world.translation *= scale;
    for (Sitting& s : r.views.sittings) s.scene_from_sitting.translation *= scale;
    if (r.views.floor) *r.views.floor *= scale;
    for (Camera& c : r.other_cameras) c.camera_from_world.translation *= scale;
    for (auto& t : r.touches_world)
        for (float& x : t) x = static_cast<float>(x * scale);
    progress.note(text_of("scale: one camera distance is %.6g%s%s", scale, o.units.empty() ? "" : " ", o.units.c_str()));
}

}  // namespace

AlignResult align(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress) {
    check_options(options, views.views.size(), masks.size());
    if (options.method == AlignMethod::Mat) return align_to_mat(views, options, progress);
    AlignResult out = Alignment(views, masks, options, progress).run();
    try {
        apply_scale(out, masks, options, progress);
    } catch (const Interrupted&) {
        throw;
    } catch (const Error& e) {
        if (out.failures.empty()) throw;
        // Of cameras that are not believed no length need be had; what is wrong with them is said first.
        out.failures.push_back(std::string("no scale: ") + e.what());
        if (out.method != AlignMethod::Refine) out.views.units.clear();
    }
    return out;
}

}  // namespace vdbcarve
