// SPDX-License-Identifier: Apache-2.0
// What is wrong with a scene, in words, before time is spent on it.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/mask.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

struct CheckOptions {
    ViewsOptions views;
    MaskOptions mask;
    bool cameras = true, masks = true, images = true;  ///< what to look at; masks made of photographs read those in any case
    int resolution = 192;                              ///< of the hull that masks are compared with
    double min_seen = 0.6;
};

struct ViewCheck {
    std::string name;
    SilhouetteAgreement agreement;  ///< of the hull of all views with this view's mask
};

/// What was found, and what to do about it.
struct Finding {
    enum class Severity {
        Note,     ///< worth knowing
        Warning,  ///< may be meant, or costs quality
        Error     ///< must be mended first
    };
    Severity severity = Severity::Warning;
    std::string part;                ///< cameras, masks or images
    std::string text, remedy;        ///< whole sentences; the remedy may be empty
    ExitCode code = ExitCode::Done;  ///< of an error
};

struct CheckResult {
    size_t views = 0;
    // Cameras; of `better`, where there is one.
    Vec3d look_at_world = Vec3d::Zero();
    double look_at_miss = 0;                              ///< median distance of the optical axes from it, share of the median distance
    Vec3d up_world = Vec3d::Zero();                       ///< mean of the images' up directions, unit length
    double distance_median = 0, distance_spread = 0;      ///< from look_at to the cameras; (largest - smallest) / median
    double elevation_min_deg = 0, elevation_max_deg = 0;  ///< about up_world
    double largest_gap_deg = 0;                           ///< between neighbouring azimuths about up_world
    double fov_deg = 0;                                   ///< median horizontal field of view
    std::string up_guessed;                               ///< the world axis nearest to up_world; empty: none within 20 degrees
    std::string up_said, units_said;                      ///< by the camera file, or the options
    // Masks.
    std::vector<ViewCheck> agreements;  ///< worst first; empty where masks were not looked at
    double median_iou = 0;
    Vec3d object_size = Vec3d::Zero();  ///< of the hull, along the world's axes
    double contour_off_px = 0;          ///< rms distance of contours from the other views' hull
    double shift_px[2] = {0, 0};        ///< what added to all principal points makes silhouettes fit best; NaN: left open
    double focal_factor = 1;            ///< and the factor of all focal lengths
    double soft_share = 0;              ///< of the masks that have grey along their contours
    // Images.
    size_t images_read = 0;
    std::vector<std::string> looked_at;  ///< in words: images, masks, cameras, how they fit together
    std::vector<Finding> findings;
    /// Cameras of another reading of the file that fits where its own does not, to be written with cameras_json(); empty: none was found.
    std::optional<Views> better;
    ExitCode exit_code = ExitCode::Done;  ///< the first error's in the order 3 (files), 4 (contradiction), 5 (cameras that the file says must not be trusted)

    std::vector<std::string> of(Finding::Severity severity) const;  ///< texts with remedies
};

/// Throws InputError and UndeterminedError like the stages do; contradictions are in the result where they can be described.
CheckResult check(const CheckOptions& options, Progress& progress);

std::string check_json(const CheckResult& result);
/// Sentences, one a line.
std::string check_text(const CheckResult& result);

}  // namespace vdbcarve
