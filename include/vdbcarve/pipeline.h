// SPDX-License-Identifier: Apache-2.0
// The whole job: a scene becomes a folder of results, stage by stage, resumable.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "vdbcarve/align.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/options.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/video.h"
#include "vdbcarve/views.h"
#include "vdbcarve/result.h"

namespace vdbcarve {

/// What reconstruct() is asked for: the options of its stages, and of the run as a whole.
struct ReconstructOptions {
    /// views.scene may be a video: its frames become the photographs. Where views.added is not empty and the output holds a result with the same cameras, that
    /// result's bounds and voxels are kept, so that its hull is extended by the views that it lacks.
    ViewsOptions views;
    VideoOptions video;
    MaskOptions mask;
    AlignOptions align;  ///< where cameras are to be found or improved
    CamerasOptions cameras;
    GridOptions grid;
    CarveSettings carve;
    FloorOptions floor;
    SurfaceSettings surface;
    StereoSettings stereo;
    ColorSettings color;
    FilterSettings filter;
    MeshSettings mesh;
    SmoothSettings smooth;
    ResultOptions result;
    RunOptions run;
};
/// Occupancy has no surface to smooth.
inline bool makes_fair(const ReconstructOptions& o) { return o.surface.fair && !o.carve.occupancy; }

/// --method says how cameras are found, and that they are to be.
struct MethodForm {
    static std::string print(AlignMethod method, bool find_again);
    static void parse(const std::string& option, const std::string& text, AlignMethod& method, bool& find_again);
};
template <OptionsOf<ReconstructOptions> O, class V>
void visit(O& o, V& v) {
    v.part(o.views);
    v.part(o.video);
    v.part(o.mask);
    v.alias(Option{"method",
                   "how cameras are found: coherence (of silhouettes, from an orbit; default), refine (silhouettes and texture, from the camera file's), mat "
                   "(markers under the object, see board), paper (Denkowski 2013, for comparison)",
                   kAlignGroup, in::kAligning, "WORD"},
            MethodForm{}, o.align.method, o.cameras.find_again);
    v.part(o.align);
    v.part(o.cameras);
    v.part(o.grid);
    v.part(o.carve);
    v.part(o.mesh);
    v.part(o.result);
    v.part(o.floor);
    v.part(o.color);
    v.part(o.surface);
    v.part(o.stereo);
    v.part(o.filter);
    v.part(o.smooth);
    v.part(o.run);
}

struct Reconstruction {
    std::string report_json;  ///< what report.json holds (of a dry run: the plan)
    MeshMeasures mesh;
    double median_iou = 0, minimum_iou = 0;
    size_t views = 0;           ///< that were carved with
    size_t added_views = 0;     ///< of them, those that the hull of an earlier run was extended by
    double extend_seconds = 0;  ///< for that: their fields and the hull, without masks and files
    std::string contradiction;  ///< why the result, which was written, is not to be trusted: most silhouettes contradict it; empty: they do not
};

/// Runs the stages that are not already in output/stages for the same inputs, options and code version.
/// Files of the result appear by rename; the same inputs give the same bytes (report.json and config.toml
/// apart, which hold times and paths). Throws Error.
Reconstruction reconstruct(const ReconstructOptions& options, Progress& progress);

/// Empties output/stages of a folder that vdbcarve made; results stay. Returns the bytes freed.
size_t clean(const std::filesystem::path& output);

}  // namespace vdbcarve
