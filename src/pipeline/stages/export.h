// SPDX-License-Identifier: Apache-2.0
// Stage `export`: the files of a result, and how well they agree with the silhouettes.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/slack.h"

namespace vdbcarve::pipeline {

/// What the stages made.
struct Made {
    const Shoot& shoot;
    const Silhouettes& masks;
    const std::optional<KeptGrid>& kept;
    const Hull& hull;
    const Surface& surface;
    const Colors& colors;
    MeshMade& mesh;
};

struct Exported {
    std::vector<SilhouetteAgreement> agreement;  ///< by view
    SeenExtent seen;
    Extrapolation extrapolation;
    std::optional<SlackShares> slack;                       ///< none: the surface is the hull's
    double tolerance = 0;                                   ///< beyond which surface counts as extrapolated
    std::vector<std::pair<std::string, FileFrame>> frames;  ///< by file
    double median_iou = 0, minimum_iou = 0;
    std::string contradiction;  ///< most views contradict the result; empty: they do not
};

struct Export {
    static constexpr const char* kName = "export";
    using Result = Exported;

    const ReconstructOptions& options;
    Made made;
    ResultSet& set;

    Exported run(Run& run);
    void report(const Exported& e, nlohmann::json& report) const;

  private:
    FrameRequest frame_request() const { return {made.shoot.up(), made.shoot.views.units, options.result.dcc, options.result.stl_mm}; }
    /// Names the part of the surface that no photograph supports.
    void mark_extrapolation(Exported& e, Run& run) const;
    void measure_slack(Exported& e, Progress& progress) const;
    void warn_of_frames(Progress& progress) const;
    void write_volume(Exported& e) const;
    void write_meshes(Exported& e, Progress& progress) const;
    void compare(Exported& e, Run& run) const;
    bool shape_was_changed() const;
    void warn_of_high_floor(const Exported& e, Progress& progress) const;
};

/// What the alignment drew; and nothing of an earlier one's.
void place_align_pictures(ResultSet& set, const Shoot& shoot);

}  // namespace vdbcarve::pipeline
