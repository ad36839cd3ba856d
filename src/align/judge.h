// SPDX-License-Identifier: Apache-2.0
// What an alignment's silhouettes say about each view once cameras are found. Private.
#pragma once

#include <vector>

#include "align/ring_aligner.h"

namespace vdbcarve {

/// Everything that is known about an alignment, once cameras are found.
class Judge {
  public:
    Judge(RingAligner& aligner, const Views& views) : aligner_(aligner), s_(aligner.silhouettes()), given_(views) {}

    /// Residuals by view, of points drawn anew.
    std::vector<AlignedView> views_of(const OrbitModel& model, const CoherencePass& pass);

    double dissent_limit_px() const { return std::max(2.0, s_.size_px() / 200); }

    /// Views whose silhouettes contradict the others': those that are not much less bad than the worst, for a bad silhouette drags its
    /// neighbours along. At most a quarter of all.
    std::vector<size_t> contradicting(const std::vector<AlignedView>& views, const std::vector<size_t>& known, bool robust) const;

  private:
    RingAligner& aligner_;
    Silhouettes& s_;
    const Views& given_;
};

}  // namespace vdbcarve
