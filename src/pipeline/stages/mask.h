// SPDX-License-Identifier: Apache-2.0
// Stage `mask`: a silhouette for every view.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct MakeMasks {
    static constexpr const char* kName = "mask";
    using Result = Silhouettes;

    const Shoot& shoot;
    const MaskOptions& options;

    /// Looks for masks in OUT that the user changed, and hashes every file that a mask is made from.
    void prepare(Run& run);
    Key key() const;
    Silhouettes run(Run& run);
    void save(Slot& slot, Silhouettes& made) const;
    Silhouettes load(const Slot& slot) const;
    void report(const Silhouettes& made, nlohmann::json& report) const;

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    Silhouettes known_{};  ///< what prepare() finds
    std::vector<std::string> view_keys_{};

  private:
    /// All that one view's mask depends on.
    Key key_of_view(size_t i, const MaskOptions& settled) const;
    /// Masks that earlier runs made, of fewer photographs, by what they were made from.
    std::vector<std::optional<KnownMask>> known_masks(const Store& store) const;
};

/// Views with a mask, but for those that cameras.json or align() says not to use. Before cameras are looked for every silhouette is asked.
std::vector<size_t> choose_used(const ReconstructOptions& options, const Shoot& shoot, const Silhouettes& masks, Progress& progress);

}  // namespace vdbcarve::pipeline
