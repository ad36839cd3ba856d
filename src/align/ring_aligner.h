// SPDX-License-Identifier: Apache-2.0
// Finding the cameras of views that all stand in one ring: passes from coarse to fine, starts, directions, the ladder of motion models. Private.
#pragma once

#include <cmath>
#include <initializer_list>
#include <map>
#include <string>
#include <vector>

#include "align/coherence_fit.h"
#include "align/orbit_model.h"
#include "base/text.h"
#include "vdbcarve/align.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {

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
    using Best = std::map<Turn, Candidate>;  ///< the best of each direction

    /// Throws InputError for fewer than 4 views with a silhouette.
    RingAligner(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress);

    Silhouettes& silhouettes() { return silhouettes_; }

    // ------------------------------------------------------------------------------------- passes

    /// So many are searched with: 36 find a hand-held orbit in every case of docs/stages/align.md, and time grows with their square.
    static constexpr size_t kKeyViews = 48;

    /// Contour points a view: `points`, and beyond the number of key views fewer, since each point is held against all other views and all of them together
    /// need no more points.
    size_t points_of(size_t points) const;
    CoherencePass coarse() const;
    CoherencePass middle() const;
    /// Weighs residuals by what they turned out to be.
    CoherencePass fine(double rms_px) const;
    /// A coarse pass that ends below this has found its way.
    double good_coarse_px() const { return 0.15 * coarse().scale + mask_noise_px_; }
    double mask_noise_px() const { return mask_noise_px_; }

    // ------------------------------------------------------------------------------------- models

    /// Nominal views, the object turning counterclockwise (cameras clockwise) or the other way.
    std::vector<OrbitView> nominal(Turn direction, double arc_deg) const;
    static constexpr double kStartFocal = 1.4;  ///< of the longer side: 39 degrees, the middle of what phones and cameras have at objects

    bool focal_known() const { return o_.fov_deg > 0 || given_.views[silhouettes_.seen().front()].camera.intrinsics.fx > 0; }
    double focal_sigma() const { return focal_known() ? 0.15 : 0.6; }

    struct Start {
        double arc_deg, ln_focal, elevation_rad;
        bool uneven;  ///< the speed may change smoothly over the turn
    };

    OrbitModel start(Orbit orbit, Turn direction, const Start& from) const;

    /// Pan and tilt that bring the origin to the middle of a view's silhouette, rad.
    Vec2d aim_of(const OrbitModel& m, size_t i) const;
    /// Pan and tilt that bring the origin to the silhouettes' middles: of each where the camera is carried, of all together where it is fixed.
    void aim(OrbitModel& m, Orbit orbit) const;

    /// What may move, with priors: a hand's unsteadiness, a turntable's unevenness, a lens's tolerance. Priors of aims are around where they are.
    void free_parts(OrbitModel& m, Orbit orbit) const;

    /// --focal-varies, --centre-varies.
    void free_own_lens(OrbitModel& m, size_t i, double diagonal_px) const;

    /// Where a ring lies to the first: priors so wide that they only keep the numbers finite.
    static void free_ring(OrbitModel& m, size_t r);

    /// The same cameras on a higher rung.
    Candidate climbed(const Candidate& c, Orbit orbit) const;

    /// The views' own cameras, in a world where the object is near the origin and cameras at distance 1; what they may be wrong by.
    OrbitModel given_cameras(const Similarity& world_from_given) const;

    // ------------------------------------------------------------------------------------- search

    /// Where to start from, the likeliest first; what comes later is tried where these lead nowhere.
    std::vector<Start> starts() const;

    void fit(Candidate& c, const CoherencePass& pass, uint64_t seed);

    std::vector<Turn> turns() const;

    static bool settled(const Best& best, double good_px);
    static Candidate& lead(Best& best);

    /// Tries a range of starts in each direction until one has clearly found its way, then in that direction until two have found the same.
    /// Returns how many did.
    int search(Orbit orbit, const std::vector<Start>& from, Best& best, int misses = 0);

    void polish(Candidate& c);

    /// Optimises anew after silhouettes were taken out or in.
    void settle(Candidate& c);

    /// Cameras of bad silhouettes, from what of their contours is right, before the silhouettes that are not: they move alone.
    void place_bad(Candidate& c, const CoherencePass& pass);

    /// A view's own quantities as the mean of its two neighbours', aimed at its silhouette.
    void start_anew(Candidate& c, size_t i) const;

    /// How far contours of bad silhouettes are outside of the others' hull: the sum over points, beyond a few pixels each counts alike. By view.
    std::vector<double> outside_of_bad(const Candidate& c);

    /// Of many views only every so many-th takes part until `place_others` is called: the rest counts as bad.
    void choose_key_views();
    /// Ends that: in every candidate the others' cameras are found from their own contours alone, before the key views.
    void place_others(std::initializer_list<Best*> candidates);

    /// Leaves out points that fit so badly that their silhouette, not the cameras, must be wrong.
    static void trim(CoherenceFit& f);

    /// What a rung makes of contour sectors that it was not fitted to: errors of a mask are alike along its contour, so that freedom which only follows
    /// them gains nothing there.
    double held_out_px(const Candidate& c);

    /// So many silhouettes may be wrong and the rest still bounds the object from all sides.
    static int robust_misses(size_t views) { return views < 14 ? 0 : static_cast<int>(std::lround(0.08 * static_cast<double>(views))); }

    /// The best explanation in each direction; the rungs that were tried.
    Best run(std::vector<AlignRung>& rungs);

    /// Said with --verbose.
    template <class... Arguments>
    void trace(const char* format, Arguments... arguments) const {
        progress_.detail(text_of(format, arguments...));
    }

  private:
    // What run() does, in this order.

    /// The turntable's and the hand-held orbit's cameras, as far as each is asked for or promises something.
    void search_motions(Best& table, Best& hand);
    /// The rungs, each from the one below or from its own search, whichever is better.
    std::vector<Candidate> ladder_of(Best& table, Best& hand, double best_coarse, std::vector<AlignRung>& rungs);
    /// More unknowns have to earn their place.
    size_t choose_rung(const std::vector<Candidate>& ladder, std::vector<AlignRung>& rungs);
    /// The other direction gets as fair a chance as it has earned.
    void add_other_direction(const Candidate& winner, Best& table, Best& hand, double best_coarse, Best& out);

    /// Standard deviation of the contours around their own smooth course, pixels.
    double find_mask_noise_px();

    int scale_for(double samples) const { return std::max(1, static_cast<int>(std::lround(silhouettes_.size_px() / samples))); }

    const Views& given_;
    const AlignOptions& o_;
    Progress& progress_;
    Silhouettes silhouettes_;
    size_t n_;
    double mask_noise_px_ = 0;
    int agreeing_ = 0;  ///< starts that led to the same cameras
};

}  // namespace vdbcarve
