// SPDX-License-Identifier: Apache-2.0
// The model of an orbit, and how far contours are from the hull of the others.
#include "vdbcarve/align.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <tbb/global_control.h>

#include <cmath>
#include <numbers>
#include <random>

#include "base/atomic_file.h"
#include "align/coherence.h"
#include "align/coherence_fit.h"
#include "image/image_io.h"
#include "align/orbit_model.h"
#include "support/align_scene.h"
#include "support/scenes.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {
namespace {

Progress quiet;

OrbitModel some_model() {
    std::vector<OrbitView> views(5);
    for (size_t i = 0; i < views.size(); ++i) {
        views[i].width_px = 640;
        views[i].height_px = 480;
        views[i].focal_px = 900;
        views[i].aspect = 1.02;
        views[i].cx = 320;
        views[i].cy = 240;
        views[i].azimuth_rad = 1.2 * static_cast<double>(i);
        views[i].turn = 0.2 * static_cast<double>(i);
        views[i].ring = i < 3 ? 0 : 1;
    }
    // One that counts from a pose of its own.
    views[4].camera_from_world = Rigid3{turned({95, 4, 20}), Vec3d(0.05, -0.02, 1.1)};
    OrbitModel m(views, 2);
    std::mt19937 random(4);
    std::uniform_real_distribution<double> small(-0.1, 0.1);
    for (int g = 0; g < OrbitModel::kGlobals; ++g) m.global(static_cast<OrbitModel::Global>(g)).value = small(random);
    for (size_t r = 0; r < 2; ++r)
        for (int p = 0; p < OrbitModel::kRingParts; ++p) m.ring(r, static_cast<OrbitModel::RingPart>(p)).value = small(random);
    for (size_t i = 0; i < 5; ++i)
        for (int p = 0; p < OrbitModel::kViewParts; ++p) m.of(i, static_cast<OrbitModel::ViewPart>(p)).value = small(random);
    return m;
}

TEST(OrbitModel, CamerasLookAtTheOriginFromWhereTheyShould) {
    OrbitView v;
    v.width_px = 640, v.height_px = 480, v.focal_px = 900, v.cx = 320, v.cy = 240;
    v.azimuth_rad = 0.7;
    OrbitModel m({v}, 1);
    m.ring(0, OrbitModel::Elevation).value = 0.3;
    const Camera c = m.camera(0).camera(640, 480);
    EXPECT_NEAR((c.centre_world() - Vec3d(std::cos(0.3) * std::cos(0.7), std::cos(0.3) * std::sin(0.7), std::sin(0.3))).norm(), 0, 1e-12);
    EXPECT_NEAR((*c.project(Vec3d::Zero()) - Vec2d(320, 240)).norm(), 0, 1e-9);
    EXPECT_LT((*c.project(Vec3d(0, 0, 0.1))).y(), 240) << "up is up in the image";
    EXPECT_TRUE(is_rotation(c.camera_from_world.rotation, 1e-12));
    // Walking counterclockwise, what is in front moves to the left.
    OrbitModel next = m;
    next.of(0, OrbitModel::Azimuth).value = 0.1;
    const Vec3d front = 0.2 * c.centre_world();
    EXPECT_LT((*next.camera(0).camera(640, 480).project(front)).x(), (*c.project(front)).x());
}

// The chain of derivatives, from parameters over cameras to pixels, against differences of pixels.
TEST(OrbitModel, ColumnsAreTheDerivativesOfProjections) {
    OrbitModel m = some_model();
    for (int g = 0; g < OrbitModel::kGlobals; ++g) m.global(static_cast<OrbitModel::Global>(g)).release(0, 1);
    for (size_t r = 0; r < 2; ++r)
        for (int p = 0; p < OrbitModel::kRingParts; ++p) m.ring(r, static_cast<OrbitModel::RingPart>(p)).release(0, 1);
    for (size_t i = 0; i < 5; ++i)
        for (int p = 0; p < OrbitModel::kViewParts; ++p) m.of(i, static_cast<OrbitModel::ViewPart>(p)).release(0, 1);
    const std::vector<size_t> free = m.free();
    const auto columns = m.columns();
    const Vec3d point(0.1, -0.07, 0.12);
    for (size_t i = 0; i < 5; ++i) {
        std::vector<bool> listed(free.size(), false);
        const OrbitCamera c = m.camera(i);
        const Vec3d x = c.camera_from_world * (point - c.centre);
        const auto pixel = [&](const OrbitModel& model) {
            const OrbitCamera k = model.camera(i);
            const Vec3d y = k.camera_from_world * (point - k.centre);
            return Vec2d(k.fx * y.x() / y.z() + k.cx, k.fx * k.aspect * y.y() / y.z() + k.cy);
        };
        for (const CameraColumn& column : columns[i]) {
            const auto& d = column.direction;
            const Vec3d moved = Vec3d(d[kTurn], d[kTurn + 1], d[kTurn + 2]).cross(x) - c.camera_from_world * Vec3d(d[kCentre], d[kCentre + 1], d[kCentre + 2]);
            const double u = x.x() / x.z(), v = x.y() / x.z();
            const Vec2d predicted(c.fx * ((moved.x() - u * moved.z()) / x.z() + u * d[kLnFocal]) + d[kCentreX],
                                  c.fx * c.aspect * ((moved.y() - v * moved.z()) / x.z() + v * d[kLnFocal]) + d[kCentreY]);
            OrbitModel more = m, less = m;
            const double h = 1e-5;
            more.at(free[static_cast<size_t>(column.parameter)]).value += h;
            less.at(free[static_cast<size_t>(column.parameter)]).value -= h;
            const Vec2d measured = (pixel(more) - pixel(less)) / (2 * h);
            EXPECT_NEAR((predicted - measured).norm(), 0, 1e-4 * (1 + measured.norm())) << "view " << i << " parameter " << column.parameter;
            listed[static_cast<size_t>(column.parameter)] = true;
        }
        for (size_t p = 0; p < free.size(); ++p) {
            if (listed[p]) continue;
            OrbitModel more = m;
            more.at(free[p]).value += 0.01;
            EXPECT_EQ((pixel(more) - pixel(m)).norm(), 0) << "view " << i << " moves with parameter " << p << ", which is not among its columns";
        }
    }
}

TEST(Coherence, MinimaxEqualsASearch) {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> unit(-1, 1);
    for (int round = 0; round < 300; ++round) {
        const size_t n = 1 + static_cast<size_t>(round % 9);
        std::vector<double> values(n), slopes(n);
        for (size_t k = 0; k < n; ++k) values[k] = unit(random), slopes[k] = 3 * unit(random);
        const double reach = 0.5 + 0.4 * unit(random);
        const auto largest = [&](double t) {
            double out = -1e9;
            for (size_t k = 0; k < n; ++k) out = std::max(out, values[k] + slopes[k] * t);
            return out;
        };
        double least = 1e9;
        for (int s = -20000; s <= 20000; ++s) least = std::min(least, largest(reach * s / 20000));
        const Minimax found = minimax(values.data(), slopes.data(), n, reach);
        EXPECT_LE(std::fabs(found.t), reach + 1e-12);
        EXPECT_NEAR(largest(found.t), least, 3e-4);
        if (found.first != found.second) {
            EXPECT_NEAR(found.share * slopes[found.first] + (1 - found.share) * slopes[found.second], 0, 1e-9) << "the two must balance";
            EXPECT_GE(found.share, 0);
            EXPECT_LE(found.share, 1);
        }
    }
}

struct Searched {
    SyntheticScene scene = synthesize(small_orbit(2, 12), quiet);
    std::vector<DistanceField> fields = distance_fields(views_of(scene.masks), {}, quiet);
    std::vector<CoherenceView> views;
    std::vector<OrbitCamera> cameras;
    std::vector<ContourPoint> points;
    Searched() {
        for (size_t i = 0; i < scene.masks.size(); ++i) {
            CoherenceView v;
            v.field = &fields[i];
            v.width_px = scene.masks[i].coverage.width;
            v.height_px = scene.masks[i].coverage.height;
            find_open_sides(view_of(scene.masks[i]), v);
            views.push_back(v);
            const Camera c = scene.views.cameras()[i];
            cameras.push_back({c.camera_from_world.rotation, c.centre_world(), c.intrinsics.fx, 1, c.intrinsics.cx, c.intrinsics.cy});
        }
        for (size_t i = 0; i < views.size(); ++i)
            for (const ContourPoint& p : contour_of(views[i], static_cast<int>(i)))
                if ((static_cast<int>(p.x_px) * 7 + static_cast<int>(p.y_px) * 13) % 29 == 0) points.push_back(p);
    }
};

/// Turns every camera a little.
void disturb(std::vector<OrbitCamera>& cameras, double rad, std::mt19937& random) {
    std::normal_distribution<double> normal;
    for (OrbitCamera& c : cameras) {
        const Vec3d turn = rad * Vec3d(normal(random), normal(random), normal(random));
        c.camera_from_world = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * c.camera_from_world;
    }
}

/// Largest distance of a point on the line of sight to the other silhouettes, from whole-image distance fields.
double largest_distance(const Searched& s, const std::vector<ImageF>& whole, const ContourPoint& p, double depth) {
    const Vec3d x = touch_position(s.cameras[static_cast<size_t>(p.view)], p, depth);
    double most = -1e9;
    for (size_t k = 0; k < s.cameras.size(); ++k) {
        if (static_cast<int>(k) == p.view) continue;
        const auto u = s.cameras[k].camera(s.views[k].width_px, s.views[k].height_px).project(x);
        if (!u) continue;
        const double px = std::clamp(u->x() - 0.5, 0.0, whole[k].width - 1.001), py = std::clamp(u->y() - 0.5, 0.0, whole[k].height - 1.001);
        const int ix = static_cast<int>(px), iy = static_cast<int>(py);
        const double a = px - ix, b = py - iy;
        const double d =
            (1 - b) * ((1 - a) * whole[k].at(ix, iy) + a * whole[k].at(ix + 1, iy)) + b * ((1 - a) * whole[k].at(ix, iy + 1) + a * whole[k].at(ix + 1, iy + 1));
        most = std::max(most, d + std::hypot(u->x() - 0.5 - px, u->y() - 0.5 - py));
    }
    return most;
}

TEST(Coherence, BranchAndBoundFindsWhatADenseSearchFinds) {
    Searched s;
    // Cameras somewhat wrong, so that residuals are of all sizes.
    std::mt19937 random(6);
    disturb(s.cameras, 0.004, random);
    std::vector<ImageF> whole;
    for (const Mask& m : s.scene.masks) whole.push_back(signed_distance(m.coverage));
    const SearchOptions options{1.6, 0.5, 0.5};
    const std::vector<Touch> touches = find_touches(s.views, s.cameras, s.points, options, {});
    ASSERT_GT(s.points.size(), 100u);
    size_t positive = 0;
    for (size_t p = 0; p < s.points.size(); p += 3) {
        const OrbitCamera& c = s.cameras[static_cast<size_t>(s.points[p].view)];
        double least = 1e9;
        const double middle = c.centre.norm();
        for (int k = 0; k <= 6000; ++k) least = std::min(least, largest_distance(s, whole, s.points[p], middle + 1.6 * (k / 3000.0 - 1)));
        if (least < -0.5) EXPECT_LE(touches[p].residual_px, -0.45);
        else EXPECT_NEAR(touches[p].residual_px, least, 0.05 + 0.02 * std::fabs(least)) << "point " << p;
        positive += least > 0.2;
    }
    EXPECT_GT(positive, 20u) << "the test must see residuals";
    // Where one starts must not matter.
    const std::vector<Touch> again = find_touches(s.views, s.cameras, s.points, options, touches);
    for (size_t p = 0; p < touches.size(); ++p)
        if (touches[p].residual_px > -0.5) {
            EXPECT_NEAR(again[p].residual_px, touches[p].residual_px, 0.05 + 0.02 * touches[p].residual_px);
        }
}

// A small step of all cameras changes residuals as the supports say.
TEST(Coherence, SupportsPredictResiduals) {
    Searched s;
    std::mt19937 random(7);
    disturb(s.cameras, 0.006, random);
    std::normal_distribution<double> normal;
    const SearchOptions options{1.6, 0.2, 0.3};
    const std::vector<Touch> before = find_touches(s.views, s.cameras, s.points, options, {});
    std::vector<OrbitCamera> moved = s.cameras;
    std::vector<std::array<double, kCameraDirections>> steps(moved.size());
    const double size[kCameraDirections] = {2e-4, 2e-4, 2e-4, 1e-3, 1e-3, 1e-3, 5e-4, 0.2, 0.2};
    for (size_t i = 0; i < moved.size(); ++i) {
        auto& d = steps[i];
        for (int k = 0; k < kCameraDirections; ++k) d[static_cast<size_t>(k)] = size[k] * normal(random);
        const Vec3d turn(d[0], d[1], d[2]);
        moved[i].camera_from_world = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * moved[i].camera_from_world;
        moved[i].centre += Vec3d(d[3], d[4], d[5]);
        moved[i].fx *= std::exp(d[6]);
        moved[i].cx += d[7];
        moved[i].cy += d[8];
    }
    const std::vector<Touch> after = find_touches(s.views, moved, s.points, options, before);
    double error = 0, change = 0;
    size_t n = 0;
    for (size_t p = 0; p < s.points.size(); ++p) {
        if (!(before[p].residual_px > 0.5) || !(after[p].residual_px > 0.2)) continue;
        const std::vector<Support> supports = supports_of(s.views, s.cameras, s.points[p], before[p], 3, 8);
        std::vector<double> values, slopes;
        for (const Support& x : supports) {
            double v = x.distance_px;
            for (int k = 0; k < kCameraDirections; ++k)
                v += x.by_own[k] * steps[static_cast<size_t>(s.points[p].view)][static_cast<size_t>(k)] +
                     x.by_view[k] * steps[static_cast<size_t>(x.view)][static_cast<size_t>(k)];
            values.push_back(v);
            slopes.push_back(x.slope);
        }
        const Minimax held = minimax(values.data(), slopes.data(), values.size(), 0.05);
        const double predicted = values[held.first] + slopes[held.first] * held.t;
        error += std::pow(predicted - after[p].residual_px, 2);
        change += std::pow(after[p].residual_px - before[p].residual_px, 2);
        ++n;
    }
    ASSERT_GT(n, 40u);
    // (Samples of a distance field scatter by some hundredths of a pixel.)
    EXPECT_LT(std::sqrt(error / n), 0.05 + 0.1 * std::sqrt(change / n))
        << "changes of " << std::sqrt(change / n) << " px are predicted to " << std::sqrt(error / n);
}

}  // namespace
}  // namespace vdbcarve::test
