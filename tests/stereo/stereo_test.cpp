// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/stereo.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <limits>
#include <random>

#include "surface/pieces.h"
#include "stereo/stereo_plan.h"
#include "support/dented_ball.h"
#include "support/same_grid.h"
#include "vdbcarve/error.h"
#include "vdbcarve/filter.h"

namespace vdbcarve::test {
namespace {

using kernel::StereoPlane;

kernel::StereoLens lens_of(const Camera& c) {
    const Intrinsics& k = c.intrinsics;
    return {static_cast<float>(k.fx), static_cast<float>(k.fy), static_cast<float>(k.skew), static_cast<float>(k.cx), static_cast<float>(k.cy), k.orthographic};
}

std::vector<Camera> random_cameras(std::mt19937& random, bool orthographic) {
    std::uniform_real_distribution<double> u(-1, 1);
    std::vector<Camera> out(2);
    for (Camera& c : out) {
        c.camera_from_world.rotation = turned(Vec3d(15 * u(random), 15 * u(random), 40 * u(random)));
        c.camera_from_world.translation = Vec3d(0.5 * u(random), 0.5 * u(random), 5 + u(random));
        Intrinsics& k = c.intrinsics;
        const double f = orthographic ? 60 : 300;
        k = {f * (1 + 0.1 * u(random)), f * (1 + 0.1 * u(random)), 0.05 * f * u(random), 150 + 20 * u(random), 110 + 20 * u(random), 320, 240, orthographic};
    }
    return out;
}

// A plane through a pixel says at every other pixel where its line of sight meets the plane, and the way into another picture is that of the point there.
TEST(Stereo, PlanesAreWhatRaysMeet) {
    std::mt19937 random(7);
    std::uniform_real_distribution<double> u(-1, 1);
    for (int n = 0; n < 400; ++n) {
        std::vector<Camera> cameras = random_cameras(random, n % 2);
        if (n % 4 > 1) cameras[1] = random_cameras(random, n % 2 == 0)[1];  // one of each kind
        const Camera &a = cameras[0], &b = cameras[1];
        const kernel::StereoLens lens = lens_of(a);
        const Vec2d pixel(160 + 60 * u(random), 120 + 40 * u(random));
        const Camera::Ray ray = a.ray(pixel);
        const double way = 5 + 0.5 * u(random);
        const Vec3d place = ray.origin + way * ray.direction;
        const Vec3d normal = (-ray.direction + 0.7 * Vec3d(u(random), u(random), u(random))).normalized();
        if (-normal.dot(ray.direction) < 0.3) continue;
        const double z = (a.camera_from_world * place).z();
        const Vec3d in_camera = a.camera_from_world.rotation * normal;
        const kernel::Vec3 given{static_cast<float>(in_camera.x()), static_cast<float>(in_camera.y()), static_cast<float>(in_camera.z())};
        const auto px = static_cast<float>(pixel.x()), py = static_cast<float>(pixel.y());
        const StereoPlane plane = kernel::plane_of_normal(lens, given, static_cast<float>(a.intrinsics.orthographic ? z : 1 / z), px, py);
        const kernel::Vec3 back = kernel::plane_normal(lens, plane, px, py);
        EXPECT_NEAR(back.x, given.x, 1e-4);
        EXPECT_NEAR(back.y, given.y, 1e-4);
        EXPECT_NEAR(back.z, given.z, 1e-4);
        EXPECT_NEAR(kernel::sight_cosine(lens, back, px, py), -normal.dot(ray.direction), 1e-4);
        const Vec2d shift(6 * u(random), 6 * u(random));
        const Camera::Ray beside = a.ray(pixel + shift);
        const Vec3d there = beside.origin + normal.dot(place - beside.origin) / normal.dot(beside.direction) * beside.direction;
        const double true_z = (a.camera_from_world * there).z();
        const StereoPlane moved = kernel::moved(plane, static_cast<float>(shift.x()), static_cast<float>(shift.y()));
        EXPECT_NEAR(kernel::depth_of(lens, moved.s), true_z, 2e-4 * true_z);
        const auto seen = b.project(there);
        ASSERT_TRUE(seen);
        const kernel::StereoPair pair = stereo_pair(a, b, 1);
        double p[3];
        for (int r = 0; r < 3; ++r)
            p[r] = pair.from_pixel[3 * r] * (pixel.x() + shift.x()) + pair.from_pixel[3 * r + 1] * (pixel.y() + shift.y()) + pair.from_pixel[3 * r + 2] +
                   static_cast<double>(moved.s) * pair.along[r];
        EXPECT_NEAR(p[0] / p[2], seen->x(), 0.02);
        EXPECT_NEAR(p[1] / p[2], seen->y(), 0.02);
        const double depth =
            (pair.depth[0] * (pixel.x() + shift.x()) + pair.depth[1] * (pixel.y() + shift.y()) + pair.depth[2] + static_cast<double>(moved.s) * pair.depth[3]) /
            (a.intrinsics.orthographic ? 1 : static_cast<double>(moved.s));
        EXPECT_NEAR(depth, (b.camera_from_world * there).z(), 2e-3);
    }
}

double volume_of(const openvdb::FloatGrid& surface) { return component_volumes(surface).front(); }

/// Voxels of the true solid, a voxel or more inside it, that the result leaves out.
size_t truth_lost(const openvdb::FloatGrid& surface) {
    const DentedBall ball;
    const double h = surface.voxelSize()[0];
    size_t out = 0;
    auto value = surface.getConstAccessor();
    for (int i = -40; i < 40; ++i)
        for (int j = -40; j < 40; ++j)
            for (int k = -40; k < 40; ++k) {
                const openvdb::Vec3d w = surface.indexToWorld(openvdb::Vec3d(i, j, k));
                const Vec3d x(w[0], w[1], w[2]);
                if (x.norm() < 1 - h && (x - ball.dent).norm() > ball.dent_radius + h && !(value.getValue({i, j, k}) < 0)) ++out;
            }
    return out;
}

TEST(Stereo, ADentThatSilhouettesDoNotShowIsFound) {
    for (const bool orthographic : {false, true}) {
        const DentedScene scene(0.9, 24, 240, 64, orthographic);
        Progress quiet;
        StereoOptions o;
        o.scale = 1;
        const StereoResult r = stereo(*scene.hull, scene.inputs, {}, o, quiet);
        const double truth = DentedBall().volume(), hull = volume_of(*scene.hull) / truth - 1, carved = volume_of(*r.surface) / truth - 1;
        EXPECT_GT(hull, 0.08);
        EXPECT_LT(carved, 0.25 * hull) << "hull " << hull << (orthographic ? ", orthographic" : "");
        EXPECT_GT(carved, -0.01);
        EXPECT_LE(truth_lost(*r.surface), truth_lost(*scene.hull) + 60);  // of 90000
        EXPECT_NEAR(r.volume, volume_of(*r.surface), 0.02 * r.volume);
        // Never outside the hull.
        auto before = scene.hull->getConstAccessor();
        for (auto v = r.surface->cbeginValueOn(); v; ++v)
            if (*v < 0) {
                ASSERT_LT(before.getValue(v.getCoord()), 0) << v.getCoord();
            }
        // Depths are those of the rays.
        const DentedBall ball;
        double worst = 0, sum = 0;
        size_t count = 0;
        for (size_t v = 0; v < r.maps.size(); ++v)
            for (int y = 0; y < r.maps[v].depth.height; ++y)
                for (int x = 0; x < r.maps[v].depth.width; ++x) {
                    const double z = r.maps[v].depth.at(x, y);
                    if (z == 0) continue;
                    const Camera::Ray ray = scene.cameras[v].ray(Vec2d(x + 0.5, y + 0.5));
                    const auto t = ball.hit(ray);
                    if (!t) continue;
                    const double off = std::fabs((scene.cameras[v].camera_from_world * (ray.origin + *t * ray.direction)).z() - z);
                    worst = std::max(worst, off);
                    sum += off < 0.05;
                    ++count;
                }
        EXPECT_GT(count, 50000u);
        EXPECT_GT(sum / static_cast<double>(count), 0.97) << "worst " << worst;
        for (const DepthMap& m : r.maps)
            for (size_t n = 0; n < m.depth.data.size(); ++n) {
                ASSERT_EQ(m.depth.data[n] > 0, m.confidence.data[n] > 0);
                ASSERT_LE(m.confidence.data[n], 1);
            }
    }
}

TEST(Stereo, WithoutTextureTheHullStands) {
    const DentedScene scene(0);
    Progress quiet;
    const StereoResult r = stereo(*scene.hull, scene.inputs, {}, {}, quiet);
    expect_same(*r.surface, *scene.hull);
    EXPECT_EQ(r.confidence->activeVoxelCount(), 0u);
    for (const StereoViewStatistics& v : r.views) EXPECT_EQ(v.trusted_pixels, 0u);
}

TEST(Stereo, SameBitsForAnyNumberOfThreads) {
    const DentedScene scene(0.9, 16, 120, 40);
    Progress quiet;
    StereoOptions o;
    o.scale = 1;
    const StereoResult a = stereo(*scene.hull, scene.inputs, {}, o, quiet);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    const StereoResult b = stereo(*scene.hull, scene.inputs, {}, o, quiet);
    expect_same(*a.surface, *b.surface);
    expect_same(*a.confidence, *b.confidence);
    EXPECT_LT(a.volume, 0.97 * a.volume_before);
    for (size_t v = 0; v < a.maps.size(); ++v) {
        EXPECT_EQ(a.maps[v].depth.data, b.maps[v].depth.data);
        EXPECT_EQ(a.maps[v].confidence.data, b.maps[v].confidence.data);
    }
}

TEST(Stereo, SaysWhatItDoesNotTake) {
    const DentedScene scene(0.9, 8, 80, 24);
    Progress quiet;
    const auto refused = [&](auto change) {
        StereoOptions o;
        change(o);
        EXPECT_THROW(stereo(*scene.hull, scene.inputs, {}, o, quiet), UsageError);
    };
    refused([](StereoOptions& o) { o.pairs = 1; });
    refused([](StereoOptions& o) { o.pairs = 9; });
    refused([](StereoOptions& o) { o.scale = -1; });
    refused([](StereoOptions& o) { o.levels = 0; });
    refused([](StereoOptions& o) { o.depth_share = 0; });
    refused([](StereoOptions& o) { o.least_angle_deg = 50; });
    refused([](StereoOptions& o) { o.truncation_vox = std::numeric_limits<double>::quiet_NaN(); });
    refused([](StereoOptions& o) { o.trust.agreeing = 7; });
    refused([](StereoOptions& o) { o.least_weight = 0; });
    StereoOptions too_small;
    too_small.scale = 4;  // 20 x 15 pixels
    try {
        stereo(*scene.hull, scene.inputs, {}, too_small, quiet);
        ADD_FAILURE();
    } catch (const InputError& e) {
        EXPECT_NE(std::string(e.what()).find("20 x 15"), std::string::npos) << e.what();
        EXPECT_NE(std::string(e.what()).find("--stereo-scale"), std::string::npos) << e.what();
    }
    std::vector<ColorInput> inputs = scene.inputs;
    const Image8 small(10, 10, 3);
    inputs[2].photo.pixels8 = small.view();
    EXPECT_THROW(stereo(*scene.hull, inputs, {}, {}, quiet), InputError);
    // Views too far from each other give no depth, and take none away.
    inputs = scene.inputs;
    StereoOptions near;
    near.least_angle_deg = 1;
    near.most_angle_deg = 2;
    const StereoResult r = stereo(*scene.hull, inputs, {}, near, quiet);
    expect_same(*r.surface, *scene.hull);
    for (const StereoViewStatistics& v : r.views) EXPECT_EQ(v.pairs, 0u);
    // Nor do two alone.
    for (size_t v = 0; v < inputs.size(); ++v) inputs[v].use = v == 0 || v == 2;
    expect_same(*stereo(*scene.hull, inputs, {}, {}, quiet).surface, *scene.hull);
}

// Coarser depths go where any finer one is, be it of the next level or of one beyond: else one photograph would be two voices.
TEST(Stereo, APhotographIsHeardOnce) {
    std::mt19937 random(11);
    std::vector<StereoLevel> levels;
    const int width = 53, height = 38;  // odd at every size
    for (int l = 0; l < 4; ++l) {
        levels.push_back({1 << l, {}, {}});
        for (int v = 0; v < 3; ++v) {
            StereoSource s;
            s.width = width >> l;
            s.height = height >> l;
            StereoDepthMap m;
            if (v < 2) m.confidence.resize(static_cast<size_t>(s.width) * static_cast<size_t>(s.height));
            for (float& c : m.confidence) c = random() % 7 == 0 ? 0.5f : 0.f;
            levels.back().sources.push_back(s);
            levels.back().maps.push_back(m);
        }
    }
    const std::vector<StereoLevel> before = levels;
    leave_to_finer(levels);
    const auto at = [](const StereoLevel& level, size_t v, int x, int y) {
        return level.maps[v].confidence[static_cast<size_t>(y) * static_cast<size_t>(level.sources[v].width) + static_cast<size_t>(x)];
    };
    for (size_t l = 0; l < levels.size(); ++l)
        for (size_t v = 0; v < 2; ++v)
            for (int y = 0; y < levels[l].sources[v].height; ++y)
                for (int x = 0; x < levels[l].sources[v].width; ++x) {
                    bool finer = false;
                    for (size_t f = 0; f < l; ++f)
                        for (int j = y << (l - f); j < (y + 1) << (l - f); ++j)
                            for (int i = x << (l - f); i < (x + 1) << (l - f); ++i) finer = finer || at(before[f], v, i, j) > 0;
                    ASSERT_EQ(at(levels[l], v, x, y), finer ? 0.f : at(before[l], v, x, y)) << "level " << l << " view " << v << " pixel " << x << ", " << y;
                }
    EXPECT_TRUE(levels[2].maps[2].confidence.empty());
}

// A depth of another view agrees where it is the same place, whatever kinds the cameras are and however unlike their distances.
TEST(Stereo, ViewsAgreeAboutTheSamePlace) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> u(-1, 1);
    size_t tried = 0;
    for (int n = 0; n < 200; ++n) {
        Camera a = random_cameras(random, n % 2)[0], b = random_cameras(random, n % 4 > 1)[0];
        const double away = n % 3 ? 1.0 : 2.5;  // so many times as far
        b.camera_from_world.translation.z() *= away;
        if (!b.intrinsics.orthographic) b.intrinsics.fx *= away, b.intrinsics.fy *= away;
        const Vec2d pixel(160.5, 120.5);
        const Camera::Ray ray = a.ray(pixel);
        const Vec3d place = ray.origin + (-(a.camera_from_world.rotation.row(2).dot(ray.origin) + a.camera_from_world.translation.z()) + 5) /
                                             a.camera_from_world.rotation.row(2).dot(ray.direction) * ray.direction;
        const Vec3d normal = (-ray.direction + 0.2 * Vec3d(u(random), u(random), u(random))).normalized();
        const auto seen = b.project(place);
        if (!seen || seen->x() < 1 || seen->y() < 1 || seen->x() > 318 || seen->y() > 238) continue;
        const auto plane_in = [&](const Camera& c, const Vec3d& at, const Vec2d& px) {
            const Vec3d m = c.camera_from_world.rotation * normal;
            const double z = (c.camera_from_world * at).z();
            return kernel::plane_of_normal(lens_of(c), {static_cast<float>(m.x()), static_cast<float>(m.y()), static_cast<float>(m.z())},
                                           static_cast<float>(c.intrinsics.orthographic ? z : 1 / z), static_cast<float>(px.x()), static_cast<float>(px.y()));
        };
        const auto agree = [&](double shift) {  // the other finds the surface so much deeper along its line of sight
            const Vec2d middle(std::floor(seen->x()) + 0.5, std::floor(seen->y()) + 0.5);
            const Vec3d on = place + shift * b.ray(*seen).direction;
            const Camera::Ray other_ray = b.ray(middle);
            const Vec3d at = other_ray.origin + normal.dot(on - other_ray.origin) / normal.dot(other_ray.direction) * other_ray.direction;
            const kernel::StereoBest best{plane_in(b, at, middle), 0.1f};
            std::vector<kernel::StereoBest> planes(320 * 240, best);
            std::vector<float> likely(320 * 240, 1.f);
            const kernel::StereoDepths depths{planes.data(), likely.data(), lens_of(b), 320, 240};
            kernel::StereoReference reference{};
            reference.lens = lens_of(a);
            const Vec3d m = a.camera_from_world.rotation * normal;
            const kernel::StereoTrustRule rule{0.5f, 0.f, 0.f, 1, 1.f, 0.7f};
            return kernel::agrees(reference, stereo_pair(a, b, 1), depths, plane_in(a, place, pixel),
                                  {static_cast<float>(m.x()), static_cast<float>(m.y()), static_cast<float>(m.z())}, rule, static_cast<float>(pixel.x()),
                                  static_cast<float>(pixel.y()));
        };
        // How far along the reference's line of sight the other picture shows as one pixel, by its projection.
        const double step = 1e-3;
        const auto nearer = b.project(place + step * ray.direction);
        if (!nearer) continue;
        const double px_per_length = (*nearer - *seen).norm() / step;
        if (px_per_length < 4) continue;  // hardly any parallax: all depths agree
        ++tried;
        EXPECT_TRUE(agree(0));
        EXPECT_TRUE(agree(0.6 / px_per_length)) << n;
        EXPECT_FALSE(agree(1.6 / px_per_length)) << n;
        EXPECT_FALSE(agree(-1.6 / px_per_length)) << n;
    }
    EXPECT_GT(tried, 60u);
}

// Loose pieces and enclosed holes that carving made go; those of before stay.
TEST(Stereo, FragmentsAreDroppedAndVoidsFilled) {
    openvdb::initialize();
    const auto ball = [](openvdb::FloatGrid& grid, const Vec3d& centre, double radius, bool add) {
        auto access = grid.getAccessor();
        for (int i = -40; i <= 40; ++i)
            for (int j = -40; j <= 40; ++j)
                for (int k = -40; k <= 40; ++k) {
                    const double d = (Vec3d(i, j, k) - centre).norm() - radius;
                    const float was = access.getValue({i, j, k}),
                                now = static_cast<float>(std::clamp(add ? std::min<double>(was, d) : std::max<double>(was, -d), -3.0, 3.0));
                    if (now != was) access.setValue({i, j, k}, now);
                }
    };
    openvdb::FloatGrid::Ptr hull = openvdb::FloatGrid::create(3.f);
    hull->setGridClass(openvdb::GRID_LEVEL_SET);
    ball(*hull, {0, 0, 0}, 20.3, true);
    ball(*hull, {33, 0, 0}, 3.2, true);   // apart in the hull, too
    ball(*hull, {0, 0, -9}, 3.7, false);  // a hole that it has
    openvdb::FloatGrid::Ptr carved = hull->deepCopy();
    ball(*carved, {0, 0, 17}, 7.4, false);  // a dent
    ball(*carved, {0, 0, 16}, 2.2, true);   // with something floating in it
    ball(*carved, {0, 6, -2}, 3.4, false);  // and a hole that nobody can have seen
    const size_t before = Pieces(*carved, true).at({0, 0, 16}) >= 0;
    EXPECT_EQ(before, 1u);
    const Fragments f = remove_fragments(*carved, *hull, 0.01);
    EXPECT_EQ(f.fragments, 1u);
    EXPECT_EQ(f.voids, 1u);
    auto value = carved->getConstAccessor();
    EXPECT_GT(value.getValue({0, 0, 16}), 0);  // gone
    EXPECT_LT(value.getValue({0, 6, -2}), 0);  // filled
    EXPECT_LT(value.getValue({33, 0, 0}), 0);  // stays
    EXPECT_GT(value.getValue({0, 0, -9}), 0);  // stays
    EXPECT_EQ(component_volumes(*carved).size(), 2u);
}

// The inside of large objects is tiles: one of 128 voxels with smaller ones beside it on all sides is one piece.
TEST(Stereo, FragmentsOfTilesAreDropped) {
    openvdb::initialize();
    openvdb::FloatGrid::Ptr hull = openvdb::FloatGrid::create(3.f), carved = openvdb::FloatGrid::create(3.f);
    hull->sparseFill(openvdb::CoordBBox(openvdb::Coord(-8), openvdb::Coord(215)), -3.f, false);
    carved->sparseFill(openvdb::CoordBBox({0, 0, 0}, {143, 135, 135}), -3.f, false);
    for (const openvdb::Coord first : {openvdb::Coord(-8, 0, 0), openvdb::Coord(64, -8, 120), openvdb::Coord(24, 40, -8), openvdb::Coord(200, 200, 200)})
        carved->tree().addTile(1, first, -3.f, false);
    EXPECT_EQ(carved->tree().leafCount(), 0u);
    EXPECT_EQ(component_volumes(*carved), (std::vector<double>{144 * 136 * 136 + 3 * 512, 512}));
    const Fragments f = remove_fragments(*carved, *hull, 0.01);
    EXPECT_EQ(f.fragments, 1u);
    EXPECT_EQ(f.dropped_voxels, 512u);
    EXPECT_EQ(f.voids, 0u);
    EXPECT_EQ(carved->tree().getValue({203, 203, 203}), 3.f);
    EXPECT_EQ(carved->tree().getValue({-4, 4, 4}), -3.f);
    EXPECT_EQ(component_volumes(*carved), (std::vector<double>{144 * 136 * 136 + 3 * 512}));
}

}  // namespace
}  // namespace vdbcarve::test
