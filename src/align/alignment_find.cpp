// SPDX-License-Identifier: Apache-2.0
// Cameras, by whatever method.
#include "align/alignment.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>

#include "align/align_join.h"
#include "align/feature_tracks.h"
#include "align/paper/align_paper.h"
#include "base/statistics.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

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

}  // namespace

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

std::vector<double> rms_of_tracks(const CoherenceFit& f) {
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    std::vector<double> out;
    for (const FeatureTrack& t : *f.tracks) out.push_back(place_of(cameras, t).rms_px());
    return out;
}

void Alignment::find() {
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
    Turn turn =
        sitting_of_.empty() ? RingAligner::lead(best_).turn : std::find_if(best_.begin(), best_.end(), [&](const auto& b) { return whole(b.second); })->first;
    if (o_.method == AlignMethod::Coherence && o_.features && mirrored_alike(best_[turn])) turn = direction_by_features(turn);
    c_ = best_[turn];
}

bool Alignment::mirrored_alike(const Candidate& c) const {
    if (o_.method == AlignMethod::Refine || o_.direction != Turn::Auto || by_features_) return false;
    return std::any_of(best_.begin(), best_.end(), [&](const auto& b) { return b.first != c.turn && b.second.typical_px() < 3 * c.typical_px() + 0.1; });
}

Turn Alignment::direction_by_features(Turn lead) {
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

void Alignment::fit_features(Candidate& c) {
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

std::vector<AlignedView> Alignment::judged() {
    CoherencePass pass = aligner_.fine(c_.typical_px());
    pass.misses = c_.misses;
    return judge_.views_of(c_.fit.model, pass);
}

}  // namespace vdbcarve
