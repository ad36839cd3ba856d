// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mesh.h"

#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/global_control.h>

#include <cmath>
#include <map>
#include <random>
#include <set>

#include "marching_cubes.h"
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
        for (int at = 0; at < 64; ++at) access.setValue(openvdb::Coord(5 + at / 16, 5 + at / 4 % 4, 5 + at % 4), static_cast<float>(random() % 2001) / 1000.f - 1.0005f);
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
    EXPECT_LT(worst, 0.02);                       // chords of the field between voxels, and 1/256 voxel off the corners
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
}

}  // namespace
}  // namespace vdbcarve::test
