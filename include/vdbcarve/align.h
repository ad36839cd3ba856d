// SPDX-License-Identifier: Apache-2.0
// Stage `align`: cameras from silhouettes alone, for photographs of an object that turned, or was walked around; or from a marker mat under it.
//
// Silhouette coherence: the line of sight through any point of a silhouette's contour touches the object, so it must touch the hull of
// all other silhouettes. How far it stays outside, in pixels, is minimised over all cameras (docs/stages/align.md).
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/board.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

enum class AlignMethod {
    Coherence,  ///< from the silhouettes and what is known of the motion
    Refine,     ///< from the cameras that the views have already, which are near the truth
    Mat,        ///< from a mat of markers that the object stands on
    Paper       ///< the seed paper's: a model of two views, turned until it looks like each photograph (docs/stages/align-paper.md)
};
const char* name_of(AlignMethod method);

/// How the cameras move; each rung has the unknowns of the one before, and more.
enum class Orbit {
    Auto,         ///< the lowest that explains contour points which it was not fitted to
    Turntable,    ///< camera fixed, the object turned by known steps
    FixedCamera,  ///< camera fixed, the object turned by steps that are known roughly
    HandHeld      ///< the camera carried around: every view stands, looks and leans as it likes
};
const char* name_of(Orbit orbit);

/// The object's turn before the camera from view to view, seen from above. A camera walking around the object clockwise sees it turn
/// counterclockwise.
enum class Turn { Auto, Clockwise, Counterclockwise };
const char* name_of(Turn turn);

/// Two places of the object that one photograph shows, and how far they are apart in a straight line.
struct KnownLength {
    std::string view;      ///< its name, with or without extension
    Vec2d from_px, to_px;  ///< first pixel's centre at (0.5, 0.5); of the photograph without lens distortion
    double length = 0;     ///< in the units wanted
};

struct AlignOptions {
    AlignMethod method = AlignMethod::Coherence;
    Orbit orbit = Orbit::Auto;
    Turn direction = Turn::Auto;
    /// Angles by which the object has turned at each view, degrees; empty: equal steps over arc_deg, a ring after the other.
    std::vector<double> angles_deg;
    double arc_deg = 360;                     ///< of a ring; a full turn does not repeat its start
    bool arc_known = true;                    ///< false: arc_deg is a guess; others are tried
    std::vector<int> rings;                   ///< views in each ring, in the order of the views; empty: one ring a sitting
    std::vector<int> sittings;                ///< views in each sitting (the object laid on another side), likewise; empty: one
    double fov_deg = 0;                       ///< horizontal, of the first view; 0: from the photographs where they say it, else found
    std::optional<Vec2d> principal_point_px;  ///< known; none: near the images' middle, or what the cameras say
    bool focal_varies = false;                ///< every view has its own focal length, near the others' (focus breathing)
    bool centre_varies = false;               ///< every view has its own principal point, near the others' (a stabiliser's crop)
    double known_distance = 0;                ///< median, of the cameras from the object's middle, in the units wanted; 0: unknown
    double known_height = 0;                  ///< of the object along the axis, likewise
    std::optional<KnownLength> known_length;
    std::string units;                       ///< of the known length; empty: arbitrary. Of a mat: what metres are turned into
    std::optional<MatLayout> mat;            ///< AlignMethod::Mat
    bool features = true;                    ///< where photographs have texture: with Refine they are fitted too, and they may decide the direction
    std::array<std::string, 2> paper_views;  ///< AlignMethod::Paper: views of the front and the side; empty: the first, and the one a quarter of the turn on
    int points = 150;                        ///< contour points a view
    int restarts = 2;                        ///< from disturbed angles, to see what the silhouettes leave open; 0: none
    uint64_t seed = 1;
};

/// Options that are not what they are where nothing is said, as the command line calls them: "--direction", "--known-height" …
std::vector<std::string> given_options(const AlignOptions& options);

/// What one view says after alignment.
struct AlignedView {
    std::string name;
    double residual_before_px = 0, residual_px = 0;  ///< rms over contour points of max(0, distance outside the others' hull)
    double residual_p95_px = 0;
    double coherent = 0;  ///< share of contour points within half a pixel of it
    double dissent = 0;   ///< share of the others' contour points that its silhouette pushes out of the hull by more than a little
    bool bad = false;     ///< its silhouette contradicts the others': it constrained nobody
    double azimuth_deg = 0;
    double azimuth_spread_deg = 0;  ///< over restarts
};

/// A rung of the ladder of motion models that was tried.
struct AlignRung {
    Orbit orbit = Orbit::HandHeld;
    Turn direction = Turn::Counterclockwise;
    double rms_px = 0;       ///< of the points fitted to
    double held_out_px = 0;  ///< of contour sectors that were not fitted to; 0: not tried
    int unknowns = 0;
};

struct AlignResult {
    AlignMethod method = AlignMethod::Coherence;
    Views views;  ///< with cameras; world z is up, along the axis
    Orbit orbit = Orbit::HandHeld;
    Turn direction = Turn::Counterclockwise;  ///< Refine, Mat: as the views follow each other
    double rms_px = 0;  ///< of max(0, residual) over views that are not bad; Mat: of corners' distances to where they should be, like all residuals
    double coherent = 0;
    double mask_noise_px = 0;  ///< of the contours, estimated
    double focal_px = 0, focal_start_px = 0;
    double focal_spread = 0;  ///< relative, over restarts
    double elevation_deg = 0;
    double principal_x_px = 0, principal_y_px = 0;
    double other_direction_px = 0;  ///< rms with the object turning the other way; 0: not tried
    double azimuth_spread_deg = 0;  ///< rms over restarts and views
    bool angles_observable = true;
    int symmetry = 1;  ///< the silhouettes look (nearly) the same after a half (2), third (3) or quarter (4) of a turn; 1: they do not
    std::vector<AlignRung> rungs;
    std::vector<AlignedView> aligned;
    /// Cameras for the other direction, where the direction is undecided; empty otherwise.
    std::vector<Camera> other_cameras;
    std::vector<std::array<float, 3>> touches_world;  ///< where lines of sight through contours touch the hull: the object's outline
    /// Why the shape must not be trusted; empty: it may.
    std::vector<std::string> failures;
    std::vector<std::string> warnings;
    std::vector<std::string> left_out;  ///< Mat: views in which it is not seen well enough; they are not in `views`
    size_t features = 0;                ///< tracks of features that were fitted (Refine), or matches that voted for the direction (Coherence)
    double features_rms_px = 0;         ///< of their reprojection
    double features_near = 0;           ///< share of the matches whose place lies on the side of the object that the cameras see
    double focal_sd_px = 0;             ///< Mat: its standard error
    std::string picture_name;           ///< what `picture` shows: "mat" (corners found), "energy_map" (Paper)
    Image8 picture;
};

/// Finds the cameras. `views` give names, image sizes and, where known, focal lengths (their poses are looked at by AlignMethod::Refine only, whose result
/// lies in their world); masks[i] belongs to views.views[i]; views with an empty mask get the camera of their nominal place. AlignMethod::Mat needs photographs
/// and no masks. Same bits for any number of threads. Time: about
/// views^2 * points * 10 us. Throws InputError for fewer than 4 views with a silhouette (Mat: with the mat),
/// UndeterminedError where there is no start or the scale cannot be had, UsageError for options that contradict each other.
AlignResult align(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress);

/// What was found, for reports.
std::string alignment_json(const AlignResult& result);

/// The cameras and the object's outline from above.
std::string orbit_svg(const AlignResult& result);

}  // namespace vdbcarve
