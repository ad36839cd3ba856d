// SPDX-License-Identifier: Apache-2.0
// Silhouette coherence (Hernández, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular motion", PAMI 2007)
// as a distance in pixels that has a derivative: how far the line of sight through a contour point stays outside the hull of all other views.
// docs/stages/derivations.md, "Alignment", derives residual and Jacobian.
#pragma once

#include <cstdint>
#include <vector>

#include "align/orbit_model.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/image.h"

namespace vdbcarve {

/// A silhouette to be looked up: its field, and where its frame says nothing.
struct CoherenceView {
    const DistanceField* field = nullptr;  ///< null, or empty: the view constrains nobody
    int width_px = 0, height_px = 0;
    /// The silhouette touches this side of the frame (left, top, right, bottom): beyond it the view says nothing.
    bool open[4] = {};
};

/// Signed distance to a silhouette at a place of its image; `scale`: pixels a side of the field's samples.
double distance_px(const kernel::FieldView& field, int scale, double x_px, double y_px);

struct ContourPoint {
    int view;
    float x_px, y_px;
};

/// Where the line of sight through a contour point comes nearest to the hull of the other views.
struct Touch {
    /// Pixels outside the hull: the least, over the line, of the largest signed distance; <= 0: it touches the hull (coherent). Exact down to
    /// -SearchOptions::margin_px, below that only a bound. NaN: no other view says anything.
    double residual_px = 0;
    double depth = 0;  ///< along the optical axis, world units
};

/// All contour points of a view: where the field crosses zero between neighbouring samples. Points at the frame's open sides and beside ignored
/// regions are left out.
std::vector<ContourPoint> contour_of(const CoherenceView& view, int index);

/// A silhouette touches these sides of its frame.
void find_open_sides(const MaskView& mask, CoherenceView& view);

struct SearchOptions {
    double ball_radius = 1;    ///< bounds the object around the origin, world units
    double margin_px = 0;      ///< how far below zero residuals are to be known
    double resolution_px = 1;  ///< narrower wells than this may be missed
    int misses = 0;            ///< so many silhouettes may say otherwise: the (misses + 1)-th largest distance counts instead of the largest
};

/// Touches of all points, by branch and bound. `before` (same size, or empty) holds those of a nearby state, from which the search starts.
/// Points in parallel; each result depends on its own input only.
std::vector<Touch> find_touches(const std::vector<CoherenceView>& views, const std::vector<OrbitCamera>& cameras, const std::vector<ContourPoint>& points,
                                const SearchOptions& options, const std::vector<Touch>& before);

/// A silhouette that is among the farthest at a touch: how its distance changes. The residual is the least over the line of the largest of
/// these, so near the touch it is min over t of max over supports of (distance + slope t + derivatives).
struct Support {
    int view = -1;
    double distance_px = 0;
    double slope = 0;                        ///< along the line, pixels a unit of depth
    double by_own[kCameraDirections] = {};   ///< by the camera whose contour point it is
    double by_view[kCameraDirections] = {};  ///< by the silhouette's
};

/// All silhouettes within `reach_px` of the farthest at the touch, at most `most`, the farthest first; the `misses` farthest of all do not count.
std::vector<Support> supports_of(const std::vector<CoherenceView>& views, const std::vector<OrbitCamera>& cameras, const ContourPoint& point,
                                 const Touch& touch, double reach_px, size_t most, int misses = 0);

/// The least over |t| <= reach of max over lines of (values[i] + slopes[i] t): the one or two lines that hold it there, at which t.
struct Minimax {
    size_t first = 0, second = 0;  ///< equal where one holds it alone
    double share = 1;              ///< of the first: the derivative by what moves the values
    double t = 0;
};
Minimax minimax(const double* values, const double* slopes, size_t count, double reach);

/// Where the touch is, world.
Vec3d touch_position(const OrbitCamera& camera, const ContourPoint& point, double depth);

}  // namespace vdbcarve
