// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/color.h"

#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/global_control.h>

#include <cmath>
#include <map>
#include <numbers>
#include <random>
#include <set>

#include "color/color_plan.h"
#include "volume/nanovdb_bytes.h"
#include "support/color_scene.h"
#include "support/noise_grid.h"
#include "support/same_grid.h"
#include "vdbcarve/kernel/color_fill.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

// ------------------------------------------------------------------------------------ the stage

TEST(Color, SameBitsForAnyNumberOfThreadsAndAnyBatch) {
    SyntheticSpec spec = small_spec("cup", 14, 320, 240);
    spec.look.exposure_jitter = 0.2;
    const ColorScene s = color_scene(spec, 64);
    Progress quiet;
    for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
        ColorOptions options;
        options.mode = mode;
        const ColorResult all = color(*s.surface, s.inputs, options, quiet);
        EXPECT_GT(all.statistics.colored, 1000u);
        {
            const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
            expect_same_colors(color(*s.surface, s.inputs, options, quiet), all);
        }
        for (const size_t batch : {1, 5, 13}) {
            options.batch = batch;
            size_t most = 0;
            const PhotoSource source = [&](size_t first, size_t last) {
                most = std::max(most, last - first);
                return std::vector<Photo>(s.photos.begin() + static_cast<long>(first), s.photos.begin() + static_cast<long>(last));
            };
            expect_same_colors(color_in_batches(*s.surface, s.inputs, source, options, quiet), all);
            EXPECT_EQ(most, batch);
        }
    }
}

// The level set's contour, its band and nothing else has colour; where no view sees it, it is flagged.
TEST(Color, GridsCoverContourAndBand) {
    const ColorScene s = color_scene(small_spec("ellipsoids", 10, 320, 240), 64);
    Progress quiet;
    for (const int depth : {1, 2, 3, 6}) {
        ColorOptions options;
        options.depth_vox = depth;
        const ColorResult r = color(*s.surface, s.inputs, options, quiet);
        EXPECT_EQ(r.color->getName(), "color");
        openvdb::FloatGrid::ConstAccessor phi = s.surface->getConstAccessor();
        openvdb::Vec3SGrid::ConstAccessor c = r.color->getConstAccessor();
        const float h = s.voxel();
        size_t missing = 0, stray = 0, contour = 0;
        for (auto it = s.surface->cbeginValueOn(); it; ++it) {
            const openvdb::Coord at = it.getCoord();
            const bool on = c.isValueOn(at);
            const bool in_contour = kernel::is_contour([&](int i, int j, int k) { return phi.getValue(openvdb::Coord(i, j, k)); }, *it, at[0], at[1], at[2]);
            contour += in_contour;
            EXPECT_EQ(r.views->tree().isValueOn(at), in_contour);
            if (in_contour || *it > -static_cast<float>(depth) * h) missing += !on;
            else stray += on;
        }
        EXPECT_EQ(missing, 0u) << depth;
        if (depth <= 3) {
            EXPECT_EQ(stray, 0u) << depth;
        }
        EXPECT_EQ(contour, r.statistics.surface_voxels);
        EXPECT_EQ(r.statistics.colored + r.statistics.synthesised, contour);
        for (auto it = r.views->cbeginValueOn(); it; ++it) EXPECT_EQ(*it > 0, r.confidence->tree().getValue(it.getCoord()) > 0);
        if (depth <= 3) continue;
        // Deeper layers: every voxel so many steps within the band's inner side has colour, and none beyond them.
        size_t beyond = 0;
        for (auto it = r.color->cbeginValueOn(); it; ++it) beyond += phi.getValue(it.getCoord()) <= -3 * h;
        EXPECT_GT(beyond, contour);
        std::set<openvdb::Coord> reached;
        for (auto it = s.surface->cbeginValueOn(); it; ++it) reached.insert(it.getCoord());
        for (int layer = 3; layer < depth; ++layer) {
            std::set<openvdb::Coord> next = reached;
            for (const openvdb::Coord& at : reached)
                for (int f = 0; f < 6; ++f) {
                    openvdb::Coord n = at;
                    n[f / 2] += f % 2 ? 1 : -1;
                    if (phi.getValue(n) < 0) next.insert(n);
                }
            reached = std::move(next);
        }
        EXPECT_EQ(reached.size(), r.color->activeVoxelCount());
    }
}

// Photographs are magenta everywhere but well inside the masks: none of it may come through.
TEST(Color, NoSampleComesFromNearAnEdgeOrFromIgnoredPixels) {
    ColorScene s = color_scene(small_spec("cup", 16, 320, 240), 80);
    s.scene.masks[3].ignore = Image8(320, 240);
    for (int y = 100; y < 150; ++y)
        for (int x = 120; x < 190; ++x) s.scene.masks[3].ignore.at(x, y) = 255;
    for (size_t i = 0; i < s.photos.size(); ++i) {
        Image8 mask = s.scene.masks[i].coverage;
        if (!s.scene.masks[i].ignore.empty())
            for (size_t p = 0; p < mask.data.size(); ++p) mask.data[p] = s.scene.masks[i].ignore.data[p] ? 0 : mask.data[p];
        const ImageF distance = signed_distance(mask, 16);
        for (int y = 0; y < 240; ++y)
            for (int x = 0; x < 320; ++x) {
                const bool near = distance.at(x, y) > -1.5f;  // bilinear samples 3 px inside read texels up to 1.42 px nearer
                for (int c = 0; c < 3; ++c) s.photos[i].pixels8.at(x, y, c) = near ? (c == 1 ? 0 : 255) : 128;
            }
    }
    lend_photos(s);
    Progress quiet;
    for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
        ColorOptions options;
        options.mode = mode;
        const ColorResult r = color(*s.surface, s.inputs, options, quiet);
        EXPECT_GT(r.statistics.colored, 3000u);
        const auto grey = static_cast<float>(linear_from_srgb(128 / 255.0));
        for (auto it = r.color->cbeginValueOn(); it; ++it) {
            ASSERT_EQ((*it)[0], grey);
            ASSERT_EQ((*it)[1], grey);
        }
    }
}

// A constant colour is exactly that at every vertex, of every mesh, and of a mesh whose vertices moved by a voxel.
TEST(Color, AConstantColourIsExactAtEveryVertex) {
    ColorScene s = color_scene(small_spec("cup", 9, 320, 240), 64);
    const std::array<uint8_t, 3> paint{200, 91, 33};
    for (Photo& p : s.photos)
        for (size_t n = 0; n < p.pixels8.data.size(); ++n) p.pixels8.data[n] = paint[n % 3];
    lend_photos(s);
    Progress quiet;
    const ColorResult r = color(*s.surface, s.inputs, {}, quiet);
    EXPECT_GT(r.statistics.synthesised, 100u);
    std::mt19937 random(2);
    for (const Mesher mesher : {Mesher::Dual, Mesher::MarchingCubes})
        for (const bool moved : {false, true}) {
            MeshOptions options;
            options.mesher = mesher;
            Mesh mesh = extract_mesh(*s.surface, options, quiet);
            if (moved)
                for (auto& v : mesh.vertices)
                    for (float& x : v) x += s.voxel() * (static_cast<float>(random() % 2001) / 1000.f - 1.f) / std::sqrt(3.f);
            EXPECT_EQ(color_vertices(mesh, *r.color), 0u);
            for (const auto& c : mesh.colors)
                for (size_t i = 0; i < 3; ++i) ASSERT_EQ(srgb8_from_linear(c[i]), paint[i]);
            color_vertices_from_photos(mesh, *s.surface, *r.color, s.inputs, {}, {}, quiet);
            for (const auto& c : mesh.colors)
                for (size_t i = 0; i < 3; ++i) ASSERT_EQ(srgb8_from_linear(c[i]), paint[i]);
        }
}

TEST(Color, SixteenBitPhotographsAndGreyOnesAreRead) {
    ColorScene s = color_scene(small_spec("torus", 10, 320, 240), 48);
    Progress quiet;
    const ColorResult eight = color(*s.surface, s.inputs, {}, quiet);
    ColorScene wide = s;
    for (Photo& p : wide.photos) {
        p.pixels16 = Image16(p.pixels8.width, p.pixels8.height, 3);
        for (size_t n = 0; n < p.pixels8.data.size(); ++n) p.pixels16.data[n] = static_cast<uint16_t>(p.pixels8.data[n] * 257);
        p.pixels8 = {};
    }
    lend_photos(wide);
    const ColorResult sixteen = color(*wide.surface, wide.inputs, {}, quiet);
    expect_same(*eight.color, *sixteen.color);
    for (Photo& p : wide.photos) {
        p.pixels8 = Image8(p.pixels16.width, p.pixels16.height, 1, 77);
        p.pixels16 = {};
    }
    lend_photos(wide);
    const ColorResult grey = color(*wide.surface, wide.inputs, {}, quiet);
    for (auto it = grey.color->cbeginValueOn(); it; ++it) EXPECT_EQ((*it)[0], (*it)[2]);
}

// The paper's Fig. 5: one solid before another.
TEST(Color, HiddenSurfacesDoNotTakeTheColourOfWhatStandsInFront) {
    SyntheticSpec spec = small_spec("pair", 24, 480, 360);
    spec.look.flat = true;
    const ColorScene s = color_scene(spec, 128);
    Progress quiet;
    ColorOptions options;
    for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
        options.mode = mode;
        options.test_occlusion = true;
        const ColorVerdict right = judge(s, color(*s.surface, s.inputs, options, quiet));
        options.test_occlusion = false;
        const ColorVerdict fault = judge(s, color(*s.surface, s.inputs, options, quiet));
        RecordProperty("wrong", std::to_string(right.wrong) + " against " + std::to_string(fault.wrong));
        EXPECT_LT(right.wrong, 0.005);
        EXPECT_GT(fault.wrong, mode == ColorMode::Best ? 0.05 : 0.02);
    }
}

// At the size of a real shoot: of what cameras truly see 3 px inside their masks 98 % is coloured, and rightly. The turntable's lamp does not turn along: there
// the truth is the mean over the cameras in front, and blending gets nearer to it than any one view.
struct QualityCase {
    const char* name;
    const char* object;
    double gloss, jitter;
    Rig::Motion motion;
    double median, p95;
};

void PrintTo(const QualityCase& c, std::ostream* out) { *out << c.name; }

class ColorQuality : public testing::TestWithParam<QualityCase> {};

TEST_P(ColorQuality, IsTheObjects) {
    const QualityCase& c = GetParam();
    SyntheticSpec spec = small_spec(c.object, 36, 1024, 768);
    spec.look.gloss = c.gloss;
    spec.look.exposure_jitter = c.jitter;
    spec.rig.motion = c.motion;
    const ColorScene s = color_scene(spec, 192);
    judge_both_modes(s, c.name, [&](const ColorResult& r, const ColorVerdict& v) {
        EXPECT_LT(v.median, c.median);
        EXPECT_LT(v.p95, c.p95);
        EXPECT_LT(v.wrong, 0.005);
        if (c.motion == Rig::Motion::Turntable) return;
        double mean = 0;
        for (const double e : s.scene.exposures) mean += std::log(e) / static_cast<double>(s.scene.exposures.size());
        for (size_t i = 0; i < s.scene.exposures.size(); ++i) EXPECT_NEAR(r.exposure.gains[i][0] * s.scene.exposures[i] / std::exp(mean), 1, 0.02) << i;
    });
}

INSTANTIATE_TEST_SUITE_P(Shoots, ColorQuality,
                         testing::Values(QualityCase{"cup", "cup", 0, 0, Rig::Motion::Camera, 2, 8},
                                         QualityCase{"cup_gloss_exposures", "cup", 0.6, 0.2, Rig::Motion::Camera, 2, 8},
                                         QualityCase{"pair", "pair", 0, 0, Rig::Motion::Camera, 2, 8},
                                         QualityCase{"cup_turntable_gloss", "cup", 0.6, 0, Rig::Motion::Turntable, 4, 12}),
                         [](const auto& instance) { return instance.param.name; });

// The paper's least: two photographs at a right angle, four around.
TEST(Color, TwoPerpendicularPhotographsAndFour) {
    Progress quiet;
    double seen_before = 0;
    for (const int views : {2, 4}) {
        SyntheticSpec spec = small_spec("ellipsoids", views, 480, 360);
        spec.rig.arc_deg = 90 * views;
        spec.rig.elevation_deg = 0;
        const ColorScene s = color_scene(spec, 64);
        for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
            ColorOptions options;
            options.mode = mode;
            const ColorResult r = color(*s.surface, s.inputs, options, quiet);
            const double seen = static_cast<double>(r.statistics.colored) / static_cast<double>(r.statistics.surface_voxels);
            EXPECT_GT(seen, views == 2 ? 0.25 : 0.5);
            if (views == 4) {
                EXPECT_GT(seen, seen_before);
            }
            if (mode == ColorMode::Blend && views == 2) seen_before = seen;
            for (auto it = r.color->cbeginValueOn(); it; ++it) ASSERT_GT((*it)[0] + (*it)[1] + (*it)[2], 0.f);
        }
    }
}

// Listing 4.2, lines 1 and 2: what looks straight up or down is left to the fill.
TEST(Color, UprightFacesAreSkippedOnRequest) {
    SyntheticSpec spec = small_spec("ellipsoids", 16, 320, 240);
    spec.rig.kind = Rig::Kind::Dome;
    spec.solids.clear();
    Solid box;
    box.kind = Solid::Kind::Box;
    box.size = {0.4, 0.4, 0.2};
    spec.solids.push_back(box);
    const ColorScene s = color_scene(spec, 64);
    Progress quiet;
    ColorOptions options;
    options.mode = ColorMode::Best;
    const ColorResult all = color(*s.surface, s.inputs, options, quiet);
    options.skip_upright = true;
    const ColorResult skipped = color(*s.surface, s.inputs, options, quiet);
    EXPECT_LT(skipped.statistics.colored, 0.9 * static_cast<double>(all.statistics.colored));
    for (auto it = skipped.views->cbeginValueOn(); it; ++it) {
        if (*it > 0) {
            EXPECT_GT(all.views->tree().getValue(it.getCoord()), 0);
        }
    }
}

// However far the world's origin is, colours stay what they are.
TEST(Color, AFarOriginCostsNothing) {
    ColorScene s = color_scene(small_spec("cup", 9, 320, 240), 64);
    Progress quiet;
    const ColorResult here = color(*s.surface, s.inputs, {}, quiet);
    // The same voxels at other indices, the cameras moved along by whole voxels.
    const openvdb::Coord shift(4096 * 2500, -4096 * 1200, 4096 * 900);
    openvdb::FloatGrid::Ptr far = openvdb::FloatGrid::create(s.surface->background());
    far->setTransform(s.surface->transformPtr());
    far->setGridClass(openvdb::GRID_LEVEL_SET);
    for (auto leaf = s.surface->tree().cbeginLeaf(); leaf; ++leaf) {
        auto* copy = new openvdb::FloatTree::LeafNodeType(*leaf);
        copy->setOrigin(leaf->origin() + shift);
        far->tree().addLeaf(copy);
    }
    openvdb::tools::signedFloodFill(far->tree());
    const double h = s.surface->voxelSize()[0];
    const Vec3d moved = h * Vec3d(shift[0], shift[1], shift[2]);
    for (ColorInput& input : s.inputs) input.camera.camera_from_world.translation -= input.camera.camera_from_world.rotation * moved;
    const ColorResult there = color(*far, s.inputs, {}, quiet);
    EXPECT_EQ(here.statistics.surface_voxels, there.statistics.surface_voxels);
    EXPECT_NEAR(static_cast<double>(here.statistics.colored), static_cast<double>(there.statistics.colored),
                0.002 * static_cast<double>(here.statistics.colored));
    size_t off = 0;
    for (auto it = here.color->cbeginValueOn(); it; ++it) off += ((*it) - there.color->tree().getValue(it.getCoord() + shift)).length() > 0.01f;
    EXPECT_LT(off, here.color->activeVoxelCount() / 200);
}

TEST(Color, SaysWhatIsWrong) {
    ColorScene s = color_scene(small_spec("ellipsoids", 6, 128, 96), 32);
    Progress quiet;
    ColorOptions options;
    auto inputs = s.inputs;
    const Image8 small(64, 48, 3);
    inputs[2].photo = {small.view(), {}};
    const std::string size = error_of(ExitCode::Input, [&] { color(*s.surface, inputs, options, quiet); });
    EXPECT_NE(size.find(inputs[2].name), std::string::npos);
    EXPECT_NE(size.find("64 x 48"), std::string::npos);
    inputs = s.inputs;
    for (ColorInput& i : inputs) i.use = false;
    error_of(ExitCode::Usage, [&] { color(*s.surface, inputs, options, quiet); });
    options.depth_vox = 0;
    error_of(ExitCode::Usage, [&] { color(*s.surface, s.inputs, options, quiet); });
    options = {};
    const Image8 nothing(128, 96);
    inputs = s.inputs;
    for (ColorInput& i : inputs) i.mask = {nothing.view(), {}};
    const std::string unseen = error_of(ExitCode::Contradiction, [&] { color(*s.surface, inputs, options, quiet); });
    EXPECT_NE(unseen.find("--color none"), std::string::npos);
}

}  // namespace
}  // namespace vdbcarve::test
