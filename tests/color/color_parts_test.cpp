// SPDX-License-Identifier: Apache-2.0
// The parts of colouring by themselves: colour spaces, lines of sight, normals, fill, exposure.
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

}  // namespace
}  // namespace vdbcarve::test
