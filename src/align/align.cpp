// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/align.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <random>

#include "align/align_join.h"
#include "align/mat/align_mat.h"
#include "align/align_options.h"
#include "align/align_scale.h"
#include "surface/coarse_hull.h"
#include "align/feature_tracks.h"
#include "mask/mask_consensus.h"
#include "align/paper/align_paper.h"
#include "align/ring_aligner.h"
#include "base/statistics.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/error.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {

namespace {

constexpr size_t kLeastVoters = 12;   ///< silhouettes, for one to be outvoted by the rest
constexpr size_t kFewViews = 12;      ///< fewer may leave angles open by degrees without any of the tests noticing
constexpr double kMostLnFocal = 1.5;  ///< a focal length 4.5 times its start's is no lens but a flight from perspective

/// Everything that is known about an alignment, once cameras are found.
class Judge {
  public:
    Judge(RingAligner& aligner, const Views& views) : aligner_(aligner), s_(aligner.silhouettes()), given_(views) {}

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
        const double own_limit = std::max({2.0, s_.size_px() / 200, 5 * median(own)}),
                     dissent_limit = std::clamp(5 * median(dissent), 0.008, robust ? 0.02 : 1.0);
        std::vector<std::pair<double, size_t>> worst;
        for (size_t i : s_.seen())
            if (!std::count(known.begin(), known.end(), i) && (views[i].residual_px > own_limit || views[i].dissent > dissent_limit))
                worst.push_back({std::max(views[i].residual_px / own_limit, views[i].dissent / dissent_limit), i});
        std::sort(worst.rbegin(), worst.rend());
        for (const auto& [how, i] : worst)
            aligner_.trace("contradicts: %zu own %.2f (limit %.2f) dissent %.4f (limit %.4f)", i, views[i].residual_px, own_limit, views[i].dissent,
                           dissent_limit);
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
};

Views with_cameras(const Views& given, const OrbitModel& model) {
    Views out = given;
    for (size_t i = 0; i < out.views.size(); ++i) {
        out.views[i].camera = model.camera(i).camera(model.view(i).width_px, model.view(i).height_px);
        out.views[i].sitting = "0";
        out.views[i].unused.clear();
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
        : given_(given),
          masks_(masks),
          o_(o),
          progress_(progress),
          aligner_(given, masks, o, progress),
          silhouettes_(aligner_.silhouettes()),
          judge_(aligner_, given) {}

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
        // Of several rings the other direction was tried with the first one only: it is there for its residual, not to be chosen.
        Turn turn = sitting_of_.empty() ? RingAligner::lead(best_).turn
                                        : std::find_if(best_.begin(), best_.end(), [&](const auto& b) { return whole(b.second); })->first;
        if (o_.method == AlignMethod::Coherence && o_.features && mirrored_alike(best_[turn])) turn = direction_by_features(turn);
        c_ = best_[turn];
    }

    /// Has cameras for all views.
    bool whole(const Candidate& c) const { return c.fit.model.views() == given_.views.size(); }

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
        for (const auto& [turn, c] : best_)
            if (whole(c)) votes[turn] = near_side(c.fit, tracks);
        if (votes.size() < best_.size()) return lead;
        for (const auto& [turn, v] : votes)
            aligner_.trace("%s: %zu features of %zu fit, %.0f %% of them on the near side", name_of(turn), v.matches, tracks.size(), 100 * v.share);
        const auto votes_for = [](const NearSide& v) { return static_cast<double>(v.matches) * v.share; };
        for (const auto& [turn, v] : votes) {
            const double others = std::accumulate(votes.begin(), votes.end(), 0.0,
                                                  [&, t = turn](double sum, const auto& w) { return w.first == t ? sum : sum + votes_for(w.second); });
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
        const auto fits = [](const AlignedView& v) { return v.residual_px < 1 && v.dissent < 0.004; };
        for (int round = 0; round < 6 && !bad.empty(); ++round) {
            for (size_t i : bad) silhouettes_.set_bad(i, true);
            aligner_.settle(c_);
            // Judged anew with all of them: others may fit now, or turn out to be wrong.
            for (size_t i : silhouettes_.seen()) silhouettes_.set_bad(i, false);
            out_.aligned = judged();
            // What contradicts the rest without having taken part stays out.
            std::erase_if(bad, [&](size_t i) { return fits(out_.aligned[i]); });
            const std::vector<size_t> now = judge_.contradicting(out_.aligned, bad, c_.misses > 0);
            const bool settled = now == bad;
            bad = now;
            if (settled) break;
        }
        if (!bad.empty() || c_.misses > 0) {
            for (size_t i : bad) silhouettes_.set_bad(i, true);
            c_.misses = 0;
            aligner_.settle(c_);
            // One that is wrong draws touches away from where they belong, and its neighbours seem wrong too: each is asked alone, now that cameras are better.
            // Who fits was named for nothing, and with it back in its place the next may fit.
            std::map<size_t, double> dissent;
            while (!bad.empty()) {
                const std::vector<size_t> named = bad;
                dissent.clear();
                for (size_t i : named) {
                    silhouettes_.set_bad(i, false);
                    const AlignedView alone = judged()[i];
                    silhouettes_.set_bad(i, true);
                    if (fits(alone)) std::erase(bad, i);
                    else dissent[i] = alone.dissent;
                }
                if (bad.size() == named.size()) break;
                for (size_t i : named) silhouettes_.set_bad(i, std::find(bad.begin(), bad.end(), i) != bad.end());
                aligner_.settle(c_);
            }
            out_.aligned = judged();
            for (const auto& [i, share] : dissent) out_.aligned[i].dissent = share;
        }
        name_holes();
        if (o_.method == AlignMethod::Coherence && c_.orbit != Orbit::Turntable) move_strays();
        progress_.step(1);
    }

    /// A few views may have found a place of their own that the others cannot talk them out of: the rest settles without them, and they start anew from where
    /// their neighbours are.
    void move_strays() {
        std::vector<size_t> strays = silhouettes_.good();
        const size_t views = strays.size();
        std::vector<double> own;
        for (size_t i : strays) own.push_back(out_.aligned[i].residual_px);
        const double limit_px = std::max(0.1, 4 * median(own));
        std::erase_if(strays, [&](size_t i) { return !(out_.aligned[i].residual_px > limit_px); });
        if (strays.empty() || 6 * strays.size() > views) return;
        Candidate anew = c_;
        for (size_t i : strays) silhouettes_.set_bad(i, true);
        aligner_.settle(anew);
        for (size_t i : strays) silhouettes_.set_bad(i, false);
        aligner_.polish(anew);
        aligner_.trace("%zu strays started anew: %.4f px, before %.4f", strays.size(), anew.rms_px(), c_.rms_px());
        if (anew.rms_px() > 0.8 * c_.rms_px()) return;
        c_ = anew;
        out_.aligned = judged();
    }

    /// A hole within a silhouette moves no camera and pushes few contours, but carves: what all views but one keep, deep within what that one calls background,
    /// is a mistake of that one.
    void name_holes() {
        const std::vector<size_t>& seen = silhouettes_.seen();
        if (seen.size() < kLeastVoters || c_.rms_px() > 0.01 * silhouettes_.size_px()) return;
        const std::vector<MaskView> trusted = trusted_masks(out_, masks_);
        Progress quiet;
        std::vector<Consensus> said;
        try {
            said = consensus_of(given_.names(), with_cameras(given_, c_.fit.model).cameras(), trusted, trusted, 1, quiet);
        } catch (const Interrupted&) {
            throw;
        } catch (const Error&) {
            return;  // there is no hull, or it has no bounds; other tests say why
        }
        std::vector<size_t> holed;
        for (size_t i : seen) {
            if (said[i].carved_px > 0) aligner_.trace("%zu carves alone: %.0f of 250 x 250", i, said[i].carved_px);
            if (said[i].carved_px >= Consensus::kLeast_px) holed.push_back(i);
        }
        if (holed.empty()) return;
        if (4 * holed.size() > seen.size()) {  // no mistake of single ones
            out_.failures.push_back(
                text_of("%zu of %zu silhouettes each call background what nearly all others keep: %s. Remedy: is it one of these? Several rings or sittings "
                        "(--rings, --sittings), masks of different objects, holes in most masks",
                        holed.size(), seen.size(), some_of(names_of(holed)).c_str()));
            return;
        }
        for (size_t i : holed) silhouettes_.set_bad(i, true);
        aligner_.settle(c_);
        out_.aligned = judged();
    }

    // ------------------------------------------------------------------------------------- what is left open

    /// The same result from disturbed angles?
    void disturb() {
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

    // ------------------------------------------------------------------------------------- result

    void describe() {
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

    void judge() {
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

    std::vector<std::string> worst_views() const {
        std::vector<size_t> order = silhouettes_.seen();
        std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return out_.aligned[a].residual_px > out_.aligned[b].residual_px; });
        order.resize(std::min<size_t>(3, order.size()));
        return names_of(order);
    }

    std::vector<std::string> names_of(const std::vector<size_t>& views) const {
        std::vector<std::string> out;
        for (size_t i : views) out.push_back(given_.views[i].name);
        return out;
    }

    /// What may be the matter where silhouettes do not fit together.
    std::string why_not() const {
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

    /// Not round, but with views among which it looks round (a cup, its handle in front): those may stand anywhere, and carve what they do not see.
    void loose_views() {
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

    void undecided_direction() {
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

    const Views& given_;
    const std::vector<MaskView>& masks_;
    const AlignOptions& o_;
    Progress& progress_;
    RingAligner aligner_;
    Silhouettes& silhouettes_;
    Judge judge_;
    Best best_;
    Candidate c_;                  ///< the one that is believed
    bool by_features_ = false;     ///< texture decided the direction
    Similarity world_from_given_;  ///< of Refine
    std::vector<int> sitting_of_;  ///< where there are several rings
    AlignResult out_;
};

}  // namespace

AlignResult align(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress) {
    check_align_options(options, views, masks.size());
    if (options.known_length) check_known_length(views, masks, *options.known_length);
    AlignResult out = options.method == AlignMethod::Mat ? align_to_mat(views, options, progress) : Alignment(views, masks, options, progress).run();
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
    out.views.unverified = out.failures;
    return out;
}

}  // namespace vdbcarve
