// SPDX-License-Identifier: Apache-2.0
// Axes, units and files of meshes and volumes.
#include "vdbcarve/export.h"

#include <openvdb/tools/LevelSetSphere.h>

#include <random>

#include "support/noise_grid.h"
#include "support/scenes.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

Vec3d turn(const FileFrame& f, const Vec3d& x) {
    Vec3d out = Vec3d::Zero();
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out[i] += f.scale * f.axes[static_cast<size_t>(i)][static_cast<size_t>(j)] * x[j];
    return out;
}
Vec3d axis_of(const std::string& name) { return (name.front() == '-' ? -1.0 : 1.0) * Vec3d::Unit(name.back() - 'x'); }

Box3d box_of(const Mesh& mesh) {
    Box3d out;
    for (const auto& v : mesh.vertices) out.extend(Vec3d(v[0], v[1], v[2]));
    return out;
}

/// Two balls, so that no axis is like another.
openvdb::FloatGrid::Ptr odd_shape() {
    openvdb::initialize();
    Progress quiet;
    const double voxel = 0.01;
    openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(static_cast<float>(3 * voxel));
    const auto transform = openvdb::math::Transform::createLinearTransform(voxel);
    transform->postTranslate(openvdb::Vec3d(0.5 * voxel + 1.3, 0.5 * voxel - 0.2, 0.5 * voxel));
    grid->setTransform(transform);
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    auto access = grid->getAccessor();
    for (int i = -60; i < 60; ++i)
        for (int j = -40; j < 40; ++j)
            for (int k = -30; k < 50; ++k) {
                const double d = std::min((Vec3d(i, j, k) - Vec3d(-20, 3, 5)).norm() - 18.2, (Vec3d(i, j, k) - Vec3d(14, -8, 20)).norm() - 23.7);
                if (std::fabs(d) < 6) access.setValue({i, j, k}, static_cast<float>(d * voxel));
            }
    return level_set(grid, {}, quiet);
}

TEST(Frames, TurnUpToWhereTheProgramWantsIt) {
    for (const char* up : {"x", "y", "z", "-x", "-y", "-z"})
        for (const Dcc dcc : {Dcc::None, Dcc::Blender, Dcc::Houdini, Dcc::Maya})
            for (const char* extension : {".vdb", ".nvdb", ".ply", ".stl", ".obj", ".glb"}) {
                const FileFrame f = file_frame(extension, {up, "cm", dcc, false});
                SCOPED_TRACE(std::string(up) + " " + extension + " " + std::to_string(static_cast<int>(dcc)));
                Mat3d m;
                for (int c = 0; c < 3; ++c) m.col(c) = turn(f, Vec3d::Unit(c)) / f.scale;
                EXPECT_NEAR(m.determinant(), 1, 1e-12);
                const bool always_y = std::string(extension) == ".obj" || std::string(extension) == ".glb";
                const std::string expected = always_y || dcc == Dcc::Houdini || dcc == Dcc::Maya ? "y" : dcc == Dcc::Blender ? "z" : up;
                EXPECT_EQ(f.up, expected);
                EXPECT_NEAR((m * axis_of(up) - axis_of(expected)).norm(), 0, 1e-12);
                const double metres = std::string(extension) == ".glb" || dcc == Dcc::Blender || dcc == Dcc::Houdini ? 0.01 : dcc == Dcc::Maya ? 1 : 1;
                EXPECT_DOUBLE_EQ(f.scale, metres);
            }
    EXPECT_DOUBLE_EQ(file_frame(".stl", {"z", "inch", Dcc::None, true}).scale, 25.4);
    EXPECT_DOUBLE_EQ(file_frame(".glb", {"z", "", Dcc::None, false}).scale, 1);
    EXPECT_EQ(file_frame(".vdb", {"", "mm", Dcc::Houdini, false}).axes, FileFrame{}.axes);
    EXPECT_NE(error_of(ExitCode::Usage, [] { file_frame(".stl", {"z", "", Dcc::None, true}); }).find("--units"), std::string::npos);
    EXPECT_NE(error_of(ExitCode::Usage, [] { file_frame(".stl", {"z", "cubits", Dcc::None, true}); }).find("cubits"), std::string::npos);
    error_of(ExitCode::Usage, [] { file_frame(".obj", {"w", "", Dcc::None, false}); });
    EXPECT_EQ(metres_per("Millimeters"), 0.001);
    EXPECT_FALSE(metres_per("arbitrary"));
}

// What a turned grid says at a turned place is what the grid said, its distances scaled; and the surface coincides with the mesh.
TEST(Frames, VolumesAndMeshesCoincide) {
    const auto surface = odd_shape();
    const auto density = density_of(*surface);
    Progress quiet;
    const Mesh mesh = extract_mesh(*surface, {}, quiet);
    std::mt19937 random(3);
    for (const char* up : {"x", "y", "z", "-x", "-y", "-z"})
        for (const Dcc dcc : {Dcc::Blender, Dcc::Houdini, Dcc::Maya}) {
            SCOPED_TRACE(std::string(up) + " " + std::to_string(static_cast<int>(dcc)));
            const FileFrame f = file_frame(".vdb", {up, "cm", dcc, false});
            const auto turned = openvdb::gridConstPtrCast<openvdb::FloatGrid>(in_frame(openvdb::GridBase::ConstPtr(surface), f));
            const auto fog = openvdb::gridConstPtrCast<openvdb::FloatGrid>(in_frame(openvdb::GridBase::ConstPtr(density), f));
            ASSERT_TRUE(turned && fog);
            EXPECT_EQ(turned->getGridClass(), openvdb::GRID_LEVEL_SET);
            EXPECT_EQ(turned->activeVoxelCount(), surface->activeVoxelCount());
            EXPECT_EQ(fog->activeVoxelCount(), density->activeVoxelCount());
            EXPECT_NEAR(turned->background(), surface->background() * f.scale, 1e-9);
            EXPECT_EQ(fog->background(), 0.f);
            for (int n = 0; n < 3000; ++n) {
                const openvdb::Coord c(static_cast<int>(random() % 140) - 70, static_cast<int>(random() % 100) - 50, static_cast<int>(random() % 100) - 40);
                const openvdb::Vec3d x = surface->indexToWorld(c);
                const Vec3d y = turn(f, Vec3d(x.x(), x.y(), x.z()));
                const openvdb::Vec3d index = turned->worldToIndex(openvdb::Vec3d(y.x(), y.y(), y.z()));
                const openvdb::Coord there = openvdb::Coord::round(index);
                ASSERT_LT((index - there.asVec3d()).length(), 1e-6);
                ASSERT_FLOAT_EQ(turned->tree().getValue(there), static_cast<float>(surface->tree().getValue(c) * f.scale));
                ASSERT_EQ(turned->tree().isValueOn(there), surface->tree().isValueOn(c));
                ASSERT_EQ(fog->tree().getValue(there), density->tree().getValue(c));
            }
            const Box3d of_volume = box_of(extract_mesh(*turned, {}, quiet)), of_mesh = box_of(in_frame(mesh, f));
            EXPECT_LT((of_volume.min() - of_mesh.min()).cwiseAbs().maxCoeff(), 1e-3 * of_mesh.sizes().maxCoeff());
            EXPECT_LT((of_volume.max() - of_mesh.max()).cwiseAbs().maxCoeff(), 1e-3 * of_mesh.sizes().maxCoeff());
        }
    const openvdb::GridBase::ConstPtr same = surface;
    EXPECT_EQ(in_frame(same, FileFrame{}), same);
    const openvdb::FloatGrid::Ptr sheared = surface->deepCopy();
    sheared->setTransform(openvdb::math::Transform::createLinearTransform(openvdb::Mat4R(1., 0.2, 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.)));
    // OpenVDB takes no voxels of less than 14 micrometres where a metre is the unit.
    EXPECT_NE(error_of(ExitCode::Output,
                       [&] {
                           in_frame(openvdb::GridBase::ConstPtr(surface), file_frame(".vdb", {"y", "mm", Dcc::Blender, false}));
                       })
                  .find("too small"),
              std::string::npos);
    error_of(ExitCode::Input, [&] { in_frame(openvdb::GridBase::ConstPtr(sheared), file_frame(".vdb", {"y", "cm", Dcc::Blender, false})); });
}

Mesh colored_mesh() {
    Progress quiet;
    MeshOptions o;
    o.mesher = Mesher::MarchingCubes;
    o.normals = true;
    Mesh mesh = extract_mesh(*odd_shape(), o, quiet);
    std::mt19937 random(1);
    for (size_t v = 0; v < mesh.vertices.size(); ++v)
        mesh.colors.push_back({static_cast<float>(random() % 1001) / 1000, static_cast<float>(random() % 100) / 5000, 1.f});
    return mesh;
}

TEST(Glb, RoundTrip) {
    TemporaryFolder folder;
    Mesh mesh = colored_mesh();
    mesh.extrapolated.assign(mesh.vertices.size(), 1);
    write_mesh(folder / "m.glb", mesh);
    write_mesh(folder / "n.glb", mesh);
    EXPECT_EQ(read_text(folder / "m.glb"), read_text(folder / "n.glb"));
    const Mesh back = read_mesh(folder / "m.glb");
    EXPECT_EQ(back.vertices, mesh.vertices);
    EXPECT_EQ(back.triangles, mesh.triangles);
    ASSERT_EQ(back.colors.size(), mesh.colors.size());
    for (size_t v = 0; v < mesh.colors.size(); ++v)
        for (size_t c = 0; c < 3; ++c) {
            ASSERT_NEAR(back.colors[v][c], mesh.colors[v][c], 0.51 / 65535);  // linear, 16 bits: darks are not banded
            ASSERT_NEAR(back.normals[v][c], mesh.normals[v][c], 1e-6);
        }
    const std::string text = read_text(folder / "m.glb");
    EXPECT_EQ(text.substr(0, 4), "glTF");
    for (const char* part : {"COLOR_0", "_EXTRAPOLATED", "\"NORMAL\"", "vdbcarve"}) EXPECT_NE(text.find(part), std::string::npos) << part;
    mesh.normals.clear();
    mesh.colors.clear();
    mesh.extrapolated.clear();
    write_mesh(folder / "m.glb", mesh);
    const Mesh plain = read_mesh(folder / "m.glb");
    EXPECT_TRUE(plain.colors.empty());
    ASSERT_EQ(plain.normals.size(), mesh.vertices.size());
    for (const auto& n : plain.normals) ASSERT_NEAR(Vec3d(n[0], n[1], n[2]).norm(), 1, 1e-5);
    write_text(folder / "bad.glb", text.substr(0, text.size() / 2));
    EXPECT_NE(error_of(ExitCode::Input, [&] { read_mesh(folder / "bad.glb"); }).find("bad.glb"), std::string::npos);
    write_text(folder / "none.glb", "glTF");
    error_of(ExitCode::Input, [&] { read_mesh(folder / "none.glb"); });
}

// A file that other people made: several nodes' transforms, textures that are not wanted.
TEST(Glb, OfOthersIsRead) {
    const char* data = std::getenv("VDBCARVE_TEST_DATA");
    if (!data || !fs::exists(fs::path(data) / "meshes/Avocado.glb")) GTEST_SKIP() << "VDBCARVE_TEST_DATA is not set, or has no meshes/Avocado.glb";
    const Mesh mesh = read_mesh(fs::path(data) / "meshes/Avocado.glb");
    EXPECT_EQ(mesh.vertices.size(), 406u);
    EXPECT_EQ(mesh.triangles.size(), 682u);
    EXPECT_NEAR(box_of(mesh).sizes().y(), 0.0629, 0.001);  // six centimetres, in metres
}

TEST(MeshFiles, QuadsStayWhole) {
    TemporaryFolder folder;
    Progress quiet;
    MeshOptions o;
    o.quads = true;
    const Mesh mesh = extract_mesh(*odd_shape(), o, quiet);
    ASSERT_GT(mesh.quads, 1000u);
    EXPECT_EQ(2 * mesh.quads, mesh.triangles.size());
    for (const char* name : {"m.ply", "m.obj"}) {
        write_mesh(folder / name, mesh);
        const Mesh back = read_mesh(folder / name);
        EXPECT_EQ(back.quads, mesh.quads) << name;
        EXPECT_EQ(back.triangles, mesh.triangles) << name;
    }
    EXPECT_NE(read_text(folder / "m.ply").find("element face " + std::to_string(mesh.quads) + "\n"), std::string::npos);
    o.adaptivity = 0.5;
    const Mesh mixed = extract_mesh(*odd_shape(), o, quiet);
    ASSERT_GT(mixed.quads, 100u);
    ASSERT_LT(2 * mixed.quads, mixed.triangles.size());
    write_mesh(folder / "m.ply", mixed);
    const Mesh back = read_mesh(folder / "m.ply");
    EXPECT_EQ(back.quads, mixed.quads);
    EXPECT_EQ(back.triangles, mixed.triangles);
    EXPECT_TRUE(measure(back).manifold);
}

TEST(MeshFiles, ExtrapolatedIsAPropertyThatReadersMaySkip) {
    TemporaryFolder folder;
    Mesh mesh = colored_mesh();
    mesh.extrapolated.resize(mesh.vertices.size());
    for (size_t v = 0; v < mesh.vertices.size(); ++v) mesh.extrapolated[v] = v % 3 == 0;
    write_mesh(folder / "m.ply", mesh);
    const std::string text = read_text(folder / "m.ply");
    EXPECT_NE(text.find("property uchar blue\nproperty uchar extrapolated\n"), std::string::npos);
    const Mesh back = read_mesh(folder / "m.ply");
    EXPECT_EQ(back.vertices, mesh.vertices);
    EXPECT_EQ(back.triangles, mesh.triangles);
    for (size_t v = 0; v < mesh.colors.size(); ++v) ASSERT_EQ(srgb8_from_linear(back.colors[v][0]), srgb8_from_linear(mesh.colors[v][0]));
    write_mesh(folder / "m.obj", mesh);
    EXPECT_NE(read_text(folder / "m.obj").find("mtllib m.mtl"), std::string::npos);
    EXPECT_NE(read_text(folder / "m.mtl").find("newmtl object"), std::string::npos);
    EXPECT_EQ(read_mesh(folder / "m.obj").colors.size(), mesh.vertices.size());
}

TEST(Vdb, HalfOnDiskAndMetadataOfOthers) {
    TemporaryFolder folder;
    openvdb::initialize();
    const auto surface = noise_grid(60, true, false, 2);
    openvdb::MetaMap said;
    said.insertMeta("shot_by", openvdb::StringMetadata("somebody"));
    write_vdb(folder / "whole.vdb", {surface}, said);
    write_vdb(folder / "half.vdb", {surface}, said, true);
    EXPECT_LT(fs::file_size(folder / "half.vdb"), 0.7 * static_cast<double>(fs::file_size(folder / "whole.vdb")));
    EXPECT_FALSE(surface->saveFloatAsHalf());
    openvdb::MetaMap back;
    const auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(read_vdb(folder / "half.vdb", &back).at(0));
    EXPECT_EQ(back["shot_by"]->str(), "somebody");
    EXPECT_NE(back["creator"]->str().find("vdbcarve"), std::string::npos);
    EXPECT_TRUE(grid->saveFloatAsHalf());
    for (auto v = surface->cbeginValueOn(); v; ++v) ASSERT_NEAR(grid->tree().getValue(v.getCoord()), *v, 1e-3);
}

TEST(Nvdb, HoldsColoursAndCountsToo) {
    openvdb::initialize();
    TemporaryFolder folder;
    const openvdb::Vec3SGrid::Ptr color = openvdb::Vec3SGrid::create();
    color->setName("color");
    const openvdb::Int32Grid::Ptr views = openvdb::Int32Grid::create();
    views->setName("views");
    for (int n = 0; n < 500; ++n) {
        color->tree().setValue({n, 2 * n, -n}, openvdb::Vec3s(static_cast<float>(n), 0.5f, 0.25f));
        views->tree().setValue({n, 2 * n, -n}, n);
    }
    write_nvdb(folder / "a.nvdb", {color, views});
    const auto back = read_nvdb(folder / "a.nvdb");
    ASSERT_EQ(back.size(), 2u);
    const auto c = openvdb::gridPtrCast<openvdb::Vec3SGrid>(back[0]);
    const auto v = openvdb::gridPtrCast<openvdb::Int32Grid>(back[1]);
    ASSERT_TRUE(c && v);
    EXPECT_EQ(c->getName(), "color");
    for (int n = 0; n < 500; ++n) {
        ASSERT_EQ(c->tree().getValue({n, 2 * n, -n}), openvdb::Vec3s(static_cast<float>(n), 0.5f, 0.25f));
        ASSERT_EQ(v->tree().getValue({n, 2 * n, -n}), n);
    }
}

// A level ring 20 degrees up around a cylinder: the flat top bulges by R tan 20 degrees, the bottom downwards likewise, and the contours know where the top
// ends.
TEST(Caps, WhatOnlyConesBoundIsNamedAndCutOff) {
    SyntheticSpec spec = small_spec("boxes", 24, 320, 240);
    spec.rig.elevation_deg = 20;
    const Shoot s = shoot(spec);
    const CarveOptions o = options_for(s, 96, 0.6);
    Progress quiet;
    const auto surface = level_set(carve(s.inputs, o, quiet).hull, {}, quiet);
    const auto cameras = s.scene.views.cameras();
    std::vector<MaskView> masks;
    for (const Mask& m : s.scene.masks) masks.push_back(view_of(m));
    const Vec3d up = Vec3d::UnitZ();
    EXPECT_GT(orbit_axis(cameras).dot(up), 0.99);
    const SeenExtent seen = seen_extent(*surface, cameras, masks, up);
    const Box3d truth = box_of(s.scene.truth);
    const double voxel = o.lattice.voxel_size;
    ASSERT_TRUE(seen.top_seen && seen.bottom_seen);
    EXPECT_NEAR(seen.highest, truth.max().z(), 2.5 * voxel);
    EXPECT_NEAR(seen.lowest, truth.min().z(), 2.5 * voxel);
    Mesh mesh = extract_mesh(*surface, {}, quiet);
    const Box3d hull = box_of(mesh);
    const Extrapolation e = mark_extrapolated(mesh, cameras, seen, up, 2 * voxel);
    EXPECT_NEAR(e.top_beyond, std::max(0.0, hull.max().z() - seen.highest), 1e-6);
    EXPECT_NEAR(e.bottom_beyond, seen.lowest - hull.min().z(), 1e-6);
    EXPECT_GT(e.bottom_beyond, 5 * voxel);
    EXPECT_GT(e.capped_share, 0.02);
    EXPECT_LT(e.capped_share + e.unseen_share, 0.6);
    ASSERT_EQ(mesh.extrapolated.size(), mesh.vertices.size());
    for (size_t v = 0; v < mesh.vertices.size(); ++v)
        ASSERT_TRUE(mesh.extrapolated[v] || (mesh.vertices[v][2] <= seen.highest + 2 * voxel && mesh.vertices[v][2] >= seen.lowest - 2 * voxel));

    const auto cut = cut_flat(surface->deepCopy(), up, seen.lowest, quiet);
    const Mesh flat = extract_mesh(*cut, {}, quiet);
    const MeshMeasures m = measure(flat);
    EXPECT_TRUE(m.manifold);
    EXPECT_NEAR(box_of(flat).min().z(), seen.lowest, 0.6 * voxel);
    EXPECT_NEAR(box_of(flat).max().z(), hull.max().z(), 0.1 * voxel);
    // The foot is a plane.
    size_t foot = 0;
    for (const auto& v : flat.vertices) foot += std::fabs(v[2] - seen.lowest) < 0.05 * voxel;
    EXPECT_GT(foot, 300u);
    error_of(ExitCode::Input, [&] { cut_flat(surface->deepCopy(), up, hull.max().z() + 1, quiet); });
}

// A tall box, a mound as a flat patch makes it, over and beside its foot, and a low box apart from them.
TEST(Caps, AMoundOnTheFloorGoesAndFeetStay) {
    constexpr double kVoxel = 0.02;
    for (const Vec3d& up : {Vec3d(0, 0, 1), Vec3d(0, -1, 0)}) {
        const auto grid = openvdb::FloatGrid::create(3 * kVoxel);
        grid->setTransform(openvdb::math::Transform::createLinearTransform(kVoxel));
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        int axis = 0;
        up.cwiseAbs().maxCoeff(&axis);
        const auto box = [](const Vec3d& p, const Vec3d& centre, const Vec3d& half) {
            const Vec3d q = (p - centre).cwiseAbs() - half;
            return q.cwiseMax(0).norm() + std::min(0.0, q.maxCoeff());
        };
        auto values = grid->getAccessor();
        for (int x = -70; x <= 70; ++x)
            for (int y = -70; y <= 70; ++y)
                for (int z = -6; z <= 60; ++z) {
                    const Vec3d p = kVoxel * Vec3d(x + 0.3, y - 0.2, z);  // z: height; no wall along voxels' centres
                    const double foot = box(p, {0, 0, 0.5}, {0.2, 0.2, 0.5}), low = box(p, {-1, -1, 0.06}, {0.2, 0.2, 0.06});
                    const double r = std::hypot(p.x() - 0.4, p.y());
                    const double mound = std::max(-p.z(), (p.z() - 0.25 * (0.8 - r)) / std::hypot(1, 0.25));
                    const double d = std::min({foot, low, mound});
                    openvdb::Coord c(x, y, z);
                    if (axis == 1) c = openvdb::Coord(x, -z, y);
                    if (std::fabs(d) < 3 * kVoxel) values.setValueOn(c, static_cast<float>(d));
                    else if (d < 0) values.setValueOff(c, static_cast<float>(-3 * kVoxel));
                }
        Progress quiet;
        const MeshMeasures before = measure(extract_mesh(*grid, {}, quiet));
        const Mesh cleared = extract_mesh(*clear_floor(grid->deepCopy(), up, 0, 0.01, 0.3, quiet), {}, quiet);
        const MeshMeasures after = measure(cleared);
        const double feet = 0.4 * 0.4 * 1 + 0.4 * 0.4 * 0.12;
        EXPECT_GT(before.volume, feet + 0.08);
        EXPECT_NEAR(after.volume, feet, 0.025 * feet);  // walls to half a voxel
        EXPECT_TRUE(after.manifold);
        EXPECT_EQ(after.components, 2u);
    }
}

}  // namespace
}  // namespace vdbcarve::test
