// SPDX-License-Identifier: Apache-2.0
// The ruler, against shapes whose distances are known; and check, on scenes with a known mistake.
#include "vdbcarve/evaluate.h"

#include <numbers>
#include <random>

#include "support/scenes.h"
#include "vdbcarve/check.h"

namespace vdbcarve::test {
namespace {

/// A closed ball of latitudes and longitudes, vertices on the sphere, faces outward.
Mesh ball(double radius, const Vec3d& centre, int rings = 90) {
    Mesh m;
    const int around = 2 * rings;
    const auto put = [&](const Vec3d& p) { m.vertices.push_back({static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())}); };
    put(centre + Vec3d(0, 0, radius));
    for (int r = 1; r < rings; ++r)
        for (int a = 0; a < around; ++a) {
            const double t = std::numbers::pi * r / rings, p = 2 * std::numbers::pi * a / around;
            put(centre + radius * Vec3d(std::sin(t) * std::cos(p), std::sin(t) * std::sin(p), std::cos(t)));
        }
    put(centre - Vec3d(0, 0, radius));
    const auto at = [&](int r, int a) { return static_cast<uint32_t>(r == 0 ? 0 : r == rings ? 1 + (rings - 1) * around : 1 + (r - 1) * around + a % around); };
    for (int r = 0; r < rings; ++r)
        for (int a = 0; a < around; ++a) {
            if (r > 0) m.triangles.push_back({at(r, a), at(r + 1, a), at(r, a + 1)});
            if (r + 1 < rings) m.triangles.push_back({at(r + 1, a), at(r + 1, a + 1), at(r, a + 1)});
        }
    return m;
}

TEST(Evaluate, BallsOneInsideTheOther) {
    Progress quiet;
    const Mesh truth = ball(1, {0.2, -0.1, 3}), larger = ball(1.1, {0.2, -0.1, 3});
    ASSERT_TRUE(measure(truth).manifold);
    EvaluateOptions o;
    o.samples = 20000;
    const Evaluation e = evaluate(larger, truth, o, quiet);
    EXPECT_NEAR(e.to_truth.mean, 0.1, 5e-4);
    EXPECT_NEAR(e.from_truth.mean, 0.1, 5e-4);
    EXPECT_NEAR(e.chamfer, 0.1, 5e-4);
    EXPECT_NEAR(e.accuracy90, 0.1, 6e-4);
    EXPECT_NEAR(e.hausdorff, 0.1, 1e-3);
    EXPECT_NEAR(e.hausdorff95, 0.1, 1e-3);
    EXPECT_NEAR(e.volume_excess, 0.331, 1e-3);
    EXPECT_NEAR(e.iou, 1 / 1.331, 2e-3);
    EXPECT_LT(e.truth_lost, 1e-3);
    EXPECT_LT(e.normal_error_mean_deg, 2);
    EXPECT_DOUBLE_EQ(e.threshold, 0.01 * e.truth_size);
    EXPECT_EQ(e.f_score, 0);
    o.threshold = 0.11;
    EXPECT_EQ(evaluate(larger, truth, o, quiet).f_score, 1);
    // The smaller one has lost a part of the truth.
    EXPECT_NEAR(evaluate(truth, larger, o, quiet).truth_lost, 1 - 1 / 1.331, 3e-3);
}

TEST(Evaluate, DistancesEqualBruteForce) {
    // Random triangles, points on one against every triangle of the other: through a sphere of samples, not the BVH.
    std::mt19937 engine(4);
    const auto random = [&] { return static_cast<float>(engine()) * 0x1p-31f - 1.f; };
    Mesh soup, point;
    for (uint32_t n = 0; n < 60; ++n) {
        for (int c = 0; c < 3; ++c) soup.vertices.push_back({random(), random(), random()});
        soup.triangles.push_back({3 * n, 3 * n + 1, 3 * n + 2});
    }
    Progress quiet;
    EvaluateOptions o;
    o.samples = 1;
    for (int n = 0; n < 40; ++n) {
        // A tiny triangle stands for a point.
        const std::array<float, 3> p{2 * random(), 2 * random(), 2 * random()};
        point.vertices = {p, {p[0] + 1e-5f, p[1], p[2]}, {p[0], p[1] + 1e-5f, p[2]}};
        point.triangles = {{0, 1, 2}};
        double best = 1e9;
        for (const auto& t : soup.triangles) {
            Vec3d v[3];
            for (size_t c = 0; c < 3; ++c) v[c] = Vec3d(soup.vertices[t[c]][0], soup.vertices[t[c]][1], soup.vertices[t[c]][2]);
            for (int i = 0; i <= 400; ++i)
                for (int j = 0; j <= 400 - i; ++j)
                    best = std::min(best, (v[0] + i / 400.0 * (v[1] - v[0]) + j / 400.0 * (v[2] - v[0]) - Vec3d(p[0], p[1], p[2])).norm());
        }
        EXPECT_NEAR(evaluate(point, soup, o, quiet).to_truth.max, best, 5e-3);
    }
}

TEST(Evaluate, AlignmentIsRecovered) {
    Similarity known;
    known.scale = 2.5;
    known.rotation = (Eigen::AngleAxisd(0.7, Vec3d(1, 2, 3).normalized())).toRotationMatrix();
    known.translation = Vec3d(4, -5, 6);
    std::vector<Vec3d> from{{0, 0, 0}, {1, 0, 0}, {0, 2, 0}, {0.3, 0.4, 1}}, to;
    for (const Vec3d& p : from) to.push_back(known * p);
    const Similarity found = align_points(from, to);
    EXPECT_NEAR(found.scale, 2.5, 1e-12);
    EXPECT_LT((found.rotation - known.rotation).norm(), 1e-12);
    EXPECT_LT((found.translation - known.translation).norm(), 1e-11);
    EXPECT_THROW(align_points({from[0], from[1]}, {to[0], to[1]}), UndeterminedError);
    EXPECT_THROW(align_points({{0, 0, 0}, {1, 1, 1}, {2, 2, 2}}, {to[0], to[1], to[2]}), UndeterminedError);
    Progress quiet;
    EvaluateOptions o;
    o.samples = 2000;
    o.align = known;
    Mesh moved = ball(1, {0, 0, 0}), truth = moved;
    for (auto& v : truth.vertices) {
        const Vec3d p = known * Vec3d(v[0], v[1], v[2]);
        v = {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())};
    }
    const Evaluation e = evaluate(moved, truth, o, quiet);
    EXPECT_LT(e.hausdorff, 1e-5);
    EXPECT_NEAR(e.volume_excess, 0, 1e-5);
    EXPECT_NE(evaluation_json(e).find("\"f_score\": 1.0"), std::string::npos);
}

TEST(Evaluate, OpenMeshesHaveNoSolid) {
    Progress quiet;
    Mesh open = ball(1, {0, 0, 0}, 12);
    open.triangles.pop_back();
    EvaluateOptions o;
    o.samples = 500;
    EXPECT_TRUE(std::isnan(evaluate(open, ball(1, {0, 0, 0}, 12), o, quiet).iou));
    EXPECT_THROW(evaluate(Mesh{}, open, o, quiet), InputError);
}

// ------------------------------------------------------------------------------------ check

CheckResult check_of(const std::filesystem::path& scene) {
    Progress quiet;
    CheckOptions o;
    o.views.scene = scene;
    o.resolution = 64;
    return check(o, quiet);
}

TEST(Check, AGoodSceneIsGood) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 12, 200, 150);
    spec.rig.elevation_deg = 17;
    spec.photos = false;
    Progress quiet;
    const SyntheticScene scene = synthesize(spec, quiet);
    write_scene(scene, folder / "scene");
    const CheckResult r = check_of(folder / "scene");
    EXPECT_EQ(r.exit_code, ExitCode::Done) << check_text(r);
    EXPECT_GT(r.median_iou, 0.97);
    EXPECT_NEAR(r.elevation_min_deg, 17, 0.5);
    EXPECT_NEAR(r.largest_gap_deg, 30, 0.5);
    EXPECT_LT((r.up_world - Vec3d::UnitZ()).norm(), 0.01);
    EXPECT_LT(r.look_at_miss, 1e-6);
    EXPECT_NE(check_text(r).find("one height"), std::string::npos);
    EXPECT_EQ(r.agreements.size(), 12u);
}

TEST(Check, SwappedMasksAndForeignAxesAreContradictions) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 12, 160, 120);
    spec.photos = false;
    Progress quiet;
    SyntheticScene scene = synthesize(spec, quiet);
    // Every view has another's mask. (All shifted by as many would be a turned object, and no contradiction.)
    for (size_t i = 0; i + 1 < scene.masks.size(); i += 2) std::swap(scene.masks[i], scene.masks[i + 1]);
    std::swap(scene.masks[2], scene.masks[9]);
    write_scene(scene, folder / "swapped");
    const CheckResult swapped = check_of(folder / "swapped");
    EXPECT_EQ(swapped.exit_code, ExitCode::Contradiction) << check_text(swapped);
    ASSERT_FALSE(swapped.of(Finding::Severity::Error).empty());
    scene = synthesize(spec, quiet);
    for (View& v : scene.views.views) v.camera.camera_from_world.rotation = Vec3d(1, -1, -1).asDiagonal() * v.camera.camera_from_world.rotation;
    for (View& v : scene.views.views) v.camera.camera_from_world.translation = Vec3d(1, -1, -1).asDiagonal() * v.camera.camera_from_world.translation;
    write_scene(scene, folder / "opengl");
    const CheckResult turned = check_of(folder / "opengl");
    EXPECT_EQ(turned.exit_code, ExitCode::Contradiction);
    EXPECT_NE(check_text(turned).find("axes"), std::string::npos) << check_text(turned);
}

TEST(Check, OneBrokenMaskIsNamed) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 14, 200, 150);
    spec.photos = false;
    spec.damage.blobs = 3;
    spec.damage.radius_px = 18;
    spec.damage.share = 1.0 / 14;  // the last view
    Progress quiet;
    write_scene(synthesize(spec, quiet), folder / "scene");
    const CheckResult r = check_of(folder / "scene");
    ASSERT_FALSE(r.agreements.empty());
    EXPECT_EQ(r.agreements.front().name, "images/0013.png");
    EXPECT_GT(r.agreements.front().agreement.largest_missed_blob_px, 100u);
    EXPECT_NE(check_text(r).find("0013.png"), std::string::npos);
}

TEST(Agreement, ThinPartsThatAreGoneAreMeasured) {
    // A block with a rod of 4 px on it, and a silhouette without the rod.
    Mask mask;
    mask.coverage = Image8(120, 100);
    Image8 hit(120, 100);
    for (int y = 40; y < 90; ++y)
        for (int x = 30; x < 90; ++x) mask.coverage.at(x, y) = hit.at(x, y) = 255;
    for (int y = 10; y < 40; ++y)
        for (int x = 58; x < 62; ++x) mask.coverage.at(x, y) = 255;
    const SilhouetteAgreement a = compare_silhouettes(hit, view_of(mask));
    EXPECT_EQ(a.missed_px, 120u);
    EXPECT_EQ(a.largest_missed_blob_px, 120u);
    EXPECT_NEAR(static_cast<double>(a.thin_length_lost_px), 28, 4);
    EXPECT_EQ(a.missed_blob, (std::array<int, 4>{58, 10, 62, 40}));
    EXPECT_EQ(compare_silhouettes(mask.coverage, view_of(mask)).thin_length_lost_px, 0u);
}

}  // namespace
}  // namespace vdbcarve::test
