// SPDX-License-Identifier: Apache-2.0
// Synthetic shoots: inputs and truth.

#include <cmath>
#include <functional>
#include <numbers>
#include <set>

#include "vdbcarve/pipeline.h"
#include "support/scenes.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/export.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

TEST(Synthetic, SameSeedSameSceneOtherSeedAnother) {
    SyntheticSpec spec = small_spec("cup", 2, 64, 48);
    spec.rig.shake_angle_deg = 5;
    Progress quiet;
    const SyntheticScene a = synthesize(spec, quiet), b = synthesize(spec, quiet);
    spec.seed = 2;
    const SyntheticScene c = synthesize(spec, quiet);
    EXPECT_EQ(a.photos[1].data, b.photos[1].data);
    EXPECT_EQ(cameras_json(a.views), cameras_json(b.views));
    EXPECT_NE(cameras_json(a.views), cameras_json(c.views));
    EXPECT_EQ(cameras_json(a.nominal), cameras_json(c.nominal));
}

TEST(Synthetic, MasksOfABallHaveItsClosedForm) {
    SyntheticSpec spec;
    Solid ball;
    ball.size = Vec3d::Constant(0.5);
    spec.solids = {ball};
    spec.photos = false;
    spec.rig.views = 3;
    spec.rig.width_px = 90;
    spec.rig.height_px = 70;
    Progress quiet;
    const SyntheticScene s = synthesize(spec, quiet);
    for (size_t v = 0; v < 3; ++v) {
        const Camera& c = s.views.views[v].camera;
        const Vec3d axis = -c.centre_world();
        const double cosine = std::cos(std::asin(0.5 / axis.norm()));
        for (int y = 0; y < 70; ++y)
            for (int x = 0; x < 90; ++x) {
                int count = 0;
                for (int j = 0; j < 16; ++j)
                    for (int i = 0; i < 16; ++i) count += c.ray({x + (i + 0.5) / 16, y + (j + 0.5) / 16}).direction.dot(axis.normalized()) >= cosine;
                ASSERT_NEAR(s.masks[v].coverage.at(x, y), (count * 255 + 128) / 256, 2) << x << " " << y;
            }
    }
}

TEST(Synthetic, MeshAndSolidsGiveTheSameMasks) {
    SyntheticSpec spec = small_spec("ellipsoids", 3, 120, 90);
    spec.photos = false;
    spec.rig.distance = 4;
    Progress quiet;
    const SyntheticScene solids = synthesize(spec, quiet);
    EXPECT_TRUE(measure(solids.truth).manifold);
    SyntheticSpec mesh = spec;
    mesh.solids.clear();
    mesh.mesh = solids.truth;
    const SyntheticScene meshed = synthesize(mesh, quiet);
    for (size_t v = 0; v < 3; ++v) {
        double difference = 0, object = 0;
        for (size_t p = 0; p < solids.masks[v].coverage.data.size(); ++p) {
            difference += std::abs(solids.masks[v].coverage.data[p] - meshed.masks[v].coverage.data[p]) / 255.0;
            object += solids.masks[v].coverage.data[p] / 255.0;
        }
        EXPECT_LT(difference, 0.01 * object);
    }
}

// A disc less a ball's cap; rays end where its value is nought; patterns are what they are called.
TEST(Synthetic, TheBowlHasItsClosedForm) {
    SyntheticSpec spec = small_spec("bowl", 6, 200, 150);
    spec.rig.elevation_deg = 40;
    spec.look.flat = true;
    Progress quiet;
    const SyntheticScene scene = synthesize(spec, quiet);
    const double radius = 0.5, height = 0.28, depth = 0.2, rim = 0.86 * radius, pi = std::numbers::pi;
    const double volume = pi * radius * radius * height - pi * depth * (3 * rim * rim + depth * depth) / 6;
    EXPECT_NEAR(measure(scene.truth).volume, volume, 0.005 * volume);
    const Solid& bowl = spec.solids.front();
    EXPECT_NEAR(bowl.value({0, 0, 0.14}), 0.2, 1e-9);  // above the deepest place
    EXPECT_NEAR(bowl.value({0, 0, -0.14 + 0.04}), -0.04, 1e-9);
    size_t inside = 0;
    for (const View& v : scene.views.views)
        for (int y = 5; y < 150; y += 10)
            for (int x = 5; x < 200; x += 10) {
                const Camera::Ray ray = v.camera.ray(Vec2d(x, y));
                const auto t = bowl.hit(ray);
                if (!t) continue;
                const Vec3d p = ray.origin + *t * ray.direction;
                EXPECT_NEAR(bowl.value(p), 0, 1e-4);
                inside += p.z() < 0.1 && std::hypot(p.x(), p.y()) < 0.4;
            }
    EXPECT_GT(inside, 20u);
    const auto colors = [&](Pattern pattern) {
        spec.pattern = pattern;
        std::set<std::array<uint8_t, 3>> out;
        const SyntheticScene s = synthesize(spec, quiet);
        for (int y = 0; y < 150; ++y)
            for (int x = 0; x < 200; ++x)
                if (s.masks[0].coverage.at(x, y) == 255) out.insert({s.photos[0].at(x, y, 0), s.photos[0].at(x, y, 1), s.photos[0].at(x, y, 2)});
        return out.size();
    };
    EXPECT_EQ(colors(Pattern::Plain), 1u);
    EXPECT_GT(colors(Pattern::Checks), 1u);
    EXPECT_GT(colors(Pattern::Clay), 100u);
}

// Two sittings, a lens, breathing, an arc: masks belong to the true cameras all the same.
TEST(Synthetic, HardShootsStayConsistent) {
    struct Variant {
        const char* name;
        std::function<void(SyntheticSpec&)> set;
    };
    for (const Variant& v :
         {Variant{"two sittings", [](SyntheticSpec& s) { s.rig.sittings = 2; }},
          Variant{"lens",
                  [](SyntheticSpec& s) {
                      s.rig.lens = {Lens::Model::OpenCV, {-0.2, 0.05, 0.001, -0.002}};
                  }},
          Variant{"breathing", [](SyntheticSpec& s) { s.rig.breathing = 0.08; }}, Variant{"crop drift", [](SyntheticSpec& s) { s.rig.crop_drift_px = 8; }},
          Variant{"wide", [](SyntheticSpec& s) { s.rig.fov_deg = 100; }},
          Variant{"arc", [](SyntheticSpec& s) { s.rig.arc_deg = 500, s.rig.speed_variation = 0.6, s.rig.start_deg = 40; }}}) {
        TemporaryFolder folder;
        SyntheticSpec spec = small_spec("ellipsoids", 12, 200, 150);
        spec.photos = false;
        v.set(spec);
        Progress quiet;
        const SyntheticScene scene = synthesize(spec, quiet);
        write_scene(scene, folder / "scene");
        ReconstructOptions o;
        o.views.scene = folder / "scene";
        o.run.output = folder / "out";
        o.grid.resolution = 96;
        o.surface.fair = false;  // the hull holds the whole object
        const Reconstruction r = reconstruct(o, quiet);
        EXPECT_GT(r.minimum_iou, 0.975) << v.name;
        EXPECT_TRUE(r.mesh.manifold) << v.name;
        EXPECT_GT(r.mesh.volume, measure(scene.truth).volume * 0.995) << v.name;
    }
}

TEST(Synthetic, ATurntableTurnsTheObjectUnderTheLight) {
    SyntheticSpec spec = small_spec("ellipsoids", 2, 96, 72);
    spec.rig.motion = Rig::Motion::Turntable;
    spec.look.gloss = 0.5;
    spec.look.table = true;
    Progress quiet;
    const SyntheticScene turned = synthesize(spec, quiet);
    spec.rig.motion = Rig::Motion::Camera;
    const SyntheticScene walked = synthesize(spec, quiet);
    EXPECT_EQ(turned.masks[1].coverage.data, walked.masks[1].coverage.data);  // the same silhouettes …
    EXPECT_NE(turned.photos[1].data, walked.photos[1].data);                  // … under another light
    // Above the table the room stands still behind a turntable, and moves for a walking camera.
    size_t still = 0, moves = 0;
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 96; ++x)
            if (turned.masks[0].coverage.at(x, y) == 0 && turned.masks[1].coverage.at(x, y) == 0) {
                still += turned.photos[0].at(x, y, 1) != turned.photos[1].at(x, y, 1);
                moves += walked.photos[0].at(x, y, 1) != walked.photos[1].at(x, y, 1);
            }
    EXPECT_EQ(still, 0u);
    EXPECT_GT(moves, 100u);
}

TEST(Synthetic, DamageIsAsMuchAsAskedFor) {
    SyntheticSpec spec = small_spec("ellipsoids", 4, 320, 240);
    spec.photos = false;
    Progress quiet;
    const auto displacement = [&](const MaskDamage& d) {
        spec.damage = d;
        const SyntheticScene s = synthesize(spec, quiet);
        double sum = 0, sum2 = 0, n = 0;
        for (size_t v = 0; v < 4; ++v) {
            const ImageF before = signed_distance(s.true_masks[v].coverage), after = signed_distance(s.masks[v].coverage);
            for (size_t p = 0; p < before.data.size(); ++p)
                if (std::fabs(before.data[p]) < 0.5) {
                    sum += before.data[p] - after.data[p];
                    sum2 += std::pow(before.data[p] - after.data[p], 2);
                    ++n;
                }
        }
        return std::pair(sum / n, std::sqrt(sum2 / n));
    };
    EXPECT_NEAR(displacement({.dilate_px = 2}).first, 2, 0.2);
    const auto [mean, rms] = displacement({.noise_px = 1.5, .correlation_px = 25});
    EXPECT_NEAR(mean, 0, 0.3);
    EXPECT_NEAR(rms, 1.5, 0.45);
    spec.damage = {.holes = 2, .radius_px = 6, .share = 0.5};
    const SyntheticScene s = synthesize(spec, quiet);
    size_t damaged = 0;
    for (size_t v = 0; v < 4; ++v) damaged += s.masks[v].coverage.data != s.true_masks[v].coverage.data;
    EXPECT_EQ(damaged, 2u);
}

TEST(Synthetic, SpecsAreReadAndMistakesNamed) {
    TemporaryFolder folder;
    write_text(folder / "s.json",
               R"({"solids":[{"type":"box","size":[1,2,3],"turn_deg":[0,0,30]}],"rig":{"type":"dome","views":5,"orthographic":true},"seed":9})");
    const SyntheticSpec spec = read_spec(folder / "s.json");
    EXPECT_EQ(spec.solids.size(), 1u);
    EXPECT_EQ(spec.rig.views, 5);
    EXPECT_TRUE(spec.rig.orthographic);
    for (const auto& [text, part] : {std::pair{R"({"solid":[]})", "'solid'"}, std::pair{R"({"rig":{"views":"many"}})", "type must be number"},
                                     std::pair{R"({"solids":[{"type":"cone","size":[1,1,1]}]})", "cone"}, std::pair{"{", "parse error"}}) {
        write_text(folder / "bad.json", text);
        EXPECT_NE(error_of(ExitCode::Input, [&] { read_spec(folder / "bad.json"); }).find(part), std::string::npos) << text;
    }
    write_text(folder / "bowl.json", R"({"builtin":"bowl","pattern":"checks"})");
    EXPECT_EQ(read_spec(folder / "bowl.json").pattern, Pattern::Checks);
    write_text(folder / "bad.json", R"({"builtin":"bowl","pattern":"tartan"})");
    EXPECT_NE(error_of(ExitCode::Input, [&] { read_spec(folder / "bad.json"); }).find("tartan"), std::string::npos);
    for (const char* name : {"cup.json", "ellipsoids_dome.json", "turntable_cup.json"}) read_spec(std::string(VDBCARVE_SOURCE_DIR) + "/data/" + name);
}

}  // namespace
}  // namespace vdbcarve::test
