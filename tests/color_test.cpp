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

using kernel::Rgb;

const nanovdb::NanoGrid<float>* grid_in(const NanoBuffer& b) { return reinterpret_cast<const nanovdb::NanoGrid<float>*>(b.data.get()); }

// ------------------------------------------------------------------------------------ colour spaces

// Pairs published with the formula (Sharma, Wu and Dalal 2005, table 1), chosen there to catch wrong implementations.
TEST(ColorSpace, Ciede2000AgreesWithThePublishedPairs) {
    const struct {
        std::array<double, 3> a, b;
        double expected;
    } pairs[] = {{{50, 2.6772, -79.7751}, {50, 0, -82.7485}, 2.0425},
                 {{50, -1.3802, -84.2814}, {50, 0, -82.7485}, 1.0000},
                 {{50, 0, 0}, {50, -1, 2}, 2.3669},
                 {{50, 2.49, -0.001}, {50, -2.49, 0.0009}, 7.1792},
                 {{50, 2.49, -0.001}, {50, -2.49, 0.0011}, 7.2195},
                 {{50, -0.001, 2.49}, {50, 0.0009, -2.49}, 4.8045},
                 {{50, 2.5, 0}, {50, 0, -2.5}, 4.3065},
                 {{50, 2.5, 0}, {73, 25, -18}, 27.1492},
                 {{60.2574, -34.0099, 36.2677}, {60.4626, -34.1751, 39.4387}, 1.2644},
                 {{2.0776, 0.0795, -1.135}, {0.9033, -0.0636, -0.5514}, 0.9082}};
    for (const auto& p : pairs) {
        EXPECT_NEAR(ciede2000(p.a, p.b), p.expected, 1e-4);
        EXPECT_NEAR(ciede2000(p.b, p.a), p.expected, 1e-4);
    }
}

TEST(ColorSpace, EveryEightBitValueComesBack) {
    for (int v = 0; v < 256; ++v) EXPECT_EQ(srgb8_from_linear(static_cast<float>(linear_from_srgb(v / 255.0))), v);
    const auto white = lab_from_linear({1, 1, 1});
    EXPECT_NEAR(white[0], 100, 1e-3);
    EXPECT_NEAR(white[1], 0, 1e-2);
    EXPECT_NEAR(white[2], 0, 1e-2);
}

// ------------------------------------------------------------------------------------ lines of sight

// Against small steps along the ray: a voxel below the threshold whose cell is entered by more than a graze blocks it, and nothing else does.
TEST(Sight, BlockedAgreesWithSmallStepsOnNoise) {
    openvdb::initialize();
    std::mt19937 random(3);
    const auto uniform = [&](double a, double b) { return a + (b - a) * static_cast<double>(random() >> 5) / static_cast<double>(1 << 27); };
    // Balls far apart, so that rays cross empty nodes of every size.
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(3.f);
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    std::vector<std::pair<Vec3d, double>> balls;
    for (int b = 0; b < 50; ++b) balls.emplace_back(Vec3d(uniform(-300, 300), uniform(-300, 300), uniform(-300, 300)), uniform(6, 40));
    auto access = grid->getAccessor();
    for (const auto& [centre, radius] : balls) {
        const int r = static_cast<int>(radius) + 4;
        for (int i = -r; i <= r; ++i)
            for (int j = -r; j <= r; ++j)
                for (int k = -r; k <= r; ++k) {
                    const openvdb::Coord c(static_cast<int>(centre.x()) + i, static_cast<int>(centre.y()) + j, static_cast<int>(centre.z()) + k);
                    const double d = (Vec3d(c[0], c[1], c[2]) - centre).norm() - radius;
                    if (d < 3 && d < access.getValue(c)) access.setValue(c, static_cast<float>(std::max(d, -3.0)));
                }
    }
    const NanoBuffer bytes = to_nanovdb(*grid, false);
    const auto* nano = grid_in(bytes);
    const std::vector<uint64_t> walls = sight_walls(*nano, 0.5f);
    const kernel::ColorBase base = color_base(leaf_box(*grid));
    const kernel::SightGrid sight{nano, walls.data(), 0.5f, base};
    kernel::SightCells cells(sight);
    const kernel::ColorRule rule = color_rule({}, leaf_box(*grid));
    int blocked = 0, compared = 0;
    for (int n = 0; n < 1000; ++n) {
        const Vec3d from(uniform(-330, 330), uniform(-330, 330), uniform(-330, 330));
        Vec3d way(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
        if (n % 7 == 0) way[n % 3] = 0;
        if (n % 50 == 0) way = Vec3d::Unit(n / 50 % 3) * (n % 100 ? 1 : -1);
        way.normalize();
        const double length = uniform(5, 700);
        const bool found = kernel::is_blocked(
            cells, rule.box, {static_cast<float>(from.x() - base.i), static_cast<float>(from.y() - base.j), static_cast<float>(from.z() - base.k)},
            {static_cast<float>(way.x()), static_cast<float>(way.y()), static_cast<float>(way.z())}, static_cast<float>(length));
        // Certainly: a cell entered by a hundredth of a voxel. Possibly: one that comes as near.
        bool certain = false, possible = false;
        for (double t = 0; t < length; t += 0.02) {
            const Vec3d p = from + t * way;
            for (int a = -1; a <= 1; a += 2)
                for (int axis = 0; axis < 3; ++axis) {
                    const Vec3d q = p + a * 0.02 * Vec3d::Unit(axis);
                    const openvdb::Coord c(static_cast<int>(std::floor(q.x() + 0.5)), static_cast<int>(std::floor(q.y() + 0.5)),
                                           static_cast<int>(std::floor(q.z() + 0.5)));
                    possible |= grid->tree().getValue(c) < 0.5f;
                }
            const openvdb::Coord c(static_cast<int>(std::floor(p.x() + 0.5)), static_cast<int>(std::floor(p.y() + 0.5)),
                                   static_cast<int>(std::floor(p.z() + 0.5)));
            const Vec3d inside = (p - Vec3d(c[0], c[1], c[2])).cwiseAbs();
            certain |= inside.maxCoeff() < 0.48 && grid->tree().getValue(c) < 0.5f;
            if (certain) break;
        }
        if (certain == possible || certain) ++compared;
        if (certain) {
            EXPECT_TRUE(found) << n;
        } else if (!possible) {
            EXPECT_FALSE(found) << n;
        }
        blocked += found;
    }
    EXPECT_GT(blocked, 50);
    EXPECT_LT(blocked, 900);
    EXPECT_GT(compared, 950);
}

// What is remembered of one line of sight must not change the next.
TEST(Sight, AnswersDoNotDependOnWhatWasAskedBefore) {
    const ColorScene s = color_scene(small_spec("ellipsoids", 8, 128, 96), 320);
    const NanoBuffer bytes = to_nanovdb(*s.surface, false);
    const auto* nano = grid_in(bytes);
    const float threshold = sight_threshold(*s.surface);
    const std::vector<uint64_t> walls = sight_walls(*nano, threshold);
    const kernel::ColorBase base = color_base(leaf_box(*s.surface));
    const kernel::SightGrid sight{nano, walls.data(), threshold, base};
    const kernel::ColorRule rule = color_rule({}, leaf_box(*s.surface));
    kernel::SightCells kept(sight);
    size_t blocked = 0, asked = 0;
    for (auto it = s.surface->cbeginValueOn(); it; ++it) {
        if (*it < 1.5f * s.voxel() || asked >= 60000) continue;
        const openvdb::Coord c = it.getCoord();
        for (const Vec3d& way : {Vec3d(1, 0.2, 0.1), Vec3d(-0.3, 1, 0.4), Vec3d(0.2, -0.4, -1), Vec3d(-1, -1, 0.3)}) {
            const Vec3d w = way.normalized();
            const kernel::Vec3 from{static_cast<float>(c[0] - base.i), static_cast<float>(c[1] - base.j), static_cast<float>(c[2] - base.k)},
                to{static_cast<float>(w.x()), static_cast<float>(w.y()), static_cast<float>(w.z())};
            kernel::SightCells fresh(sight);
            const bool expected = kernel::is_blocked(fresh, rule.box, from, to, 2000);
            ASSERT_EQ(kernel::is_blocked(kept, rule.box, from, to, 2000), expected);
            blocked += expected;
            ++asked;
        }
    }
    EXPECT_GT(blocked, asked / 10);
    EXPECT_LT(blocked, asked * 9 / 10);
}

// ------------------------------------------------------------------------------------ normals

// The paper's window makes normals of a binary ball that differences alone cannot.
TEST(Normals, WindowedGradientOfABinaryBall) {
    const double radius = 30.3;
    const auto value = [&](int i, int j, int k) { return std::sqrt(static_cast<double>(i * i + j * j + k * k)) < radius ? -1.f : 1.f; };
    const auto mean_error = [&](int window) {
        const std::vector<float> weights = normal_weights(window);
        double sum = 0;
        int count = 0;
        for (int i = -31; i <= 31; ++i)
            for (int j = -31; j <= 31; ++j)
                for (int k = -31; k <= 31; ++k) {
                    if (!kernel::is_contour(value, value(i, j, k), i, j, k)) continue;
                    const kernel::SurfacePoint p = kernel::surface_point(value, 0.f, 1.f, i, j, k, {window, weights.data()}, {0, 0, 0});
                    const Vec3d n(p.nx, p.ny, p.nz);
                    sum += std::acos(std::clamp(n.dot(Vec3d(i, j, k).normalized()), -1.0, 1.0)) * 180 / std::numbers::pi;
                    ++count;
                }
        return sum / count;
    };
    const double plain = mean_error(0), narrow = mean_error(2), wide = mean_error(4);
    RecordProperty("plain_deg", std::to_string(plain));
    RecordProperty("narrow_deg", std::to_string(narrow));
    RecordProperty("wide_deg", std::to_string(wide));
    EXPECT_GT(plain, 8);
    EXPECT_LT(narrow, 0.7 * plain);
    EXPECT_LT(wide, 3);
}

// ------------------------------------------------------------------------------------ filling

TEST(Fill, MortonKeysComeBackAndSortParentsFirst) {
    std::mt19937 random(1);
    uint64_t last = 0;
    std::vector<uint64_t> keys;
    for (int n = 0; n < 10000; ++n) {
        const uint32_t x = random() & 0x1fffff, y = random() & 0x1fffff, z = random() & 0x1fffff;
        const uint64_t key = kernel::morton_key(x, y, z);
        EXPECT_EQ(kernel::gather_bits(key >> 2), x);
        EXPECT_EQ(kernel::gather_bits(key >> 1), y);
        EXPECT_EQ(kernel::gather_bits(key), z);
        EXPECT_EQ(kernel::morton_key(x >> 1, y >> 1, z >> 1), key >> 3);
        keys.push_back(key);
    }
    std::sort(keys.begin(), keys.end());
    for (const uint64_t key : keys) {
        EXPECT_GE(key >> 3, last);
        last = key >> 3;
    }
}

struct Patch {
    std::vector<uint64_t> keys;
    std::vector<uint8_t> known;
    std::vector<Rgb> colors;
    std::map<std::pair<int, int>, size_t> at;
    void add(int x, int y, bool is_known, const Rgb& c) {
        at[{x, y}] = keys.size();
        keys.push_back(kernel::morton_of_voxel(x, y, 7));
        known.push_back(is_known);
        colors.push_back(is_known ? c : Rgb{0, 0, 0});
    }
};

// A strip whose ends are known: the harmonic colour between is linear.
TEST(Fill, LinearBetweenTwoKnownEnds) {
    Patch p;
    for (int x = -40; x <= 160; ++x)
        for (int y = -12; y <= 12; ++y)
            p.add(x, y, x < 0 || x > 100,
                  {0.2f + 0.006f * static_cast<float>(std::clamp(x, 0, 101)), 0.5f, 0.9f - 0.008f * static_cast<float>(std::clamp(x, 0, 101))});
    fill_colors(p.keys, p.known, p.colors);
    double worst = 0;
    for (int x = 0; x <= 100; ++x)
        for (int y = -12; y <= 12; ++y) worst = std::max<double>(worst, std::fabs(p.colors[p.at[{x, y}]].r - (0.2 + 0.006 * x)));
    RecordProperty("worst", std::to_string(worst));
    EXPECT_LT(worst, 0.03);  // of a range of 0.6
    // What was known is untouched, what was constant stays exactly so.
    for (size_t n = 0; n < p.keys.size(); ++n) EXPECT_EQ(p.colors[n].g, 0.5f);
    EXPECT_EQ(p.colors[p.at[std::pair(-5, 3)]].r, 0.2f);
}

TEST(Fill, KeepsWithinTheKnownColoursAndReachesEveryPiece) {
    std::mt19937 random(4);
    Patch p;
    for (int x = 0; x < 90; ++x)
        for (int y = 0; y < 90; ++y) {
            const float shade = 0.25f + 0.5f * static_cast<float>(random() % 1000) / 999.f;
            p.add(x, y, random() % 40 == 0, {shade, shade, shade});
        }
    p.add(500, 500, false, {});  // a piece on its own
    fill_colors(p.keys, p.known, p.colors);
    for (const Rgb& c : p.colors) {
        EXPECT_GE(c.r, 0.25f - 1e-6f);
        EXPECT_LE(c.r, 0.75f + 1e-6f);
    }
}

// ------------------------------------------------------------------------------------ exposure

TEST(Exposure, GainsComeBackDespiteOutliers) {
    std::mt19937 random(8);
    const auto uniform = [&] { return static_cast<double>(random() >> 5) / static_cast<double>(1 << 27); };
    const size_t views = 20;
    std::vector<double> exposure;
    for (size_t v = 0; v < views; ++v) exposure.push_back(0.8 + 0.4 * uniform());
    Observations o;
    o.views = views;
    for (int p = 0; p < 3000; ++p) {
        const double albedo[3] = {0.1 + 0.5 * uniform(), 0.1 + 0.5 * uniform(), 0.1 + 0.5 * uniform()};
        const size_t middle = random() % views;
        for (size_t v = 0; v < views; ++v) {
            const size_t apart = std::min((v + views - middle) % views, (middle + views - v) % views);
            if (apart > 2) {
                o.table.push_back({{0, 0, 0}, 0});
                continue;
            }
            const double wild = random() % 8 == 0 ? 1.8 : 0.95 + 0.1 * uniform();  // one in eight shows a highlight
            const double f = exposure[v] * wild;
            o.table.push_back({{static_cast<float>(f * albedo[0]), static_cast<float>(f * albedo[1]), static_cast<float>(f * albedo[2])}, 1});
        }
    }
    for (const bool per_channel : {false, true}) {
        ExposureOptions options;
        options.per_channel = per_channel;
        const Exposure e = estimate_exposure(o, options);
        double mean = 0, product = 0;
        for (size_t v = 0; v < views; ++v) mean += std::log(exposure[v]) / static_cast<double>(views);
        for (size_t v = 0; v < views; ++v) {
            for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(std::log(e.gains[v][c]) + std::log(exposure[v]) - mean, 0, 0.01) << v;
            product += std::log(e.gains[v][0]);
        }
        EXPECT_NEAR(product, 0, 1e-9);
        EXPECT_LT(e.disagreement, 0.5 * e.disagreement_before);
    }
}

TEST(Exposure, ViewsThatShareNothingKeepAGainOfOne) {
    Observations o;
    o.views = 3;
    for (int p = 0; p < 100; ++p) {
        o.table.push_back({{0.5f, 0.5f, 0.5f}, 1});
        o.table.push_back({{0.4f, 0.4f, 0.4f}, 1});
        o.table.push_back({{0, 0, 0}, 0});
    }
    const Exposure e = estimate_exposure(o, {});
    EXPECT_EQ(e.gains[2][0], 1);
    EXPECT_NEAR(e.gains[1][0] / e.gains[0][0], 1.25, 0.01);
    EXPECT_EQ(e.places[2], 0u);
}

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
