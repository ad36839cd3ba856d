// SPDX-License-Identifier: Apache-2.0
#include "align/ring_aligner.h"

#include <algorithm>
#include <numbers>

#include "base/statistics.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

RingAligner::RingAligner(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress)
    : given_(views), o_(options), progress_(progress), silhouettes_(masks), n_(masks.size()) {
    if (silhouettes_.seen().size() < 4)
        throw InputError("align: " + counted(silhouettes_.seen().size(), "view") +
                         " with a silhouette; at least 4 are needed, a dozen make sense. Remedy: more photographs");
    mask_noise_px_ = find_mask_noise_px();
}

size_t RingAligner::points_of(size_t points) const {
    const size_t asked = silhouettes_.good().size();
    return asked <= kKeyViews ? points : std::max(std::min<size_t>(10, points), points * kKeyViews / asked);
}

CoherencePass RingAligner::coarse() const {
    const int scale = scale_for(110);
    return {scale, points_of(40), std::max(6.0, silhouettes_.size_px() / 30), 20, 2.0, 3e-3, 0, 2.0 * scale, 2.0 * scale, 1};
}

CoherencePass RingAligner::middle() const {
    const int scale = scale_for(250);
    return {scale, points_of(80), std::max(3.0, silhouettes_.size_px() / 100), 25, 1.0, 1e-3, 0.5 * scale, 1.0 * scale, 1.5 * scale, 8};
}

CoherencePass RingAligner::fine(double rms_px) const {
    return {
        scale_for(700), points_of(static_cast<size_t>(o_.points)), std::max(1.0, 2 * rms_px), 25, std::clamp(1.5 * rms_px, 0.1, 3.0), 1e-3, 0.5, 0.75, 1.0, 8};
}

std::vector<OrbitView> RingAligner::nominal(Turn direction, double arc_deg) const {
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

OrbitModel RingAligner::start(Orbit orbit, Turn direction, const Start& from) const {
    OrbitModel m(nominal(direction, from.arc_deg), 1);
    m.global(OrbitModel::LnFocal).value = from.ln_focal;
    m.ring(0, OrbitModel::Elevation).value = from.elevation_rad;
    aim(m, orbit);
    free_parts(m, orbit);
    if (from.uneven)
        for (int h = 0; h < OrbitModel::kHarmonics; ++h) m.harmonic(h).release(0, 20 * kRadians);
    return m;
}

Vec2d RingAligner::aim_of(const OrbitModel& m, size_t i) const {
    const OrbitCamera c = m.camera(i);
    return {std::atan2(silhouettes_.extent(i).cx - c.cx, c.fx), -std::atan2(silhouettes_.extent(i).cy - c.cy, c.fx * c.aspect)};
}

void RingAligner::aim(OrbitModel& m, Orbit orbit) const {
    std::vector<double> pan, tilt;
    for (size_t i : silhouettes_.seen()) {
        const Vec2d aim = aim_of(m, i);
        pan.push_back(aim.x());
        tilt.push_back(aim.y());
        if (orbit == Orbit::HandHeld) m.of(i, OrbitModel::Pan).value = aim.x(), m.of(i, OrbitModel::Tilt).value = aim.y();
    }
    if (orbit == Orbit::HandHeld) return;
    m.ring(0, OrbitModel::RingPan).value = median(pan);
    m.ring(0, OrbitModel::RingTilt).value = median(tilt);
}

void RingAligner::start_anew(Candidate& c, size_t i) const {
    OrbitModel& m = c.fit.model;
    std::vector<size_t> near = silhouettes_.good();
    std::erase_if(near, [&](size_t j) { return m.ring_of(j) != m.ring_of(i); });
    if (near.empty()) return;
    std::stable_sort(near.begin(), near.end(), [&](size_t a, size_t b) { return std::max(a, i) - std::min(a, i) < std::max(b, i) - std::min(b, i); });
    near.resize(std::min<size_t>(2, near.size()));
    Vec2d off = Vec2d::Zero();  // of the neighbours' aims from their silhouettes' middles, which the object's shape makes
    for (size_t j : near) off += (Vec2d(m.of(j, OrbitModel::Pan).value, m.of(j, OrbitModel::Tilt).value) - aim_of(m, j)) / static_cast<double>(near.size());
    for (int part = 0; part < OrbitModel::kViewParts; ++part) {
        const auto p = static_cast<OrbitModel::ViewPart>(part);
        double mean = 0;
        for (size_t j : near) mean += m.of(j, p).value / static_cast<double>(near.size());
        m.of(i, p).value = mean;
    }
    if (c.orbit != Orbit::HandHeld) return;
    const Vec2d aim = aim_of(m, i) + off;
    m.of(i, OrbitModel::Pan).value = aim.x();
    m.of(i, OrbitModel::Tilt).value = aim.y();
}

void RingAligner::free_parts(OrbitModel& m, Orbit orbit) const {
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
    for (size_t i : silhouettes_.good()) {
        if (orbit != Orbit::Turntable) m.of(i, OrbitModel::Azimuth).release(0, 9 * kRadians);
        if (orbit == Orbit::HandHeld) {
            for (const auto part : {OrbitModel::Pan, OrbitModel::Tilt}) m.of(i, part).release(m.of(i, part).value, 0.09 * width_rad);
            m.of(i, OrbitModel::Roll).release(0, 6 * kRadians);
            m.of(i, OrbitModel::LnDistance).release(0, 0.03);
            m.of(i, OrbitModel::Height).release(0, 0.03);
        }
        free_own_lens(m, i, diagonal);
    }
}

void RingAligner::free_own_lens(OrbitModel& m, size_t i, double diagonal_px) const {
    if (o_.focal_varies) m.of(i, OrbitModel::ViewLnFocal).release(0, 0.015);
    if (o_.centre_varies)
        for (const auto part : {OrbitModel::ViewCentreX, OrbitModel::ViewCentreY}) m.of(i, part).release(0, 0.01 * diagonal_px);
}

void RingAligner::free_ring(OrbitModel& m, size_t r) {
    m.ring(r, OrbitModel::RingAzimuth).release(m.ring(r, OrbitModel::RingAzimuth).value, 1);
    m.ring(r, OrbitModel::RingDistance).release(m.ring(r, OrbitModel::RingDistance).value, 0.2);
    for (int a = 0; a < 3; ++a) {
        Parameter& turn = m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingTurn + a));
        Parameter& shift = m.ring(r, static_cast<OrbitModel::RingPart>(OrbitModel::SittingShift + a));
        turn.release(turn.value, 0.3);
        shift.release(shift.value, 0.1);
    }
}

Candidate RingAligner::climbed(const Candidate& c, Orbit orbit) const {
    Candidate out = c;
    out.orbit = orbit;
    OrbitModel& m = out.fit.model;
    if (orbit == Orbit::HandHeld)
        for (const auto& [shared, own] :
             {std::pair{OrbitModel::RingPan, OrbitModel::Pan}, {OrbitModel::RingTilt, OrbitModel::Tilt}, {OrbitModel::RingRoll, OrbitModel::Roll}}) {
            for (size_t i = 0; i < n_; ++i) m.of(i, own).value += m.ring(static_cast<size_t>(m.ring_of(i)), shared).value;
            for (size_t r = 0; r < m.rings(); ++r) m.ring(r, shared).hold(0);
        }
    free_parts(m, orbit);
    return out;
}

OrbitModel RingAligner::given_cameras(const Similarity& world_from_given) const {
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
        free_own_lens(m, i, diagonal);
    }
    return m;
}

std::vector<RingAligner::Start> RingAligner::starts() const {
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

void RingAligner::fit(Candidate& c, const CoherencePass& pass, uint64_t seed) {
    c.fit.points = silhouettes_.contour(pass.scale, pass.points, seed);
    refine(c.fit, silhouettes_, pass, progress_);
}

std::vector<Turn> RingAligner::turns() const {
    if (o_.direction != Turn::Auto) return {o_.direction};
    return {Turn::Counterclockwise, Turn::Clockwise};
}

bool RingAligner::settled(const Best& best, double good_px) {
    std::vector<double> found;
    for (const auto& [turn, c] : best) found.push_back(c.typical_px());
    std::sort(found.begin(), found.end());
    return !found.empty() && found.front() < good_px && (found.size() == 1 || found.back() > 2 * found.front() + 0.5 * good_px);
}

Candidate& RingAligner::lead(Best& best) {
    return std::min_element(best.begin(), best.end(), [](const auto& a, const auto& b) { return a.second.typical_px() < b.second.typical_px(); })->second;
}

int RingAligner::search(Orbit orbit, const std::vector<Start>& from, Best& best, int misses) {
    std::vector<std::pair<Turn, double>> found;
    const auto agreeing = [&] {
        const Candidate& c = lead(best);
        return static_cast<int>(std::count_if(found.begin(), found.end(),
                                              [&](const auto& f) { return f.first == c.turn && f.second < 1.2 * c.typical_px() + 0.01 * coarse().scale; }));
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
            trace("%s %s%s arc %.0f f x%.2f e %.0f%s: %.3f px, f x%.3f", name_of(orbit), name_of(turn), misses ? " robust" : "", s.arc_deg,
                  std::exp(s.ln_focal), s.elevation_rad / kRadians, s.uneven ? " uneven" : "", c.typical_px(),
                  std::exp(c.fit.model.global(OrbitModel::LnFocal).value));
            found.emplace_back(turn, c.typical_px());
            const auto known = best.find(turn);
            if (known == best.end() || c.typical_px() < known->second.typical_px()) best[turn] = std::move(c);
        }
    }
    return agreeing();
}

void RingAligner::polish(Candidate& c) {
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
    trace("%s %s polished: %.4f px after %.4f, f %.1f", name_of(c.orbit), name_of(c.turn), c.rms_px(), after_middle,
          c.fit.model.focal_px(silhouettes_.seen().front()));
}

void RingAligner::settle(Candidate& c) {
    CoherencePass pass = coarse();
    pass.misses = c.misses;
    fit(c, pass, 6);
    polish(c);
    place_bad(c, middle());
    // They may have been led astray before they were known to be bad: from its neighbours' places, each has a second chance. (Where a neighbour is missing too
    // the hull bulges, and bears many places.)
    const std::vector<size_t>& seen = silhouettes_.seen();
    std::vector<size_t> alone;
    for (size_t k = 0; k < seen.size(); ++k)
        if (silhouettes_.bad(seen[k]) && !silhouettes_.bad(seen[(k + 1) % seen.size()]) && !silhouettes_.bad(seen[(k + seen.size() - 1) % seen.size()]))
            alone.push_back(seen[k]);
    if (alone.empty()) return;
    Candidate anew = c;
    for (size_t i : alone) start_anew(anew, i);
    place_bad(anew, coarse());
    place_bad(anew, middle());
    const std::vector<double> before = outside_of_bad(c), after = outside_of_bad(anew);
    for (size_t i : alone)
        if (after[i] < before[i]) c.fit.model.take_view(i, anew.fit.model);
}

std::vector<double> RingAligner::outside_of_bad(const Candidate& c) {
    const CoherencePass pass = middle();
    const std::vector<ContourPoint> points = silhouettes_.contour(pass.scale, pass.points, 8, 0, Silhouettes::Which::Bad);
    const std::vector<Touch> touches = touches_of(silhouettes_, c.fit.model, points, pass);
    std::vector<double> out(n_, 0);
    for (size_t p = 0; p < points.size(); ++p)
        if (!std::isnan(touches[p].residual_px)) out[static_cast<size_t>(points[p].view)] += std::clamp(touches[p].residual_px, 0.0, pass.huber_px);
    return out;
}

void RingAligner::choose_key_views() {
    const std::vector<size_t>& seen = silhouettes_.seen();
    if (seen.size() <= kKeyViews) return;
    for (const size_t i : seen) silhouettes_.set_bad(i, true);
    for (size_t k = 0; k < kKeyViews; ++k) silhouettes_.set_bad(seen[k * seen.size() / kKeyViews], false);
}

void RingAligner::place_others(std::initializer_list<Best*> candidates) {
    std::vector<size_t> others;
    for (const size_t i : silhouettes_.seen())
        if (silhouettes_.bad(i)) others.push_back(i);
    if (others.empty()) return;
    const auto count_as_bad = [&](bool bad) {
        for (const size_t i : others) silhouettes_.set_bad(i, bad);
    };
    for (Best* best : candidates)
        for (auto& [turn, c] : *best) {
            count_as_bad(false);
            free_parts(c.fit.model, c.orbit);
            count_as_bad(true);
            for (CoherencePass pass : {coarse(), middle()}) {
                pass.points /= 2;
                pass.misses = c.misses;
                place_bad(c, pass);
            }
            if (c.misses > 0) c.misses = robust_misses(n_);
        }
    count_as_bad(false);
}

void RingAligner::place_bad(Candidate& c, const CoherencePass& pass) {
    Candidate alone = c;
    alone.fit.points = silhouettes_.contour(pass.scale, 2 * pass.points, 7, 0, Silhouettes::Which::Bad);
    if (alone.fit.points.empty()) return;
    OrbitModel& m = alone.fit.model;
    for (const size_t p : m.free()) m.at(p).sigma = 0;
    for (size_t i : silhouettes_.seen())
        if (silhouettes_.bad(i))
            for (int part = 0; part < OrbitModel::kViewParts; ++part)
                m.of(i, static_cast<OrbitModel::ViewPart>(part)).sigma = c.fit.model.of(i, static_cast<OrbitModel::ViewPart>(part)).sigma;
    if (m.free().empty()) return;
    refine(alone.fit, silhouettes_, pass, progress_);
    for (size_t i : silhouettes_.seen())
        if (silhouettes_.bad(i)) c.fit.model.take_view(i, m);
}

void RingAligner::trim(CoherenceFit& f) {
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

double RingAligner::held_out_px(const Candidate& c) {
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

namespace {

int unknowns(const Candidate& c) { return static_cast<int>(c.fit.model.free().size()); }

}  // namespace

void RingAligner::search_motions(Best& table, Best& hand) {
    const std::vector<Start> all = starts();
    choose_key_views();
    const bool any = o_.orbit == Orbit::Auto;
    if (any || o_.orbit != Orbit::HandHeld) agreeing_ = search(Orbit::Turntable, {all.front()}, table);
    if (any || o_.orbit == Orbit::HandHeld) {
        if (any && settled(table, good_coarse_px())) {
            Candidate up = climbed(lead(table), Orbit::HandHeld);
            fit(up, coarse(), 1);
            hand[up.turn] = std::move(up);
        } else {
            agreeing_ = search(Orbit::HandHeld, {all.front()}, hand);
            if (!settled(hand, good_coarse_px()) && robust_misses(std::min(n_, kKeyViews)) > 0) {
                // A few silhouettes may be wrong: does it work without listening to all of them?
                Best robust;
                const int agree = search(Orbit::HandHeld, {all.begin(), all.begin() + std::min<long>(3, static_cast<long>(all.size()))}, robust,
                                         robust_misses(std::min(n_, kKeyViews)));
                if (settled(robust, good_coarse_px())) hand = robust, agreeing_ = agree;
            }
            if (lead(hand).misses == 0 && (!settled(hand, good_coarse_px()) || agreeing_ < 2))
                agreeing_ += search(Orbit::HandHeld, {all.begin() + 1, all.end()}, hand);
        }
    }
    progress_.step(3);
    if (!table.empty() && !settled(table, good_coarse_px()) && (hand.empty() || !settled(hand, good_coarse_px())))
        agreeing_ = search(Orbit::Turntable, {all.begin() + 1, all.end()}, table);
    progress_.step(1);
}

std::vector<Candidate> RingAligner::ladder_of(Best& table, Best& hand, double best_coarse, std::vector<AlignRung>& rungs) {
    const bool any = o_.orbit == Orbit::Auto;
    const auto in_the_race = [&](double rms) { return rms < 5 * best_coarse + 0.1 * coarse().scale; };
    std::vector<Candidate> ladder;
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
    return ladder;
}

size_t RingAligner::choose_rung(const std::vector<Candidate>& ladder, std::vector<AlignRung>& rungs) {
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
    return chosen;
}

void RingAligner::add_other_direction(const Candidate& winner, Best& table, Best& hand, double best_coarse, Best& out) {
    for (Best* tried : {&hand, &table})
        for (auto& [turn, c] : *tried)
            if (turn != winner.turn && !out.count(turn) && (c.orbit == winner.orbit || hand.empty() || table.empty())) {
                if (c.typical_px() < 4 * best_coarse + good_coarse_px()) polish(c);
                out[turn] = c;
            }
    if (o_.direction == Turn::Auto && out.size() == 1) {
        const Turn other = winner.turn == Turn::Clockwise ? Turn::Counterclockwise : Turn::Clockwise;
        Candidate c{{}, winner.orbit, other};
        c.fit.model = start(winner.orbit, other,
                            {o_.arc_deg, winner.fit.model.global(OrbitModel::LnFocal).value, winner.fit.model.ring(0, OrbitModel::Elevation).value, false});
        fit(c, coarse(), 1);
        if (c.typical_px() < 4 * best_coarse + good_coarse_px()) polish(c);
        out[other] = c;
    }
}

RingAligner::Best RingAligner::run(std::vector<AlignRung>& rungs) {
    Best table, hand;
    search_motions(table, hand);
    const double best_coarse = std::min(table.empty() ? INFINITY : lead(table).typical_px(), hand.empty() ? INFINITY : lead(hand).typical_px());
    place_others({&table, &hand});
    const std::vector<Candidate> ladder = ladder_of(table, hand, best_coarse, rungs);
    progress_.step(3);
    Best out;
    const Candidate& winner = ladder[choose_rung(ladder, rungs)];
    out[winner.turn] = winner;
    add_other_direction(winner, table, hand, best_coarse, out);
    progress_.step(1);
    return out;
}

double RingAligner::find_mask_noise_px() {
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

}  // namespace vdbcarve
