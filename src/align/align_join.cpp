// SPDX-License-Identifier: Apache-2.0
#include "align/align_join.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

/// Places ring `r` of the joint model by a turn of its world around its outline's middle, onto the outline of the first.
void place_ring(OrbitModel& m, size_t r, const std::vector<Group>& groups, const Mat3d& scene_from_ring, const Outline& scene, const Outline& ring,
                const OrbitModel& own) {
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

}  // namespace

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
        if (end > sitting_ends[static_cast<size_t>(sitting)])
            throw UsageError("--rings and --sittings: a ring goes over the end of sitting " + std::to_string(sitting) +
                             ". Remedy: rings within each sitting, like --sittings 24,24 --rings 12,12,24");
        out.push_back({first, end - first, sitting});
        first = end;
    }
    return out;
}

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

namespace {

/// Rings are aligned one by one, put into one model, and turned until they fit together.
class GroupJoin {
  public:
    GroupJoin(const Views& given, const std::vector<MaskView>& masks, const AlignOptions& o, const std::vector<Group>& groups, RingAligner& joint,
              std::vector<AlignRung>& rungs, std::vector<std::string>& failures, Progress& progress)
        : given_(given), masks_(masks), o_(o), groups_(groups), joint_(joint), rungs_(rungs), failures_(failures), progress_(progress), random_(o.seed) {}

    RingAligner::Best run() {
        align_each();
        make_model();
        const Outline scene = outline_of(leads_[0].fit);
        for (size_t r = 1; r < groups_.size(); ++r) place(r, scene);
        OrbitModel& m = all_.fit.model;
        joint_.free_parts(m, all_.orbit);
        m.global(OrbitModel::LnArc).hold(0);
        joint_.fit(all_, joint_.coarse(), 1);
        joint_.polish(all_);
        rungs_.push_back({all_.orbit, all_.turn, all_.rms_px(), 0, static_cast<int>(m.free().size())});
        RingAligner::Best out;
        out[all_.turn] = all_;
        for (auto& [turn, c] : parts_.front())
            if (turn != all_.turn) out[turn] = c;  // for its residual: the others were only tried in the first one's direction
        return out;
    }

  private:
    void align_each() {
        Turn direction = o_.direction;
        for (const Group& g : groups_) {
            Views views = given_;
            views.views = {given_.views.begin() + static_cast<long>(g.first), given_.views.begin() + static_cast<long>(g.first + g.count)};
            const std::vector<MaskView> some(masks_.begin() + static_cast<long>(g.first), masks_.begin() + static_cast<long>(g.first + g.count));
            AlignOptions own = o_;
            own.rings.clear();
            own.sittings.clear();
            own.direction = direction;
            if (!o_.angles_deg.empty())
                own.angles_deg = {o_.angles_deg.begin() + static_cast<long>(g.first), o_.angles_deg.begin() + static_cast<long>(g.first + g.count)};
            RingAligner aligner(views, some, own, progress_);
            std::vector<AlignRung> tried;
            parts_.push_back(aligner.run(tried));
            leads_.push_back(RingAligner::lead(parts_.back()));
            if (leads_.back().rms_px() > std::max(1.5, aligner.silhouettes().size_px() / 250))
                failures_.push_back(text_of("the ring of %s to %s does not fit together by itself (%.2f px)", views.views.front().name.c_str(),
                                            views.views.back().name.c_str(), leads_.back().rms_px()));
            direction = leads_.back().turn;
        }
    }

    /// One model of all views: angles as found, everything else where it was.
    void make_model() {
        std::vector<OrbitView> views;
        for (size_t r = 0; r < groups_.size(); ++r)
            for (size_t k = 0; k < groups_[r].count; ++k) {
                OrbitView v = leads_[r].fit.model.view(k);
                v.azimuth_rad = leads_[r].fit.model.azimuth(k);
                v.ring = static_cast<int>(r);
                views.push_back(v);
            }
        all_ = leads_[0];
        OrbitModel& m = all_.fit.model = OrbitModel(views, static_cast<int>(groups_.size()));
        for (const Candidate& c : leads_)
            if (c.orbit > all_.orbit) all_.orbit = c.orbit;
        const double share = 1.0 / static_cast<double>(groups_.size());
        for (size_t r = 0; r < groups_.size(); ++r) {
            const OrbitModel& own = leads_[r].fit.model;
            for (const auto which : {OrbitModel::LnFocal, OrbitModel::CentreX, OrbitModel::CentreY}) m.global(which).value += share * own.global(which).value;
            for (const auto part : {OrbitModel::Elevation, OrbitModel::RingHeight, OrbitModel::RingPan, OrbitModel::RingTilt, OrbitModel::RingRoll})
                m.ring(r, part).value = own.ring(0, part).value;
            for (size_t k = 0; k < groups_[r].count; ++k)
                for (int part = OrbitModel::Pan; part < OrbitModel::kViewParts; ++part) {
                    const auto p = static_cast<OrbitModel::ViewPart>(part);
                    m.of(groups_[r].first + k, p).value = own.of(k, p).value;
                    if (all_.orbit == Orbit::HandHeld && leads_[r].orbit != Orbit::HandHeld)
                        for (const auto& [shared, mine] : {std::pair{OrbitModel::RingPan, OrbitModel::Pan},
                                                           {OrbitModel::RingTilt, OrbitModel::Tilt},
                                                           {OrbitModel::RingRoll, OrbitModel::Roll}})
                            if (p == mine) m.of(groups_[r].first + k, p).value += own.ring(0, shared).value;
                }
            if (all_.orbit == Orbit::HandHeld)
                for (const auto part : {OrbitModel::RingPan, OrbitModel::RingTilt, OrbitModel::RingRoll}) m.ring(r, part).hold(0);
        }
    }

    /// Ways in which a ring may lie to the first one.
    std::vector<Mat3d> turns_of(size_t r) {
        std::vector<Mat3d> turns;
        if (groups_[r].sitting == groups_[0].sitting)
            for (int k = 0; k < 90; ++k) turns.push_back(Eigen::AngleAxisd(4 * k * kRadians, Vec3d::UnitZ()).toRotationMatrix());
        else
            for (int k = 0; k < 1200; ++k) {  // about 18 degrees apart
                std::normal_distribution<double> normal;
                const Eigen::Quaterniond q(normal(random_), normal(random_), normal(random_), normal(random_));
                turns.push_back(q.normalized().toRotationMatrix());
            }
        return turns;
    }

    /// Those ways, and how badly contours of each of the two fit the other's silhouettes; the best first.
    std::vector<std::pair<double, size_t>> scores_of(size_t r, const std::vector<Mat3d>& turns, const Outline& scene, const Outline& own) {
        Silhouettes& s = joint_.silhouettes();
        const CoherencePass pass = joint_.coarse();
        OrbitModel& m = all_.fit.model;
        const auto mixed = [&](size_t looking, size_t asked, size_t count) {
            std::vector<ContourPoint> points = s.contour(pass.scale, count, 51);
            const Group& g = groups_[looking];
            std::erase_if(points,
                          [&](const ContourPoint& p) { return static_cast<size_t>(p.view) < g.first || static_cast<size_t>(p.view) >= g.first + g.count; });
            std::vector<CoherenceView> some = s.at_scale(pass.scale);
            for (size_t i = 0; i < some.size(); ++i)
                if (i < groups_[asked].first || i >= groups_[asked].first + groups_[asked].count) some[i].field = nullptr;
            return std::pair{points, some};
        };
        const size_t few = std::max<size_t>(2, 60 / groups_[r].count);
        const auto [from_ring, first_views] = mixed(r, 0, few);
        const auto [from_first, ring_views] = mixed(0, r, std::max<size_t>(2, 60 / groups_[0].count));
        const auto score = [&, &from_ring = from_ring, &first_views = first_views, &from_first = from_first,
                            &ring_views = ring_views](const OrbitModel& model) {
            const std::vector<OrbitCamera> cameras = model.cameras();
            double sum = 0;
            for (const auto& [points, some] : {std::pair{&from_ring, &first_views}, {&from_first, &ring_views}})
                for (const Touch& t : find_touches(*some, cameras, *points, {ball_radius(s, model), 0, 2 * pass.resolution_px}, {}))
                    if (!std::isnan(t.residual_px)) sum += std::min(std::max(0.0, t.residual_px), 4 * pass.huber_px) / static_cast<double>(points->size());
            return sum;
        };
        std::vector<std::pair<double, size_t>> scored;
        for (size_t k = 0; k < turns.size(); ++k) {
            place_ring(m, r, groups_, turns[k], scene, own, leads_[r].fit.model);
            scored.emplace_back(score(m), k);
            progress_.check();
        }
        std::sort(scored.begin(), scored.end());
        return scored;
    }

    /// How ring r lies to the first.
    void place(size_t r, const Outline& scene) {
        Silhouettes& s = joint_.silhouettes();
        const CoherencePass pass = joint_.coarse();
        OrbitModel& m = all_.fit.model;
        const Outline own = outline_of(leads_[r].fit);
        const std::vector<Mat3d> turns = turns_of(r);
        const std::vector<std::pair<double, size_t>> scored = scores_of(r, turns, scene, own);
        // The best few, each led to its own optimum with only the ring's place free.
        Candidate best;
        double least = INFINITY, second = INFINITY;
        Mat3d best_turn = Mat3d::Identity();
        for (size_t k = 0; k < std::min<size_t>(8, scored.size()); ++k) {
            Candidate c = all_;
            place_ring(c.fit.model, r, groups_, turns[scored[k].second], scene, own, leads_[r].fit.model);
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
            refine(c.fit, s, pass, progress_);
            for (size_t i = 0; i < s.count(); ++i) s.set_bad(i, was[i]);
            const double rms = c.rms_px();
            joint_.trace("ring %zu: score %.3f, then %.3f px", r, scored[k].first, rms);
            const Mat3d turn = c.fit.model.camera(groups_[r].first).camera_from_world;
            const bool same = k > 0 && Eigen::AngleAxisd(turn * best_turn.transpose()).angle() < 5 * kRadians;
            if (rms < least) {
                if (!same) second = least;
                least = rms, best = c, best_turn = turn;
            } else if (!same) {
                second = std::min(second, rms);
            }
        }
        if (second < 1.3 * least + 0.05 * pass.scale)
            failures_.push_back(text_of("how the views from %s on lie to the first ones cannot be told: two ways fit alike (%.2f and %.2f px)",
                                        given_.views[groups_[r].first].name.c_str(), least, second));
        for (int part = 0; part < OrbitModel::kRingParts; ++part) {
            const auto p = static_cast<OrbitModel::RingPart>(part);
            if (best.fit.model.views() > 0) m.ring(r, p).value = best.fit.model.ring(r, p).value;
        }
        if (best.fit.model.views() > 0)
            for (size_t k = 0; k < groups_[r].count; ++k)
                m.of(groups_[r].first + k, OrbitModel::Height).value = best.fit.model.of(groups_[r].first + k, OrbitModel::Height).value;
    }

    const Views& given_;
    const std::vector<MaskView>& masks_;
    const AlignOptions& o_;
    const std::vector<Group>& groups_;
    RingAligner& joint_;
    std::vector<AlignRung>& rungs_;
    std::vector<std::string>& failures_;
    Progress& progress_;
    std::mt19937_64 random_;
    std::vector<RingAligner::Best> parts_;
    std::vector<Candidate> leads_;
    Candidate all_;
};

}  // namespace

RingAligner::Best join_groups(const Views& given, const std::vector<MaskView>& masks, const AlignOptions& o, const std::vector<Group>& groups,
                              RingAligner& joint, std::vector<AlignRung>& rungs, std::vector<std::string>& failures, Progress& progress) {
    return GroupJoin(given, masks, o, groups, joint, rungs, failures, progress).run();
}

}  // namespace vdbcarve
