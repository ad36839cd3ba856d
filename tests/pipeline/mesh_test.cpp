// SPDX-License-Identifier: Apache-2.0
// Filter, mesh, smoothing and files for other programs through the whole job.

#include "support/job.h"
#include "vdbcarve/export.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

// A changed filter redoes the filter and what follows, smoothing only itself; and files are the same bytes whether stages ran or were found.
TEST(Pipeline, FilterMeshAndSmoothAreStagesOfTheirOwn) {
    Job job("ellipsoids", true);
    job.options.result.mesh_formats = {"ply", "glb"};
    const json soft = job.run();
    EXPECT_EQ(soft["filter"]["chain"], "none");
    EXPECT_FALSE(soft["filter"].contains("mask_softness"));  // the fair surface needs no filter, however hard the masks are
    job.options.surface.fair = false;
    const json hull = job.run();
    EXPECT_EQ(hull["filter"]["chain"], "none");
    EXPECT_GT(hull["filter"]["mask_softness"], 0.5);
    job.options.surface.fair = true;
    job.options.filter.steps = parse_filters("edge-preserving:1");
    const json first = job.run();
    EXPECT_NEAR(first["filter"]["volume"].get<double>() / first["filter"]["volume_before"].get<double>(), 1, 2e-4);
    const std::string ply = job.bytes("mesh.ply"), glb = job.bytes("mesh.glb"), volume = job.bytes("volume.vdb");
    for (const char* name : {"mesh.ply", "mesh.glb", "volume.vdb"}) fs::remove(job.folder / "out" / name);
    const json again = job.run();
    for (const char* stage : {"level_set", "color", "filter", "mesh"}) EXPECT_TRUE(Job::reused(again, stage)) << stage;
    EXPECT_EQ(again["filter"]["chain"], "edge-preserving:1x1");
    EXPECT_EQ(again["filter"]["volume"], first["filter"]["volume"]);
    EXPECT_EQ(job.bytes("mesh.ply"), ply);
    EXPECT_EQ(job.bytes("mesh.glb"), glb);
    EXPECT_EQ(job.bytes("volume.vdb"), volume);
    // A damaged mesh of a stage counts as none.
    for (const auto& entry : fs::recursive_directory_iterator(job.folder / "out/stages"))
        if (entry.path().extension() == ".bin") fs::resize_file(entry.path(), fs::file_size(entry.path()) - 5);
    EXPECT_FALSE(Job::reused(job.run(), "mesh"));
    EXPECT_EQ(job.bytes("mesh.glb"), glb);

    job.options.filter.steps = parse_filters("gaussian:1");
    const json other = job.run();
    EXPECT_TRUE(Job::reused(other, "color"));
    EXPECT_FALSE(Job::reused(other, "filter"));
    EXPECT_FALSE(Job::reused(other, "mesh"));
    EXPECT_NE(job.bytes("mesh.ply"), ply);
    job.options.smooth.iterations = 5;
    job.options.smooth.faces = 1500;
    const json smooth = job.run();
    EXPECT_TRUE(Job::reused(smooth, "filter"));
    EXPECT_TRUE(Job::reused(smooth, "mesh"));
    EXPECT_FALSE(Job::reused(smooth, "smooth"));
    EXPECT_LE(smooth["mesh"]["faces"], 1500);
    EXPECT_TRUE(smooth["mesh"]["manifold"]);
    EXPECT_EQ(read_mesh(job.folder / "out/mesh.ply").triangles.size(), smooth["mesh"]["faces"].get<size_t>());
    EXPECT_FALSE(read_mesh(job.folder / "out/mesh.ply").colors.empty());
    EXPECT_TRUE(Job::reused(job.run(), "smooth"));
    // The binary model, unfiltered, is smoothed by itself.
    job.options.smooth.iterations.reset();
    job.options.smooth.faces = 0;
    job.options.filter.steps = parse_filters("none");
    EXPECT_EQ(job.run()["smooth"]["iterations"], 0);
    job.options.carve.occupancy = true;
    EXPECT_EQ(job.run()["smooth"]["iterations"], 10);
    job.options.filter.steps.reset();
    const json binary = job.run();
    EXPECT_EQ(binary["filter"]["chain"], "edge-preserving:2x4");
    EXPECT_EQ(binary["smooth"]["iterations"], 0);
}

TEST(Pipeline, AFilterThatTakesPartsAwaySaysSo) {
    Job job("cup");
    job.options.filter.steps = parse_filters("gaussian:2x2");
    job.options.filter.keep_thin_vox = 0;
    const json r = job.run();
    bool said = false;
    for (const json& w : r["warnings"]) said |= w.get<std::string>().find("of the volume") != std::string::npos;
    EXPECT_TRUE(said) << r["warnings"];
}

// What every preset is for: after each format's own rule, mesh and volume lie in the same box.
TEST(Pipeline, FilesOfAPresetCoincide) {
    Job job;
    job.options.result.mesh_formats = {"ply", "obj", "glb", "stl"};
    job.options.views.units = "cm";
    job.options.views.up = "z";
    const auto box = [](const Mesh& mesh) {
        Box3d out;
        for (const auto& v : mesh.vertices) out.extend(Vec3d(v[0], v[1], v[2]));
        return out;
    };
    const auto expect_box = [](const Box3d& found, const Box3d& expected) {
        const double size = expected.sizes().maxCoeff();
        EXPECT_LT((found.min() - expected.min()).cwiseAbs().maxCoeff(), 1e-3 * size);
        EXPECT_LT((found.max() - expected.max()).cwiseAbs().maxCoeff(), 1e-3 * size);
    };
    Progress quiet;
    job.run();
    const Box3d scene = box(read_mesh(job.folder / "out/mesh.ply"));
    const auto y_up = [&](double scale) {
        return Box3d(scale * Vec3d(scene.min().x(), scene.min().z(), -scene.max().y()), scale * Vec3d(scene.max().x(), scene.max().z(), -scene.min().y()));
    };
    const auto scaled_box = [&](double scale) { return Box3d(scale * scene.min(), scale * scene.max()); };
    const struct {
        Dcc dcc;
        Box3d volume, obj;
        const char* color;
    } cases[] = {{Dcc::None, scene, y_up(1), ""},
                 {Dcc::Blender, scaled_box(0.01), y_up(0.01), ""},
                 {Dcc::Houdini, y_up(0.01), y_up(0.01), ""},
                 {Dcc::Maya, y_up(1), y_up(1), ""}};
    for (const auto& c : cases) {
        SCOPED_TRACE(static_cast<int>(c.dcc));
        job.options.result.dcc = c.dcc;
        const json r = job.run();
        for (const auto& grid : read_vdb(job.folder / "out/volume.vdb"))
            if (grid->getName() == "surface") {
                const auto surface = openvdb::gridPtrCast<openvdb::FloatGrid>(grid);
                expect_box(box(extract_mesh(*surface, {}, quiet)), c.volume);
                EXPECT_NEAR(r["files"]["volume.vdb"]["scale"].get<double>() * r["grid"]["voxel_size"].get<double>(), surface->voxelSize()[0], 1e-12);
            }
        expect_box(box(read_mesh(job.folder / "out/mesh.ply")), c.volume);
        expect_box(box(read_mesh(job.folder / "out/mesh.stl")), c.volume);
        expect_box(box(read_mesh(job.folder / "out/mesh.obj")), c.obj);
        expect_box(box(read_mesh(job.folder / "out/mesh.glb")), y_up(0.01));
        EXPECT_TRUE(measure(read_mesh(job.folder / "out/mesh.ply")).volume > 0);
    }
    job.options.result.dcc = Dcc::None;
    job.options.result.stl_mm = true;
    job.run();
    expect_box(box(read_mesh(job.folder / "out/mesh.stl")), scaled_box(10));
    job.options.views.units.clear();
    EXPECT_NE(error_of(ExitCode::Usage, [&] { job.run(); }).find("--units"), std::string::npos);
}

}  // namespace
}  // namespace vdbcarve::test
