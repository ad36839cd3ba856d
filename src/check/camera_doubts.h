// SPDX-License-Identifier: Apache-2.0
// What silhouettes say about cameras that do not fit them: other ways to read the poses, and errors that all cameras share. Private.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// Cameras and silhouettes put together in another way than the files say.
struct Reading {
    std::string words;  ///< "inverted (camera to world …)"; empty: as the files say
    std::vector<Camera> cameras;
    std::vector<size_t> silhouette;  ///< of each camera, the number of its silhouette
    bool mirrored = false;           ///< the silhouettes are mirror images, left for right
    double overlap = 0;              ///< median IoU of the hull's silhouettes with them; 0: there is no hull
};

/// All readings that are tried: poses as camera to world, with the rotation transposed, with the translation as the camera's place; each with
/// OpenCV's and OpenGL's axes; silhouettes mirrored, in reverse order, off by one; focal lengths of half and twice the length. The first is the files' own.
std::vector<Reading> readings_of(const std::vector<Camera>& cameras);

/// Fills in the overlaps. Silhouettes are looked at in small: half a second for each reading of 36 views. Views without a mask do not count.
void judge(std::vector<Reading>& readings, const std::vector<MaskView>& masks, Progress& progress);

/// The mean of the images' up directions, unit length, world; zero where they cancel each other (cameras all around, or turned upside down by turns).
Vec3d mean_up(const std::vector<Camera>& cameras);

/// The world axis ("x", "-x" …) within 20 degrees of a direction; empty: none is.
std::string axis_near(const Vec3d& up_world);

/// A sentence with its remedy where the cameras stand upright along another direction than `said` (an axis; empty: it is not said), by more than 45 degrees;
/// else empty.
std::string doubt_of_up(const std::vector<Camera>& cameras, const std::string& said);

/// What would make the silhouettes more coherent, were it added to all cameras.
struct CommonError {
    double shift_x_px = 0, shift_y_px = 0;  ///< of the principal points; NaN where the views leave it open
    double focal_factor = 1;
    std::array<double, 3> sd{};  ///< standard errors of the three, the last one relative
    double rms_before_px = 0, rms_after_px = 0;
};

/// By Gauss and Newton on the distances of lines of sight through contours from the hull of all other views (coherence.h), from the cameras given,
/// which must be about right. Nothing where no hull is seen. Time: a few seconds for 36 views.
std::optional<CommonError> common_error(const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, Progress& progress);

}  // namespace vdbcarve
