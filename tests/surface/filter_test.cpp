// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/filter.h"

#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/global_control.h>

#include <map>
#include <random>
#include <set>

#include "support/noise_grid.h"
#include "support/same_grid.h"
#include "support/scenes.h"
#include "mesh/triangle_tree.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "base/vector_loops.h"

namespace vdbcarve::test {
namespace {

using kernel::FilterPass;
using openvdb::FloatGrid;

FloatGrid::Ptr sample(const std::function<double(const Vec3d&)>& distance, int reach, float voxel = 1.f) {
    openvdb::initialize();
    FloatGrid::Ptr out = FloatGrid::create(3.f * voxel);
    out->setTransform(openvdb::math::Transform::createLinearTransform(voxel));
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    out->setName("surface");
    auto access = out->getAccessor();
    for (int i = -reach; i <= reach; ++i)
        for (int j = -reach; j <= reach; ++j)
            for (int k = -reach; k <= reach; ++k)
                if (const double d = distance(Vec3d(i, j, k)); std::fabs(d) < 3) access.setValue({i, j, k}, voxel * static_cast<float>(d == 0 ? 1e-6 : d));
    openvdb::tools::signedFloodFill(out->tree());
    return out;
}
FloatGrid::Ptr ball(double radius, float voxel = 1.f) {
    return sample([=](const Vec3d& x) { return (x - Vec3d(0.31, 0.17, -0.23)).norm() - radius; }, static_cast<int>(radius) + 5, voxel);
}
FilterResult filtered(const FloatGrid& grid, const std::string& chain, const std::function<void(FilterOptions&)>& adjust = {}) {
    FilterOptions o;
    o.steps = parse_filters(chain);
    if (adjust) adjust(o);
    Progress quiet;
    return filter(grid.deepCopy(), o, quiet);
}

TEST(Filters, AreReadAndWritten) {
    EXPECT_TRUE(parse_filters("none").empty());
    EXPECT_EQ(parse_filters("median"), (std::vector<FilterStep>{{FilterKind::Median, 1, 1}}));
    EXPECT_EQ(parse_filters("median:2,laplacian:1x2,edge-preserving"),
              (std::vector<FilterStep>{{FilterKind::Median, 2, 1}, {FilterKind::Laplacian, 1, 2}, {FilterKind::EdgePreserving, 2, 1}}));
    EXPECT_EQ(parse_filters("gaussianx3"), (std::vector<FilterStep>{{FilterKind::Gaussian, 1, 3}}));
    for (const char* text : {"median:1x1", "mean-curvature:1x7,gaussian:4x2", "edge-preserving:1x2"}) EXPECT_EQ(filters_text(parse_filters(text)), text);
    EXPECT_EQ(filters_text({}), "none");
    const std::pair<const char*, const char*> wrong[] = {
        {"", "is no filter"},           {"blur", "'blur' is no filter"},  {"median:", "no whole number"},         {"median:3", "1..2 voxels, not 3"},
        {"median:1x0", "0 iterations"}, {"median,", "is no filter"},      {"none,median", "'none' is no filter"}, {"laplacian:2", "a width of 1 voxel"},
        {"gaussian:9", "not 9"},        {"median:1.5", "no whole number"}};
    for (const auto& [text, part] : wrong) EXPECT_NE(error_of(ExitCode::Usage, [&] { parse_filters(text); }).find(part), std::string::npos) << text;
}

// Every pass against its definition, on random values, for all instruction sets.
TEST(Filters, PassesAreWhatTheySay) {
    std::mt19937 random(3);
    std::vector<float> halo(kFilterHaloVoxels);
    for (const bool smooth : {false, true}) {
        for (size_t n = 0; n < halo.size(); ++n) {
            const double x = static_cast<double>(n / 256), y = static_cast<double>(n / 16 % 16), z = static_cast<double>(n % 16);
            halo[n] = static_cast<float>(static_cast<double>(random() % 60001) / 10000 - 3) * (smooth ? 0.05f : 1.f) +
                      (smooth ? static_cast<float>(0.5 * (x - 7.3) + 0.7 * (y - 8.1) - 0.5 * (z - 7.9)) : 0.f);
            halo[n] = std::clamp(halo[n], -3.f, 3.f);
        }
        const auto at = [&](int i, int j, int k) { return halo[static_cast<size_t>(((i + 4) * 16 + j + 4) * 16 + k + 4)]; };
        const auto each = [&](const FilterPass& pass, const auto& expected, double tolerance) {
            std::vector<float> first;
            for (const VectorLoops* loops : all_vector_loops()) {
                SCOPED_TRACE(std::string(loops->name) + ", pass " + std::to_string(pass.kind) + ", width " + std::to_string(pass.width) + ", axis " +
                             std::to_string(pass.axis));
                std::vector<float> out(kLeafVoxels);
                loops->filter_leaf(pass, halo.data(), 3.f, out.data());
                if (first.empty()) first = out;
                EXPECT_EQ(std::memcmp(first.data(), out.data(), out.size() * sizeof(float)), 0);
                for (int n = 0; n < kLeafVoxels; ++n) ASSERT_NEAR(out[static_cast<size_t>(n)], expected(n >> 6, n >> 3 & 7, n & 7), tolerance) << n;
            }
        };
        for (const int w : {1, 2})
            each(
                {FilterPass::Median, w, 0},
                [&](int i, int j, int k) {
                    std::vector<float> v;
                    for (int a = -w; a <= w; ++a)
                        for (int b = -w; b <= w; ++b)
                            for (int c = -w; c <= w; ++c) v.push_back(at(i + a, j + b, k + c));
                    std::nth_element(v.begin(), v.begin() + static_cast<long>(v.size() / 2), v.end());
                    return v[v.size() / 2];
                },
                0);
        for (const int w : {1, 2, 4})
            for (int axis = 0; axis < 3; ++axis) {
                const auto along = [&](int i, int j, int k, int n) { return at(i + (axis == 0) * n, j + (axis == 1) * n, k + (axis == 2) * n); };
                each(
                    {FilterPass::Box, w, axis},
                    [&](int i, int j, int k) {
                        double sum = 0;
                        for (int n = -w; n <= w; ++n) sum += along(i, j, k, n);
                        return sum / (2 * w + 1);
                    },
                    2e-6);
                each(
                    {FilterPass::Least, w, axis},
                    [&](int i, int j, int k) {
                        float least = 9;
                        for (int n = -w; n <= w; ++n) least = std::min(least, along(i, j, k, n));
                        return least;
                    },
                    0);
            }
        each(
            {FilterPass::MeanOfSix, 1, 0},
            [&](int i, int j, int k) {
                return (at(i - 1, j, k) + at(i + 1, j, k) + at(i, j - 1, k) + at(i, j + 1, k) + at(i, j, k - 1) + at(i, j, k + 1)) / 6.0;
            },
            2e-6);
        each(
            {FilterPass::MeanCurvature, 1, 0},
            [&](int i, int j, int k) {
                // div(grad / |grad|) |grad| = Laplacian - n^T Hessian n.
                const Vec3d g(0.5 * (at(i + 1, j, k) - at(i - 1, j, k)), 0.5 * (at(i, j + 1, k) - at(i, j - 1, k)), 0.5 * (at(i, j, k + 1) - at(i, j, k - 1)));
                Mat3d h;
                for (int a = 0; a < 3; ++a)
                    for (int b = 0; b < 3; ++b) {
                        const auto step = [&](int s, int t) {
                            return static_cast<double>(at(i + s * (a == 0) + t * (b == 0), j + s * (a == 1) + t * (b == 1), k + s * (a == 2) + t * (b == 2)));
                        };
                        h(a, b) = a == b ? at(i + (a == 0), j + (a == 1), k + (a == 2)) + at(i - (a == 0), j - (a == 1), k - (a == 2)) - 2.0 * at(i, j, k)
                                         : 0.25 * (step(1, 1) + step(-1, -1) - step(1, -1) - step(-1, 1));
                    }
                return g.norm() == 0 ? static_cast<double>(at(i, j, k)) : at(i, j, k) + (h.trace() - g.dot(h * g) / g.squaredNorm()) / 6;
            },
            2e-5);
        for (const int w : {1, 2})
            each(
                {FilterPass::EdgePreserving, w, 0},
                [&](int i, int j, int k) {
                    const auto normal = [&](int a, int b, int c) -> Vec3d {
                        const Vec3d g(at(a + 1, b, c) - at(a - 1, b, c), at(a, b + 1, c) - at(a, b - 1, c), at(a, b, c + 1) - at(a, b, c - 1));
                        return g / std::max(g.norm(), 1e-6);
                    };
                    const Vec3d mine = normal(i, j, k);
                    double sum = at(i, j, k), weights = 1;
                    if (std::fabs(at(i, j, k)) >= 3) return sum;
                    for (int a = -w; a <= w; ++a)
                        for (int b = -w; b <= w; ++b)
                            for (int c = -w; c <= w; ++c) {
                                if (!a && !b && !c) continue;
                                const Vec3d other = normal(i + a, j + b, k + c), d(a, b, c);
                                const double cosine = std::cos(40 * 3.14159265358979 / 180), same = std::max(0.0, (mine.dot(other) - cosine) / (1 - cosine)),
                                             near = 1 - d.squaredNorm() / (3 * w * w + 2);
                                const double value = at(i + a, j + b, k + c);
                                const double weight = std::fabs(value) < 3 ? same * same * near * near : 0;
                                sum += weight * (value - 0.5 * (mine + other).dot(d));
                                weights += weight;
                            }
                    return sum / weights;
                },
                2e-4);
    }
}

// A sphere shrinks by 1 / (3 R) voxel a step of diffusion, dV / V = -1 / R^2; the repair takes it back.
TEST(Filters, SpheresDriftAsTheyMustAndAreRepaired) {
    for (const double radius : {10.0, 20.0, 50.0}) {
        const auto grid = ball(radius, 0.25f);
        for (const auto& [chain, steps] : std::map<std::string, double>{{"laplacian:1", 1}, {"mean-curvature:1", 1}, {"laplacian:1x8", 8}, {"gaussian:1", 8}}) {
            SCOPED_TRACE(chain + ", radius " + std::to_string(radius));
            const FilterResult r = filtered(*grid, chain);
            const double drift = r.volume_filtered / r.volume_before - 1;
            EXPECT_NEAR(drift, -steps / (radius * radius), 0.06 * steps / (radius * radius) + 0.3 / (radius * radius));
            EXPECT_NEAR(r.volume / r.volume_before, 1, kVolumeTolerance);
            EXPECT_LE(r.repair_steps, kMostRepairSteps);
            Progress quiet;
            const MeshMeasures before = measure(extract_mesh(*grid, {}, quiet)), after = measure(extract_mesh(*r.surface, {}, quiet));
            EXPECT_NEAR(after.volume / before.volume, 1, 3e-3);
            EXPECT_TRUE(after.manifold);
            EXPECT_EQ(r.components, 1u);
        }
        const FilterResult kept = filtered(*grid, "median:1", [](FilterOptions& o) { o.repair_volume = false; });
        EXPECT_EQ(kept.offset_vox, 0);
        EXPECT_EQ(kept.volume, kept.volume_filtered);
        EXPECT_LT(kept.volume, kept.volume_before);
    }
}

TEST(Filters, EdgePreservingKeepsEdgesAndRoundParts) {
    // Without any repair: a sphere keeps its volume by itself.
    for (const double radius : {10.0, 20.0, 50.0}) {
        const FilterResult r = filtered(*ball(radius), "edge-preserving:2x4", [](FilterOptions& o) { o.repair_volume = false; });
        EXPECT_NEAR(r.volume / r.volume_before, 1, 0.3 / (radius * radius)) << radius;
    }
    const double h = 30;
    for (const bool tilted : {false, true}) {
        const Mat3d turn = tilted ? turned(Vec3d(25, 20, 10)) : Mat3d(Mat3d::Identity());
        const Vec3d centre = tilted ? Vec3d::Zero() : Vec3d(0.5, 0.5, 0.5);  // faces midway between samples
        const auto grid = sample(
            [&](const Vec3d& x) {
                const Vec3d q = (turn.transpose() * (x - centre)).cwiseAbs() - Vec3d::Constant(h);
                return q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0);
            },
            60);
        const auto recession = [&](const std::string& chain) {
            Progress quiet;
            const TriangleTree tree(extract_mesh(chain == "none" ? *grid : *filtered(*grid, chain).surface, {}, quiet));
            double sum = 0;
            int count = 0;
            for (int axis = 0; axis < 3; ++axis)
                for (int n = 0; n < 4; ++n)
                    for (double t = -0.8 * h; t <= 0.8 * h; t += 2.7, ++count) {
                        Vec3d p;
                        p[axis] = t;
                        p[(axis + 1) % 3] = n & 1 ? h : -h;
                        p[(axis + 2) % 3] = n & 2 ? h : -h;
                        sum += tree.nearest(turn * p + centre).distance;
                    }
            return sum / count;
        };
        const double untouched = recession("none"), edges = recession("edge-preserving:2x2"), gaussian = recession("gaussian:1");
        SCOPED_TRACE(tilted ? "tilted" : "straight");
        std::printf("edges recede by %.3f voxels untouched, %.3f edge-preserving, %.3f gaussian\n", untouched, edges, gaussian);
        // The mesher alone takes the first; edges that lie between samples take half a voxel at most in all.
        EXPECT_LE(edges, tilted ? untouched + 0.2 : 0.5);
        EXPECT_GT(gaussian, 1.0);
    }
}

TEST(Filters, TheBandIsWholeAndTrueAfterwards) {
    const auto grid = ball(24, 0.5f);
    const FilterResult r = filtered(*grid, "gaussian:1");
    EXPECT_EQ(r.surface->getName(), "surface");
    EXPECT_EQ(r.surface->getGridClass(), openvdb::GRID_LEVEL_SET);
    EXPECT_EQ(r.surface->background(), 1.5f);
    // Every voxel: its distance to the sphere that has the same volume, which is the one before.
    auto access = r.surface->getConstAccessor();
    double worst = 0;
    size_t inactive = 0;
    for (int i = -30; i <= 30; ++i)
        for (int j = -30; j <= 30; ++j)
            for (int k = -30; k <= 30; ++k) {
                const double d = (Vec3d(i, j, k) - Vec3d(0.31, 0.17, -0.23)).norm() - 24;
                const openvdb::Coord c(i, j, k);
                if (std::fabs(d) < 2.7) {
                    inactive += !access.isValueOn(c);
                    worst = std::max(worst, std::fabs(access.getValue(c) / 0.5 - d));
                } else if (std::fabs(d) > 3.3) {
                    ASSERT_FALSE(access.isValueOn(c)) << c;
                    ASSERT_EQ(access.getValue(c), d < 0 ? -1.5f : 1.5f) << c;
                }
            }
    EXPECT_EQ(inactive, 0u);
    EXPECT_LT(worst, 0.15);
}

// A rod of 1.3 voxels' radius on a ball.
TEST(Filters, ThinPartsStayWhereTheyAreKept) {
    const auto grid = sample(
        [](const Vec3d& x) {
            const Vec3d q = x - Vec3d(0.3, 0.2, 0.1), rod(std::max(0.0, std::fabs(q.x() - 14) - 14), q.y(), q.z());
            return std::min(q.norm() - 12, rod.norm() - 1.3);
        },
        34);
    const auto reach = [](const FloatGrid& g) {
        int far = -99;
        auto access = g.getConstAccessor();
        for (int i = 0; i < 34; ++i)
            if (access.getValue({i, 0, 0}) < 0) far = i;
        return far;
    };
    ASSERT_GE(reach(*grid), 28);
    EXPECT_LT(reach(*filtered(*grid, "gaussian:1", [](FilterOptions& o) { o.keep_thin_vox = 0; }).surface), 16);
    const FilterResult kept = filtered(*grid, "gaussian:1");
    EXPECT_GE(reach(*kept.surface), 28);
    EXPECT_EQ(kept.components, 1u);
    // Two balls and a rod between them: without protection they come apart.
    const auto dumbbell = sample(
        [](const Vec3d& x) {
            const Vec3d q = x - Vec3d(0.3, 0.2, 0.1), rod(std::max(0.0, std::fabs(q.x()) - 16), q.y(), q.z());
            return std::min({(q - Vec3d(18, 0, 0)).norm() - 9, (q + Vec3d(18, 0, 0)).norm() - 9, rod.norm() - 1.3});
        },
        32);
    const FilterResult torn = filtered(*dumbbell, "gaussian:1", [](FilterOptions& o) { o.keep_thin_vox = 0; });
    EXPECT_EQ(torn.components_before, 1u);
    EXPECT_EQ(torn.components, 2u);
    EXPECT_EQ(filtered(*dumbbell, "gaussian:1").components, 1u);
}

TEST(Filters, PiecesAreThoseOfAFloodFill) {
    std::mt19937 random(11);
    for (int round = 0; round < 4; ++round) {
        // Balls of any size, the large ones with tiles inside, some of them touching.
        struct Ball {
            Vec3d c;
            double r;
        };
        std::vector<Ball> balls;
        for (int n = 0; n < 14; ++n)
            balls.push_back({Vec3d(random() % 120, random() % 120, random() % 120) - Vec3d::Constant(60), 1.2 + random() % (n ? 12 : 40)});
        const auto grid = sample(
            [&](const Vec3d& x) {
                double d = 99;
                for (const Ball& b : balls) d = std::min(d, (x - b.c).norm() - b.r);
                return d;
            },
            104);
        std::map<std::tuple<int, int, int>, bool> seen;
        std::vector<double> expected;
        auto access = grid->getConstAccessor();
        for (const Ball& b : balls) {
            std::vector<openvdb::Coord> open{
                openvdb::Coord(static_cast<int>(std::lround(b.c.x())), static_cast<int>(std::lround(b.c.y())), static_cast<int>(std::lround(b.c.z())))};
            double count = 0;
            while (!open.empty()) {
                const openvdb::Coord c = open.back();
                open.pop_back();
                if (!(access.getValue(c) < 0) || !seen.emplace(std::tuple(c.x(), c.y(), c.z()), true).second) continue;
                ++count;
                for (int a = 0; a < 3; ++a)
                    for (const int s : {-1, 1}) {
                        openvdb::Coord n = c;
                        n[a] += s;
                        open.push_back(n);
                    }
            }
            if (count > 0) expected.push_back(count);
        }
        std::sort(expected.rbegin(), expected.rend());
        EXPECT_EQ(component_volumes(*grid), expected) << round;
    }
}

// The same shape in other units is filtered alike: at the band's end a quotient that is a digit short must not count.
TEST(Filters, UnitsDoNotMatter) {
    const auto one = filtered(*ball(12, 1.f), "edge-preserving:2");
    for (const float voxel : {1.5985744f, 0.1f, 0.7123f}) {
        const auto other = filtered(*ball(12, voxel), "edge-preserving:2");
        EXPECT_NEAR(other.offset_vox, one.offset_vox, 1e-6);
        for (auto v = one.surface->cbeginValueOn(); v; ++v) ASSERT_NEAR(other.surface->tree().getValue(v.getCoord()) / voxel, *v, 2e-5) << voxel;
    }
}

// However strong a filter is: a level set without walls between leaves and tiles, which the meshers would not close or would invent.
TEST(Filters, StrongChainsLeaveALevelSet) {
    const auto grid = sample(
        [](const Vec3d& x) {
            const Vec3d q = x.cwiseAbs() - Vec3d(36, 33, 30);
            return q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0);
        },
        42);
    for (const char* chain : {"gaussian:4x6", "laplacian:1x300"}) {
        SCOPED_TRACE(chain);
        const FilterResult r = filtered(*grid, chain, [](FilterOptions& o) { o.keep_thin_vox = 0; });
        Progress quiet;
        for (const Mesher mesher : {Mesher::Dual, Mesher::MarchingCubes}) {
            MeshOptions o;
            o.mesher = mesher;
            EXPECT_TRUE(measure(extract_mesh(*r.surface, o, quiet)).manifold);
        }
        // No neighbours differ by more than a step of distance can.
        auto access = r.surface->getConstAccessor();
        for (auto v = r.surface->cbeginValueOn(); v; ++v)
            for (int a = 0; a < 3; ++a) {
                openvdb::Coord n = v.getCoord();
                ++n[a];
                ASSERT_LT(std::fabs(access.getValue(n) - *v), 3.1f) << n;
            }
    }
}

TEST(Filters, SameBitsForAnyNumberOfThreads) {
    openvdb::initialize();
    Progress quiet;
    const auto noise = level_set(noise_grid(60, true, false, 5), {}, quiet);
    for (const char* chain : {"median:1,laplacian:1x2", "edge-preserving:2", "gaussian:2"}) {
        const FilterResult many = filtered(*noise, chain);
        const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
        const FilterResult single = filtered(*noise, chain);
        expect_same(*many.surface, *single.surface);
        EXPECT_EQ(many.volume, single.volume);
    }
}

TEST(Filters, WhatCannotBeDoneIsSaid) {
    const auto small = ball(2.2);
    EXPECT_NE(
        error_of(ExitCode::Contradiction, [&] { filtered(*small, "gaussian:3x4", [](FilterOptions& o) { o.keep_thin_vox = 0; }); }).find("leaves nothing"),
        std::string::npos);
    EXPECT_NE(error_of(ExitCode::Usage, [&] { filtered(*small, "median", [](FilterOptions& o) { o.keep_thin_vox = 5; }); }).find("0..4.5"), std::string::npos);
    const auto fog = density_of(*small);
    EXPECT_NE(error_of(ExitCode::Input, [&] { filtered(*fog, "median"); }).find("no level set"), std::string::npos);
    const FilterResult none = filtered(*small, "none");
    EXPECT_EQ(none.volume, none.volume_before);
    expect_same(*none.surface, *small);
}

}  // namespace
}  // namespace vdbcarve::test
