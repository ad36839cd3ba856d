// SPDX-License-Identifier: Apache-2.0
// One alignment by silhouettes: its steps share what they know. Each section below has a file of its own. Private.
#pragma once

#include <string>
#include <vector>

#include "align/judge.h"
#include "align/ring_aligner.h"

namespace vdbcarve {

inline constexpr double kMostLnFocal = 1.5;  ///< a focal length 4.5 times its start's is no lens but a flight from perspective

/// The given views with a model's cameras.
Views with_cameras(const Views& given, const OrbitModel& model);

/// How far each of a fit's tracks is from its place, pixels.
std::vector<double> rms_of_tracks(const CoherenceFit& f);

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

    AlignResult run();

  private:
    using Best = RingAligner::Best;

    // Cameras: alignment_find.cpp

    void find();

    /// Has cameras for all views.
    bool whole(const Candidate& c) const { return c.fit.model.views() == given_.views.size(); }

    /// The other direction explains the silhouettes nearly as well.
    bool mirrored_alike(const Candidate& c) const;

    /// Texture moves with the side of the object that is seen, the near one: cameras that put it on the far side turn the wrong way.
    Turn direction_by_features(Turn lead);

    /// Texture as further residuals: what is left of mismatches is dropped by how far from their places they are, twice.
    void fit_features(Candidate& c);

    std::vector<AlignedView> judged();

    // Bad silhouettes: alignment_bad.cpp

    /// They are named, and then ignored.
    void name_bad();

    /// A few views may have found a place of their own that the others cannot talk them out of: the rest settles without them, and they start anew from where
    /// their neighbours are.
    void move_strays();

    /// A hole within a silhouette moves no camera and pushes few contours, but carves: what all views but one keep, deep within what that one calls background,
    /// is a mistake of that one.
    void name_holes();

    // What is left open: alignment_open.cpp

    /// The same result from disturbed angles?
    void disturb();

    /// Where nothing says what the angles are, those that were meant are as good as any.
    void hold_unobservable();

    /// Does the object look the same after half a turn (or a third, a quarter)? Then a view could as well be another one.
    void find_symmetry();

    // Result: alignment_verdict.cpp

    void describe();

    void judge();

    std::vector<std::string> worst_views() const;

    std::vector<std::string> names_of(const std::vector<size_t>& views) const;

    /// What may be the matter where silhouettes do not fit together.
    std::string why_not() const;

    /// Not round, but with views among which it looks round (a cup, its handle in front): those may stand anywhere, and carve what they do not see.
    void loose_views();

    void undecided_direction();

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

}  // namespace vdbcarve
