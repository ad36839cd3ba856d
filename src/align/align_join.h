// SPDX-License-Identifier: Apache-2.0
// Several rings, and several sittings of the object: each is aligned alone, then how they lie to each other is found. Private.
#pragma once

#include <string>
#include <vector>

#include "align/ring_aligner.h"

namespace vdbcarve {

/// Views that stand in one ring: they are aligned by themselves first.
struct Group {
    size_t first, count;
    int sitting;
};

/// As --rings and --sittings say. Throws UsageError for a ring that goes over a sitting's end.
std::vector<Group> groups_of(const AlignOptions& o, size_t views);

/// What was seen of the object in a ring's own world.
struct Outline {
    Vec3d middle = Vec3d::Zero();
    double radius = 0;  ///< rms
};
Outline outline_of(const CoherenceFit& f);

/// Aligns each ring alone, finds how their worlds lie to each other by trying turns (about the axis within a sitting, all of them between sittings),
/// then everything together.
RingAligner::Best join_groups(const Views& given, const std::vector<MaskView>& masks, const AlignOptions& o, const std::vector<Group>& groups,
                              RingAligner& joint, std::vector<AlignRung>& rungs, std::vector<std::string>& failures, Progress& progress);

}  // namespace vdbcarve
