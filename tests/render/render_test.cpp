// SPDX-License-Identifier: Apache-2.0
// Pictures against what a ray tracer for spheres and boxes gives, and against each other.
#include "vdbcarve/render.h"

#include <openvdb/tools/LevelSetSphere.h>

#include <cmath>

#include "render/render_plan.h"
#include "support/scenes.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/app/pictures.h"

namespace vdbcarve::test {
namespace {

constexpr double kRadius = 0.7;
const Vec3d kCentre(0.3, -0.2, 0.5);

/// A ball on a lattice far from the origin's own voxel, with tiles inside.
openvdb::FloatGrid::Ptr ball(double voxel = 0.01, const Vec3d& centre = kCentre, double radius = kRadius) {
    openvdb::initialize();
    return openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
        static_cast<float>(radius), openvdb::Vec3f(static_cast<float>(centre.x()), static_cast<float>(centre.y()), static_cast<float>(centre.z())),
        static_cast<float>(voxel), 3.f);
}

Camera camera_at(const Vec3d& towards, int width, int height, double fov_deg = 35) {
    OrbitView v;
    v.azimuth_deg = std::atan2(towards.y(), towards.x()) * 180 / std::numbers::pi;
    v.elevation_deg = std::asin(towards.normalized().z()) * 180 / std::numbers::pi;
    v.fov_deg = fov_deg;
    v.width_px = width;
    v.height_px = height;
    Box3d box(kCentre - Vec3d::Constant(kRadius), kCentre + Vec3d::Constant(kRadius));
    Camera c = orbit_camera(box, Vec3d::UnitZ(), v);
    c.intrinsics.skew = fov_deg > 0 ? 3 : 0;  // nothing may be taken for zero
    c.intrinsics.cx += 4.3;
    return c;
}

/// Where a ray passes a ball: distance of its line from the centre, and how long it is inside.
struct Passage {
    double off, inside;
};
Passage passage(const Camera& camera, double x, double y) {
    const Camera::Ray ray = camera.ray(Vec2d(x, y));
    const Vec3d to = kCentre - ray.origin;
    const double off = to.cross(ray.direction).norm();
    return {off, off < kRadius ? 2 * std::sqrt(kRadius * kRadius - off * off) : 0.0};
}

RenderOptions plain(RenderStyle style) {
    RenderOptions o;
    o.style = style;
    o.samples = 1;
    o.background.reset();
    return o;
}

TEST(Render, ABallIsWhereItIs) {
    RenderVolume volume(*ball(), nullptr);
    for (const double fov : {35.0, 0.0})
        for (const Vec3d& towards : {Vec3d(1, 0, 0), Vec3d(-1, 2, 1), Vec3d(0, 0.001, -1)}) {
            const Camera camera = camera_at(towards, 201, 160, fov);
            const Image8 p = render(volume, camera, plain(RenderStyle::Surface));
            size_t hits = 0;
            for (int y = 0; y < p.height; ++y)
                for (int x = 0; x < p.width; ++x) {
                    const double off = passage(camera, x + 0.5, y + 0.5).off;
                    if (std::fabs(off - kRadius) < 2e-4) continue;  // a fiftieth of a voxel: the lattice's own error
                    hits += p.at(x, y, 3) == 255;
                    ASSERT_EQ(p.at(x, y, 3), off < kRadius ? 255 : 0) << x << " " << y << " off by " << off - kRadius;
                }
            EXPECT_GT(hits, 5000u);
        }
}

// The lit colour depends on the normal alone, which a ball knows.
TEST(Render, LightIsThatOfTheBallsNormals) {
    RenderVolume volume(*ball(), nullptr);
    const Camera camera = camera_at(Vec3d(1, 1, 0.4), 160, 160);
    RenderOptions o = plain(RenderStyle::Surface);
    o.ambient_rays = 0;
    const Image8 p = render(volume, camera, o);
    const kernel::Lights lights = lights_of(camera, Vec3d::Zero());
    int worst = 0;
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x) {
            const Passage through = passage(camera, x + 0.5, y + 0.5);
            if (through.off > 0.97 * kRadius) continue;
            const Camera::Ray ray = camera.ray(Vec2d(x + 0.5, y + 0.5));
            const Vec3d hit = ray.origin + ((kCentre - ray.origin).dot(ray.direction) - 0.5 * through.inside) * ray.direction, n = (hit - kCentre).normalized();
            const auto f = [](const Vec3d& v) { return kernel::Vec3{static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())}; };
            const float c = static_cast<float>(o.plain[0]);
            const kernel::Rgb expected = kernel::lit({c, c, c}, f(n), f(-ray.direction), lights, 1.f);
            worst = std::max(worst, std::abs(p.at(x, y, 0) - srgb8_from_linear(expected.r)));
        }
    EXPECT_LE(worst, 2);
}

TEST(Render, AnXRayIsAsDarkAsTheBallIsThick) {
    RenderVolume volume(*ball(), nullptr);
    const Camera camera = camera_at(Vec3d(1, -1, 0.2), 120, 120);
    const Image8 p = render(volume, camera, plain(RenderStyle::XRay));
    const double half = 0.12 * 2 * (kRadius + 0.03);  // thickness that lets half through; leaves reach a little beyond the ball
    for (int y = 0; y < p.height; y += 3)
        for (int x = 0; x < p.width; x += 3) {
            const Passage through = passage(camera, x + 0.5, y + 0.5);
            if (std::fabs(through.off - kRadius) < 0.03) continue;
            const double t = (std::sqrt(2.0) - 1) * through.inside / half, let = 1 / ((1 + t) * (1 + t));
            EXPECT_NEAR(p.at(x, y, 3) / 255.0, 1 - let, 0.03) << x << " " << y;
        }
}

// Every voxel inside is a cube: the picture is that of the cubes, found by walking the grid in small steps.
TEST(Render, VoxelsAreCubes) {
    const auto grid = ball(0.1);
    RenderVolume volume(*grid, nullptr);
    const Camera camera = camera_at(Vec3d(2, 1, 1), 90, 90);
    const Image8 p = render(volume, camera, plain(RenderStyle::Voxels));
    size_t different = 0;
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x) {
            const Camera::Ray ray = camera.ray(Vec2d(x + 0.5, y + 0.5));
            const double middle = (kCentre - ray.origin).dot(ray.direction);
            bool hit = false;
            for (double t = middle - 1; t < middle + 1 && !hit; t += 0.0005) {
                const Vec3d w = ray.origin + t * ray.direction;
                hit = grid->tree().getValue(openvdb::Coord::round(grid->worldToIndex(openvdb::Vec3d(w.x(), w.y(), w.z())))) < 0;
            }
            different += hit != (p.at(x, y, 3) == 255);
        }
    EXPECT_LE(different, 3u);  // where a ray grazes an edge by less than the step
}

TEST(Render, ASliceIsACircle) {
    RenderVolume volume(*ball(), nullptr);
    RenderOptions o = plain(RenderStyle::Slice);
    const double height = kCentre.z() + 0.4;
    o.slice = {Vec3d(0, 0, 2), 2 * height};  // a normal of any length
    const Camera camera = slice_camera(volume.bounds_world(), Vec3d::UnitZ(), Vec3d::UnitZ(), 200);
    const Image8 p = render(volume, camera, o);
    const double radius = std::sqrt(kRadius * kRadius - 0.16);
    for (int y = 0; y < p.height; y += 2)
        for (int x = 0; x < p.width; x += 2) {
            const Vec3d at = camera.ray(Vec2d(x + 0.5, y + 0.5)).origin;
            const double off = std::hypot(at.x() - kCentre.x(), at.y() - kCentre.y()) - radius;
            if (std::fabs(off) < 0.012) continue;  // the contour's line
            EXPECT_EQ(p.at(x, y, 3), off < 0 ? 255 : 0) << x << " " << y;
        }
}

TEST(Render, IsoMovesTheSurface) {
    const auto grid = ball();
    RenderVolume volume(*grid, nullptr);
    const Camera camera = camera_at(Vec3d(1, 0, 0), 300, 300);
    const auto covered = [&](double iso) {
        RenderOptions o = plain(RenderStyle::Surface);
        o.iso = iso;
        const Image8 p = render(volume, camera, o);
        size_t n = 0;
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x) n += p.at(x, y, 3) == 255;
        return static_cast<double>(n);
    };
    // A silhouette's area goes as tan^2 of the angle that the radius is seen under.
    const double distance = (camera.centre_world() - kCentre).norm();
    const auto area = [&](double r) { return r * r / (distance * distance - r * r); };
    EXPECT_NEAR(covered(-0.02) / covered(0), area(kRadius - 0.02) / area(kRadius), 0.003);
}

TEST(Render, ColoursAreTheGrids) {
    const auto grid = ball(0.02);
    auto color = openvdb::Vec3SGrid::create();
    color->setTransform(grid->transform().copy());
    for (auto v = grid->cbeginValueOn(); v; ++v) color->tree().setValueOn(v.getCoord(), openvdb::Vec3s(0.8f, 0.2f, 0.1f));
    RenderVolume volume(*grid, color.get()), without(*grid, nullptr);
    const Camera camera = camera_at(Vec3d(1, 0, 0), 64, 64);
    RenderOptions o = plain(RenderStyle::Surface);
    const Image8 colored = render(volume, camera, o);
    RenderOptions clay = o;
    clay.plain = {0.8, 0.2, 0.1};
    EXPECT_EQ(colored.data, render(without, camera, clay).data);
    o.color = false;
    EXPECT_EQ(render(volume, camera, o).data, render(without, camera, o).data);
}

// Under a lid it is darker than in the open.
TEST(Render, AmbientOcclusionDarkensWhatIsHidden) {
    auto floor = ball(0.01, Vec3d(0, 0, -1.2), 1.0);
    const auto lid = ball(0.01, Vec3d(0, 0, 0.2), 0.25);
    for (auto v = lid->cbeginValueAll(); v; ++v)
        if (v.isVoxelValue()) floor->tree().setValueOn(v.getCoord(), std::min(*v, floor->tree().getValue(v.getCoord())));
    RenderVolume volume(*floor, nullptr);
    Camera camera = camera_at(Vec3d(1, 0, 0.25), 200, 200);
    const auto light_at = [&](const Vec3d& world, int rays) {
        RenderOptions o = plain(RenderStyle::Surface);
        o.ambient_rays = rays;
        o.ambient_reach = 0.4;
        o.samples = 4;
        const Vec2d at = *camera.project(world);
        return static_cast<int>(render(volume, camera, o).at(static_cast<int>(at.x()), static_cast<int>(at.y()), 0));
    };
    camera.camera_from_world.translation = -(camera.camera_from_world.rotation * Vec3d(6, 0, 1.2));
    const Vec3d under(0.18, 0, -1.2 + std::sqrt(1 - 0.18 * 0.18)), open(0.75, 0, -1.2 + std::sqrt(1 - 0.75 * 0.75));
    EXPECT_LT(light_at(under, 32), light_at(under, 0) - 10);
    EXPECT_GT(light_at(open, 32), light_at(open, 0) - 5);
}

TEST(Render, AMeshLooksLikeItsVolume) {
    const auto grid = ball();
    Progress quiet;
    const Mesh mesh = extract_mesh(*grid, {}, quiet);
    RenderVolume volume(*grid, nullptr);
    const Camera camera = camera_at(Vec3d(1, 1, 1), 150, 150);
    RenderOptions o;
    o.ambient_rays = 0;
    const Image8 a = render(volume, camera, o), b = render(mesh, camera, o);
    size_t far = 0;
    for (size_t i = 0; i < a.data.size(); ++i) far += std::abs(a.data[i] - b.data[i]) > 6;
    EXPECT_LT(far, a.data.size() / 200);
}

TEST(Render, SameBytesEveryTime) {
    const auto grid = ball();
    RenderVolume volume(*grid, nullptr), again(*grid, nullptr);
    const Camera camera = camera_at(Vec3d(1, 1, 1), 120, 90);
    EXPECT_EQ(render(volume, camera, {}).data, render(again, camera, {}).data);
}

TEST(Render, OrbitCamerasSeeTheWholeBoxUpright) {
    const Box3d box(Vec3d(-3, 1, 2), Vec3d(2, 1.5, 9));
    for (const Vec3d& up : {Vec3d(0, 0, 1), Vec3d(0, 1, 0), Vec3d(-1, 0, 0)})
        for (const double azimuth : {0.0, 77.0, 200.0})
            for (const double elevation : {-90.0, -10.0, 0.0, 35.0, 90.0})
                for (const double fov : {0.0, 20.0, 90.0}) {
                    OrbitView v;
                    v.azimuth_deg = azimuth;
                    v.elevation_deg = elevation;
                    v.fov_deg = fov;
                    v.width_px = 300;
                    v.height_px = 200;
                    const Camera c = orbit_camera(box, up, v);
                    EXPECT_TRUE(is_rotation(c.camera_from_world.rotation, 1e-9));
                    double fullest = 0;
                    for (int n = 0; n < 8; ++n) {
                        const auto p = c.project(box.corner(static_cast<Box3d::CornerType>(n)));
                        ASSERT_TRUE(p);
                        fullest = std::max({fullest, std::fabs(p->x() - 150) / 150, std::fabs(p->y() - 100) / 100});
                    }
                    EXPECT_LT(fullest, 0.9401);
                    if (fov < 50) EXPECT_GT(fullest, 0.5);
                    if (std::fabs(elevation) < 80) {
                        EXPECT_LT(c.camera_from_world.rotation.row(1).dot(up), -0.1);
                    }
                }
}

TEST(Render, SaysWhatItDoesNotTake) {
    RenderVolume volume(*ball(0.05), nullptr);
    const Camera camera = camera_at(Vec3d(1, 0, 0), 20, 20);
    RenderOptions o;
    o.samples = 0;
    EXPECT_THROW(render(volume, camera, o), UsageError);
    o.samples = 1;
    o.ambient_rays = -1;
    EXPECT_THROW(render(volume, camera, o), UsageError);
    EXPECT_THROW(RenderVolume(*openvdb::FloatGrid::create(1), nullptr), UsageError);
    RenderOptions sections = plain(RenderStyle::Slice);
    EXPECT_THROW(render(Mesh(), camera, sections), UsageError);
}

}  // namespace
}  // namespace vdbcarve::test
