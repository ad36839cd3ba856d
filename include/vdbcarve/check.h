// SPDX-License-Identifier: Apache-2.0
// What is wrong with a scene, in words, before time is spent on it.
#pragma once

#include <string>
#include <vector>

#include "vdbcarve/mask.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/render.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

struct CheckOptions {
    ViewsOptions views;
    MaskOptions mask;
    bool cameras = true, masks = true;  ///< what to look at; images are read as far as masks need them
    int resolution = 192;               ///< of the hull that masks are compared with
    double min_seen = 0.6;
};

struct ViewCheck {
    std::string name;
    SilhouetteAgreement agreement;  ///< of the hull of all views with this view's mask
};

struct CheckResult {
    size_t views = 0;
    // Cameras.
    Vec3d look_at_world = Vec3d::Zero();
    double look_at_miss = 0;          ///< median distance of the optical axes from it, share of the median distance
    Vec3d up_world = Vec3d::Zero();   ///< mean of the images' up directions, unit length
    double distance_median = 0, distance_spread = 0;  ///< from look_at to the cameras; (largest - smallest) / median
    double elevation_min_deg = 0, elevation_max_deg = 0;  ///< about up_world
    double largest_gap_deg = 0;       ///< between neighbouring azimuths about up_world
    double fov_deg = 0;               ///< median horizontal field of view
    // Masks.
    std::vector<ViewCheck> agreements;  ///< worst first; empty where masks were not looked at
    double median_iou = 0;
    std::vector<std::string> warnings, errors;
    ExitCode exit_code = ExitCode::Done;  ///< Done with or without warnings, Contradiction when the data disagree, Undetermined when the camera file says that its cameras must not be trusted
};

/// Throws InputError and UndeterminedError like the stages do; contradictions are in the result where they can be described.
CheckResult check(const CheckOptions& options, Progress& progress);

std::string check_json(const CheckResult& result);
/// Sentences, one a line.
std::string check_text(const CheckResult& result);

}  // namespace vdbcarve
