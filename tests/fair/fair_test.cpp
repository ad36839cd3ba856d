// SPDX-License-Identifier: Apache-2.0
// The fair surface: inside the hull, over every silhouette, nearer to the object.

#include "vdbcarve/fair.h"

#include <gtest/gtest.h>
#include <openvdb/tools/Composite.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <tbb/global_control.h>

#include <atomic>
#include <cmath>
#include <numbers>
#include <random>

#include "base/vector_loops.h"
#include "fair/fair_level.h"
#include "support/depth_scene.h"
#include "support/same_grid.h"
#include "support/scenes.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/silhouettes_kept.h"
#include "vdbcarve/slack.h"

namespace vdbcarve::test {
namespace {

struct Faired {
    Shoot shoot;
    openvdb::FloatGrid::Ptr hull;
    std::vector<FairView> views;
    FairResult result;

    explicit Faired(const SyntheticSpec& spec, int resolution, double fairness = 0.06, const std::function<void(SyntheticScene&)>& adjust = {},
                    double margin = 0.1)
        : shoot(test::shoot(spec, adjust)) {
        Progress quiet;
        hull = level_set(carve(shoot.inputs, options_for(shoot, resolution, margin), quiet).hull, {}, quiet);
        const auto cameras = shoot.scene.views.cameras();
        for (size_t u = 0; u < cameras.size(); ++u) views.push_back({cameras[u], view_of(shoot.scene.masks[u])});
        result = again(fairness);
    }
    FairResult again(double fairness = 0.06, const FairEvidence* evidence = nullptr) const {
        Progress quiet;
        FairOptions options;
        options.fairness = fairness;
        return fair(*hull, views, options, quiet, evidence);
    }
    Evaluation against_truth(const openvdb::FloatGrid& surface) const {
        Progress quiet;
        EvaluateOptions options;
        options.samples = 20000;
        options.volume_resolution = 128;
        return evaluate(extract_mesh(surface, {}, quiet), shoot.scene.truth, options, quiet);
    }
};

/// The least value along a line of sight, by small steps in double precision.
double least_along(const openvdb::FloatGrid& grid, const Camera::Ray& ray, const openvdb::CoordBBox& box) {
    const openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> sampler(grid);
    const openvdb::Vec3d lo = grid.indexToWorld(box.min().asVec3d()), hi = grid.indexToWorld(box.max().asVec3d());
    double enter = 0, leave = 1e30, least = 1e30;
    for (int a = 0; a < 3; ++a) {
        double p = (lo[a] - ray.origin[a]) / ray.direction[a], q = (hi[a] - ray.origin[a]) / ray.direction[a];
        if (p > q) std::swap(p, q);
        enter = std::max(enter, p);
        leave = std::min(leave, q);
    }
    for (double t = enter; t < leave; t += 0.15 * grid.voxelSize()[0]) {
        const Vec3d x = ray.origin + t * ray.direction;
        least = std::min(least, static_cast<double>(sampler.wsSample(openvdb::Vec3d(x.x(), x.y(), x.z()))));
    }
    return least;
}

/// Pixels at least half a pixel inside a contour that the hull covers and the surface does not; and how many there are.
std::pair<size_t, size_t> uncovered(const Faired& f) {
    const openvdb::CoordBBox box = f.hull->evalActiveVoxelBoundingBox();
    std::atomic<size_t> open{0}, all{0};
    const double voxel = f.hull->voxelSize()[0];
    tbb::parallel_for(size_t{0}, f.views.size(), [&](size_t u) {
        const ImageF distance = signed_distance(f.views[u].mask.coverage, 8);
        for (int y = 0; y < distance.height; ++y)
            for (int x = 0; x < distance.width; ++x) {
                if (distance.at(x, y) > -0.5f) continue;
                const Camera::Ray ray = f.views[u].camera.ray(Vec2d(x + 0.5, y + 0.5));
                if (least_along(*f.hull, ray, box) > -0.05 * voxel) continue;
                ++all;
                if (least_along(*f.result.surface, ray, box) > 0.03 * voxel) ++open;
            }
    });
    return {open, all};
}

TEST(Fair, EverySilhouetteStaysCovered) {
    for (const char* object : {"cup", "torus"}) {
        const Faired f(small_spec(object, 10, 160, 120), 90);
        const auto [open, all] = uncovered(f);
        EXPECT_GT(all, 10000u);
        EXPECT_EQ(open, 0u) << object << ", of " << all;
        EXPECT_EQ(f.result.uncovered, 0u);
        EXPECT_NEAR(static_cast<double>(f.result.lines_of_sight), static_cast<double>(all), 0.02 * static_cast<double>(all));
    }
}

void expect_inside_hull(const Faired& f) {
    const auto hull = f.hull->getConstAccessor();
    const float band = f.hull->background();
    size_t seen = 0;
    for (auto v = f.result.surface->cbeginValueOn(); v; ++v, ++seen) ASSERT_GE(*v, std::min(hull.getValue(v.getCoord()), band) - 1e-5f * band);
    EXPECT_GT(seen, 1000u);
}

TEST(Fair, LiesInsideTheHull) {
    const Faired f(small_spec("cup", 10, 160, 120), 90);
    expect_inside_hull(f);
    EXPECT_EQ(f.result.surface->getGridClass(), openvdb::GRID_LEVEL_SET);
    EXPECT_EQ(f.result.surface->getName(), "surface");
    EXPECT_LT(f.result.volume, f.result.hull_volume);
}

TEST(Fair, IsNearerToTheObject) {
    const Faired f(small_spec("ellipsoids", 8, 240, 180), 128);
    const Evaluation hull = f.against_truth(*f.hull), fair = f.against_truth(*f.result.surface);
    EXPECT_GT(hull.volume_excess, 0.05);
    EXPECT_LT(fair.volume_excess, 0.6 * hull.volume_excess);
    EXPECT_LT(fair.to_truth.mean, 0.75 * hull.to_truth.mean);
    EXPECT_LT(fair.from_truth.mean, hull.from_truth.mean);
    EXPECT_GT(fair.iou, hull.iou);
    EXPECT_LT(fair.truth_lost, 0.05);
    EXPECT_LT(fair.normal_error_mean_deg, hull.normal_error_mean_deg);
}

// A cup's hollow shows in no silhouette. Depths that are off by up to a voxel say where it is; those of one half say nothing of the other.
TEST(Fair, FollowsDepthsWhereTheyAreSure) {
    Faired f(small_spec("cup", 10, 240, 180), 128);
    const auto off = [&](const openvdb::FloatGrid& surface, double lo, double hi) {  // of the truth, mean over its vertices with such an x
        const openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> sampler(surface);
        double sum = 0;
        size_t count = 0;
        for (const auto& v : f.shoot.scene.truth.vertices) {
            if (v[0] < lo || v[0] > hi) continue;
            sum += std::fabs(sampler.wsSample(openvdb::Vec3d(v[0], v[1], v[2]))) / f.hull->voxelSize()[0];
            ++count;
        }
        return sum / static_cast<double>(count);
    };
    const openvdb::FloatGrid::Ptr without = f.result.surface;
    EXPECT_GT(off(*without, -1, 1), 0.8);
    for (const double sure_from : {-1.0, 0.0}) {
        const DepthScene depths = depth_scene(*f.hull, f.shoot.scene.truth, 1, sure_from);
        const FairEvidence evidence = depths.evidence();
        f.result = f.again(0.06, &evidence);
        EXPECT_LT(off(*f.result.surface, sure_from + 0.25, 1), 0.25) << sure_from;  // beside the cut through the hollow it is rounded
        if (sure_from > -1) EXPECT_LT(off(*f.result.surface, -1, -0.25), off(*without, -1, -0.25) + 0.05);
        EXPECT_EQ(uncovered(f).first, 0u);
        expect_inside_hull(f);
        for (const int threads : {1, 3}) {
            const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threads));
            expect_same(*f.result.surface, *f.again(0.06, &evidence).surface);
        }
    }
}

// Masks that are two pixels too large all around make a hull that depths contradict along every contour.
TEST(Fair, DepthsTellMasksThatAreTooLarge) {
    const auto widen = [](SyntheticScene& scene) {
        for (Mask& m : scene.masks) {
            const Image8 from = m.coverage;
            for (int y = 0; y < from.height; ++y)
                for (int x = 0; x < from.width; ++x)
                    for (int d = 0; d < 25; ++d)
                        m.coverage.at(x, y) =
                            std::max(m.coverage.at(x, y), from.at(std::clamp(x + d % 5 - 2, 0, from.width - 1), std::clamp(y + d / 5 - 2, 0, from.height - 1)));
        }
    };
    for (const bool wide : {false, true}) {
        const Faired f(small_spec("ellipsoids", 10, 240, 180), 128, 0, wide ? widen : std::function<void(SyntheticScene&)>());
        const DepthScene depths = depth_scene(*f.hull, f.shoot.scene.truth, 0.3, -9);
        const double kept = silhouettes_kept(*f.hull, depths.evidence(), f.views);
        EXPECT_TRUE(wide ? kept < 0.5 : kept > 0.95) << kept;
    }
}

// A piece that hangs in the air goes whole, with the parts of its inside that are stored as tiles.
TEST(Fair, DropsPiecesWithTheirTiles) {
    const auto large = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(40.3f, openvdb::Vec3f(0, 0, 0), 1.f, 3.f);
    const auto small = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(16.3f, openvdb::Vec3f(84, 4, 4), 1.f, 3.f);
    openvdb::FloatGrid::Ptr both = large->deepCopy();
    openvdb::tools::csgUnion(*both, *small->deepCopy());
    fairing::Level level = fairing::level_of(*both);
    level.field = level.hull;
    ASSERT_EQ(fairing::grid_of(level, *both)->tree().getValue(openvdb::Coord(84, 4, 4)), -3.f);  // a tile
    EXPECT_EQ(fairing::drop_pieces(level, 0.5), 1u);
    const openvdb::FloatGrid::Ptr left = fairing::grid_of(level, *both);
    for (auto v = left->cbeginValueAll(); v; ++v)
        if (*v < 0.f) ASSERT_LT(v.getCoord().x(), 45);
    EXPECT_LT(left->tree().getValue(openvdb::Coord(0, 0, 0)), 0.f);
}

// Lines with no surface near are reached through the hull, however deep that is: the mesh stays closed.
TEST(Fair, MeshesStayClosedWhereLinesAreReachedThroughTheHull) {
    const Faired f(small_spec("ellipsoids", 5, 96, 72), 64, 0.15, add_speckles);
    Progress quiet;
    const MeshMeasures m = measure(extract_mesh(*f.result.surface, {}, quiet));
    EXPECT_TRUE(m.closed);
    const auto at = f.result.surface->getConstAccessor();
    for (auto v = f.result.surface->cbeginValueOff(); v; ++v) {  // a voxel outside the band has none of the other side beside it
        if (!v.isVoxelValue()) continue;
        for (int n = 0; n < 3; ++n) {
            openvdb::Coord beside = v.getCoord();
            ++beside[n];
            if (!at.isValueOn(beside)) ASSERT_EQ(*v < 0.f, at.getValue(beside) < 0.f) << v.getCoord();
        }
    }
}

// A filter takes rims and thin parts away.
TEST(Fair, CoversAgainWhatAFilterUncovers) {
    Faired f(small_spec("cup", 10, 160, 120), 90);
    Progress quiet;
    FilterOptions rough;
    rough.steps = parse_filters("gaussian:2x2");
    rough.repair_volume = false;
    const openvdb::FloatGrid::Ptr fair = f.result.surface;
    const double volume = f.result.volume;
    f.result.surface = filter(fair->deepCopy(), rough, quiet).surface;
    EXPECT_GT(uncovered(f).first, 20u);
    f.result = cover_again(*f.hull, *f.result.surface, f.views, quiet);
    EXPECT_EQ(uncovered(f).first, 0u);
    EXPECT_EQ(f.result.uncovered, 0u);
    expect_inside_hull(f);
    // What covers already stays, but for contours that are near enough to be kept once others are.
    const FairResult same = cover_again(*f.hull, *fair, f.views, quiet);
    const auto before = fair->getConstAccessor();
    for (auto v = same.surface->cbeginValueOn(); v; ++v) ASSERT_LE(*v, before.getValue(v.getCoord()) + 1e-5f * f.hull->background());
    EXPECT_LT(same.volume, 1.005 * volume);
}

SyntheticSpec solids(std::vector<Solid> which, int views, Rig::Kind rig) {
    SyntheticSpec spec;
    spec.solids = std::move(which);
    spec.rig.kind = rig;
    spec.rig.views = views;
    spec.rig.width_px = 640;
    spec.rig.height_px = 480;
    return spec;
}
Solid solid(Solid::Kind kind, const Vec3d& size) {
    Solid out;
    out.kind = kind;
    out.size = size;
    return out;
}
/// Along z, closed, of as many sides as make it round.
Mesh cylinder(float radius, float half_height) {
    constexpr uint32_t kSides = 360, kRings = 40;
    Mesh out;
    for (uint32_t k = 0; k <= kRings; ++k)
        for (uint32_t i = 0; i < kSides; ++i) {
            const float at = static_cast<float>(i) * 6.2831853f / kSides;
            out.vertices.push_back({radius * std::cos(at), radius * std::sin(at), half_height * (2 * static_cast<float>(k) / kRings - 1)});
        }
    const auto below = static_cast<uint32_t>(out.vertices.size()), above = below + 1;
    out.vertices.push_back({0, 0, -half_height});
    out.vertices.push_back({0, 0, half_height});
    for (uint32_t i = 0; i < kSides; ++i) {
        const uint32_t j = (i + 1) % kSides, top = kRings * kSides;
        for (uint32_t k = 0; k < top; k += kSides) {
            out.triangles.push_back({k + i, k + j, k + j + kSides});
            out.triangles.push_back({k + i, k + j + kSides, k + i + kSides});
        }
        out.triangles.push_back({below, j, i});
        out.triangles.push_back({above, top + i, top + j});
    }
    return out;
}

// Where many views leave no room the hull is right already, and stays. Of a ball the fair surface is nearer to the truth than the hull.
TEST(Fair, WhatIsRightAlreadyStays) {
    SyntheticSpec round = solids({}, 48, Rig::Kind::Dome);
    round.mesh = cylinder(0.6f, 0.8f);
    const std::vector<std::pair<const char*, SyntheticSpec>> specs = {
        {"ball", solids({solid(Solid::Kind::Ellipsoid, Vec3d(1, 1, 1))}, 48, Rig::Kind::Dome)},
        {"ellipsoid", solids({solid(Solid::Kind::Ellipsoid, Vec3d(1, 0.7, 0.5))}, 48, Rig::Kind::Dome)},
        {"cube", solids({solid(Solid::Kind::Box, Vec3d(0.7, 0.7, 0.7))}, 48, Rig::Kind::Dome)},
        {"cylinder", round}};
    for (const auto& [name, spec] : specs) {
        const Faired f(spec, 256, 0.06, {}, 0.02);
        const openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> hull(*f.hull), fair(*f.result.surface);
        double sum2 = 0;
        size_t count = 0;
        const double voxel = f.hull->voxelSize()[0];
        for (const auto& v : f.shoot.scene.truth.vertices) {
            const openvdb::Vec3d x(v[0], v[1], v[2]);
            const double before = static_cast<double>(hull.wsSample(x)) / voxel;
            if (std::fabs(before) > 0.1) continue;
            const double moved = static_cast<double>(fair.wsSample(x)) / voxel - before;
            sum2 += moved * moved;
            ++count;
        }
        ASSERT_GT(count, 1000u) << name;
        EXPECT_LT(std::sqrt(sum2 / static_cast<double>(count)), 0.05) << name;
        if (std::string(name) == "ball") EXPECT_LT(f.against_truth(*f.result.surface).to_truth.mean, 0.9 * f.against_truth(*f.hull).to_truth.mean);
    }
}

// Stems three pixels wide, which no surface that shrinks would keep, and the handle of a cup.
TEST(Fair, ThinPartsStay) {
    SyntheticSpec spec = solids({solid(Solid::Kind::Ellipsoid, Vec3d(0.3, 0.3, 0.25))}, 24, Rig::Kind::Orbit);
    spec.rig.width_px = 480;
    spec.rig.height_px = 360;
    spec.solids[0].world_from_solid.translation = Vec3d(0, 0, -0.7);
    const double half = 1.5 / (0.4 * spec.rig.height_px);  // the object's ball fills 0.8 of the height
    for (int n = 0; n < 6; ++n) {
        Solid stem = solid(n % 2 ? Solid::Kind::Box : Solid::Kind::Ellipsoid, Vec3d(half, half, 0.75));
        const Mat3d turn = (Eigen::AngleAxisd(1.05 * n, Vec3d::UnitZ()) * Eigen::AngleAxisd(0.1 + 0.1 * n, Vec3d::UnitY())).toRotationMatrix();
        stem.world_from_solid = {turn, Vec3d(0, 0, -0.6) + 0.7 * turn.col(2)};
        spec.solids.push_back(stem);
    }
    const Faired f(spec, 160);
    const openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> hull(*f.hull), fair(*f.result.surface);
    size_t there = 0, kept = 0;
    for (size_t s = 1; s < spec.solids.size(); ++s)
        for (double t = -0.7; t < 0.7; t += 0.003) {
            const Vec3d x = spec.solids[s].world_from_solid * Vec3d(0, 0, t);
            const openvdb::Vec3d at(x.x(), x.y(), x.z());
            there += hull.wsSample(at) < 0;
            kept += hull.wsSample(at) < 0 && fair.wsSample(at) < 0.03 * f.hull->voxelSize()[0];
        }
    EXPECT_GT(there, 2000u);
    EXPECT_EQ(kept, there);
    EXPECT_EQ(uncovered(f).first, 0u);
    // The hole under a cup's handle stays a hole, and the handle stays.
    const Faired cup(small_spec("cup", 24, 320, 240), 128);
    Progress quiet;
    const MeshMeasures m = measure(extract_mesh(*cup.result.surface, {}, quiet));
    EXPECT_EQ(m.components, 1u);
    EXPECT_EQ(m.genus, 1);
}

TEST(Fair, EasesTowardsANearHullOnly) {
    constexpr float kFar = 2;
    for (const float value : {-3.f, -1.f, 0.f, 0.5f, 3.f}) {
        EXPECT_EQ(kernel::eased(value, value, kFar), value);
        EXPECT_EQ(kernel::eased(value, value - kFar, kFar), value);
        EXPECT_EQ(kernel::eased(value, -kernel::kFairBand_vox, kFar), value);  // the hull lies anywhere above
        EXPECT_EQ(kernel::eased(value, value, 0), value);
    }
    float last = -1;
    for (float apart = 0; apart < 3; apart += 0.01f) {  // what is deeper stays deeper
        const float eased = kernel::eased(apart - 1, -1, kFar);
        EXPECT_GE(eased, -1);
        EXPECT_LE(eased, apart - 1);
        EXPECT_GE(eased, last);
        last = eased;
    }
}

// A ball's hull between two tangents, R (1 / cos(half the angle) - 1).
TEST(Fair, KnowsHowFarContoursAreApart) {
    const auto between = [](const std::vector<double>& azimuths_deg) {
        fairing::LeafLattice lattice;
        lattice.lo = {-8, -8, -8};
        lattice.size = {16, 16, 16};
        std::vector<FairView> views;
        for (const double degrees : azimuths_deg) {
            FairView v{};
            const double a = degrees * std::numbers::pi / 180;
            v.camera.camera_from_world.rotation << -std::sin(a), std::cos(a), 0, 0, 0, -1, -std::cos(a), -std::sin(a), 0;
            v.camera.camera_from_world.translation = Vec3d(0, 0, 500);
            views.push_back(v);
        }
        return fairing::between_contours_vox(lattice, *openvdb::math::Transform::createLinearTransform(1), views);
    };
    const double expected = 56 * (1 / std::cos(10 * std::numbers::pi / 180) - 1);
    EXPECT_NEAR(between({0, 20, 40, 60}), expected, 0.01);
    EXPECT_NEAR(between({0, 0.01, 20, 20.02, 40, 40.01, 60, 60.01}), expected, 0.02);  // two from each place
    EXPECT_EQ(between({30, 30, 30}), 0);
    EXPECT_EQ(between({}), 0);
}

TEST(Fair, SameBitsForAnyNumberOfThreads) {
    const Faired f(small_spec("cup", 8, 160, 120), 160);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    expect_same(*f.result.surface, *f.again().surface);
}

TEST(Fair, SameBitsForInstructionSets) {
    std::mt19937 engine(3);
    std::vector<float> halo(16 * 16 * 16), hull(512);
    for (float& v : halo) v = static_cast<float>(engine()) * 0x1p-30f - 2.f;
    for (float& v : hull) v = static_cast<float>(engine()) * 0x1p-31f - 2.f;
    const float weight[5] = {0.3f, 0.2f, 0.1f, 0.04f, 0.01f};
    std::vector<std::vector<float>> results;
    for (const VectorLoops* loops : all_vector_loops()) {
        std::vector<float> out(1024);
        loops->blur_leaf(halo.data(), weight, out.data());
        loops->straighten_leaf(halo.data(), hull.data(), out.data() + 512);
        results.push_back(out);
    }
    for (const auto& r : results) EXPECT_EQ(r, results.front());
    double sum = 0;
    for (int i = -4; i <= 4; ++i)
        for (int j = -4; j <= 4; ++j)
            for (int k = -4; k <= 4; ++k)
                sum += static_cast<double>(weight[std::abs(i)]) * static_cast<double>(weight[std::abs(j)]) * static_cast<double>(weight[std::abs(k)]) *
                       static_cast<double>(halo[static_cast<size_t>(((i + 6) * 16 + j + 9) * 16 + k + 11)]);
    EXPECT_NEAR(static_cast<double>(results.front()[2 << 6 | 5 << 3 | 7]), sum, 1e-6);
}

TEST(Fair, NothingIsForcedWhereNothingIsSeen) {
    // The lower half of every picture is ignored: no line of sight is asked there.
    const auto ignore_below = [](SyntheticScene& scene) {
        for (Mask& m : scene.masks) {
            m.ignore = Image8(m.coverage.width, m.coverage.height);
            for (int y = m.coverage.height / 2; y < m.coverage.height; ++y)
                for (int x = 0; x < m.coverage.width; ++x) m.ignore.at(x, y) = 255;
        }
    };
    const SyntheticSpec spec = small_spec("ellipsoids", 8, 160, 120);
    const Faired all(spec, 64);
    FairResult half;
    {
        Shoot shoot = test::shoot(spec, ignore_below);
        std::vector<FairView> views;
        const auto cameras = shoot.scene.views.cameras();
        for (size_t u = 0; u < cameras.size(); ++u) views.push_back({cameras[u], view_of(shoot.scene.masks[u])});
        Progress quiet;
        half = fair(*all.hull, views, {}, quiet);
    }
    EXPECT_LT(half.lines_of_sight, 0.8 * static_cast<double>(all.result.lines_of_sight));
    EXPECT_LT(half.volume, all.result.volume);
    EXPECT_EQ(half.uncovered, 0u);
}

// Balls in a ball: slack is the difference of the radii, within the band and far beyond it.
TEST(Slack, IsTheDistanceToTheHull) {
    const auto ball = [](float radius) { return openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(radius, openvdb::Vec3f(1, 2, 3), 0.5f, 3.f); };
    const auto hull = ball(20);
    for (const float radius : {20.f, 19.2f, 17.f, 12.f, 5.f}) {
        const auto inner = ball(radius);
        const auto grid = slack(*hull, *inner);
        EXPECT_EQ(grid->activeVoxelCount(), inner->activeVoxelCount());
        Progress quiet;
        Mesh mesh = extract_mesh(*inner, {}, quiet);
        set_slack(mesh, *grid);
        const double expected = static_cast<double>(20 - radius);
        for (const float s : mesh.slack) ASSERT_NEAR(static_cast<double>(s), expected, 0.05 + 0.16 * expected) << radius;
        const SlackShares shares = slack_shares(mesh);
        EXPECT_NEAR(shares.mean, expected, 0.05 + 0.12 * expected);
        EXPECT_NEAR(shares.known_share, 1, 1e-9);
        EXPECT_LE(shares.half, shares.most);
        // The upper part is not known.
        mesh.extrapolated.assign(mesh.vertices.size(), 0);
        for (size_t v = 0; v < mesh.vertices.size(); ++v) mesh.extrapolated[v] = mesh.vertices[v][2] > 3;
        const SlackShares lower = slack_shares(mesh);
        EXPECT_NEAR(lower.known_share, 0.5, 0.06);
        EXPECT_EQ(lower.most_share, lower.known_share);
        EXPECT_TRUE(std::isfinite(lower.most));
    }
}

TEST(Fair, RefusesWhatItCannotDo) {
    const Faired f(small_spec("ellipsoids", 4, 96, 72), 32);
    EXPECT_NE(error_of(ExitCode::Usage, [&] { f.again(0.7); }).find("--fairness"), std::string::npos);
    Progress quiet;
    EXPECT_NE(error_of(ExitCode::Input, [&] { fair(*openvdb::FloatGrid::create(1), f.views, {}, quiet); }).find("no surface"), std::string::npos);
    // No motion: the hull.
    const FairResult same = f.again(0);
    expect_same(*same.surface, *f.hull);
    EXPECT_EQ(same.volume, same.hull_volume);
}

}  // namespace
}  // namespace vdbcarve::test
