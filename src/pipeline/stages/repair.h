// SPDX-License-Identifier: Apache-2.0
// Stage `repair`: masks that contradict all others are mended.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct RepairMasks {
    static constexpr const char* kName = "repair";
    using Result = Silhouettes;

    const Shoot& shoot;
    const Silhouettes& masks;

    Key key() const { return Key(kName).of(masks.key).of(shoot.views.cameras()).of(masks.used); }
    Silhouettes run(Run& run);
    void save(Slot& slot, Silhouettes& made) const;
    Silhouettes load(const Slot& slot) const;

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    std::vector<size_t> mended_{};
};

/// Masks that contradict all others carve all the same: one view may know what no other can. They are named.
void warn_of_broken_masks(const Shoot& shoot, const Silhouettes& masks, Progress& progress);

}  // namespace vdbcarve::pipeline
