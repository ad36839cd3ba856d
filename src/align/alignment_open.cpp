// SPDX-License-Identifier: Apache-2.0
// What silhouettes leave open.
#include "align/alignment.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>
#include <random>

#include "base/statistics.h"

namespace vdbcarve {

void Alignment::disturb() {
    const std::vector<size_t> seen = silhouettes_.good();  // bad ones constrain nobody: where they stand says nothing
    std::mt19937_64 random(o_.seed);
    std::normal_distribution<double> normal;
    CoherencePass quick = aligner_.middle();
    quick.sigma_px = std::clamp(2 * c_.rms_px(), 0.1, 3.0);
    quick.points = aligner_.points_of(50);
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

void Alignment::hold_unobservable() {
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

void Alignment::find_symmetry() {
    if (!out_.angles_observable || o_.method != AlignMethod::Coherence) return;
    // A sixth of the views, turned on and then aimed anew (the axis need not be the object's), before the silhouettes of all the others: do they fit there
    // as well? They may not go away: what is far enough fits anywhere.
    const std::vector<size_t> good = silhouettes_.good();
    std::vector<size_t> tried;
    const size_t count = std::min<size_t>(12, (good.size() + 5) / 6);
    for (size_t k = 0; k < count; ++k) tried.push_back(good[k * good.size() / count]);
    const CoherencePass pass = aligner_.middle();
    const Candidate home = aligner_.climbed(c_, Orbit::HandHeld);
    const auto outside = [&](double turn_rad) {
        Candidate moved = home;
        for (size_t i : tried) {
            silhouettes_.set_bad(i, true);
            OrbitModel& m = moved.fit.model;
            m.of(i, OrbitModel::Azimuth).value += turn_rad;
            for (const auto part : {OrbitModel::Azimuth, OrbitModel::LnDistance, OrbitModel::Height}) m.of(i, part).sigma = 0;
        }
        aligner_.place_bad(moved, pass);
        std::vector<ContourPoint> points = silhouettes_.contour(pass.scale, pass.points, 61, 0, Silhouettes::Which::Bad);
        std::erase_if(points, [&](const ContourPoint& p) { return std::find(tried.begin(), tried.end(), static_cast<size_t>(p.view)) == tried.end(); });
        std::vector<double> all;
        for (const Touch& t : touches_of(silhouettes_, moved.fit.model, points, pass))
            if (!std::isnan(t.residual_px)) all.push_back(std::max(0.0, t.residual_px));
        for (size_t i : tried) silhouettes_.set_bad(i, false);
        return percentile(all, 0.85);
    };
    const double here = outside(0);
    for (const int fold : {2, 3, 4}) {
        const double there = outside(2 * std::numbers::pi / fold);
        aligner_.trace("turned by 1/%d: %.3f px outside, as it is %.3f", fold, there, here);
        if (there < 2 * here + 0.004 * silhouettes_.size_px()) out_.symmetry = fold;
    }
}

}  // namespace vdbcarve
