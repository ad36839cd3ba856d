// SPDX-License-Identifier: Apache-2.0
// Cameras from silhouettes.
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

std::vector<MaskView> views_of(const std::vector<Mask>& masks) {
    std::vector<MaskView> out;
    for (const Mask& m : masks) out.push_back(view_of(m));
    return out;
}

std::vector<Vec3d> points_on(const SyntheticScene& scene) {
    std::vector<Vec3d> out;
    for (size_t v = 0; v < scene.truth.vertices.size(); v += scene.truth.vertices.size() / 200)
        out.emplace_back(scene.truth.vertices[v][0], scene.truth.vertices[v][1], scene.truth.vertices[v][2]);
    return out;
}

/// Something else beside the object, around a place given as shares of the image.
void add_blob(Image8& mask, double x_share, double y_share, double radius_px) {
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x)
            if (std::hypot(x - x_share * mask.width, y - y_share * mask.height) < radius_px) mask.at(x, y) = 255;
}

SyntheticSpec small_orbit(uint64_t seed, int views) {
    SyntheticSpec spec = hand_held_orbit(seed);
    spec.rig.views = views;
    spec.rig.width_px = 480;
    spec.rig.height_px = 360;
    return spec;
}

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

struct Found {
    SyntheticScene scene;
    AlignResult result;
    CameraErrors errors;
};
Found find(const SyntheticSpec& spec, const AlignOptions& options, double focal_factor = 0) {
    Found out;
    out.scene = synthesize(spec, quiet);
    out.result = align(without_cameras(out.scene.views, focal_factor), views_of(out.scene.masks), options, quiet);
    out.errors = compare_cameras(out.result.views.cameras(), out.scene.views.cameras(), points_on(out.scene));
    return out;
}

TEST(Align, AHandHeldOrbitFromNothingButMasks) {
    const Found f = find(small_orbit(1, 20), {});
    EXPECT_TRUE(f.result.failures.empty()) << f.result.failures.front();
    EXPECT_EQ(f.result.orbit, Orbit::HandHeld);
    EXPECT_EQ(f.result.direction, Turn::Clockwise) << "the cameras walk counterclockwise";
    EXPECT_LT(f.errors.reprojection_rms_px, 0.3);
    EXPECT_LT(f.errors.rotation_rms_deg, 0.3);
    EXPECT_NEAR(f.errors.focal_ratio, 1, 0.01);
    EXPECT_GT(f.result.other_direction_px, 1);
    EXPECT_EQ(f.result.views.up, "z");
    EXPECT_TRUE(f.result.views.units.empty());
    for (const AlignedView& v : f.result.aligned) {
        EXPECT_LT(v.residual_px, 0.3);
        EXPECT_FALSE(v.bad);
    }
}

TEST(Align, ATurntableIsSeenToBeOne) {
    SyntheticSpec spec = small_orbit(3, 18);
    spec.rig.shake_angle_deg = spec.rig.shake_look_at = spec.rig.shake_roll_deg = 0;
    spec.rig.elevation_deg = 20;
    AlignOptions options;
    options.known_distance = 400;
    options.units = "mm";
    const Found f = find(spec, options);
    EXPECT_TRUE(f.result.failures.empty());
    EXPECT_EQ(f.result.orbit, Orbit::Turntable);
    EXPECT_LT(f.errors.rotation_rms_deg, 0.1);
    EXPECT_NEAR(f.result.elevation_deg, 20, 1);
    EXPECT_EQ(f.result.views.units, "mm");
    // The distance is that from the object's middle.
    Box3d box;
    for (const auto& v : f.scene.truth.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    std::vector<double> distances;
    for (const Camera& c : f.scene.views.cameras()) distances.push_back((c.centre_world() - box.center()).norm());
    std::sort(distances.begin(), distances.end());
    EXPECT_NEAR(400 * f.errors.truth_from_estimate.scale / distances[distances.size() / 2], 1, 0.02);
}

TEST(Align, AKnownHeightGivesTheScale) {
    SyntheticSpec spec = small_orbit(3, 18);
    spec.rig.elevation_deg = 5;
    double low = 1e9, high = -1e9;
    const SyntheticScene scene = synthesize(spec, quiet);
    for (const auto& v : scene.truth.vertices) low = std::min<double>(low, v[2]), high = std::max<double>(high, v[2]);
    AlignOptions options;
    options.known_height = high - low;
    const AlignResult r = align(without_cameras(scene.views, 0), views_of(scene.masks), options, quiet);
    const CameraErrors e = compare_cameras(r.views.cameras(), scene.views.cameras(), {});
    EXPECT_NEAR(e.truth_from_estimate.scale, 1, 0.01);
}

TEST(Align, ARoundObjectKeepsItsEvenAngles) {
    SyntheticSpec spec = small_orbit(1, 18);
    spec.solids = round_object();
    spec.rig.shake_angle_deg = 0;
    const Found f = find(spec, {});
    EXPECT_TRUE(f.result.failures.empty()) << f.result.failures.front();
    EXPECT_FALSE(f.result.angles_observable);
    ASSERT_FALSE(f.result.warnings.empty());
    EXPECT_NE(f.result.warnings.front().find("same from all around"), std::string::npos);
    for (size_t i = 1; i < f.result.aligned.size(); ++i)
        EXPECT_NEAR(std::fabs(std::remainder(f.result.aligned[i].azimuth_deg - f.result.aligned[i - 1].azimuth_deg, 360)), 20, 0.5);
}

TEST(Align, TheWrongDirectionIsRefused) {
    AlignOptions options;
    options.direction = Turn::Counterclockwise;
    options.restarts = 0;
    const Found f = find(small_orbit(1, 16), options);
    EXPECT_FALSE(f.result.failures.empty());
}

TEST(Align, AnotherObjectsMasksAreRefused) {
    const SyntheticScene a = synthesize(small_orbit(1, 16), quiet), b = synthesize(small_orbit(5, 16), quiet);
    std::vector<MaskView> masks = views_of(a.masks);
    for (size_t i = 0; i < masks.size(); i += 2) masks[i] = view_of(b.masks[i]);
    AlignOptions options;
    options.restarts = 0;
    EXPECT_FALSE(align(without_cameras(a.views, 1), masks, options, quiet).failures.empty());
}

TEST(Align, ABrokenMaskIsNamedAndDoesNoHarm) {
    SyntheticScene scene = synthesize(small_orbit(1, 20), quiet);
    add_blob(scene.masks[7].coverage, 0.7, 0.4, 45);
    const AlignResult r = align(without_cameras(scene.views, 0), views_of(scene.masks), {}, quiet);
    EXPECT_TRUE(r.failures.empty()) << r.failures.front();
    for (size_t i = 0; i < r.aligned.size(); ++i) EXPECT_EQ(r.aligned[i].bad, i == 7) << i;
    std::vector<Camera> found = r.views.cameras(), truth = scene.views.cameras();
    found.erase(found.begin() + 7);
    truth.erase(truth.begin() + 7);
    EXPECT_LT(compare_cameras(found, truth, points_on(scene)).reprojection_rms_px, 0.4);
}

TEST(Align, GivenCamerasAreRefinedInTheirOwnWorld) {
    SyntheticSpec spec = small_orbit(4, 20);
    spec.rig.shake_angle_deg = 3;
    const SyntheticScene scene = synthesize(spec, quiet);
    Views nominal = scene.nominal;
    // A world of other units, moved and turned.
    const Similarity world{25, turned({20, -40, 70}), Vec3d(100, -30, 12)};
    for (View& v : nominal.views) {
        Rigid3& p = v.camera.camera_from_world;
        const Vec3d centre = world * v.camera.centre_world();
        p.rotation = p.rotation * world.rotation.transpose();
        p.translation = -(p.rotation * centre);
    }
    nominal.up = "-y";
    nominal.units = "cm";
    AlignOptions options;
    options.method = AlignMethod::Refine;
    const AlignResult r = align(nominal, views_of(scene.masks), options, quiet);
    EXPECT_TRUE(r.failures.empty());
    const CameraErrors before = compare_cameras(nominal.cameras(), scene.views.cameras(), points_on(scene)),
                       after = compare_cameras(r.views.cameras(), scene.views.cameras(), points_on(scene));
    EXPECT_GT(before.reprojection_rms_px, 2);
    EXPECT_LT(after.reprojection_rms_px, 0.4);
    EXPECT_NEAR(after.truth_from_estimate.scale, 1.0 / 25, 0.05 / 25) << "the world stays the given cameras'";
    EXPECT_EQ(r.views.up, "-y");
    EXPECT_EQ(r.views.units, "cm");
    EXPECT_EQ(r.direction, Turn::Clockwise) << "the cameras walk counterclockwise; the world's y is not quite their axis";
    Views backwards = nominal;
    std::reverse(backwards.views.begin(), backwards.views.end());
    std::vector<Mask> masks(scene.masks.rbegin(), scene.masks.rend());
    EXPECT_EQ(align(backwards, views_of(masks), options, quiet).direction, Turn::Counterclockwise);
}

TEST(Align, TwoRingsAndTwoSittingsFindEachOther) {
    SyntheticSpec rings = small_orbit(2, 0);
    rings.rig.kind = Rig::Kind::Rings;
    rings.rig.rings = {{12, 5}, {12, 35}};
    AlignOptions options;
    options.rings = {12, 12};
    options.restarts = 0;
    const Found two = find(rings, options);
    EXPECT_TRUE(two.result.failures.empty()) << two.result.failures.front();
    EXPECT_LT(two.errors.reprojection_rms_px, 0.4);
    EXPECT_EQ(two.result.symmetry, 1);

    SyntheticSpec tipped = small_orbit(2, 28);
    tipped.rig.sittings = 2;
    tipped.rig.arc_deg = 720;
    tipped.rig.elevation_deg = 15;
    options.rings.clear();
    options.sittings = {14, 14};
    const Found laid = find(tipped, options);
    EXPECT_TRUE(laid.result.failures.empty()) << laid.result.failures.front();
    EXPECT_LT(laid.errors.reprojection_rms_px, 0.4);
    ASSERT_EQ(laid.result.views.sittings.size(), 2u);
    EXPECT_EQ(laid.result.views.views.front().sitting, "0");
    EXPECT_EQ(laid.result.views.views.back().sitting, "1");
    // The object was tipped by a right angle, so the second sitting's axis lies in the first's ground plane.
    EXPECT_NEAR(laid.result.views.sittings[1].scene_from_sitting.rotation(2, 2), 0, 0.02);
}

TEST(Align, SameBitsOnAnyNumberOfThreads) {
    const SyntheticScene scene = synthesize(small_orbit(6, 12), quiet);
    const auto run = [&](size_t threads) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        AlignOptions options;
        options.restarts = 1;
        return align(without_cameras(scene.views, 0), views_of(scene.masks), options, quiet);
    };
    const AlignResult one = run(1), many = run(4);
    EXPECT_EQ(cameras_json(one.views), cameras_json(many.views));
    EXPECT_EQ(alignment_json(one), alignment_json(many));
}

TEST(Align, OptionsThatContradictEachOtherAreNamedTogether) {
    const SyntheticScene scene = synthesize(small_orbit(1, 8), quiet);
    AlignOptions options;
    options.angles_deg = {0, 10};
    options.rings = {4, 3};
    options.known_distance = options.known_height = 1;
    try {
        align(without_cameras(scene.views, 0), views_of(scene.masks), options, quiet);
        FAIL();
    } catch (const UsageError& e) {
        for (const char* part : {"2 angles for 8 views", "--rings: 3 views together", "7 views, the scene has 8", "one of --known-distance"})
            EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
    EXPECT_THROW(align(without_cameras(scene.views, 0), std::vector<MaskView>(8), {}, quiet), InputError);
    // What a method does not heed is not swallowed.
    AlignOptions refine;
    refine.method = AlignMethod::Refine;
    refine.direction = Turn::Clockwise;
    refine.paper_views = {"1", "2"};
    EXPECT_EQ(given_options(refine), (std::vector<std::string>{"--method", "--direction", "--paper-views"}));
    try {
        align(scene.views, views_of(scene.masks), refine, quiet);
        FAIL();
    } catch (const UsageError& e) {
        for (const char* part : {"--direction is of --method coherence or paper, not of refine", "--paper-views is of --method paper"})
            EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
    EXPECT_TRUE(given_options({}).empty());
}

// Half a turn brings a plate on its edge back to itself, a third does not; a lump is never the same.
TEST(Align, ATwofoldSymmetryIsSeen) {
    SyntheticSpec spec = small_orbit(2, 18);
    Solid plate;
    plate.kind = Solid::Kind::Box;
    plate.size = Vec3d(0.6, 0.25, 0.45);
    spec.solids = {plate};
    spec.rig.elevation_deg = 25;
    spec.rig.shake_angle_deg = 0;
    AlignOptions options;
    options.restarts = 0;
    const Found f = find(spec, options);
    EXPECT_EQ(f.result.symmetry, 2);
    EXPECT_NE(
        std::find_if(f.result.warnings.begin(), f.result.warnings.end(), [](const std::string& w) { return w.find("1/2 of a turn") != std::string::npos; }),
        f.result.warnings.end());
    const Found lump = find(small_orbit(2, 18), options);
    EXPECT_TRUE(lump.result.angles_observable);
    EXPECT_EQ(lump.result.symmetry, 1);
}

// One ring said to be two, before a camera that is said to stand: refused, with cameras for every view.
TEST(Align, RingsThatAreNoneAreRefused) {
    AlignOptions options;
    options.orbit = Orbit::Turntable;
    options.rings = {10, 10};
    options.restarts = 0;
    const Found f = find(small_orbit(1, 20), options);
    EXPECT_FALSE(f.result.failures.empty());
    EXPECT_EQ(f.result.aligned.size(), 20u);
    EXPECT_TRUE(std::isfinite(f.result.rms_px));
}

// A stabiliser's crop wanders before a table that turns evenly: given its own principal point, every view finds it; without, the table is not believed.
TEST(Align, ACropThatDriftsIsFollowed) {
    SyntheticSpec spec = small_orbit(3, 18);
    spec.rig.shake_angle_deg = spec.rig.shake_look_at = spec.rig.shake_roll_deg = 0;
    spec.rig.crop_drift_px = 5;
    AlignOptions options;
    options.restarts = 0;
    options.orbit = Orbit::Turntable;
    EXPECT_FALSE(find(spec, options).result.failures.empty());
    options.centre_varies = true;
    const Found f = find(spec, options);
    EXPECT_TRUE(f.result.failures.empty()) << f.result.failures.front();
    EXPECT_LT(f.errors.reprojection_rms_px, 0.4);
    EXPECT_LT(f.errors.rotation_rms_deg, 0.3);
    // All of them together may be off: that is a turn of all cameras.
    double mean_px = 0, off_px = 0;
    const std::vector<Camera> found = f.result.views.cameras(), truth = f.scene.views.cameras();
    const auto off = [&](size_t i) { return found[i].intrinsics.cx - truth[i].intrinsics.cx; };
    for (size_t i = 0; i < 18; ++i) mean_px += off(i) / 18;
    for (size_t i = 0; i < 18; ++i) off_px = std::max(off_px, std::fabs(off(i) - mean_px));
    EXPECT_LT(off_px, 1.0) << "they wander by 5 px each way";
}

// Views beyond those that are searched with are placed before them, a broken one among them is named, whatever the number of threads.
TEST(Align, ManyViewsAreSearchedByAFew) {
    SyntheticSpec spec = small_orbit(2, 54);
    spec.rig.width_px = 320, spec.rig.height_px = 240;
    SyntheticScene scene = synthesize(spec, quiet);
    const size_t broken = 7;  // one that is searched with; of 54 every ninth is not: 8, 17, 26 …
    for (const size_t which : {broken, size_t{17}}) add_blob(scene.masks[which].coverage, 0.75, 0.4, 30);
    AlignOptions options;
    options.restarts = 0;
    const AlignResult r = align(without_cameras(scene.views, 0), views_of(scene.masks), options, quiet);
    EXPECT_TRUE(r.failures.empty()) << r.failures.front();
    for (size_t i = 0; i < r.aligned.size(); ++i) EXPECT_EQ(r.aligned[i].bad, i == broken || i == 17) << i;
    std::vector<Camera> found, truth;
    for (size_t i = 0; i < r.aligned.size(); ++i)
        if (!r.aligned[i].bad) found.push_back(r.views.cameras()[i]), truth.push_back(scene.views.cameras()[i]);
    EXPECT_LT(compare_cameras(found, truth, points_on(scene)).reprojection_rms_px, 0.3);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    const AlignResult again = align(without_cameras(scene.views, 0), views_of(scene.masks), options, quiet);
    for (size_t i = 0; i < r.aligned.size(); ++i) {
        EXPECT_EQ(r.views.views[i].camera.camera_from_world.translation, again.views.views[i].camera.camera_from_world.translation) << i;
        EXPECT_EQ(r.aligned[i].residual_px, again.aligned[i].residual_px) << i;
    }
}

// What restarts leave open is asked of views that have a say: a broken mask does not make an object round.
TEST(Align, ATurntableWithABrokenMaskIsNotRound) {
    SyntheticSpec spec = small_orbit(1, 18);
    spec.rig.shake_angle_deg = spec.rig.shake_look_at = spec.rig.shake_roll_deg = 0;
    SyntheticScene scene = synthesize(spec, quiet);
    add_blob(scene.masks[5].coverage, 0.7, 0.4, 45);
    const AlignResult r = align(without_cameras(scene.views, 0), views_of(scene.masks), {}, quiet);
    EXPECT_EQ(r.orbit, Orbit::Turntable);
    EXPECT_TRUE(r.aligned[5].bad);
    EXPECT_TRUE(r.angles_observable);
    EXPECT_LT(r.azimuth_spread_deg, 0.3);
}

TEST(CompareCameras, DoesNotSeeASimilarity) {
    const SyntheticScene scene = synthesize(small_orbit(1, 8), quiet);
    const Similarity moved{3, turned({10, 50, -20}), Vec3d(1, 2, 3)};
    std::vector<Camera> other = scene.views.cameras();
    for (Camera& c : other) {
        const Vec3d centre = moved * c.centre_world();
        c.camera_from_world.rotation = c.camera_from_world.rotation * moved.rotation.transpose();
        c.camera_from_world.translation = -(c.camera_from_world.rotation * centre);
    }
    const CameraErrors same = compare_cameras(other, scene.views.cameras(), points_on(scene));
    EXPECT_LT(same.rotation_max_deg, 1e-5);
    EXPECT_LT(same.centre_max, 1e-9);
    EXPECT_LT(same.reprojection_rms_px, 1e-6);
    EXPECT_NEAR(same.truth_from_estimate.scale, 1.0 / 3, 1e-9);
    other[3].camera_from_world.rotation = Eigen::AngleAxisd(1 * kRadians, Vec3d::UnitZ()).toRotationMatrix() * other[3].camera_from_world.rotation;
    const CameraErrors one = compare_cameras(other, scene.views.cameras(), points_on(scene));
    EXPECT_NEAR(one.rotation_deg[3], 1, 0.2);
    EXPECT_GT(one.reprojection_rms_px, 0.1);
}

struct Folder {
    TemporaryFolder folder;
    ReconstructOptions options;

    explicit Folder(const SyntheticSpec& spec) {
        write_scene(synthesize(spec, quiet), folder / "scene");
        for (const char* file : {"transforms.json", "transforms_nominal.json"}) std::filesystem::remove(folder / "scene" / file);
        options.views.scene = folder / "scene";
        options.run.output = folder / "out";
        options.grid.resolution = 64;
        options.color.options.mode = ColorMode::None;
        options.result.mesh_formats = {"ply"};
        options.align.restarts = 1;
    }
    nlohmann::json run() {
        Progress progress;
        return nlohmann::json::parse(reconstruct(options, progress).report_json);
    }
};

TEST(AlignPipeline, MasksAloneBecomeAMeshAndAgainTheSame) {
    Folder f(small_orbit(1, 14));
    const nlohmann::json first = f.run();
    EXPECT_TRUE(first["align"]["verified"]);
    EXPECT_EQ(first["align"]["units"], "arbitrary");
    EXPECT_EQ(first["align"]["views"].size(), 14u);
    EXPECT_GT(first["silhouette_iou"]["minimum"], 0.95);
    EXPECT_TRUE(first["mesh"]["manifold"]);
    EXPECT_TRUE(std::filesystem::exists(f.folder / "out/orbit.svg"));
    const std::string mesh = read_text(f.folder / "out/mesh.ply"), cameras = read_text(f.folder / "out/cameras.json");
    const nlohmann::json again = f.run();
    for (const auto& stage : again["stages"])
        if (stage["name"] == "align" || stage["name"] == "carve") {
            EXPECT_TRUE(stage["reused"]) << stage["name"];
        }
    EXPECT_EQ(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_EQ(read_text(f.folder / "out/cameras.json"), cameras);
    EXPECT_EQ(again["align"], first["align"]);
    // What was found is a camera file like any other, and carves to the same bits.
    std::filesystem::copy_file(f.folder / "out/cameras.json", f.folder / "scene/cameras.json");
    f.options.run.output = f.folder / "out2";
    f.options.align = {};
    f.run();
    EXPECT_EQ(read_text(f.folder / "out2/mesh.ply"), mesh);
}

TEST(AlignPipeline, CamerasThatCannotBeTrustedEndTheRunUnlessAccepted) {
    Folder f(small_orbit(1, 14));
    f.run();
    const std::string mesh = read_text(f.folder / "out/mesh.ply"), cameras = read_text(f.folder / "out/cameras.json"),
                      report = read_text(f.folder / "out/report.json");
    f.options.align.direction = Turn::Counterclockwise;
    const std::string said = error_of(ExitCode::Undetermined, [&] { f.run(); });
    EXPECT_NE(said.find("do not fit together"), std::string::npos) << said;
    EXPECT_NE(said.find("--accept-unobservable"), std::string::npos) << said;
    // What was there before stays, and what was found lies apart.
    EXPECT_EQ(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_EQ(read_text(f.folder / "out/cameras.json"), cameras);
    EXPECT_EQ(read_text(f.folder / "out/report.json"), report);
    for (const char* file : {"preview.png", "cameras.json", "report.json"}) EXPECT_TRUE(std::filesystem::exists(f.folder / "out/unverified" / file)) << file;
    EXPECT_FALSE(nlohmann::json::parse(read_text(f.folder / "out/unverified/report.json"))["align"]["verified"]);
    // Nor are such cameras carved with by another run that does not ask for it.
    std::filesystem::copy_file(f.folder / "out/unverified/cameras.json", f.folder / "doubtful.json");
    const ReconstructOptions searching = f.options;
    f.options.align = {};
    f.options.views.cameras = f.folder / "doubtful.json";
    f.options.run.output = f.folder / "out2";
    f.options.carve.max_misses = 4;  // or nothing is left
    EXPECT_NE(error_of(ExitCode::Undetermined, [&] { f.run(); }).find("UNVERIFIED"), std::string::npos);
    f.options.cameras.accept_unobservable = true;
    f.run();
    EXPECT_TRUE(std::filesystem::exists(f.folder / "out2/mesh.ply"));
    EXPECT_NE(read_text(f.folder / "out2/cameras.json").find("unverified"), std::string::npos);
    f.options = searching;
    f.options.cameras.accept_unobservable = true;
    f.options.carve.max_misses = 4;
    const nlohmann::json r = f.run();
    EXPECT_FALSE(r["align"]["verified"]);
    EXPECT_NE(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_FALSE(std::filesystem::exists(f.folder / "out/unverified"));
}

TEST(AlignPipeline, ABrokenMaskIsNotCarvedWith) {
    Folder f(small_orbit(1, 20));
    const double clean = f.run()["mesh"]["volume"];
    const std::filesystem::path file = f.folder / "scene/masks/0007.png";
    std::filesystem::copy_file(file, f.folder / "clean.png");
    Image8 mask = io::read_image8(file);
    for (int y = 0; y < mask.height; ++y)
        for (int x = mask.width / 2; x < mask.width; ++x) mask.at(x, y) = 0;
    const std::vector<uint8_t> png = io::encode_png(mask);
    write_file(file, png.data(), png.size());
    const nlohmann::json broken = f.run();
    EXPECT_NEAR(broken["mesh"]["volume"].get<double>() / clean, 1, 0.03);
    for (size_t i = 0; i < 20; ++i) EXPECT_EQ(broken["views"][i]["used"], i != 7) << i;
    // The camera file says so too.
    const std::string mesh = read_text(f.folder / "out/mesh.ply");
    std::filesystem::copy_file(f.folder / "out/cameras.json", f.folder / "scene/cameras.json");
    f.options.run.output = f.folder / "out2";
    f.options.align = {};
    EXPECT_FALSE(f.run()["views"][7]["used"]);
    EXPECT_EQ(read_text(f.folder / "out2/mesh.ply"), mesh);
    EXPECT_NE(read_text(f.folder / "out2/cameras.json").find("\"unused\": \"its silhouette contradicts"), std::string::npos);
    // A mended mask has its say again when cameras are refined.
    std::filesystem::remove(file);
    std::filesystem::copy_file(f.folder / "clean.png", file);
    f.options.run.output = f.folder / "out3";
    f.options.align.method = AlignMethod::Refine;
    f.options.align.features = false;
    f.options.cameras.find_again = true;
    EXPECT_TRUE(f.run()["views"][7]["used"]);
}

TEST(Align, FewViewsAreNotTakenForARoundObject) {
    const SyntheticScene scene = synthesize(small_orbit(1, 5), quiet);
    const AlignResult r = align(without_cameras(scene.views, 0), views_of(scene.masks), {}, quiet);
    for (const std::string& w : r.warnings) EXPECT_EQ(w.find("looks the same"), std::string::npos) << w;
    std::string said;
    for (const auto* all : {&r.failures, &r.warnings})
        for (const std::string& s : *all) said += s;
    EXPECT_NE(said.find("5 silhouettes "), std::string::npos) << said;
    EXPECT_NE(said.find("two dozen photographs"), std::string::npos) << said;
}

TEST(AlignPipeline, PhotographsSayTheirFocalLength) {
    SyntheticSpec spec = small_orbit(1, 4);
    spec.photos = true;
    spec.look.jpeg_quality = 90;
    spec.look.exif = true;
    Folder f(spec);
    ViewsOptions options;
    options.scene = f.folder / "scene";
    EXPECT_NE(error_of(ExitCode::Input, [&] { load_views(options, quiet); }).find("vdbcarve align"), std::string::npos);
    options.allow_unposed = true;
    const Views views = load_views(options, quiet);
    EXPECT_FALSE(views.posed);
    ASSERT_EQ(views.views.size(), 4u);
    // EXIF has whole millimetres.
    const double true_px = 0.5 * 360 / std::tan(0.5 * spec.rig.fov_deg * kRadians);
    EXPECT_NEAR(views.views[0].camera.intrinsics.fx / true_px, 1, 0.5 / (true_px / 480 * 36));
    EXPECT_EQ(views.views[0].camera.intrinsics.width_px, 480);
}

}  // namespace
}  // namespace vdbcarve::test
