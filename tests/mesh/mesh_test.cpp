// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mesh.h"

#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/global_control.h>

#include <cmath>
#include <map>
#include <random>
#include <set>

#include "mesh/marching_cubes.h"
#include "support/noise_grid.h"
#include "support/scenes.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::test {
namespace {

MeshOptions marching() {
    MeshOptions o;
    o.mesher = Mesher::MarchingCubes;
    return o;
}

void expect_closed_manifold(const Mesh& mesh) {
    const MeshMeasures m = measure(mesh);
    EXPECT_EQ(m.boundary_edges, 0u);
    EXPECT_EQ(m.non_manifold_edges, 0u);
    EXPECT_EQ(m.non_manifold_vertices, 0u);
    EXPECT_EQ(m.zero_area_faces, 0u);
    EXPECT_TRUE(m.manifold);
}

// The table: every crossing edge of a cell in exactly one loop, and on each face the same lines whichever cell asks.
TEST(MarchingCubes, TableDrawsEveryCrossingEdgeAndNothingElse) {
    const auto& cases = marching_cases();
    size_t most = 0;
    for (unsigned mask = 0; mask < 256; ++mask) {
        const kernel::MarchingCase& c = cases[mask];
        most = std::max<size_t>(most, c.count);
        std::set<int> used, crossing;
        for (int n = 0; n < 3 * c.count; ++n) used.insert(c.edges[n]);
        for (int corner = 0; corner < 8; ++corner)
            for (int axis = 0; axis < 3; ++axis) {
                const int step = 4 >> axis;
                if (!(corner & step) && ((mask >> corner & 1) != (mask >> (corner | step) & 1))) crossing.insert(corner << 2 | axis);
            }
        EXPECT_EQ(used, crossing) << "case " << mask;
        // Directed edges of triangles: a boundary edge of the cell's sheet has no twin, an inner one has exactly one.
        std::map<std::pair<int, int>, int> directed;
        for (int t = 0; t < c.count; ++t)
            for (int v = 0; v < 3; ++v) ++directed[{c.edges[3 * t + v], c.edges[3 * t + (v + 1) % 3]}];
        for (const auto& [edge, count] : directed) EXPECT_EQ(count, 1) << "case " << mask;
    }
    EXPECT_EQ(most, 5u);
}

// All ways to fill two neighbouring cells, and many ways to fill 4^3 of them: closed, two faces an edge, one fan a vertex.
TEST(MarchingCubes, ClosedAndManifoldOnAnyPattern) {
    openvdb::initialize();
    std::mt19937 random(5);
    for (const int axis : {0, 1, 2})
        for (unsigned pattern = 1; pattern < 4096; ++pattern) {
            openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(1.f);
            grid->setGridClass(openvdb::GRID_LEVEL_SET);
            auto access = grid->getAccessor();
            // 3 x 2 x 2 corners across a border between leaves.
            for (int n = 0; n < 12; ++n) {
                int at[3];
                at[axis] = 6 + n / 4;
                at[(axis + 1) % 3] = 3 + n / 2 % 2;
                at[(axis + 2) % 3] = 3 + n % 2;
                access.setValue(openvdb::Coord(at[0], at[1], at[2]), pattern >> n & 1 ? -0.7f : 0.4f);
            }
            const MeshMeasures m = measure(marching_cubes(*grid, false));
            ASSERT_TRUE(m.manifold && m.zero_area_faces == 0 && m.volume > 0) << "axis " << axis << ", pattern " << pattern;
        }
    for (int n = 0; n < 3000; ++n) {
        openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(1.f);
        auto access = grid->getAccessor();
        for (int at = 0; at < 64; ++at)
            access.setValue(openvdb::Coord(5 + at / 16, 5 + at / 4 % 4, 5 + at % 4), static_cast<float>(random() % 2001) / 1000.f - 1.0005f);
        const MeshMeasures m = measure(marching_cubes(*grid, false));
        ASSERT_TRUE(m.manifold && m.zero_area_faces == 0) << n;
    }
}

TEST(MarchingCubes, ClosedAndManifoldOnNoise) {
    openvdb::initialize();
    for (const bool smooth : {false, true})
        for (const bool tiny : {false, true}) {
            SCOPED_TRACE((smooth ? "smooth" : "white") + std::string(tiny ? ", values around zero" : ""));
            expect_closed_manifold(marching_cubes(*noise_grid(44, smooth, tiny, 7), false));
        }
}

// Borders of the leaves that are inside where the tile beyond is outside: cells below the leaves belong to nobody.
TEST(MarchingCubes, ALeafAloneIsClosed) {
    openvdb::initialize();
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(1.f);
    grid->tree().touchLeaf(openvdb::Coord(8, 16, -8))->fill(-0.5f, true);
    const Mesh mesh = marching_cubes(*grid, true);
    expect_closed_manifold(mesh);
    EXPECT_NEAR(measure(mesh).volume, std::pow(7 + 2. / 3, 3), 6);  // a third of a voxel on every side, edges bevelled
    EXPECT_EQ(measure(mesh).genus, 0);
}

TEST(MarchingCubes, SphereIsWhereItIs) {
    openvdb::initialize();
    const double radius = 35, voxel = 0.5;
    const openvdb::Vec3f centre(0.37f, -12.2f, 5.61f);
    const auto sphere = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(static_cast<float>(radius * voxel), centre, static_cast<float>(voxel), 3.f);
    MeshOptions o = marching();
    o.normals = true;
    Progress quiet;
    const Mesh mesh = extract_mesh(*sphere, o, quiet);
    expect_closed_manifold(mesh);
    const MeshMeasures m = measure(mesh);
    EXPECT_EQ(m.genus, 0);
    EXPECT_NEAR(m.volume / (4.0 / 3.0 * 3.14159265358979 * std::pow(radius * voxel, 3)), 1.0, 2e-3);
    ASSERT_EQ(mesh.normals.size(), mesh.vertices.size());
    double worst = 0, worst_angle = 0;
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
        Vec3d r(mesh.vertices[v][0] - centre[0], mesh.vertices[v][1] - centre[1], mesh.vertices[v][2] - centre[2]);
        worst = std::max(worst, std::fabs(r.norm() - radius * voxel) / voxel);
        const Vec3d n(mesh.normals[v][0], mesh.normals[v][1], mesh.normals[v][2]);
        EXPECT_NEAR(n.norm(), 1.0, 1e-5);
        worst_angle = std::max(worst_angle, std::acos(std::min(1.0, n.dot(r.normalized()))));
    }
    EXPECT_LT(worst, 0.02);  // chords of the field between voxels, and 1/256 voxel off the corners
    EXPECT_LT(worst_angle, 1.0 * 3.14159 / 180);
}

TEST(MarchingCubes, SameMeshForAnyNumberOfThreads) {
    openvdb::initialize();
    const auto grid = noise_grid(60, true, false, 3);
    const Mesh many = marching_cubes(*grid, true);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    const Mesh single = marching_cubes(*grid, true);
    EXPECT_EQ(many.vertices, single.vertices);
    EXPECT_EQ(many.triangles, single.triangles);
    EXPECT_EQ(many.normals, single.normals);
}

// Both meshers of a carved hull: the same closed surface but for where vertices stand.
TEST(MarchingCubes, AgreesWithDualContouring) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("torus", 12));
    const CarveOptions o = options_for(s, 64);
    Progress quiet;
    const auto surface = level_set(carve(s.inputs, o, quiet).hull, {}, quiet);
    const MeshMeasures cubes = measure(extract_mesh(*surface, marching(), quiet)), dual = measure(extract_mesh(*surface, {}, quiet));
    EXPECT_TRUE(cubes.manifold);
    EXPECT_EQ(cubes.genus, dual.genus);
    EXPECT_EQ(cubes.components, dual.components);
    EXPECT_NEAR(cubes.volume / dual.volume, 1.0, 5e-3);
    EXPECT_NEAR(cubes.area / dual.area, 1.0, 2e-2);
}

/// Grids on which meshers go wrong: noise, bits, exact zeros, sheets thinner than a voxel, cubes that touch at edges and corners.
std::vector<std::pair<std::string, openvdb::FloatGrid::Ptr>> hard_grids() {
    openvdb::initialize();
    std::vector<std::pair<std::string, openvdb::FloatGrid::Ptr>> out;
    for (const bool smooth : {false, true})
        for (const bool tiny : {false, true})
            out.emplace_back(std::string(smooth ? "smooth noise" : "white noise") + (tiny ? " around zero" : ""), noise_grid(36, smooth, tiny, 7));
    std::mt19937 random(3);
    const auto fill = [&](const char* name, int side, const auto& value) {
        const openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(1.f);
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        auto access = grid->getAccessor();
        for (int i = 0; i < side; ++i)
            for (int j = 0; j < side; ++j)
                for (int k = 0; k < side; ++k) access.setValue({i - 5, j + 3, k - 11}, value(i, j, k));
        out.emplace_back(name, grid);
    };
    fill("bits", 36, [&](int, int, int) { return random() % 2 ? -1.f : 1.f; });
    fill("bits and zeros", 36, [&](int, int, int) { return static_cast<float>(random() % 3) - 1.f; });
    fill("ninths", 36, [&](int, int, int) { return (static_cast<float>(random() % 9) - 4.f) / 4; });
    fill("zeros beside the inside", 24, [&](int i, int j, int k) { return (i / 3 + j / 3 + k / 3) % 2 ? -1.f : 0.f; });
    fill("a thin sheet", 40, [&](int i, int j, int k) {
        return std::max(
            {std::fabs(static_cast<float>(i) - 20) - 15, std::fabs(static_cast<float>(j) - 20) - 15, std::fabs(static_cast<float>(k) - 20.3f) - 0.4f});
    });
    fill("a sheet on samples", 40, [&](int i, int j, int k) {
        return std::max({std::fabs(static_cast<float>(i) - 20) - 15, std::fabs(static_cast<float>(j) - 20) - 15, std::fabs(static_cast<float>(k) - 20) - 1});
    });
    fill("cubes that touch", 33, [&](int i, int j, int k) {
        return (i / 4 % 2 + j / 4 % 2 + k / 4 % 2) % 2 == 0 && i > 1 && j > 1 && k > 1 && i < 31 && j < 31 && k < 31 ? -1.f : 1.f;
    });
    return out;
}

TEST(Meshers, ClosedAndManifoldOnEverySetting) {
    Progress quiet;
    for (const auto& [name, grid] : hard_grids()) {
        SCOPED_TRACE(name);
        for (const double adaptivity : {0.0, 0.1, 0.5, 1.0})
            for (const bool quads : {false, true}) {
                MeshOptions o;
                o.adaptivity = adaptivity;
                o.quads = quads;
                SCOPED_TRACE("adaptivity " + std::to_string(adaptivity));
                const Mesh mesh = extract_mesh(*grid, o, quiet);
                expect_closed_manifold(mesh);
                EXPECT_GT(measure(mesh).volume, 0);
            }
        expect_closed_manifold(extract_mesh(*grid, marching(), quiet));
    }
}

// In slabs: the same vertices, the same faces.
TEST(Meshers, SlabsMakeTheSameMesh) {
    Progress quiet;
    const auto faces_of = [](const Mesh& mesh) {
        std::vector<std::array<std::array<float, 3>, 3>> out;
        for (const auto& t : mesh.triangles) {
            std::array<std::array<float, 3>, 3> f{mesh.vertices[t[0]], mesh.vertices[t[1]], mesh.vertices[t[2]]};
            std::rotate(f.begin(), std::min_element(f.begin(), f.end()), f.end());
            out.push_back(f);
        }
        std::sort(out.begin(), out.end());
        return out;
    };
    auto grids = hard_grids();
    const Shoot s = shoot(small_spec("torus", 12));
    grids.emplace_back("a hull", level_set(carve(s.inputs, options_for(s, 128), quiet).hull, {}, quiet));
    for (const auto& [name, grid] : grids) {
        const Mesh whole = extract_mesh(*grid, {}, quiet);
        for (const int pieces : {2, 3, 7}) {
            SCOPED_TRACE(name + " in " + std::to_string(pieces));
            MeshOptions o;
            o.pieces = pieces;
            const Mesh parts = extract_mesh(*grid, o, quiet);
            EXPECT_EQ(parts.vertices.size(), whole.vertices.size());
            EXPECT_TRUE(faces_of(parts) == faces_of(whole));
            expect_closed_manifold(parts);
        }
    }
}

TEST(Meshers, SmallPiecesAreLeftOut) {
    openvdb::initialize();
    Progress quiet;
    const openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(3.f);
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    auto access = grid->getAccessor();
    const std::pair<Vec3d, double> balls[] = {{{0, 0, 0}, 20}, {{40, 0, 0}, 8}, {{0, 40, 3}, 1.6}, {{0, -38, 0}, 1.6}};
    for (int i = -30; i < 60; ++i)
        for (int j = -50; j < 50; ++j)
            for (int k = -30; k < 30; ++k) {
                double d = 99;
                for (const auto& [c, r] : balls) d = std::min(d, (Vec3d(i, j, k) - c).norm() - r);
                d = std::max(d, 5.2 - (Vec3d(i, j, k) - Vec3d(3, 2, 1)).norm());  // a hollow
                if (std::fabs(d) < 3) access.setValue({i, j, k}, static_cast<float>(d));
            }
    openvdb::tools::signedFloodFill(grid->tree());
    MeshOptions o;
    o.quads = true;
    Mesh mesh = extract_mesh(*grid, o, quiet);
    const MeshMeasures all = measure(mesh);
    EXPECT_EQ(all.components, 5u);
    const Mesh before = mesh;
    const DroppedPieces none = drop_small_pieces(mesh, 0);
    EXPECT_EQ(none.pieces, 0u);
    EXPECT_EQ(mesh.vertices, before.vertices);
    const DroppedPieces two = drop_small_pieces(mesh, 1e-3);
    EXPECT_EQ(two.pieces, 2u);
    EXPECT_EQ(two.kept, 3u);
    EXPECT_NEAR(two.volume_share, 2 * std::pow(1.6, 3) / (8000 + 512 + 2 * std::pow(1.6, 3) + std::pow(5.2, 3)),
                5e-4);  // the small balls lose a third to the mesher
    const MeshMeasures left = measure(mesh);
    EXPECT_TRUE(left.manifold);
    EXPECT_EQ(left.components, 3u);
    EXPECT_EQ(2 * mesh.quads, mesh.triangles.size());
    EXPECT_NEAR(left.volume, all.volume - 2 * 4.18879 * std::pow(1.6, 3), 15);
    drop_small_pieces(mesh, 1);  // of all but the largest nothing stays
    EXPECT_EQ(measure(mesh).components, 1u);
}

TEST(MarchingCubes, OptionsThatDoNotFitAreNamed) {
    openvdb::initialize();
    const auto sphere = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(5.f, openvdb::Vec3f(0), 1.f, 3.f);
    Progress quiet;
    MeshOptions o = marching();
    o.adaptivity = 0.5;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { extract_mesh(*sphere, o, quiet); }).find("adaptivity"), std::string::npos);
    o = {};
    o.normals = true;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { extract_mesh(*sphere, o, quiet); }).find("normals"), std::string::npos);
    o = marching();
    o.quads = true;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { extract_mesh(*sphere, o, quiet); }).find("quads"), std::string::npos);
    o = {};
    o.adaptivity = 0.1;
    o.pieces = 2;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { extract_mesh(*sphere, o, quiet); }).find("slabs"), std::string::npos);
}

}  // namespace
}  // namespace vdbcarve::test
