// SPDX-License-Identifier: Apache-2.0
// check() on shoots that are wrong on purpose, each in one way.
#include <cmath>
#include <nlohmann/json.hpp>

#include "check/camera_doubts.h"
#include "image/image_io.h"
#include "support/camera_files.h"
#include "support/scenes.h"
#include "vdbcarve/check.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

/// Boxes seen from two heights, unevenly around: nothing of it looks the same when it is turned.
struct Scene {
    TemporaryFolder folder;
    SyntheticScene scene;

    explicit Scene(bool photos = false, int width = 240, int height = 180) {
        SyntheticSpec spec = small_spec("boxes", 16, width, height);
        spec.rig.kind = Rig::Kind::Rings;
        spec.rig.rings = {{9, 5}, {7, 32}};
        spec.rig.shake_angle_deg = 6;
        spec.rig.shake_roll_deg = 2;
        spec.photos = photos;
        Progress quiet;
        scene = synthesize(spec, quiet);
    }
    template <class Change>
    void each(const Change& change) {
        for (View& v : scene.views.views) change(v.camera);
    }
    CheckResult result(const std::function<void(CheckOptions&)>& choose = {}) {
        write_scene(scene, folder / "scene");
        return again(choose);
    }
    CheckResult again(const std::function<void(CheckOptions&)>& choose = {}) {
        Progress quiet;
        CheckOptions o;
        o.views.scene = folder / "scene";
        o.resolution = 96;
        if (choose) choose(o);
        return check(o, quiet);
    }
};

void expect_finding(const CheckResult& r, ExitCode code, const std::string& text, const std::string& remedy) {
    EXPECT_EQ(r.exit_code, code) << check_text(r);
    for (const Finding& f : r.findings)
        if (f.text.find(text) != std::string::npos && f.remedy.find(remedy) != std::string::npos) return;
    ADD_FAILURE() << "no finding with '" << text << "' and '" << remedy << "' in\n" << check_text(r);
}

/// The truth again, once what was found is heeded.
void expect_mended(Scene& s, const CheckResult& r) {
    ASSERT_TRUE(r.better);
    write_cameras(*r.better, s.folder / "fixed.json");
    const CheckResult mended = s.again([&](CheckOptions& o) { o.views.cameras = s.folder / "fixed.json"; });
    EXPECT_EQ(mended.exit_code, ExitCode::Done) << check_text(mended);
    EXPECT_GT(mended.median_iou, 0.97);
}

TEST(SceneCheck, AGoodOneHasNothingWrong) {
    Scene s;
    const CheckResult r = s.result();
    EXPECT_EQ(r.exit_code, ExitCode::Done);
    EXPECT_TRUE(r.of(Finding::Severity::Warning).empty()) << check_text(r);
    EXPECT_EQ(r.up_guessed, "z");
    EXPECT_LT(std::abs(r.shift_px[0]), 0.05);
    EXPECT_LT(std::abs(r.shift_px[1]), 0.1);
    EXPECT_NEAR(r.focal_factor, 1, 0.005);
    Box3d box;
    for (const auto& v : s.scene.truth.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    EXPECT_LT((r.object_size - box.sizes()).norm(), 0.15 * box.sizes().norm());
    EXPECT_EQ(r.soft_share, 1);
}

TEST(SceneCheck, PosesTheOtherWayRound) {
    Scene s;
    s.each([](Camera& c) { c.camera_from_world = c.camera_from_world.inverse(); });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Contradiction, "they fit inverted", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, OpenGlAxes) {
    Scene s;
    const Mat3d flip = Vec3d(1, -1, -1).asDiagonal();
    s.each([&](Camera& c) { c.camera_from_world = {flip * c.camera_from_world.rotation, flip * c.camera_from_world.translation}; });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Contradiction, "y and z axes negated", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, PosesTheOtherWayRoundWithOpenGlAxes) {
    Scene s;
    const Mat3d flip = Vec3d(1, -1, -1).asDiagonal();
    s.each([&](Camera& c) { c.camera_from_world = Rigid3{flip * c.camera_from_world.rotation, flip * c.camera_from_world.translation}.inverse(); });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Contradiction, "they fit inverted", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, PlacesForTranslations) {
    Scene s;
    s.each([](Camera& c) { c.camera_from_world.translation = c.centre_world(); });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Contradiction, "translations as the cameras' places", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, TransposedRotations) {
    Scene s;
    s.each([](Camera& c) { c.camera_from_world.rotation.transposeInPlace(); });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Contradiction, "rotations transposed", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, TransposedRotationsAtTheirPlaces) {
    for (const bool gl : {false, true}) {
        Scene s;
        const Mat3d flip = gl ? Mat3d(Vec3d(1, -1, -1).asDiagonal()) : Mat3d(Mat3d::Identity());
        s.each([&](Camera& c) {
            const Vec3d centre = c.centre_world();
            c.camera_from_world.rotation = Mat3d(flip * c.camera_from_world.rotation.transpose() * flip);
            c.camera_from_world.translation = -(c.camera_from_world.rotation * centre);
        });
        const CheckResult r = s.result();
        expect_finding(r, ExitCode::Contradiction, "staying where they are", "--write-cameras");
        expect_mended(s, r);
    }
}

TEST(SceneCheck, LeftHandedPoses) {
    Scene s;
    s.result();
    auto j = nlohmann::json::parse(read_text(s.folder / "scene/transforms.json"));
    for (auto& f : j["frames"])
        for (auto& x : f["transform_matrix"][2]) x = -x.get<double>();
    write_text(s.folder / "scene/transforms.json", j.dump());
    expect_finding(s.again(), ExitCode::Input, "left-handed", "right-handed");
}

TEST(SceneCheck, MirroredImages) {
    Scene s;
    for (Mask& m : s.scene.masks) m.coverage = io::turned(m.coverage, 2);
    expect_finding(s.result(), ExitCode::Contradiction, "mirrored left for right", "mirror");
}

TEST(SceneCheck, HalfTheFocalLength) {
    Scene s;
    s.each([](Camera& c) { c.intrinsics.fx *= 0.5, c.intrinsics.fy *= 0.5; });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Done, "twice the focal length", "--write-cameras");
    expect_mended(s, r);
}

TEST(SceneCheck, PixelCentresHalfAPixelOff) {
    for (const double off : {-0.5, 0.5}) {
        Scene s;
        s.each([&](Camera& c) { c.intrinsics.cx += off, c.intrinsics.cy += off; });
        const CheckResult r = s.result();
        expect_finding(r, ExitCode::Done, "half a pixel", off < 0 ? "--pixel-centre integer" : "--pixel-centre corner");
        EXPECT_NEAR(r.shift_px[0], -off, 0.08);
    }
}

TEST(SceneCheck, FocalLengthsAFewPerCentOff) {
    Scene s;
    s.each([](Camera& c) { c.intrinsics.fx *= 1.04, c.intrinsics.fy *= 1.04; });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Done, "focal lengths times 0.9", "--method refine");
    EXPECT_NEAR(r.focal_factor, 1 / 1.04, 0.006);
}

TEST(SceneCheck, InvertedMasks) {
    Scene s;
    for (Mask& m : s.scene.masks)
        for (uint8_t& v : m.coverage.data) v = static_cast<uint8_t>(255 - v);
    expect_finding(s.result(), ExitCode::Input, "look inverted", "--mask-invert");
}

TEST(SceneCheck, AnEmptyMask) {
    Scene s;
    std::fill(s.scene.masks[3].coverage.data.begin(), s.scene.masks[3].coverage.data.end(), uint8_t{0});
    expect_finding(s.result(), ExitCode::Input, "0003.png", "--allow-missing");
}

TEST(SceneCheck, ImagesOfHalfTheSize) {
    Scene s;
    s.each([](Camera& c) {
        Intrinsics& k = c.intrinsics;
        k.fx *= 2, k.fy *= 2, k.cx *= 2, k.cy *= 2, k.width_px *= 2, k.height_px *= 2;
    });
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Input, "made 2 times smaller", "size that the cameras were calibrated for");
}

TEST(SceneCheck, ADamagedPhotograph) {
    Scene s;
    s.result();
    std::vector<uint8_t> jpeg = io::encode_jpeg(Image8(240, 180, 3, 90), 90, 0);
    jpeg.resize(jpeg.size() - 100);
    write_text(s.folder / "scene/images/0002.png", {jpeg.begin(), jpeg.end()});
    expect_finding(s.again(), ExitCode::Input, "0002.png: is damaged", "copy it again");
    expect_finding(s.again([](CheckOptions& o) { o.cameras = o.masks = false; }), ExitCode::Input, "0002.png: is damaged", "copy it again");
}

TEST(SceneCheck, TheWrongWayUp) {
    Scene s;
    expect_finding(s.result([](CheckOptions& o) { o.views.up = std::string("y"); }), ExitCode::Done, "upright along z", "--up z");
}

TEST(SceneCheck, TheWrongUnit) {
    Scene s;
    s.each([](Camera& c) { c.camera_from_world.translation *= 1e-2; });
    expect_finding(s.result([](CheckOptions& o) { o.views.units = "mm"; }), ExitCode::Done, "hardly visible", "--units");
}

TEST(SceneCheck, ABlurredPhotographAndATwin) {
    Scene s(true);
    s.scene.photos[4] = io::blurred(s.scene.photos[4], 4);
    s.scene.photos[6] = s.scene.photos[5];
    const CheckResult r = s.result();
    expect_finding(r, ExitCode::Done, "less sharp than the others: images/0004.png", "take them away");
    expect_finding(r, ExitCode::Done, "images/0006.png is the very same picture as images/0005.png", "one of them");
}

TEST(SceneCheck, PhotographsWithoutCameras) {
    Scene s;
    s.result();
    const CheckResult r = s.again([](CheckOptions& o) { o.views.cameras = "none"; });
    expect_finding(r, ExitCode::Done, "no cameras yet", "vdbcarve align");
}

TEST(SceneCheck, ExchangedCamerasAreNamedWithTheMaskThatFits) {
    Scene s;
    std::swap(s.scene.views.views[2].camera, s.scene.views.views[7].camera);
    const CheckResult r = s.result();
    const std::string two = s.scene.views.views[2].name, seven = s.scene.views.views[7].name;
    expect_finding(r, ExitCode::Contradiction, two + " (whose camera the mask of " + seven + " fits)", "the name that the camera file has");
}

TEST(SceneCheck, OneCameraThatMovedIsNamed) {
    Scene s;
    s.scene.views.views[3].camera.camera_from_world.translation.x() += 0.3;
    expect_finding(s.result(), ExitCode::Contradiction, "1 mask against all others: " + s.scene.views.views[3].name, "its view's camera is wrong");
}

TEST(SceneCheck, AFocalLengthFarOff) {
    Scene s;
    s.each([](Camera& c) { c.intrinsics.fx *= 1.2, c.intrinsics.fy *= 1.2; });
    expect_finding(s.result(), ExitCode::Contradiction, "focal lengths times 0.8", "--method refine");
}

TEST(SceneCheck, SaysWhatWasLookedAt) {
    Scene s;
    EXPECT_EQ(s.result().looked_at, (std::vector<std::string>{"images", "masks", "cameras", "how they fit together"}));
    EXPECT_EQ(s.again([](CheckOptions& o) { o.masks = o.images = false; }).looked_at, std::vector<std::string>{"cameras"});
}

TEST(SceneCheck, JsonHoldsFindings) {
    Scene s;
    const std::string text = check_json(s.result([](CheckOptions& o) { o.views.up = std::string("y"); }));
    EXPECT_NE(text.find("\"findings\""), std::string::npos);
    EXPECT_NE(text.find("\"remedy\": \"--up z\""), std::string::npos);
}

}  // namespace
}  // namespace vdbcarve::test
