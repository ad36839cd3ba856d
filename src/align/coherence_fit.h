// SPDX-License-Identifier: Apache-2.0
// Minimising silhouette coherence: Levenberg and Marquardt's method for residuals that are a least over a largest.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <vector>

#include "align/coherence.h"
#include "align/feature_tracks.h"
#include "align/orbit_model.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// How exact one pass of the optimisation is.
struct CoherencePass {
    int scale = 1;        ///< pixels a side of a field's sample
    size_t points = 150;  ///< a view
    double huber_px = 1;  ///< residuals beyond count linearly
    int iterations = 25;
    double sigma_px = 0.1;        ///< expected of residuals: their weight against the priors
    double least_gain = 1e-3;     ///< relative; smaller ones end the pass
    double margin_px = 0.5;       ///< points that are inside the hull by less may come to count within a step
    double resolution_px = 0.75;  ///< of the search along lines of sight
    double support_px = 1;        ///< silhouettes that are so near to the farthest may come to hold a residual within a step
    int turns = 8;                ///< of finding out which
    int misses = 0;               ///< SearchOptions::misses
    double track_sigma_px = 0.7;  ///< expected of features
    double track_huber_px = 2;
    double give_up_px = INFINITY;  ///< a pass that is still above after four iterations ends
};

/// A state of the optimisation with what it is judged by.
struct CoherenceFit {
    OrbitModel model;
    std::vector<ContourPoint> points;
    std::vector<Touch> touches;  ///< of the points
    /// Features that are to be fitted too; null: none.
    std::shared_ptr<const std::vector<FeatureTrack>> tracks;
    double cost = 0;
    double ball_radius = 0;  ///< of the object around the origin, world units

    /// max(0, residual) of the points about which other views say something; infinity alone where they are the lesser part.
    std::vector<double> outside_px() const;
    /// Their root mean square.
    double rms_px() const;
    /// The same of the 85 % smallest: what it would be but for a few broken masks.
    double typical_px() const;
};

/// Silhouettes with their distance fields at the scales that are asked for.
class Silhouettes {
  public:
    /// Where one is in its image, pixels.
    struct Extent {
        double x0 = 0, y0 = 0, x1 = 0, y1 = 0;  ///< bounding box
        double cx = 0, cy = 0;                  ///< middle of the area in x, of the box in y
        double size() const { return std::max(x1 - x0, y1 - y0); }
    };

    explicit Silhouettes(const std::vector<MaskView>& masks);

    size_t count() const { return masks_.size(); }
    const std::vector<size_t>& seen() const { return seen_; }  ///< views with a silhouette
    const Extent& extent(size_t i) const { return extents_[i]; }
    double size_px() const { return size_px_; }  ///< of the object, median
    int width_px(size_t i) const { return views_[i].width_px; }
    int height_px(size_t i) const { return views_[i].height_px; }

    /// Of what a mask covers by half or more; size() <= 0 where that is nothing.
    static Extent extent_of(ImageView<uint8_t> coverage);

    /// A bad silhouette constrains nobody.
    void set_bad(size_t i, bool bad) { bad_[i] = bad; }
    bool bad(size_t i) const { return bad_[i]; }
    std::vector<size_t> good() const;  ///< views with a silhouette that is not bad

    /// The views as the search wants them.
    const std::vector<CoherenceView>& at_scale(int scale);
    /// Contour points of views, `count` of each. Sectors (0: all): only those in even (1) or odd (2) sectors of 30 degrees around the
    /// silhouette's middle.
    enum class Which { Good, Bad, All };
    std::vector<ContourPoint> contour(int scale, size_t count, uint64_t seed, int sectors = 0, Which which = Which::Good);

  private:
    const std::vector<DistanceField>& fields(int scale);

    std::vector<MaskView> masks_;
    std::vector<size_t> seen_;
    std::vector<Extent> extents_;
    double size_px_ = 0;
    std::vector<bool> bad_;
    std::vector<CoherenceView> views_;
    std::map<int, std::vector<DistanceField>> fields_;
    std::map<int, std::vector<std::vector<ContourPoint>>> contours_;
};

/// Radius of the ball around the origin that holds the object, if these cameras are right.
double ball_radius(const Silhouettes& silhouettes, const OrbitModel& model);

/// Where lines of sight of a track nearly meet, and how far from them its sightings are.
struct TrackedPlace {
    Vec3d place = Vec3d::Zero();
    std::vector<Vec2d> residuals_px;  ///< projected - seen, of each sighting
    bool in_front = false;            ///< of all cameras that saw it; residuals mean nothing otherwise
    double rms_px() const;
};
TrackedPlace place_of(const std::vector<OrbitCamera>& cameras, const FeatureTrack& track);

/// What a fit's tracks cost: squared residuals (Huber's way) by their expected size, every place where its squared residuals are least.
double track_cost(const CoherenceFit& fit, const CoherencePass& pass);

/// The same near the present state: cost + 2 gradient x + x' curvature x for a step x of the free parameters, the places themselves eliminated (Schur
/// complement: what is left of the rows across the space that moving the place can reach; docs/stages/derivations.md, 8). Empty without tracks.
struct TrackNormal {
    Eigen::MatrixXd curvature;
    Eigen::VectorXd gradient;
    double cost = 0;
    double after(const Eigen::VectorXd& x) const { return curvature.size() == 0 ? 0 : cost + 2 * gradient.dot(x) + x.dot(curvature * x); }
};
TrackNormal normal_of_tracks(const CoherenceFit& fit, const CoherencePass& pass, size_t free_parameters);

/// Touches of given points in a state.
std::vector<Touch> touches_of(Silhouettes& silhouettes, const OrbitModel& model, const std::vector<ContourPoint>& points, const CoherencePass& pass);

/// Minimises over the model's free parameters; fit.points are those to be fitted. Priors keep the gauge.
void refine(CoherenceFit& fit, Silhouettes& silhouettes, const CoherencePass& pass, Progress& progress);

}  // namespace vdbcarve
