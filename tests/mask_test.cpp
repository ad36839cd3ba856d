// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mask.h"

#include <fstream>
#include <random>

#include "image/image_io.h"
#include "mask/mask_consensus.h"
#include "mask/mask_methods.h"
#include "support/scenes.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

/// A bright disc on black, its edge blurred over some pixels, and a few specks.
Image8 photo(int width, int height, double radius) {
    Image8 out(width, height, 3, 6);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const double d = std::hypot(x + 0.5 - 50.3, y + 0.5 - 40.7) - radius;
            const double light = std::clamp(0.5 - d / 4, 0.0, 1.0);
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = static_cast<uint8_t>(6 + light * (c == 1 ? 150 : 190));
        }
    return out;
}

size_t object_pixels(const Mask& m) {
    return static_cast<size_t>(std::count_if(m.coverage.data.begin(), m.coverage.data.end(), [](uint8_t v) { return v >= 128; }));
}

TEST(ThresholdMask, KeepsTheEdgeSoft) {
    ThresholdOptions o;
    o.level = 101;  // half way between background and object
    const ImageF s = signed_distance(threshold_mask(photo(100, 80, 22), o).coverage);
    double sum2 = 0;
    int n = 0;
    for (int y = 0; y < 80; ++y)
        for (int x = 0; x < 100; ++x) {
            const double exact = std::hypot(x + 0.5 - 50.3, y + 0.5 - 40.7) - 22;
            if (std::fabs(exact) > 2) continue;
            sum2 += (s.at(x, y) - exact) * (s.at(x, y) - exact);
            ++n;
        }
    EXPECT_LT(std::sqrt(sum2 / n), 0.1);
}

TEST(ThresholdMask, LevelDecidesExactly) {
    Image8 ramp(256, 3);
    for (int y = 0; y < 3; ++y)
        for (int x = 0; x < 256; ++x) ramp.at(x, y) = static_cast<uint8_t>(x);
    for (const int level : {1, 2, 77, 128, 254, 255}) {
        ThresholdOptions o;
        o.level = level;
        const Mask m = threshold_mask(ramp, o);
        for (int x = 0; x < 256; ++x) ASSERT_EQ(m.coverage.at(x, 1) >= 128, x >= level) << x << " at level " << level;
        o.invert = true;
        const Mask inverted = threshold_mask(ramp, o);
        for (int x = 0; x < 256; ++x) ASSERT_EQ(inverted.coverage.at(x, 1) >= 128, x < level) << x << " at level " << level;
    }
}

TEST(ThresholdMask, OtsuSeparatesTwoLevels) {
    for (const double automatic : {ThresholdOptions::kAuto, ThresholdOptions::kOtsu}) {
        ThresholdOptions o;
        o.level = automatic;
        const double area = static_cast<double>(object_pixels(threshold_mask(photo(100, 80, 22), o)));
        EXPECT_NEAR(area, 3.14159 * 22 * 22, 0.1 * area);
    }
}

TEST(ThresholdMask, LargestPieceHolesOpeningClosing) {
    Image8 p = photo(100, 80, 22);
    const auto paint = [&](int x0, int y0, int w, int h, uint8_t v) {
        for (int y = y0; y < y0 + h; ++y)
            for (int x = x0; x < x0 + w; ++x)
                for (int c = 0; c < 3; ++c) p.at(x, y, c) = v;
    };
    paint(2, 2, 9, 9, 200);    // another piece
    paint(45, 35, 2, 3, 0);    // a small hole
    paint(52, 40, 10, 10, 0);  // a large one
    ThresholdOptions o;
    o.level = 90;
    const Mask m = threshold_mask(p, o);
    EXPECT_LT(m.coverage.at(5, 5), 128);
    EXPECT_GE(m.coverage.at(45, 36), 128);
    EXPECT_LT(m.coverage.at(56, 45), 128);
    MaskCleanUp c;
    c.fill_holes = 1;
    EXPECT_GE(threshold_mask(p, o, c).coverage.at(56, 45), 128);
    c.largest_component = false;
    EXPECT_GE(threshold_mask(p, o, c).coverage.at(5, 5), 128);
    c.open_px = 6;
    EXPECT_LT(threshold_mask(p, o, c).coverage.at(5, 5), 128);
    c.open_px = 0;
    c.fill_holes = 0;
    c.close_px = 8;
    EXPECT_GE(threshold_mask(p, o, c).coverage.at(56, 45), 128);
}

TEST(ThresholdMask, Channels) {
    Image8 p(4, 4, 3);
    for (int x = 0; x < 4; ++x)
        for (int y = 0; y < 4; ++y) {
            p.at(x, y, 0) = x < 2 ? 200 : 20;
            p.at(x, y, 1) = 200;
            p.at(x, y, 2) = 200;
        }
    ThresholdOptions o;
    o.level = 100;
    MaskCleanUp c;
    c.fill_holes = 0;
    o.channel = MaskChannel::Red;
    EXPECT_EQ(object_pixels(threshold_mask(p, o, c)), 8u);
    o.channel = MaskChannel::Saturation;
    EXPECT_LT(threshold_mask(p, o).coverage.at(0, 0), 128);
    EXPECT_GE(threshold_mask(p, o).coverage.at(3, 0), 128);
}

/// A scene of three views on disk whose files tests can spoil.
struct Scene {
    TemporaryFolder folder;
    Views views;
    MaskOptions options;

    Scene() {
        fs::create_directories(folder / "images");
        fs::create_directories(folder / "masks");
        for (int i = 0; i < 3; ++i) {
            View v;
            v.name = "v" + std::to_string(i) + ".png";
            v.image_path = folder / ("images/" + v.name);
            v.camera.intrinsics = {100, 100, 0, 50, 40, 100, 80, false};
            views.views.push_back(v);
            write("images/" + v.name, photo(100, 80, 20 + i));
            write("masks/" + v.name, threshold_mask(photo(100, 80, 20 + i), {90}).coverage);
        }
    }
    void write(const std::string& name, const Image8& image) {
        const auto png = io::encode_png(image);
        write_text(folder / name, {png.begin(), png.end()});
    }
    Masks make(std::vector<std::string>* warnings = nullptr) {
        Progress progress;
        Masks m = make_masks(views, folder.path(), options, {}, progress);
        if (warnings) *warnings = progress.warnings();
        return m;
    }
    std::string error() {
        return error_of(ExitCode::Input, [&] { make(); });
    }
};

TEST(Masks, FolderIsFoundAndKeptSoft) {
    Scene s;
    const Masks m = s.make();
    EXPECT_EQ(m.origins[1], (s.folder / "masks/v1.png").string());
    EXPECT_EQ(m.masks[1].coverage.data, threshold_mask(photo(100, 80, 21), {90}).coverage.data);
}

TEST(Masks, SearchOrder) {
    Scene s;
    const Image8 other(100, 80, 1, 200);
    Image8 marked = other;
    for (int x = 0; x < 100; ++x)
        for (int y = 0; y < 80; ++y) marked.at(x, y) = (x / 10 + y / 10) % 2 ? 255 : 0;
    const auto origin = [&] { return fs::path(s.make().origins[0]).lexically_relative(s.folder.path()).string(); };
    const Image8 fine = threshold_mask(photo(100, 80, 20), {90}).coverage;
    s.write("images/v0.png.mask.png", fine);
    s.write("images/v0.mask.png", fine);
    s.write("images/v0_mask.png", fine);
    s.write("masks/v0.png.png", fine);
    EXPECT_EQ(origin(), "masks/v0.png.png");
    fs::remove(s.folder / "masks/v0.png.png");
    EXPECT_EQ(origin(), "masks/v0.png");
    fs::remove(s.folder / "masks/v0.png");
    EXPECT_EQ(origin(), "images/v0_mask.png");
    fs::remove(s.folder / "images/v0_mask.png");
    EXPECT_EQ(origin(), "images/v0.mask.png");
    fs::remove(s.folder / "images/v0.mask.png");
    EXPECT_EQ(origin(), "images/v0.png.mask.png");
    s.write("named.png", fine);
    s.views.views[0].mask_path = s.folder / "named.png";
    EXPECT_EQ(origin(), "named.png");
    s.write("v0-by-pattern.png", fine);
    s.write("v1-by-pattern.png", fine);
    s.write("v2-by-pattern.png", fine);
    s.options.pattern = "{stem}-by-pattern.png";
    EXPECT_EQ(origin(), "v0-by-pattern.png");
    fs::create_directories(s.folder / "mine");
    for (const char* n : {"v0", "v1", "v2"}) s.write("mine/" + std::string(n) + ".png", fine);
    s.options.masks = "mine";
    EXPECT_EQ(origin(), "mine/v0.png");
}

TEST(Masks, AlphaSixteenBitsAndSilhouettesAsImages) {
    Scene s;
    fs::remove_all(s.folder / "masks");
    for (int i = 0; i < 3; ++i) {
        const Image8 a = threshold_mask(photo(100, 80, 20 + i), {90}).coverage;
        Image8 rgba(100, 80, 4, 99);
        for (size_t p = 0; p < a.data.size(); ++p) rgba.data[4 * p + 3] = a.data[p];
        s.write("images/v" + std::to_string(i) + ".png", rgba);
    }
    EXPECT_NE(s.make().origins[2].find("alpha"), std::string::npos);
    for (int i = 0; i < 3; ++i) {
        Image8 two = threshold_mask(photo(100, 80, 20 + i), {90}).coverage;
        for (uint8_t& v : two.data) v = v >= 128 ? 255 : 0;
        s.write("images/v" + std::to_string(i) + ".png", two);
    }
    EXPECT_NE(s.make().origins[2].find("silhouette"), std::string::npos);
}

TEST(Masks, InvertAndIgnore) {
    Scene s;
    for (int i = 0; i < 3; ++i) {
        Image8 m = threshold_mask(photo(100, 80, 20 + i), {90}).coverage;
        for (uint8_t& v : m.data) v = static_cast<uint8_t>(255 - v);
        s.write("masks/v" + std::to_string(i) + ".png", m);
    }
    EXPECT_NE(s.error().find("--mask-invert"), std::string::npos);
    s.options.invert = true;
    fs::create_directories(s.folder / "ignore");
    Image8 ignore(100, 80);
    ignore.at(7, 8) = 255;
    s.write("ignore/v1.png", ignore);
    const Masks m = s.make();
    EXPECT_GE(m.masks[0].coverage.at(50, 40), 128);
    EXPECT_TRUE(m.masks[0].ignore.empty());
    EXPECT_EQ(m.masks[1].ignore.at(7, 8), 255);
}

TEST(Masks, MistakesAreNamed) {
    const auto has = [](const std::string& message, std::initializer_list<const char*> parts) {
        for (const char* part : parts) EXPECT_NE(message.find(part), std::string::npos) << message;
    };
    {
        Scene s;
        s.write("masks/v1.png", Image8(50, 40));
        has(s.error(), {"masks/v1.png", "50 x 40", "100 x 80", "v1.png"});
    }
    {
        Scene s;
        s.write("masks/v2.png", Image8(100, 80));
        has(s.error(), {"empty mask", "v2.png", "--allow-missing"});
        s.options.allow_missing = true;
        EXPECT_EQ(s.make().left_out, std::vector<size_t>{2});
    }
    {
        Scene s;
        fs::remove(s.folder / "masks/v0.png");
        has(s.error(), {"1 of 3 views have no mask", "v0.png", "--mask threshold"});
    }
    {
        Scene s;
        s.write("masks/v1.png", Image8(100, 80, 1, 1));
        has(s.error(), {"masks/v1.png", "class numbers"});
    }
    {
        Scene s;
        Image8 red(100, 80, 3);
        for (size_t i = 0; i < red.data.size(); i += 3) red.data[i] = 255;
        s.write("masks/v1.png", red);
        has(s.error(), {"masks/v1.png", "coloured"});
    }
    {
        Scene s;
        write_text(s.folder / "masks/v1.png", "no picture");
        has(s.error(), {"masks/v1.png", "decoded"});
    }
    {
        Scene s;
        std::vector<std::string> warnings;
        s.write("masks/v1.png", Image8(100, 80, 1, 255));
        s.make(&warnings);
        ASSERT_EQ(warnings.size(), 1u);
        has(warnings[0], {"object everywhere", "v1.png"});
    }
}

TEST(Masks, FoldersTellViewsApart) {
    Scene s;
    for (size_t i = 0; i < 2; ++i) {
        const std::string sub = "cam" + std::to_string(i);
        for (const char* top : {"images/", "masks/"}) fs::create_directories(s.folder / (top + sub));
        s.write("images/" + sub + "/a.png", photo(100, 80, 20 + 2 * static_cast<double>(i)));
        s.write("masks/" + sub + "/a.png", threshold_mask(photo(100, 80, 20 + 2 * static_cast<double>(i)), {90}).coverage);
        s.views.views[i].name = sub + "/a.png";
        s.views.views[i].image_path = s.folder / ("images/" + sub + "/a.png");
    }
    const Masks m = s.make();
    EXPECT_EQ(m.origins[1], (s.folder / "masks/cam1/a.png").string());
    EXPECT_NE(m.masks[0].coverage.data, m.masks[1].coverage.data);
    // One file for both is a mistake, not a guess.
    fs::rename(s.folder / "masks/cam1/a.png", s.folder / "masks/a.png");
    fs::remove(s.folder / "masks/cam0/a.png");
    EXPECT_NE(s.error().find("both cam0/a.png and cam1/a.png"), std::string::npos);
}

TEST(Masks, AnEditedMaskKeepsWhatIsIgnored) {
    Scene s;
    fs::create_directories(s.folder / "ignore");
    Image8 ignore(100, 80);
    ignore.at(7, 8) = 255;
    s.write("ignore/v1.png", ignore);
    s.write("edited.png", Image8(100, 80, 1, 200));
    Progress quiet;
    const Masks m = make_masks(s.views, s.folder.path(), {}, {{}, s.folder / "edited.png", {}}, quiet);
    EXPECT_EQ(m.masks[1].coverage.at(50, 3), 200);
    EXPECT_EQ(m.masks[1].ignore.at(7, 8), 255);
}

// A mask seen through a lens, undistorted, is the mask of the pinhole camera.
TEST(Masks, LensIsRemovedWithTheHalfPixelInPlace) {
    Scene s;
    fs::remove_all(s.folder / "masks");
    for (const auto& [model, k] :
         {std::pair{Lens::Model::OpenCV, std::vector<double>{-0.25, 0.08, 0.002, -0.003}}, std::pair{Lens::Model::SimpleRadial, std::vector<double>{0.2}},
          std::pair{Lens::Model::OpenCVFisheye, std::vector<double>{0.05, 0.01, 0, 0}}}) {
        View& v = s.views.views[0];
        v.lens = {model, k};
        v.camera.intrinsics = {80, 82, 0, 51.3, 38.6, 100, 80, false};
        const Intrinsics& in = v.camera.intrinsics;
        // Forward model, written out here: where a ray (x, y, 1) lands in the distorted picture.
        const auto distort = [&, m = model, c = k](double x, double y) {
            const double r2 = x * x + y * y;
            double dx = x, dy = y;
            if (m == Lens::Model::OpenCVFisheye) {
                const double r = std::sqrt(r2), t = std::atan(r), t2 = t * t;
                const double td = t * (1 + c[0] * t2 + c[1] * t2 * t2);
                if (r > 0) dx = x * td / r, dy = y * td / r;
            } else {
                const double radial = 1 + c[0] * r2 + (c.size() > 1 ? c[1] * r2 * r2 : 0);
                const double p1 = c.size() > 2 ? c[2] : 0, p2 = c.size() > 3 ? c[3] : 0;
                dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
                dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
            }
            return Vec2d(in.fx * dx + in.cx, in.fy * dy + in.cy);
        };
        // The object: a disc in the undistorted picture. Its distorted mask by dense sampling of the undistorted plane.
        Image<uint32_t> hits(100, 80), all(100, 80);
        for (double u = -60; u < 160; u += 0.02)
            for (double w = -60; w < 140; w += 0.02) {
                const Vec2d d = distort((u - in.cx) / in.fx, (w - in.cy) / in.fy);
                const int x = static_cast<int>(std::floor(d.x())), y = static_cast<int>(std::floor(d.y()));
                if (x < 0 || y < 0 || x >= 100 || y >= 80) continue;
                ++all.at(x, y);
                hits.at(x, y) += std::hypot(u - 44.2, w - 47.9) < 18;
            }
        Image8 distorted(100, 80);
        for (size_t i = 0; i < distorted.data.size(); ++i) distorted.data[i] = all.data[i] ? static_cast<uint8_t>(255.0 * hits.data[i] / all.data[i] + 0.5) : 0;
        fs::create_directories(s.folder / "masks");
        s.write("masks/v0.png", distorted);
        s.views.views.resize(1);
        const ImageF d = signed_distance(s.make().masks[0].coverage);
        double sum = 0, sum2 = 0;
        int n = 0;
        for (int y = 0; y < 80; ++y)
            for (int x = 0; x < 100; ++x) {
                const double exact = std::hypot(x + 0.5 - 44.2, y + 0.5 - 47.9) - 18;
                if (std::fabs(exact) > 1.5) continue;
                sum += d.at(x, y) - exact;
                sum2 += (d.at(x, y) - exact) * (d.at(x, y) - exact);
                ++n;
            }
        EXPECT_LT(std::fabs(sum / n), 0.03);   // a half-pixel slip would show as a shift of the disc …
        EXPECT_LT(std::sqrt(sum2 / n), 0.15);  // … and here
    }
}

/// Share of the pixels that object and truth share, of those that either has.
double iou(const Image8& a, const Image8& b) {
    size_t both = 0, either = 0;
    for (size_t i = 0; i < a.data.size(); ++i) {
        const bool x = a.data[i] >= 128, y = b.data[i] >= 128;
        both += x && y, either += x || y;
    }
    return static_cast<double>(both) / static_cast<double>(either);
}

/// How far the contour of a mask lies from the truth's, pixels (rms, and in which direction on average: > 0 outside).
struct Apart {
    double rms = 0, mean = 0;
};
Apart contours_apart(const Image8& made, const Image8& truth) {
    const ImageF a = signed_distance(made), b = signed_distance(truth);
    double sum = 0, squares = 0;
    size_t n = 0;
    for (size_t i = 0; i < a.data.size(); ++i) {
        if (std::fabs(b.data[i]) > 1) continue;
        const double d = std::clamp<double>(b.data[i] - a.data[i], -5, 5);
        sum += d, squares += d * d, ++n;
    }
    return {std::sqrt(squares / static_cast<double>(n)), sum / static_cast<double>(n)};
}

SyntheticSpec before(const char* object, uint64_t seed) {
    SyntheticSpec spec = builtin_spec(object);
    spec.rig.views = 4;
    spec.rig.width_px = 320, spec.rig.height_px = 240;
    spec.look.noise = 2;
    spec.seed = seed;
    return spec;
}

/// The scene on disk, its own masks away.
struct Shoot {
    TemporaryFolder folder;
    Progress progress;
    SyntheticScene scene;
    Views views;
    MaskOptions options;

    explicit Shoot(const SyntheticSpec& spec) : scene(synthesize(spec, progress)) {
        write_scene(scene, folder / "scene");
        fs::rename(folder / "scene/masks", folder / "truth");
        ViewsOptions o;
        o.scene = folder / "scene";
        views = load_views(o, progress);
        for (View& v : views.views) v.mask_path.clear();
    }
    Masks make() { return make_masks(views, folder / "scene", options, {}, progress); }
};

TEST(ChromaMask, FoldsAndSpillAreNotTheObject) {
    for (const Vec3d& cloth : {Vec3d(0.02, 0.3, 0.08), Vec3d(0.03, 0.08, 0.45)}) {
        SyntheticSpec spec = before("ellipsoids", 3);
        spec.look.backdrop = cloth;
        spec.look.spill = 0.3;
        Shoot s(spec);
        s.options.method = MaskMethod::Chroma;
        const Masks made = s.make();
        for (size_t i = 0; i < made.masks.size(); ++i) {
            EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.985) << i;
            const Apart a = contours_apart(made.masks[i].coverage, s.scene.masks[i].coverage);
            EXPECT_LT(a.rms, 0.35) << i;
            EXPECT_LT(std::fabs(a.mean), 0.2) << i;
            EXPECT_NE(made.origins[i].find("chroma key of"), std::string::npos);
        }
    }
}

TEST(ChromaMask, AGivenKeyAndBackdropsWithoutColour) {
    SyntheticSpec spec = before("pair", 3);
    spec.look.backdrop = Vec3d(0.02, 0.3, 0.08);
    Shoot s(spec);
    s.options.method = MaskMethod::Chroma;
    s.options.clean_up.largest_component = false;
    s.options.chroma.key_rgb = std::array<uint8_t, 3>{40, 150, 80};
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.98) << i;
    s.options.chroma = {};
    s.options.chroma.key_rgb = std::array<uint8_t, 3>{128, 130, 128};
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("nearly grey"), std::string::npos);
}

TEST(PlateMask, LampsMayDrift) {
    SyntheticSpec spec = before("ellipsoids", 5);
    spec.look.plates = true;
    spec.look.light_drift = 0.15;
    spec.look.table = true;  // with a shadow and a reflection
    spec.look.table_reflection = 0;
    Shoot s(spec);
    s.options.method = MaskMethod::CleanPlate;
    s.options.plate.plate = "plates";
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) {
        EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.97) << i;
        EXPECT_LT(contours_apart(made.masks[i].coverage, s.scene.masks[i].coverage).rms, 0.9) << i;
    }
    // The drift is what would be wrong without being allowed for: a shadow's is larger, and is object when it is kept.
    s.options.plate.shadows = false;
    EXPECT_LT(iou(s.make().masks[0].coverage, s.scene.masks[0].coverage), iou(made.masks[0].coverage, s.scene.masks[0].coverage));
    fs::remove(s.folder / "scene/plates" / "0002.png");
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("0002"), std::string::npos);
    s.options.plate.plate = "nowhere";
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("neither a photograph nor a folder"), std::string::npos);
}

TEST(GrabCutMask, FromABoxAndTheSameTwice) {
    SyntheticSpec spec = before("ellipsoids", 7);
    spec.look.backdrop = Vec3d(0.5, 0.5, 0.55);
    Shoot s(spec);
    s.options.method = MaskMethod::GrabCut;
    const Masks made = s.make(), again = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) {
        EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.97) << i;
        EXPECT_EQ(made.masks[i].coverage.data, again.masks[i].coverage.data) << i;
    }
    s.options.grabcut.box_px = std::array<int, 4>{0, 0, 320, 240};
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("leaves background around it"), std::string::npos);
}

TEST(MaskCommand, WordsAreSplitAsAShellWould) {
    EXPECT_EQ(words_of_command("tool -a 'two words' \"{in}\" x\\ y={out}"), (std::vector<std::string>{"tool", "-a", "two words", "{in}", "x y={out}"}));
    for (const auto& [text, part] : {std::pair{"tool {in}", "{out}"}, {"tool {in} '{out}", "not closed"}, {"", "{in}"}})
        EXPECT_NE(error_of(ExitCode::Usage, [&] { words_of_command(text); }).find(part), std::string::npos) << text;
}

TEST(MaskCommand, AnotherProgramIsRunOnceForAPhotograph) {
    Shoot s(before("ellipsoids", 9));
    const fs::path tool = s.folder / "a tool.sh";
    const auto write_tool = [&](const std::string& body) {
        std::ofstream(tool) << "#!/bin/sh\n" << body << "\n";
        fs::permissions(tool, fs::perms::owner_all);
    };
    const std::string truth = (s.folder / "truth").string(), log = (s.folder / "log").string();
    write_tool("echo x >> '" + log + "'\ncp '" + truth + "'/$(basename \"$1\") \"$2\"");
    s.options.method = MaskMethod::Command;
    s.options.command = "'" + tool.string() + "' {in} {out}";
    s.options.cache = s.folder / "cache";
    const auto runs = [&] { return read_text(log).size() / 2; };
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) EXPECT_EQ(made.masks[i].coverage.data, s.scene.masks[i].coverage.data) << i;
    EXPECT_EQ(runs(), 4u);
    s.make();
    EXPECT_EQ(runs(), 4u);
    fs::copy_file(s.folder / "scene/images/0000.png", s.folder / "scene/images/0001.png", fs::copy_options::overwrite_existing);
    s.make();  // the same content under another name
    EXPECT_EQ(runs(), 4u);
    s.options.command += " --better";
    s.options.command_jobs = 4;
    s.make();
    EXPECT_GE(runs(), 7u);
    for (const auto& [body, part] : {std::pair{"echo out of luck; exit 3", "status 3; it said:\n    out of luck"},
                                     {"exit 0", "wrote no {out}; it said nothing"},
                                     {"kill -9 $$", "signal 9"},
                                     {"head -c 20 \"$1\" > \"$2\"", "a tool.sh: wrote no picture"}}) {
        write_tool(body);
        s.options.cache = s.folder / "elsewhere";
        s.options.command_jobs = 1;
        EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find(part), std::string::npos) << body;
    }
    s.options.command = "no-such-tool {in} {out}";
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("could not be started"), std::string::npos);
}

std::vector<MaskView> views_of(const std::vector<Mask>& masks) {
    std::vector<MaskView> out;
    for (const Mask& m : masks) out.push_back(view_of(m));
    return out;
}

/// Three masks that are wrong, each in its way.
std::vector<size_t> break_masks(std::vector<Mask>& masks) {
    Image8& limb = masks[3].coverage;
    for (int y = 0; y < limb.height; ++y)
        for (int x = 0; x < limb.width; ++x)
            if (y < 0.45 * limb.height) limb.at(x, y) = 0;
    for (uint8_t& v : masks[11].coverage.data) v = static_cast<uint8_t>(255 - v);
    Image8& blob = masks[17].coverage;
    for (int y = 0; y < blob.height; ++y)
        for (int x = 0; x < blob.width; ++x)
            if (std::hypot(x - 0.12 * blob.width, y - 0.2 * blob.height) < 20) blob.at(x, y) = 255;
    return {3, 11, 17};
}

TEST(Consensus, ABrokenMaskIsNamedAndACleanOneIsNot) {
    Progress quiet;
    for (const char* object : {"ellipsoids", "cup", "boxes", "torus", "pair"})
        for (const Rig::Kind kind : {Rig::Kind::Orbit, Rig::Kind::Dome}) {
            SyntheticSpec spec = before(object, 11);
            spec.rig.kind = kind;
            spec.rig.views = 24;
            spec.photos = false;
            SyntheticScene scene = synthesize(spec, quiet);
            EXPECT_TRUE(find_broken_masks(scene.views.names(), scene.views.cameras(), views_of(scene.masks), quiet).empty()) << object;
            if (std::string(object) != "ellipsoids") continue;
            const std::vector<size_t> broken = break_masks(scene.masks);
            EXPECT_EQ(find_broken_masks(scene.views.names(), scene.views.cameras(), views_of(scene.masks), quiet), broken);
        }
}

TEST(Consensus, PhotographsMendMasks) {
    Progress quiet;
    SyntheticSpec spec = before("ellipsoids", 11);
    spec.rig.views = 24;
    spec.look.backdrop = Vec3d(0.5, 0.5, 0.55);
    SyntheticScene scene = synthesize(spec, quiet);
    const std::vector<Mask> truth = scene.masks;
    const std::vector<size_t> broken = break_masks(scene.masks);
    std::vector<Mask> without = scene.masks;
    const auto names = scene.views.names();
    const auto cameras = scene.views.cameras();
    EXPECT_NE(repair_masks(
                  names, cameras, scene.masks, broken, [&](size_t i) { return scene.photos[i]; }, quiet)[0]
                  .find("by its photograph"),
              std::string::npos);
    for (const size_t i : broken) EXPECT_GT(iou(scene.masks[i].coverage, truth[i].coverage), 0.97) << i;
    // Without photographs what nobody else bears out is ignored, or away.
    EXPECT_NE(repair_masks(
                  names, cameras, without, broken, [&](size_t) { return Image8(); }, quiet)[0]
                  .find("ignored"),
              std::string::npos);
    for (const size_t i : broken) {
        size_t wrong = 0, object = 0;
        for (size_t p = 0; p < truth[i].coverage.data.size(); ++p) {
            const bool is = truth[i].coverage.data[p] >= 128;
            object += is;
            wrong += (without[i].ignore.empty() || !without[i].ignore.data[p]) && is != (without[i].coverage.data[p] >= 128);
        }
        EXPECT_LT(wrong, 0.12 * static_cast<double>(object)) << i;
    }
}

}  // namespace
}  // namespace vdbcarve::test
