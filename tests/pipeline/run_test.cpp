// SPDX-License-Identifier: Apache-2.0
// The whole job on a synthetic shoot: what it writes, what it reuses, what it refuses.

#include <algorithm>

#include "support/job.h"
#include "image/image_io.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/export.h"

namespace vdbcarve::test {
namespace {

TEST(Pipeline, WritesTheResultAndItsReport) {
    Job job;
    const json r = job.run();
    for (const char* f : kFiles) EXPECT_TRUE(fs::exists(job.folder / (std::string("out/") + f))) << f;
    EXPECT_TRUE(fs::exists(job.folder / "out/masks/0003.png"));
    EXPECT_EQ(r["backend"], "cpu");
    EXPECT_TRUE(r["mesh"]["closed"]);
    EXPECT_TRUE(r["mesh"]["manifold"]);
    EXPECT_GT(r["mesh"]["volume"], 0);
    ASSERT_EQ(r["views"].size(), 8u);
    for (const json& v : r["views"]) EXPECT_GT(v["silhouette_iou"], 0.98) << v;
    std::vector<std::string> names;
    for (const json& s : r["stages"]) {
        names.push_back(s["name"]);
        EXPECT_TRUE(s["seconds"].is_number());
        EXPECT_GT(s["peak_rss_bytes"], 1000000);
    }
    EXPECT_EQ(names, (std::vector<std::string>{"views", "mask", "distance", "carve", "level_set", "fair", "color", "filter", "mesh", "smooth", "export"}));
    for (const char* key : {"dims", "voxel_size", "active_voxels", "leaves", "bytes"}) EXPECT_TRUE(r["grid"].contains(key)) << key;
    EXPECT_EQ(r["inputs"].size(), 8u);
}

TEST(Pipeline, TwoRunsGiveTheSameBytesAndTheSecondRedoesNothing) {
    Job a, b;
    a.run();
    b.run();
    for (const char* f : kFiles) EXPECT_EQ(a.bytes(f), b.bytes(f)) << f;
    const json again = a.run();
    for (const char* stage : {"mask", "carve", "level_set", "mesh"}) EXPECT_TRUE(Job::reused(again, stage)) << stage;
    for (const char* f : kFiles) EXPECT_EQ(a.bytes(f), b.bytes(f)) << f;
    // After `clean` everything is made anew, the same.
    EXPECT_GT(clean(a.options.run.output), 100000u);
    EXPECT_EQ(std::distance(fs::directory_iterator(a.folder / "out/stages"), {}), 1);  // the marker
    EXPECT_FALSE(Job::reused(a.run(), "carve"));
    for (const char* f : kFiles) EXPECT_EQ(a.bytes(f), b.bytes(f)) << f;
}

TEST(Pipeline, AChangedOptionRedoesOnlyWhatDependsOnIt) {
    Job job;
    job.run();
    job.options.mesh.adaptivity = 0.2;
    json r = job.run();
    EXPECT_TRUE(Job::reused(r, "carve"));
    EXPECT_TRUE(Job::reused(r, "level_set"));
    EXPECT_FALSE(Job::reused(r, "mesh"));
    job.options.carve.max_misses = 1;
    r = job.run();
    EXPECT_TRUE(Job::reused(r, "mask"));
    EXPECT_FALSE(Job::reused(r, "carve"));
    job.options.carve.max_misses = 0;
    EXPECT_TRUE(Job::reused(job.run(), "carve"));  // the older stage is still there
}

TEST(Pipeline, AMaskEditedByHandIsUsedAndKept) {
    Job job;
    const double before = job.run()["mesh"]["volume"];
    const fs::path mask = job.folder / "out/masks/0002.png";
    Image8 m = io::read_image8(mask);
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < 75; ++x) m.at(x, y) = 0;  // cuts the object's left part off
    const auto png = io::encode_png(m);
    write_text(mask, {png.begin(), png.end()});
    const std::string edited = read_text(mask);
    const json r = job.run();
    EXPECT_FALSE(Job::reused(r, "mask"));
    EXPECT_LT(r["mesh"]["volume"], 0.9 * before);
    EXPECT_EQ(read_text(mask), edited);
    EXPECT_TRUE(Job::reused(job.run(), "carve"));
    EXPECT_EQ(read_text(mask), edited);
}

TEST(Pipeline, AStageThatWasCutOffIsMadeAgain) {
    Job job;
    job.run();
    const std::string good = job.bytes("mesh.ply");
    // What a killed run leaves: some stages done, a temporary file, no result.
    for (const auto& e : fs::directory_iterator(job.folder / "out/stages"))
        if (e.path().filename().string().rfind("level_set-", 0) == 0) fs::remove_all(e.path());
    for (const char* f : kFiles) fs::remove(job.folder / (std::string("out/") + f));
    write_text(job.folder / "out/stages/.surface-123.vdb.part99", "half");
    const json r = job.run();
    EXPECT_TRUE(Job::reused(r, "carve"));
    EXPECT_FALSE(Job::reused(r, "level_set"));
    EXPECT_EQ(job.bytes("mesh.ply"), good);
}

TEST(Pipeline, ForeignFoldersAreLeftAlone) {
    Job job;
    fs::create_directories(job.options.run.output);
    write_text(job.folder / "out/thesis.txt", "precious");
    EXPECT_NE(error_of(ExitCode::Output, [&] { job.run(); }).find("--force"), std::string::npos);
    job.options.run.force = true;
    job.run();
    EXPECT_EQ(job.bytes("thesis.txt"), "precious");
    EXPECT_THROW(clean(job.folder / "scene"), InputError);
}

TEST(Pipeline, GridsBoundsAndOrigin) {
    Job job;
    job.options.grid.resolution = 0;
    job.options.run.last_stage = LastStage::Carve;
    job.options.grid.bounds = Box3d(Vec3d(-1, -0.8, -1), Vec3d(1, 0.8, 1));
    job.options.grid.dims = {50, 40, 50};
    json r = job.run();
    EXPECT_EQ(r["grid"]["dims"], json({50, 40, 50}));
    EXPECT_NEAR(r["grid"]["voxel_size"], 0.04, 1e-12);
    job.options.grid.dims = {50, 50, 50};
    EXPECT_NE(error_of(ExitCode::Usage, [&] { job.run(); }).find("not cubes"), std::string::npos);
    job.options.grid.dims.reset();
    job.options.grid.voxel_size = 0.05;
    EXPECT_EQ(job.run()["grid"]["dims"], json({40, 32, 40}));
    job.options.grid.bounds->min().x() = 0.1;
    r = job.run();
    EXPECT_GT(r["grid"]["clipped_share"], 0.02);
    EXPECT_NE(r["warnings"].dump().find("cut the object"), std::string::npos);
    job.options.grid.resolution = 10;
    EXPECT_THROW(job.run(), UsageError);
    job.options.grid.resolution = 0;
    job.options.grid.bounds = Box3d(Vec3d(0, 0, 0), Vec3d(1, 0, 1));
    EXPECT_NE(error_of(ExitCode::Usage, [&] { job.run(); }).find("--bounds has no volume"), std::string::npos);
    job.options.grid.bounds.reset();
    job.options.run.backend = Backend::Cuda;
    job.options.run.device = 99;
    const std::string said = error_of(ExitCode::Backend, [&] { job.run(); });
    EXPECT_NE(said.find(cuda_devices().empty() ? "Remedy: --backend cpu" : "--device 99"), std::string::npos) << said;
}

// A limit below what the process holds already: bricks and batches of the least size, and the same hull.
TEST(Pipeline, BricksUnderAMemoryLimitEqualTheWhole) {
    Job job;
    job.options.grid.resolution = 200;
    job.options.run.last_stage = LastStage::Carve;
    const json whole = job.run();
    const auto hull = read_float_grid(job.folder / "out/hull.vdb", "hull");
    job.options.run.output = job.folder / "bricks";
    job.options.run.memory_limit = 1 << 20;
    const json parts = job.run();
    ASSERT_TRUE(parts["grid"].contains("bricks"));
    EXPECT_GT(parts["grid"]["bricks"].size(), 1u);
    EXPECT_EQ(parts["grid"]["leaves"], whole["grid"]["leaves"]);
    EXPECT_FALSE(fs::exists(job.folder / "bricks/hull.vdb"));
    std::vector<openvdb::FloatGrid::Ptr> bricks;
    for (const json& name : parts["grid"]["bricks"]) bricks.push_back(read_float_grid(job.folder / "bricks/hull_bricks" / name.get<std::string>(), "hull"));
    const auto merged = merge_bricks(bricks);
    EXPECT_TRUE(merged->tree().hasSameTopology(hull->tree()));
    for (auto it = hull->cbeginValueAll(); it; ++it) ASSERT_EQ(*it, merged->tree().getValue(it.getCoord()));
    // A brick that is lost is made again, the others are kept.
    const std::string lost = parts["grid"]["bricks"][1];
    for (const auto& e : fs::recursive_directory_iterator(job.folder / "bricks/stages"))
        if (e.path().filename() == lost) fs::remove(e.path());
    job.run();
    EXPECT_TRUE(fs::exists(job.folder / "bricks/hull_bricks" / lost));
    // So is one that is damaged.
    const std::string whole_brick = read_text(job.folder / "bricks/hull_bricks" / lost);
    for (const auto& e : fs::recursive_directory_iterator(job.folder / "bricks/stages"))
        if (e.path().filename() == lost) {
            std::string damaged = whole_brick;
            damaged[damaged.size() / 2] ^= 1;
            write_text(e.path(), damaged);
        }
    job.run();
    EXPECT_EQ(read_text(job.folder / "bricks/hull_bricks" / lost), whole_brick);
    // The whole job says what it needs instead of trying.
    job.options.run.last_stage = LastStage::Export;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { job.run(); }).find("--memory-limit"), std::string::npos);
}

// As shells complete the name of a folder.
TEST(Pipeline, AnOutputFolderMayEndWithASlash) {
    Job job;
    const json first = job.run();
    job.options.run.output = (job.folder / "out").string() + "/";
    job.options.mesh.adaptivity = 0.3;
    const json again = job.run();
    EXPECT_TRUE(Job::reused(again, "carve"));
    EXPECT_LT(again["mesh"]["faces"], first["mesh"]["faces"]);
    job.options.run.last_stage = LastStage::Carve;
    const json carve = job.run();
    EXPECT_TRUE(Job::reused(carve, "carve"));
    EXPECT_NE(carve["warnings"].dump().find("is of an earlier run"), std::string::npos);
}

TEST(Pipeline, HullsKnownInOtherWordsSayTheirOwnUnits) {
    Job job;
    job.options.run.last_stage = LastStage::Carve;
    job.options.views.units = "mm";
    job.run();
    job.options.views.units = "cm";
    EXPECT_TRUE(Job::reused(job.run(), "carve"));
    openvdb::io::File file((job.folder / "out/hull.vdb").string());
    file.open();
    EXPECT_EQ((*file.getMetadata())["units"]->str(), "cm");
}

TEST(Pipeline, TheFairSurfaceLiesInsideTheHull) {
    Job job("cup");
    job.options.surface.fair = false;
    const json hull = job.run();
    EXPECT_FALSE(hull.contains("fair"));
    EXPECT_FALSE(hull.contains("slack"));
    job.options.surface.fair = job.options.surface.keep_hull = true;
    const json first = job.run();
    EXPECT_TRUE(Job::reused(first, "level_set"));
    EXPECT_FALSE(Job::reused(first, "fair"));
    EXPECT_EQ(first["fair"]["uncovered"], 0);
    EXPECT_LT(first["fair"]["volume"], first["fair"]["hull_volume"]);
    EXPECT_LT(first["mesh"]["volume"], hull["mesh"]["volume"]);
    EXPECT_TRUE(first["mesh"]["manifold"]);
    EXPECT_GT(job.last.median_iou, 0.97);
    const auto kept = read_float_grid(job.folder / "out/volume.vdb", "hull_surface"), fair = read_float_grid(job.folder / "out/volume.vdb", "surface");
    EXPECT_EQ(kept->getGridClass(), openvdb::GRID_LEVEL_SET);
    for (auto v = fair->cbeginValueOn(); v; ++v) ASSERT_GE(*v, kept->tree().getValue(v.getCoord()) - 1e-5);
    // What it leaves open is there as a grid, in the mesh and in the report.
    const auto slack = read_float_grid(job.folder / "out/volume.vdb", "slack");
    EXPECT_EQ(slack->activeVoxelCount(), fair->activeVoxelCount());
    EXPECT_NE(job.bytes("mesh.ply").find("property float slack"), std::string::npos);
    EXPECT_LT(first["slack"]["half"], first["slack"]["most"]);
    EXPECT_GT(first["slack"]["most"], 0);
    EXPECT_LE(first["slack"]["most_share"], 0.9);
    const std::string mesh = job.bytes("mesh.ply");
    EXPECT_TRUE(Job::reused(job.run(), "fair"));
    EXPECT_EQ(job.bytes("mesh.ply"), mesh);
    job.options.surface.options.fairness = 0.1;
    EXPECT_FALSE(Job::reused(job.run(), "fair"));
    job.options.surface.fair = false;
    job.run();
    EXPECT_EQ(read_vdb(job.folder / "out/volume.vdb").size(), 2u);
    // Wider and narrower bands.
    job.options.surface = {};
    for (const int width : {2, 5}) {
        job.options.carve.half_width_vox = width;
        const json wide = job.run();
        EXPECT_NEAR(wide["mesh"]["volume"].get<double>() / first["mesh"]["volume"].get<double>(), 1, 0.02) << width;
        const auto grid = read_float_grid(job.folder / "out/volume.vdb", "surface");
        EXPECT_NEAR(static_cast<double>(grid->background()) / grid->voxelSize()[0], width, 1e-4);
    }
}

TEST(Pipeline, OccupancyAndDryRun) {
    Job job("torus");
    job.options.carve.occupancy = true;
    const json r = job.run();
    EXPECT_TRUE(r["mesh"]["manifold"]);
    EXPECT_EQ(r["mesh"]["genus"], 1);
    Job plan;
    plan.options.run.dry_run = true;
    const json p = plan.run();
    EXPECT_GT(p["grid"]["expected_peak_bytes"], p["grid"]["expected_bytes"]);
    EXPECT_FALSE(fs::exists(plan.options.run.output));
    // What it said came true, but for leaves that a coarse hull cannot foresee.
    plan.options.run.dry_run = false;
    const json done = plan.run();
    EXPECT_NEAR(p["grid"]["expected_leaves"].get<double>(), done["grid"]["leaves"].get<double>(), 0.1 * done["grid"]["leaves"].get<double>());
}

// Masks made from photographs are made once, as long as what is found from all of them together stays.
TEST(Pipeline, MasksOfKnownPhotographsAreNotMadeAgain) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5, 6, 7}) a.arrive(n);
    a.options.mask.method = MaskMethod::Command;
    const fs::path log = a.folder / "log", tool = a.folder / "tool.sh";
    write_text(tool, "#!/bin/sh\necho made >> " + log.string() + "\ncp \"$(dirname \"$1\")/../masks/$(basename \"$1\" | sed 's/\\.[a-z]*$/.png/')\" \"$2\"\n");
    fs::permissions(tool, fs::perms::owner_all);
    a.options.mask.command = tool.string() + " {in} {out}";
    a.options.run.last_stage = LastStage::Mask;
    const auto made = [&] {
        const std::string text = read_text(log);
        return std::count(text.begin(), text.end(), '\n');
    };
    a.run(a.options);
    EXPECT_EQ(made(), 8);
    const std::string known = a.bytes("out/masks/" + fs::path(a.names[3]).stem().string() + ".png");
    fs::remove_all(a.folder / "out/stages/mask_command");  // it has a memory of its own
    a.arrive(8);
    a.run(a.options);
    EXPECT_EQ(made(), 9);
    EXPECT_EQ(known, a.bytes("out/masks/" + fs::path(a.names[3]).stem().string() + ".png"));
    // One that was damaged in the meantime is made again.
    for (const auto& entry : fs::directory_iterator(a.folder / "out/stages"))
        if (entry.path().filename().string().rfind("mask-", 0) == 0) write_text(entry.path() / "3.png", "no picture");
    fs::remove_all(a.folder / "out/stages/mask_command");
    fs::remove(a.folder / ("scene/images/" + a.names[0]));
    a.run(a.options);
    EXPECT_EQ(made(), 10);
    EXPECT_EQ(known, a.bytes("out/masks/" + fs::path(a.names[3]).stem().string() + ".png"));
}

}  // namespace
}  // namespace vdbcarve::test
