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

}  // namespace
}  // namespace vdbcarve::test
