// SPDX-License-Identifier: Apache-2.0
// Cameras around an object, by the quantities that a photographer's motion is made of.
//
// World: z up along the orbit's axis, the object near the origin, the first ring's mean distance 1. A camera at azimuth p (counterclockwise
// seen from above), elevation e, distance d and height h stands at
//     c = (d cos e cos p, d cos e sin p, d sin e + h)
// and is turned, from looking at the axis, by pan (about its y), then tilt (about its x), then roll (about its z):
//     camera_from_world = Rz(roll) Rx(tilt) Ry(pan) R_look(p, e).
// Every quantity is a sum of what all views share, what a ring shares and what a view has of its own; which parts are free makes
// the motion: a turntable, a fixed camera before an object turned by hand, a camera held by hand.
#pragma once

#include <Eigen/Core>
#include <array>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "base/angles.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {

/// A quantity to be estimated: a Gaussian prior around `mean`; sigma 0: it is held.
struct Parameter {
    double value = 0, mean = 0, sigma = 0;
    bool free() const { return sigma > 0; }
    double prior_cost() const { return free() ? (value - mean) * (value - mean) / (sigma * sigma) : 0; }
    void hold(double at) { *this = {at, at, 0}; }
    void release(double prior_mean, double prior_sigma) { mean = prior_mean, sigma = prior_sigma; }
};

/// A camera as the optimiser sees it: pixels = (fx X/Z + cx, fx aspect Y/Z + cy).
struct OrbitCamera {
    Mat3d camera_from_world;
    Vec3d centre;
    double fx = 1, aspect = 1, cx = 0, cy = 0;

    Camera camera(int width_px, int height_px) const;
};

/// Derivatives of a camera are taken in these nine directions: a small turn in the camera's frame (R <- exp(w) R), its centre in the world,
/// the logarithm of its focal length, its principal point.
inline constexpr int kCameraDirections = 9;
enum CameraDirection { kTurn = 0, kCentre = 3, kLnFocal = 6, kCentreX = 7, kCentreY = 8 };

/// How a camera moves with one parameter.
struct CameraColumn {
    int parameter;  ///< among the free ones
    std::array<double, kCameraDirections> direction;
};

/// What is known of a view before it is aligned.
struct OrbitView {
    int width_px = 0, height_px = 0;
    double focal_px = 0;                      ///< start; along x
    double aspect = 1;                        ///< fy / fx
    double cx = 0, cy = 0;                    ///< start of the principal point
    double azimuth_rad = 0;                   ///< nominal, from the ring's first view
    std::optional<Rigid3> camera_from_world;  ///< a pose that is near already: steps sideways, back, up and turns are counted from it
    double turn = 0;                          ///< share of the ring passed, 0..1: where smooth changes of speed are counted
    int ring = 0;
};

/// Parameters and the map from them to cameras.
class OrbitModel {
  public:
    enum Global { LnFocal, CentreX, CentreY, LnArc, Harmonic, kHarmonics = 6, kGlobals = Harmonic + kHarmonics };
    enum RingPart {
        RingAzimuth,
        Elevation,
        RingDistance,
        RingHeight,
        RingPan,
        RingTilt,
        RingRoll,
        SittingTurn,
        SittingShift = SittingTurn + 3,
        kRingParts = SittingShift + 3
    };
    enum ViewPart { Azimuth, Pan, Tilt, Roll, LnDistance, Height, ViewLnFocal, ViewCentreX, ViewCentreY, kViewParts };

    OrbitModel() = default;
    OrbitModel(std::vector<OrbitView> views, int rings);

    size_t views() const { return views_.size(); }
    size_t rings() const { return rings_; }
    const OrbitView& view(size_t i) const { return views_[i]; }
    int ring_of(size_t i) const { return views_[i].ring; }

    Parameter& global(Global which) { return all_[static_cast<size_t>(which)]; }
    Parameter& harmonic(int which) { return all_[static_cast<size_t>(Harmonic + which)]; }
    Parameter& ring(size_t r, RingPart which) { return all_[static_cast<size_t>(kGlobals) + r * kRingParts + static_cast<size_t>(which)]; }
    Parameter& of(size_t i, ViewPart which) { return all_[first_of_views() + i * kViewParts + static_cast<size_t>(which)]; }
    const Parameter& global(Global which) const { return const_cast<OrbitModel*>(this)->global(which); }
    const Parameter& ring(size_t r, RingPart which) const { return const_cast<OrbitModel*>(this)->ring(r, which); }
    const Parameter& of(size_t i, ViewPart which) const { return const_cast<OrbitModel*>(this)->of(i, which); }
    const Parameter& harmonic(int which) const { return const_cast<OrbitModel*>(this)->harmonic(which); }

    /// A view's own quantities as another model of the same views has them.
    void take_view(size_t i, const OrbitModel& from) {
        for (int part = 0; part < kViewParts; ++part) of(i, static_cast<ViewPart>(part)).value = from.of(i, static_cast<ViewPart>(part)).value;
    }

    /// How a ring's own world lies in the scene.
    Rigid3 scene_from_ring(size_t r) const;
    double azimuth(size_t i) const;  ///< rad, all parts together
    double focal_px(size_t i) const;

    OrbitCamera camera(size_t i) const;
    std::vector<OrbitCamera> cameras() const;

    /// Indices of the free parameters, in order.
    std::vector<size_t> free() const;
    const Parameter& at(size_t index) const { return all_[index]; }
    Parameter& at(size_t index) { return all_[index]; }
    double prior_cost() const;
    /// Views' camera derivatives by the free parameters that move them (central differences: exact to 1e-9).
    std::vector<std::vector<CameraColumn>> columns() const;

  private:
    size_t first_of_views() const { return static_cast<size_t>(kGlobals) + rings_ * static_cast<size_t>(kRingParts); }

    std::vector<OrbitView> views_;
    size_t rings_ = 1;
    std::vector<Parameter> all_;
};

}  // namespace vdbcarve
