// SPDX-License-Identifier: Apache-2.0
// Stage `align`: cameras are found, or improved.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Align {
    static constexpr const char* kName = "align";
    static constexpr bool kReadBack = true;  // a camera file's numbers are not its cameras' last bits
    using Result = Shoot;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;  ///< not looked at where a mat is: it is looked for in the photographs, before there are masks

    /// Of a video, what is known of the object's turn at each frame.
    void prepare(Run& run);
    Key key() const;
    Shoot run(Run& run);
    void save(Slot& slot, const Shoot& made) const;
    Shoot load(const Slot& slot) const;
    void say(const Shoot& made, Progress& progress) const;
    void report(const Shoot& made, nlohmann::json& report) const { report["align"] = made.alignment->said; }

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    AlignOptions align_{};
    AlignResult found_{};

  private:
    /// Depths would be wrong by what silhouettes leave open, a few tenths of a pixel. (A mat's cameras are better than silhouettes can make them.)
    bool refines_for_stereo() const;
    bool by_mat() const { return options.align.method == AlignMethod::Mat; }
    std::vector<MaskView> mask_views() const { return by_mat() ? std::vector<MaskView>() : used_mask_views(shoot, masks); }
};

/// The shoot with the cameras that the object turned the other way would have. Only where Alignment::other_cameras is there.
Views other_direction(const Shoot& shoot);

}  // namespace vdbcarve::pipeline
