// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/smooth.h"

#include <openvdb/tools/LevelSetSphere.h>
#include <tbb/global_control.h>

#include <set>

#include "support/scenes.h"
#include "mesh/triangle_tree.h"
#include "vdbcarve/decimate.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

/// The binary model of a sphere or of a ring, meshed: steps of a voxel everywhere.
Mesh blocky(double radius, double hole) {
    openvdb::initialize();
    const openvdb::MaskGrid::Ptr mask = openvdb::MaskGrid::create(false);
    auto access = mask->getAccessor();
    const int reach = static_cast<int>(radius + hole) + 3;
    for (int i = -reach; i <= reach; ++i)
        for (int j = -reach; j <= reach; ++j)
            for (int k = -reach; k <= reach; ++k)
                if (std::hypot(hole > 0 ? std::hypot(i - 0.31, j - 0.17) - hole : std::hypot(i - 0.31, j - 0.17), k + 0.23) < radius)
                    access.setValueOn({i, j, k});
    Progress quiet;
    return extract_mesh(*level_set_of_occupancy(*mask, {}, quiet), {}, quiet);
}

double normals_rms_deg(const Mesh& mesh) {
    double sum = 0, area = 0;
    for (const auto& t : mesh.triangles) {
        const auto at = [&](size_t c) { return Vec3d(mesh.vertices[t[c]][0], mesh.vertices[t[c]][1], mesh.vertices[t[c]][2]); };
        const Vec3d n = (at(1) - at(0)).cross(at(2) - at(0)), out = (at(0) + at(1) + at(2)) / 3 - Vec3d(0.31, 0.17, -0.23);
        const double angle = std::acos(std::clamp(n.normalized().dot(out.normalized()), -1.0, 1.0)) * 180 / 3.14159265358979;
        sum += n.norm() * angle * angle;
        area += n.norm();
    }
    return std::sqrt(sum / area);
}

TEST(Smooth, TakesTheStepsAndKeepsVolumeGenusAndColours) {
    for (const double hole : {0.0, 50.0}) {
        const double radius = hole > 0 ? 18 : 35;
        Mesh mesh = blocky(radius, hole);
        mesh.colors.resize(mesh.vertices.size());
        for (size_t v = 0; v < mesh.colors.size(); ++v) mesh.colors[v] = {static_cast<float>(v % 7) / 7, static_cast<float>(v % 5) / 5, 0.5f};
        const Mesh before = mesh;
        Progress quiet;
        smooth(mesh, {}, quiet);
        const MeshMeasures a = measure(before), b = measure(mesh);
        EXPECT_NEAR(b.volume / a.volume, 1, 1e-3);
        EXPECT_EQ(b.genus, a.genus);
        EXPECT_TRUE(b.manifold);
        EXPECT_EQ(b.zero_area_faces, 0u);
        EXPECT_EQ(mesh.triangles, before.triangles);
        EXPECT_EQ(mesh.colors, before.colors);
        EXPECT_TRUE(hole > 0 || normals_rms_deg(mesh) < 0.5 * normals_rms_deg(before));
    }
}

// The transfer function: one iteration multiplies a spatial frequency k by (1 - lambda k)(1 - mu k), so that kPB passes unchanged.
TEST(Smooth, PassesItsBandAndStopsTheRest) {
    EXPECT_NEAR(mu_for(0.6307, 0.1), -0.6732, 1e-4);
    EXPECT_NEAR(1 / 0.33 + 1 / mu_for(0.33, 0.029), 0.029, 1e-9);
    // A closed tube whose rings all have the same neighbours is a circle along its length; the eigenvectors of the umbrella operator on a torus grid are waves.
    const int n = 48, m = 12;
    Mesh mesh;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) {
            const double u = 2 * 3.14159265358979 * i / n, v = 2 * 3.14159265358979 * j / m;
            mesh.vertices.push_back({static_cast<float>((10 + 2 * std::cos(v)) * std::cos(u)), static_cast<float>((10 + 2 * std::cos(v)) * std::sin(u)),
                                     static_cast<float>(2 * std::sin(v))});
        }
    const auto at = [&](int i, int j) { return static_cast<uint32_t>((i + n) % n * m + (j + m) % m); };
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) {
            mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
            mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
        }
    // z is made a wave of its own, of p turns along and q around: an eigenvector with k = 1 - mean of cos over the six neighbours.
    for (const auto& [p, q] : {std::pair(2, 1), std::pair(24, 6), std::pair(5, 0)}) {
        Mesh wave = mesh;
        const auto phase = [&](int i, int j) { return 2 * 3.14159265358979 * (static_cast<double>(p) * i / n + static_cast<double>(q) * j / m); };
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < m; ++j) wave.vertices[at(i, j)][2] = static_cast<float>(std::cos(phase(i, j)));
        const double a = 2 * 3.14159265358979 * p / n, b = 2 * 3.14159265358979 * q / m, k = 1 - (std::cos(a) + std::cos(b) + std::cos(a + b)) / 3;
        SmoothOptions o;
        o.iterations = 3;
        const double factor = std::pow((1 - o.lambda * k) * (1 - o.mu * k), o.iterations);
        Progress quiet;
        smooth(wave, o, quiet);
        for (int i = 0; i < n; i += 5)
            for (int j = 0; j < m; ++j) ASSERT_NEAR(wave.vertices[at(i, j)][2], factor * std::cos(phase(i, j)), 2e-5) << p << " " << q;
    }
}

TEST(Smooth, SameBitsForAnyNumberOfThreads) {
    Mesh many = blocky(20, 0), single = many;
    Progress quiet;
    smooth(many, {}, quiet);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    smooth(single, {}, quiet);
    EXPECT_EQ(many.vertices, single.vertices);
}

TEST(Smooth, WhatShrinksOrIsNoManifoldIsRefused) {
    Mesh mesh = blocky(8, 0);
    Progress quiet;
    error_of(ExitCode::Usage, [&] { smooth(mesh, {10, 0.5, 0.5}, quiet); });
    error_of(ExitCode::Usage, [&] { smooth(mesh, {10, 0.5, -0.4}, quiet); });
    error_of(ExitCode::Usage, [&] { smooth(mesh, {-1, 0.5, -0.6}, quiet); });
    error_of(ExitCode::Usage, [&] { mu_for(0.5, 3); });
    mesh.triangles.push_back(mesh.triangles.front());
    EXPECT_NE(error_of(ExitCode::Input, [&] { smooth(mesh, {}, quiet); }).find("no 2-manifold at face"), std::string::npos);
}

TEST(Decimate, FewerFacesSameShape) {
    for (const double hole : {0.0, 40.0}) {
        Mesh mesh = blocky(hole > 0 ? 12 : 25, hole);
        Progress quiet;
        smooth(mesh, {}, quiet);
        mesh.colors.resize(mesh.vertices.size());
        for (size_t v = 0; v < mesh.colors.size(); ++v) mesh.colors[v] = {mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]};
        const Mesh before = mesh;
        const size_t wanted = before.triangles.size() / 10;
        EXPECT_LE(decimate(mesh, {wanted, 0}, quiet), wanted);
        EXPECT_GE(mesh.triangles.size(), wanted - 2);
        const MeshMeasures a = measure(before), b = measure(mesh);
        EXPECT_TRUE(b.manifold);
        EXPECT_EQ(b.genus, a.genus);
        EXPECT_EQ(b.zero_area_faces, 0u);
        EXPECT_NEAR(b.volume / a.volume, 1, 0.01);
        EXPECT_EQ(mesh.colors, mesh.vertices);  // what is left kept its colour
        Mesh again = before;
        decimate(again, {wanted, 0}, quiet);
        EXPECT_EQ(again.vertices, mesh.vertices);
        EXPECT_EQ(again.triangles, mesh.triangles);
    }
}

// For a picture: at most so many faces, none far from the shape, colours carried, thin parts still there.
TEST(Decimate, SimplifiedForDisplay) {
    Mesh ball = blocky(30, 0);
    for (const auto& v : ball.vertices) ball.colors.push_back({v[0] > 0 ? 1.f : 0.f, 0.25f, 0.5f});
    ball.normals = vertex_normals(ball);
    for (const size_t most : {20000, 5000, 800}) {
        const Mesh few = simplified_for_display(ball, most);
        EXPECT_LE(few.triangles.size(), most);
        EXPECT_GE(few.triangles.size(), most / 4) << most;
        ASSERT_EQ(few.colors.size(), few.vertices.size());
        for (size_t i = 0; i < few.vertices.size(); ++i) {
            const auto& v = few.vertices[i];
            EXPECT_NEAR(std::hypot(v[0] - 0.31, v[1] - 0.17, v[2] + 0.23), 30, 2.5);
            EXPECT_FLOAT_EQ(few.colors[i][1], 0.25f);
            if (v[0] > 6) {
                EXPECT_FLOAT_EQ(few.colors[i][0], 1.f);
            }
        }
        const double volume = measure(few).volume;
        EXPECT_NEAR(volume, measure(ball).volume, 0.05 * measure(ball).volume);
    }
    // A plate thinner than any cell stays in sight.
    Mesh plate;
    for (int i = 0; i <= 100; ++i)
        for (int j = 0; j <= 100; ++j)
            for (int side = 0; side < 2; ++side)
                plate.vertices.push_back({0.1f * static_cast<float>(i), 0.1f * static_cast<float>(j), 0.001f * static_cast<float>(side)});
    const auto at = [](int i, int j, int side) { return static_cast<uint32_t>((i * 101 + j) * 2 + side); };
    for (int i = 0; i < 100; ++i)
        for (int j = 0; j < 100; ++j)
            for (int side = 0; side < 2; ++side) {
                plate.triangles.push_back({at(i, j, side), at(i + 1, j, side), at(i + 1, j + 1, side)});
                plate.triangles.push_back({at(i, j, side), at(i + 1, j + 1, side), at(i, j + 1, side)});
            }
    const Mesh sheet = simplified_for_display(plate, 2000);
    EXPECT_LE(sheet.triangles.size(), 2000u);
    EXPECT_NEAR(measure(sheet).area, 100, 15);  // one side of it
    // Few faces, or none, stay as they are.
    EXPECT_EQ(simplified_for_display(plate, 1000000).triangles.size(), plate.triangles.size());
    EXPECT_TRUE(simplified_for_display({}, 100).vertices.empty());
}

TEST(Decimate, StaysWithinTheError) {
    Mesh mesh = blocky(25, 0);
    Progress quiet;
    smooth(mesh, {}, quiet);
    const Mesh before = mesh;
    decimate(mesh, {0, 0.2}, quiet);
    EXPECT_LT(mesh.triangles.size(), before.triangles.size() / 4);
    EXPECT_TRUE(measure(mesh).manifold);
    const TriangleTree tree(mesh);
    double worst = 0;
    for (const auto& v : before.vertices) worst = std::max(worst, tree.nearest(Vec3d(v[0], v[1], v[2])).distance);
    EXPECT_LE(worst, 0.2 * 1.001);
    error_of(ExitCode::Usage, [&] { decimate(mesh, {}, quiet); });
    error_of(ExitCode::Usage, [&] { decimate(mesh, {2, 0}, quiet); });
    const size_t all = mesh.triangles.size();
    EXPECT_EQ(decimate(mesh, {all + 10, 0}, quiet), all);
}

}  // namespace
}  // namespace vdbcarve::test
