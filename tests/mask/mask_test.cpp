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

}  // namespace
}  // namespace vdbcarve::test
