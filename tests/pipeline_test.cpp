// SPDX-License-Identifier: Apache-2.0
// The whole job on a synthetic shoot, and the shoot itself.
#include "vdbcarve/pipeline.h"

#include <chrono>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "image/image_io.h"
#include "base/statistics.h"
#include "support/dented_ball.h"
#include "support/scenes.h"
#include "vdbcarve/app/bundle.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/app/report.h"
#include "vdbcarve/app/watch.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct Job {
    TemporaryFolder folder;
    ReconstructOptions options;

    explicit Job(const char* object = "ellipsoids", bool photos = false) {
        SyntheticSpec spec = small_spec(object, 8, 160, 120);
        spec.photos = photos;
        Progress quiet;
        write_scene(synthesize(spec, quiet), folder / "scene");
        options.views.scene = folder / "scene";
        options.run.output = folder / "out";
        options.grid.resolution = 64;
        options.result.mesh_formats = {"ply", "obj", "stl"};
    }
    Reconstruction last;

    json run() {
        Progress progress;
        last = reconstruct(options, progress);
        return json::parse(last.report_json);
    }
    static bool reused(const json& report, const std::string& stage) {
        for (const json& s : report["stages"])
            if (s["name"] == stage) return s["reused"];
        ADD_FAILURE() << "no stage " << stage;
        return false;
    }
    std::string bytes(const std::string& name) const { return read_text(folder / ("out/" + name)); }
};

const char* const kFiles[] = {"volume.vdb", "mesh.ply", "mesh.obj", "mesh.stl", "cameras.json", "preview.png"};

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
    EXPECT_EQ(names, (std::vector<std::string>{"views", "mask", "distance", "carve", "level_set", "color", "filter", "mesh", "smooth", "export"}));
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
        if (e.path().filename().string().rfind("surface-", 0) == 0) fs::remove(e.path());
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
        if (e.path().filename() == lost || (e.path().extension() == ".json" && e.path().filename().string().rfind("hull-", 0) == 0)) fs::remove(e.path());
    job.run();
    EXPECT_TRUE(fs::exists(job.folder / "bricks/hull_bricks" / lost));
    // The whole job says what it needs instead of trying.
    job.options.run.last_stage = LastStage::Export;
    EXPECT_NE(error_of(ExitCode::Usage, [&] { job.run(); }).find("--memory-limit"), std::string::npos);
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

TEST(Pipeline, ColoursReachVolumeMeshAndReport) {
    Job job("ellipsoids", true);
    job.options.result.dcc = Dcc::Houdini;
    job.options.result.views_grid = job.options.result.confidence_grid = true;
    job.options.color.leave_out = 4;
    const json r = job.run();
    std::set<std::string> names;
    openvdb::Vec3SGrid::Ptr color;
    for (const auto& grid : read_vdb(job.folder / "out/volume.vdb")) {
        names.insert(grid->getName());
        if (grid->getName() == "Cd") color = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grid);
    }
    EXPECT_EQ(names, (std::set<std::string>{"surface", "density", "Cd", "views", "confidence"}));
    ASSERT_TRUE(color);
    // PLY and OBJ say the same, and what the volume says at the vertices, to their precision.
    const Mesh ply = read_mesh(job.folder / "out/mesh.ply"), obj = read_mesh(job.folder / "out/mesh.obj");
    ASSERT_EQ(ply.colors.size(), ply.vertices.size());
    ASSERT_EQ(obj.colors.size(), obj.vertices.size());
    Mesh sampled = ply;
    EXPECT_EQ(color_vertices(sampled, *color), 0u);
    std::set<uint8_t> shades;
    for (size_t v = 0; v < ply.colors.size(); ++v)
        for (size_t c = 0; c < 3; ++c) {
            const uint8_t expected = srgb8_from_linear(sampled.colors[v][c]);
            ASSERT_EQ(srgb8_from_linear(ply.colors[v][c]), expected);
            ASSERT_EQ(srgb8_from_linear(obj.colors[v][c]), expected);
            shades.insert(expected);
        }
    EXPECT_GT(shades.size(), 30u);
    EXPECT_GT(r["color"]["seen_share"], 0.5);
    size_t left_out = 0;
    for (const json& v : r["views"]) {
        left_out += !v["color_used"].get<bool>();
        EXPECT_EQ(v["exposure_gain"].size(), 3u);
    }
    EXPECT_EQ(left_out, 2u);
    EXPECT_TRUE(read_mesh(job.folder / "out/mesh.stl").colors.empty());

    // Again: nothing to do. Another mode: from colour on. None: no colour anywhere.
    EXPECT_TRUE(Job::reused(job.run(), "color"));
    const std::string before = job.bytes("mesh.ply");
    job.options.color.options.mode = ColorMode::Best;
    const json best = job.run();
    EXPECT_TRUE(Job::reused(best, "level_set"));
    EXPECT_FALSE(Job::reused(best, "color"));
    EXPECT_FALSE(Job::reused(best, "mesh"));
    EXPECT_NE(job.bytes("mesh.ply"), before);
    job.options.color.options.mode = ColorMode::Blend;
    EXPECT_TRUE(Job::reused(job.run(), "mesh"));
    EXPECT_EQ(job.bytes("mesh.ply"), before);
    job.options.color.from_photos = true;
    job.run();
    EXPECT_EQ(read_mesh(job.folder / "out/mesh.ply").colors.size(), ply.vertices.size());
    job.options.color.options.mode = ColorMode::None;
    job.run();
    EXPECT_TRUE(read_mesh(job.folder / "out/mesh.ply").colors.empty());
}

TEST(Pipeline, ColoursFromOnePhotographAtATimeAreTheSame) {
    Job job("torus", true);
    job.run();
    const std::string volume = job.bytes("volume.vdb"), mesh = job.bytes("mesh.ply");
    fs::remove_all(job.folder / "out");
    job.options.color.options.batch = 1;
    job.run();
    EXPECT_EQ(job.bytes("volume.vdb"), volume);
    EXPECT_EQ(job.bytes("mesh.ply"), mesh);
}

TEST(Pipeline, APhotographThatCannotBeReadGivesNoColourAndIsNamed) {
    Job job("ellipsoids", true);
    write_text(job.folder / "scene/images/0003.png", read_text(job.folder / "scene/images/0003.png").substr(0, 100));
    const json r = job.run();
    bool named = false;
    for (const json& w : r["warnings"]) named |= w.get<std::string>().find("0003.png") != std::string::npos;
    EXPECT_TRUE(named) << r["warnings"];
    EXPECT_EQ(r["views"][3]["color_used"], false);
    EXPECT_EQ(r["views"][2]["color_used"], true);
    EXPECT_FALSE(read_mesh(job.folder / "out/mesh.ply").colors.empty());
}

// Carving needs masks only: a photograph of another size gives no colour, with a lens or without.
TEST(Pipeline, APhotographOfAnotherSizeGivesNoColourAndIsNamed) {
    for (const bool lens : {false, true}) {
        TemporaryFolder folder;
        SyntheticSpec spec = small_spec("ellipsoids", 8, 160, 120);
        if (lens) {
            spec.rig.lens.model = Lens::Model::OpenCV;
            spec.rig.lens.coefficients = {-0.1, 0.02, 0.001, -0.001};
        }
        Progress progress;
        write_scene(synthesize(spec, progress), folder / "scene");
        const auto small = io::encode_png(Image8(80, 60, 3, 90));
        write_text(folder / "scene/images/0003.png", std::string(small.begin(), small.end()));
        ReconstructOptions o;
        o.views.scene = folder / "scene";
        o.run.output = folder / "out";
        o.grid.resolution = 48;
        json r;
        try {
            r = json::parse(reconstruct(o, progress).report_json);
        } catch (const InputError& e) {
            // The views' own check of sizes may come first; it names the picture too.
            EXPECT_NE(std::string(e.what()).find("0003.png"), std::string::npos) << e.what();
            continue;
        }
        EXPECT_EQ(r["views"][3]["color_used"], false);
        bool named = false;
        for (const json& w : r["warnings"]) named |= w.get<std::string>().find("80 x 60") != std::string::npos;
        EXPECT_TRUE(named) << r["warnings"];
    }
}

TEST(Pipeline, AShapeWithoutReadablePhotographsStandsWithoutColour) {
    Job job("ellipsoids", true);
    for (int i = 0; i < 8; ++i) {
        const fs::path file = job.folder / ("scene/images/000" + std::to_string(i) + ".png");
        write_text(file, read_text(file).substr(0, 100));
    }
    const json r = job.run();
    EXPECT_TRUE(r["mesh"]["manifold"]);
    EXPECT_TRUE(read_mesh(job.folder / "out/mesh.ply").colors.empty());
    bool said = false;
    for (const json& w : r["warnings"]) said |= w.get<std::string>().find("no colour") != std::string::npos;
    EXPECT_TRUE(said) << r["warnings"];
}

TEST(Pipeline, OccupancyWithColoursFromTheImages) {
    Job job("torus", true);
    job.options.carve.occupancy = true;
    job.options.color.from_photos = true;
    const json r = job.run();
    EXPECT_GT(r["color"]["vertices_seen_share"], 0.5);
    // Said again when the mesh is there already.
    EXPECT_GT(job.run()["color"]["vertices_seen_share"], 0.5);
}

TEST(Pipeline, RenderingsAreComparedWithPhotographs) {
    Job job("ellipsoids", true);
    job.options.color.leave_out = 4;
    job.options.grid.resolution = 96;
    job.run();
    Progress quiet;
    ViewsOptions o;
    o.scene = job.folder / "scene";
    const Views views = load_views(o, quiet);
    const Mesh mesh = read_mesh(job.folder / "out/mesh.ply");
    const auto mean = [&](bool from_volume, bool used) {
        double sum = 0;
        int count = 0;
        for (const PhotoComparison& c : compare_photos(mesh, views, {job.folder / "out", from_volume, job.folder / "pictures"}, quiet))
            if (c.used == used) {
                sum += c.agreement.psnr_db;
                ++count;
                EXPECT_GT(c.agreement.pixels, 500u);
                EXPECT_GT(c.agreement.ssim, 0.5);
            }
        EXPECT_EQ(count, used ? 6 : 2);
        return sum / count;
    };
    EXPECT_GT(mean(false, true), 24);
    EXPECT_GT(mean(false, false), 20);
    EXPECT_NEAR(mean(true, true), mean(false, true), 1.5);
    EXPECT_EQ(std::distance(fs::directory_iterator(job.folder / "pictures"), {}), 8);
    // A picture against itself, and against itself made darker.
    const Photo photo = load_photo(views.views[0]);
    Image8 same(160, 120, 4, 255);
    for (int y = 0; y < 120; ++y)
        for (int x = 0; x < 160; ++x)
            for (int c = 0; c < 3; ++c) same.at(x, y, c) = photo.pixels8.at(x, y, c);
    const PhotoAgreement exact = compare_photo(same, view_of(photo), {});
    EXPECT_TRUE(std::isinf(exact.psnr_db));
    EXPECT_NEAR(exact.ssim, 1, 1e-9);
    Image8 darker = same;
    for (size_t n = 0; n < darker.data.size(); ++n)
        if (n % 4 != 3) darker.data[n] = static_cast<uint8_t>(std::max(0, darker.data[n] - 10));
    EXPECT_NEAR(compare_photo(darker, view_of(photo), {}).psnr_db, 20 * std::log10(25.5), 0.1);
}

// A changed filter redoes the filter and what follows, smoothing only itself; and files are the same bytes whether stages ran or were found.
TEST(Pipeline, FilterMeshAndSmoothAreStagesOfTheirOwn) {
    Job job("ellipsoids", true);
    job.options.result.mesh_formats = {"ply", "glb"};
    const json soft = job.run();
    EXPECT_EQ(soft["filter"]["chain"], "none");
    EXPECT_GT(soft["filter"]["mask_softness"], 0.5);
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
    for (const auto& entry : fs::directory_iterator(job.folder / "out/stages"))
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

TEST(Pipeline, TheFootIsCutFlatAndWhatNobodySawIsNamed) {
    Job job("boxes");
    const json hull = job.run();
    EXPECT_GT(hull["extrapolated"]["bottom_beyond"], 3 * hull["grid"]["voxel_size"].get<double>());
    EXPECT_GT(hull["extrapolated"]["area_share"], 0.02);
    EXPECT_FALSE(hull["extrapolated"].contains("top_beyond_mm"));
    EXPECT_NE(job.bytes("mesh.ply").find("property uchar extrapolated"), std::string::npos);
    job.options.floor.flat_base = true;
    job.options.views.units = "cm";
    const json flat = job.run();
    EXPECT_LT(flat["extrapolated"]["bottom_beyond"], 0.7 * flat["grid"]["voxel_size"].get<double>());
    EXPECT_NEAR(flat["extrapolated"]["bottom_beyond_mm"].get<double>(), 10 * flat["extrapolated"]["bottom_beyond"].get<double>(), 1e-9);
    EXPECT_LT(flat["mesh"]["volume"], hull["mesh"]["volume"]);
    EXPECT_TRUE(flat["mesh"]["manifold"]);
}

TEST(Pipeline, AFilmIsAScene) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 60, 160, 120);
    spec.look.film_rate_hz = 20;
    spec.look.backdrop = Vec3d(0.05, 0.45, 0.1);
    Progress quiet;
    write_scene(synthesize(spec, quiet), folder / "scene");
    ReconstructOptions o;
    o.views.scene = folder / "scene/film.mp4";
    o.video.frames = 20;
    o.mask.method = MaskMethod::Chroma;
    o.run.last_stage = LastStage::Mask;
    o.run.output = folder / "out";
    const auto run = [&] {
        Progress progress;
        return json::parse(reconstruct(o, progress).report_json);
    };
    const json first = run();
    ASSERT_EQ(first["video"]["frames"].size(), 20u);
    EXPECT_FALSE(Job::reused(first, "views"));
    const std::string name = first["video"]["frames"][7]["name"];
    EXPECT_TRUE(fs::exists(folder / ("out/masks/" + name)));
    EXPECT_TRUE(Job::reused(run(), "views"));
    o.video.frames = 10;
    EXPECT_FALSE(Job::reused(run(), "views"));
    // Cameras that belong to the frames are found again beside them.
    o.video.frames = 20;
    Views posed;
    {
        ViewsOptions v;
        for (const auto& entry : fs::directory_iterator(folder / "out/stages"))
            if (entry.path().filename().string().rfind("frames-", 0) == 0 && read_video_json(entry.path() / "frames.json").frames.size() == 20)
                v.scene = entry.path();
        v.allow_unposed = true;
        posed = load_views(v, quiet);
        const SyntheticScene truth = synthesize(spec, quiet);
        for (size_t i = 0; i < 20; ++i) posed.views[i].camera = truth.views.views[first["video"]["frames"][i]["index"].get<size_t>()].camera;
    }
    write_text(folder / "cameras.json", cameras_json(posed));
    o.views.cameras = folder / "cameras.json";
    o.run.last_stage = LastStage::Export;
    o.run.output = folder / "model";
    o.grid.resolution = 64;
    const json model = run();
    EXPECT_GT(model["silhouette_iou"]["median"], 0.96);  // of 120 lines, as the film's compression left them
    EXPECT_TRUE(model["mesh"]["manifold"]);
    // And from the result on, for other programs.
    const Views again = result_views(folder / "model", {}, quiet);
    ASSERT_EQ(again.views.size(), 20u);
    EXPECT_TRUE(fs::exists(again.views[3].image_path));
    o.run.dry_run = true;
    EXPECT_THROW(run(), UsageError);
}

// A hull of masks and cameras that do not belong together is written, to be looked at, but not called done.
TEST(Pipeline, AResultThatMostViewsContradictIsNotDone) {
    Job job("boxes");
    job.run();
    EXPECT_EQ(job.last.contradiction, "");
    const auto mask = [&](const char* called, int i) { return job.folder / fs::path("scene/masks/" + std::string(called) + std::to_string(i) + ".png"); };
    for (int i = 0; i < 8; ++i) fs::rename(mask("000", i), mask("m", i));
    for (int i = 0; i < 8; ++i) fs::rename(mask("m", i), mask("000", 3 * i % 8));
    job.run();
    EXPECT_LT(job.last.median_iou, 0.9);
    EXPECT_NE(job.last.contradiction.find("vdbcarve check"), std::string::npos);
    EXPECT_TRUE(fs::exists(job.folder / "out/mesh.ply"));
    // Whoever has the files only is told, too.
    EXPECT_EQ(json::parse(job.last.report_json)["contradiction"], job.last.contradiction);
    Progress quiet;
    EXPECT_NE(report_html(job.folder / "out", {}, quiet).find("contradict each other</b>"), std::string::npos);
}

TEST(Pipeline, AFloorThatTakesALegOffIsSaid) {
    Job job("ellipsoids");
    job.options.views.up = "z";
    job.options.floor.from = FloorOptions::From::Given;
    job.options.floor.height = 0;
    const json r = job.run();
    EXPECT_NE(r["warnings"].dump().find("--floor 0 leaves out"), std::string::npos) << r["warnings"];
}

TEST(Pipeline, UpAgainstTheCamerasIsSaid) {
    Job job("cup");
    job.options.views.up = "-z";
    EXPECT_NE(job.run()["warnings"].dump().find("--up z"), std::string::npos);
}

// One file, nothing fetched: every view with its photograph, worst first, the model in it, every warning.
TEST(Pipeline, AReportSaysWhatTheResultIs) {
    Job job("cup", true);
    job.options.views.up = "-z";  // is warned of
    const json r = job.run();
    Progress quiet;
    const std::string page = report_html(job.folder / "out", {}, quiet);
    // The job writes it, too: but for the model, whose colours it has before they are rounded for a file.
    const auto without_data = [](std::string text) {
        for (const char* kind : {"data:model", "data:image/png"})
            for (size_t from; (from = text.find(kind)) != std::string::npos;) text.erase(from, text.find('"', from) - from);
        return text;
    };
    EXPECT_TRUE(without_data(page) == without_data(job.bytes("report.html")));
    EXPECT_LT(page.size(), 25'000'000u);
    size_t at = page.find("worst first");
    ASSERT_NE(at, std::string::npos);
    std::vector<std::pair<double, std::string>> worst;
    for (const json& v : r["views"]) worst.emplace_back(v["silhouette_iou"], v["name"]);
    std::sort(worst.begin(), worst.end());
    for (const auto& [iou, name] : worst) {
        at = page.find("alt=\"" + name + "\" src=\"data:image/jpeg;base64,", at);
        ASSERT_NE(at, std::string::npos) << name;
    }
    EXPECT_NE(page.find("up is said to be -z"), std::string::npos);
    EXPECT_EQ(page.find("data:model/gltf-binary;base64,") != std::string::npos, report_has_viewer());
    EXPECT_NE(page.find("data:image/png;base64,"), std::string::npos);
    // Nothing of ours points outside. (The viewer's own text names its decoders' homes, which it asks only for compressed models.)
    const std::string ours = page.substr(page.find("<body>"));
    EXPECT_EQ(ours.find("http"), std::string::npos);
    ReportOptions small;
    small.most_faces = 0;
    small.most_photos = 3;
    const std::string less = report_html(job.folder / "out", small, quiet);
    EXPECT_EQ(less.find("gltf-binary;base64"), std::string::npos);
    EXPECT_NE(less.find("5 more views"), std::string::npos);
    EXPECT_THROW(report_html(job.folder / "scene", {}, quiet), InputError);
}

/// Photographs and masks of a shoot, to be put into a scene one after another.
struct Arrivals {
    TemporaryFolder folder;
    std::vector<std::string> names;
    ReconstructOptions options;

    explicit Arrivals(bool truncated = false, int views = 9) {
        SyntheticSpec spec = small_spec("cup", views, 160, 120);
        if (truncated) spec.rig.fill = 1.35;
        Progress quiet;
        write_scene(synthesize(spec, quiet), folder / "all");
        for (const auto& entry : fs::directory_iterator(folder / "all/images")) names.push_back(entry.path().filename().string());
        std::sort(names.begin(), names.end());
        fs::create_directories(folder / "scene/images");
        fs::create_directories(folder / "scene/masks");
        fs::copy_file(folder / "all/transforms.json", folder / "scene/transforms.json");
        options.views.scene = folder / "scene";
        options.views.allow_missing = options.mask.allow_missing = true;
        options.run.output = folder / "out";
        options.grid.resolution = 56;
        options.result.mesh_formats = {"ply"};
        options.result.report = false;
    }
    /// The mask first: a photograph without one would be left out until it comes.
    void arrive(size_t n) const {
        const std::string mask = fs::path(names[n]).stem().string() + ".png";
        fs::copy_file(folder / ("all/masks/" + mask), folder / ("scene/masks/" + mask), fs::copy_options::overwrite_existing);
        fs::copy_file(folder / ("all/images/" + names[n]), folder / ("scene/images/" + names[n]), fs::copy_options::overwrite_existing);
    }
    json run(const ReconstructOptions& o) const {
        Progress progress;
        return json::parse(reconstruct(o, progress).report_json);
    }
    /// All views at once, with the bounds and voxels of `report`.
    ReconstructOptions batch(const json& report) const {
        ReconstructOptions o = options;
        const auto b = report["grid"]["bounds"].get<std::array<double, 6>>();
        o.grid.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
        o.grid.resolution = 0;
        o.grid.dims.reset();
        o.grid.voxel_size = report["grid"]["voxel_size"].get<double>();
        const auto at = report["grid"]["origin"].get<std::array<double, 3>>();
        o.grid.origin = Vec3d(at[0], at[1], at[2]);
        o.run.output = folder / "batch";
        o.views.added.clear();
        return o;
    }
    /// Bytes of the raw hull in a result's stages.
    std::string hull(const fs::path& out) const {
        std::vector<fs::path> found;
        for (const auto& entry : fs::directory_iterator(out / "stages"))
            if (entry.path().filename().string().rfind("hull-", 0) == 0 && entry.path().extension() == ".vdb") found.push_back(entry.path());
        EXPECT_EQ(found.size(), 1u) << out;  // those of fewer views are gone
        return found.empty() ? "" : read_text(found.front());
    }
    std::string bytes(const std::string& name) const { return read_text(folder / name); }
};

// Views added one by one, in several orders, with and without allowed misses and frames that cut the object: the hull, and all that follows from it, are those
// of carving all of them at once.
TEST(Pipeline, AddedViewsGiveWhatAllAtOnceGive) {
    for (const int variant : {0, 1, 2}) {
        Arrivals a(variant == 2);
        a.options.carve.max_misses = variant == 1;
        const std::vector<size_t> order = variant == 0 ? std::vector<size_t>{4, 7, 1, 8, 0, 6, 2, 5, 3} : std::vector<size_t>{0, 3, 6, 1, 4, 7, 2, 5, 8};
        ReconstructOptions adding = a.options;
        json last;
        for (size_t n = 0; n < order.size(); ++n) {
            a.arrive(order[n]);
            if (n < 3) continue;
            if (n > 3) adding.views.added = {a.options.views.scene};
            last = a.run(adding);
            if (n == 5) last = a.run(adding);  // nothing new: nothing happens
            EXPECT_TRUE(n != 5 || Job::reused(last, "carve"));
            EXPECT_TRUE(n == 5 || !Job::reused(last, "carve"));
        }
        ASSERT_EQ(last["views"].size(), order.size());
        const json whole = a.run(a.batch(last));
        EXPECT_EQ(whole["grid"]["dims"], last["grid"]["dims"]);
        EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out")) << "variant " << variant;
        for (const char* file : {"volume.vdb", "mesh.ply", "preview.png", "cameras.json"})
            EXPECT_EQ(a.bytes(std::string("batch/") + file), a.bytes(std::string("out/") + file)) << file << " of variant " << variant;
    }
}

TEST(Pipeline, AddingSaysWhatItCannotKeep) {
    Arrivals a;
    for (size_t n = 0; n < 6; ++n) a.arrive(n);
    a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    Progress quiet;
    o.grid.resolution = 57;
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    o.grid.resolution = 56;
    o.grid.bounds = Box3d(Vec3d(-1, -1, -1), Vec3d(1, 1, 1));
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    o.grid.bounds.reset();
    // A view that moved makes its old bounds worthless, which is said, and carved anew.
    json cameras = json::parse(read_text(a.folder / "scene/transforms.json"));
    for (json& f : cameras["frames"]) f["transform_matrix"][0][3] = f["transform_matrix"][0][3].get<double>() + 0.01;
    write_text(a.folder / "scene/transforms.json", cameras.dump());
    std::string said;
    quiet.on_warning = [&](const std::string& text) { said += text + "\n"; };
    reconstruct(o, quiet);
    EXPECT_NE(said.find("its cameras are others"), std::string::npos) << said;
}

// A second folder of photographs in the same world: its masks are looked for in it, its views are taken too.
TEST(Pipeline, ASecondSceneIsAdded) {
    Arrivals a;
    const auto move_to = [&](const std::string& scene, const std::vector<size_t>& views, const std::string& prefix) {
        json cameras = json::parse(read_text(a.folder / "all/transforms.json")), part = cameras;
        part["frames"] = json::array();
        fs::create_directories(a.folder / (scene + "/images"));
        fs::create_directories(a.folder / (scene + "/masks"));
        for (const size_t n : views) {
            const std::string stem = fs::path(a.names[n]).stem().string();
            for (json f : cameras["frames"])
                if (fs::path(f["file_path"].get<std::string>()).filename() == a.names[n]) {
                    f["file_path"] = "images/" + prefix + a.names[n];
                    part["frames"].push_back(f);
                }
            fs::copy_file(a.folder / ("all/images/" + a.names[n]), a.folder / (scene + "/images/" + prefix + a.names[n]));
            fs::copy_file(a.folder / ("all/masks/" + stem + ".png"), a.folder / (scene + "/masks/" + prefix + stem + ".png"));
        }
        write_text(a.folder / (scene + "/transforms.json"), part.dump());
    };
    move_to("first", {0, 2, 4, 6, 8}, "");
    move_to("second", {1, 3, 5, 7}, "b");
    move_to("clash", {1, 2}, "");
    a.options.views.scene = a.folder / "first";
    const json before = a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.folder / "second"};
    const json both = a.run(o);
    EXPECT_EQ(both["views"].size(), 9u);
    EXPECT_EQ(both["grid"]["bounds"], before["grid"]["bounds"]);
    for (const json& v : both["views"]) EXPECT_GT(v["silhouette_iou"], 0.97) << v;
    // The page finds the photographs of both.
    Progress quiet;
    const Views found = result_views(a.folder / "out", {}, quiet);
    for (const View& v : found.views) EXPECT_FALSE(v.image_path.empty()) << v.name;
    o.views.added = {a.folder / "first"};
    EXPECT_THROW(reconstruct(o, quiet), UsageError);  // the second's views would be lost
    o.views.added = {a.folder / "clash"};
    EXPECT_THROW(reconstruct(o, quiet), InputError);  // two photographs called alike
    fs::remove(a.folder / "second/transforms.json");
    o.views.added = {a.folder / "second"};
    EXPECT_THROW(reconstruct(o, quiet), InputError);  // nobody says where they were taken
}

TEST(Watch, PhotographsBecomeAResultWhileTheyArrive) {
    Arrivals a(false, 8);
    const auto half_written = [&](size_t n) {
        const std::string whole = a.bytes("all/images/" + a.names[n]);
        write_text(a.folder / ("scene/images/" + a.names[n]), whole.substr(0, whole.size() / 2));
    };
    WatchOptions w;
    w.reconstruct = a.options;
    w.settle_s = 0.4;
    w.poll_s = 0.05;
    w.until_views = a.names.size();
    std::vector<size_t> sizes;
    size_t extended = 0;
    w.on_result = [&](const Reconstruction& r) {
        sizes.push_back(r.views);
        extended += r.added_views;
    };
    std::thread camera([&] {
        for (const size_t n : {3, 1, 5, 0}) a.arrive(n);
        std::this_thread::sleep_for(std::chrono::seconds(3));
        half_written(2);  // goes on being written for longer than the watch takes to look
        for (int i = 0; i < 6; ++i) {
            std::this_thread::sleep_for(std::chrono::milliseconds(150));
            std::ofstream(a.folder / ("scene/images/" + a.names[2]), std::ios::app) << "x";
        }
        a.arrive(2);
        for (const size_t n : {7, 4, 6}) {
            std::this_thread::sleep_for(std::chrono::milliseconds(1500));
            a.arrive(n);
        }
    });
    Progress progress;
    const Reconstruction last = watch(w, progress);
    camera.join();
    EXPECT_EQ(last.views, a.names.size());
    ASSERT_GE(sizes.size(), 2u);
    EXPECT_EQ(sizes.front(), 4u);
    EXPECT_TRUE(std::is_sorted(sizes.begin(), sizes.end()));
    EXPECT_GT(extended, 0u);
    const json report = json::parse(last.report_json);
    a.run(a.batch(report));
    EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out"));
    EXPECT_EQ(a.bytes("batch/mesh.ply"), a.bytes("out/mesh.ply"));
}

// Masks made from the photographs themselves: one that was written badly is named and left out, and holds nobody up.
TEST(Watch, ADamagedPhotographHoldsUpNobody) {
    Arrivals a;
    fs::remove_all(a.folder / "scene/masks");
    const auto arrive = [&](size_t n) {
        fs::copy_file(a.folder / ("all/images/" + a.names[n]), a.folder / ("scene/images/" + a.names[n]), fs::copy_options::overwrite_existing);
    };
    for (const size_t n : {0, 2, 4, 6}) arrive(n);
    const std::string whole = a.bytes("all/images/" + a.names[1]);
    write_text(a.folder / ("scene/images/" + a.names[1]), whole.substr(0, whole.size() / 2));
    arrive(8);
    write_text(a.folder / "scene/images/stranger.png", whole);
    WatchOptions w;
    w.reconstruct = a.options;
    w.reconstruct.mask.method = MaskMethod::Threshold;
    w.settle_s = 0.1;
    w.poll_s = 0.05;
    w.idle_s = 0.5;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
    size_t views = 0;
    w.on_result = [&](const Reconstruction& r) { views = r.views; };
    Progress progress;
    try {
        watch(w, progress);
        FAIL() << "a photograph is missing from the result";
    } catch (const InputError& e) {
        EXPECT_NE(std::string(e.what()).find(a.names[1]), std::string::npos) << e.what();
    }
    EXPECT_EQ(views, 5u);
    std::string said;
    for (const std::string& warning : progress.warnings()) said += warning + "\n";
    EXPECT_NE(said.find(a.names[1]), std::string::npos) << said;
    EXPECT_NE(said.find("stranger.png"), std::string::npos) << said;
    arrive(1);
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
    w.until_views = 7;
    EXPECT_THROW(watch(w, progress), InputError);  // 6 have come
    EXPECT_EQ(views, 6u);
    w.until_views = 6;
    EXPECT_EQ(watch(w, progress).views, 6u);
}

TEST(Watch, EndsWhenNothingComesAndSaysWhatWasWrong) {
    Arrivals a;
    WatchOptions w;
    w.reconstruct = a.options;
    w.settle_s = 0.1;
    w.poll_s = 0.05;
    w.idle_s = 0.5;
    Progress quiet;
    EXPECT_THROW(watch(w, quiet), InputError);  // nothing at all
    for (size_t n = 0; n < 5; ++n) a.arrive(n);
    write_text(a.folder / ("scene/masks/" + fs::path(a.names[2]).stem().string() + ".png"), "no picture");
    EXPECT_THROW(watch(w, quiet), InputError);
    a.arrive(2);
    EXPECT_EQ(watch(w, quiet).views, 5u);
    // What is empty for good holds nothing up, nor does a folder of another kind.
    write_text(a.folder / "scene/images/.keep", "");
    write_text(a.folder / ("scene/images/" + fs::path(a.names[1]).stem().string() + ".lock"), "");
    // Another watch goes on from there.
    a.arrive(5);
    const auto settle = [] { std::this_thread::sleep_for(std::chrono::milliseconds(300)); };
    settle();
    EXPECT_EQ(watch(w, quiet).added_views, 1u);
    // Something broken, and nothing else comes.
    write_text(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"), "no picture");
    fs::copy_file(a.folder / ("all/images/" + a.names[6]), a.folder / ("scene/images/" + a.names[6]));
    settle();
    WatchOptions broken = w;
    broken.reconstruct.run.output = a.folder / "broken";
    EXPECT_THROW(watch(broken, quiet), InputError);
    fs::remove(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"));
    EXPECT_EQ(watch(broken, quiet).views, 6u);
    // Photographs and masks elsewhere, by whatever path.
    fs::rename(a.folder / "scene/images", a.folder / "photographs");
    fs::create_directory_symlink(a.folder / "photographs", a.folder / "link");
    broken.reconstruct.views.images = a.folder / "link";
    broken.reconstruct.run.output = a.folder / "elsewhere";
    EXPECT_EQ(watch(broken, quiet).views, 6u);
    w.reconstruct.views.scene = a.folder / "nowhere";
    EXPECT_THROW(watch(w, quiet), InputError);
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
        if (entry.path().filename().string().rfind("masks-", 0) == 0) write_text(entry.path() / "3.png", "no picture");
    fs::remove_all(a.folder / "out/stages/mask_command");
    fs::remove(a.folder / ("scene/images/" + a.names[0]));
    a.run(a.options);
    EXPECT_EQ(made(), 10);
    EXPECT_EQ(known, a.bytes("out/masks/" + fs::path(a.names[3]).stem().string() + ".png"));
}

// Two photographs, and their masks, with the same bytes are two views all the same.
TEST(Pipeline, ViewsThatAreAlikeAreAdded) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4}) a.arrive(n);
    for (const char* part : {"images/", "masks/"}) {
        const auto name = [&](size_t n) {
            return a.folder / (std::string("scene/") + part + (part[0] == 'i' ? a.names[n] : fs::path(a.names[n]).stem().string() + ".png"));
        };
        fs::copy_file(name(0), name(8), fs::copy_options::overwrite_existing);
    }
    a.options.color.options.mode = ColorMode::None;
    a.options.carve.max_misses = 1;
    a.run(a.options);
    a.arrive(5);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    Progress quiet;
    EXPECT_EQ(reconstruct(o, quiet).views, 7u);
}

// What was asked for in other words is not made again: the hull of the first run is the one that is kept, and its config.toml repeats it elsewhere.
TEST(Pipeline, AddingNothingRedoesNothing) {
    for (const bool by_grid : {false, true}) {
        Arrivals a;
        for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
        if (by_grid) {
            a.options.grid.resolution = 0;
            a.options.grid.dims = {56, 48, 40};
        }
        a.options.run.config_text = "reconstruct.scene=\"x\"\nreconstruct.resolution=56\n";
        const json first = a.run(a.options);
        ReconstructOptions o = a.options;
        o.views.added = {a.options.views.scene};
        const json second = a.run(o);
        for (const char* stage : {"mask", "carve", "level_set", "color", "mesh"}) EXPECT_TRUE(Job::reused(second, stage)) << stage;
        EXPECT_EQ(first["grid"]["bounds"], second["grid"]["bounds"]);
        EXPECT_EQ(first["grid"]["bounds_automatic"], second["grid"]["bounds_automatic"]);
        a.arrive(6);
        const json third = a.run(o);
        EXPECT_EQ(first["grid"]["bounds"], third["grid"]["bounds"]);
        const std::string config = a.bytes("out/config.toml");
        EXPECT_EQ(config.find("resolution"), std::string::npos);
        EXPECT_NE(config.find("reconstruct.voxel-size="), std::string::npos);
        EXPECT_NE(config.find("reconstruct.bounds=\""), std::string::npos);
        a.run(a.batch(third));
        EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out"));
    }
}

// Fields of all views together exceed the limit: then views are not added but all are carved, in batches; the same result.
TEST(Pipeline, AddingWithinAMemoryLimit) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    o.run.memory_limit = 1;  // less than the process holds: batches of the least size
    o.run.last_stage = LastStage::Carve;
    a.arrive(6);
    json limited;
    ASSERT_NO_THROW(limited = a.run(o));
    o.run.memory_limit = 0;
    o.run.last_stage = LastStage::Export;
    const json third = a.run(o);
    EXPECT_EQ(limited["grid"]["bounds"], third["grid"]["bounds"]);
    EXPECT_EQ(limited["grid"]["active_voxels"], third["grid"]["active_voxels"]);
}

// Views of another scene that are not named again would be lost silently.
TEST(Pipeline, ViewsThatAreGoneAreNamed) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    fs::remove(a.folder / ("scene/images/" + a.names[2]));
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    const json r = a.run(o);
    bool said = false;
    for (const std::string w : r["warnings"])
        said |= w.find(fs::path(a.names[2]).stem().string()) != std::string::npos && w.find("which is not here") != std::string::npos;
    EXPECT_TRUE(said) << r["warnings"];
}

TEST(Bundle, HoldsASceneThatCarvesAlikeAndNoPhotographs) {
    Job job("cup", true);
    job.options.result.report = true;
    const json r = job.run();
    Progress quiet;
    const fs::path archive = job.folder / "b.tar.gz";
    BundleOptions o;
    o.width_px = 120;
    const size_t bytes = bundle(job.folder / "out", archive, o, quiet);
    EXPECT_EQ(bytes, fs::file_size(archive));
    const std::string first = read_text(archive);
    bundle(job.folder / "out", archive, o, quiet);
    EXPECT_EQ(first, read_text(archive));
    ASSERT_EQ(std::system(("tar xzf '" + archive.string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    const fs::path root = job.folder / "vdbcarve-bundle";
    for (const char* file : {"README.txt", "versions.json", "report.json", "report.html", "config.toml", "scene/cameras.json", "scene/masks/0003.png"})
        EXPECT_EQ(fs::exists(root / file), std::string(file) != "config.toml") << file;  // the library was given no configuration
    EXPECT_FALSE(fs::exists(root / "scene/images"));
    // The photographs' colours are not in it: COLOR_0, in base64 wherever it may begin.
    const auto has_colors = [](const std::string& page) {
        return page.find("Q09MT1Jf") != std::string::npos || page.find("NPTE9SXz") != std::string::npos || page.find("DT0xPUl8w") != std::string::npos;
    };
    EXPECT_FALSE(has_colors(read_text(root / "report.html")));
    EXPECT_EQ(has_colors(job.bytes("report.html")), report_has_viewer());
    EXPECT_EQ(io::read_image8(root / "scene/masks/0003.png").width, 120);
    ReconstructOptions again = job.options;
    again.views.scene = root / "scene";
    again.run.output = job.folder / "again";
    const json second = json::parse(reconstruct(again, quiet).report_json);
    EXPECT_NEAR(second["mesh"]["volume"].get<double>(), r["mesh"]["volume"].get<double>(), 0.02 * r["mesh"]["volume"].get<double>());
    o.photos = true;
    bundle(job.folder / "out", archive, o, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + archive.string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    EXPECT_EQ(io::read_image8(root / "scene/images/0003.jpg").width, 120);
    EXPECT_THROW(bundle(job.folder / "scene", archive, o, quiet), InputError);
}

// A later run that fails on a finished result: the bundle's scene is what that run had.
TEST(Bundle, OfALaterRunThatFailedHasItsScene) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    a.arrive(6);
    fs::copy_file(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"),
                  a.folder / ("scene/masks/" + fs::path(a.names[7]).stem().string() + ".png"));
    fs::copy_file(a.folder / ("all/images/" + a.names[7]), a.folder / ("scene/images/" + a.names[7]));
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    o.grid.bounds = Box3d(Vec3d(50, 50, 50), Vec3d(51, 51, 51));
    Progress quiet;
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    bundle(a.folder / "out", a.folder / "b.tar.gz", {}, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + (a.folder / "b.tar.gz").string() + "' -C '" + a.folder.path().string() + "'").c_str()), 0);
    const json cameras = json::parse(read_text(a.folder / "vdbcarve-bundle/scene/cameras.json"));
    EXPECT_EQ(cameras["frames"].size(), 8u);
}

// Killed before it was done, with cameras that were found and are not to be trusted from before: both are in it.
TEST(Bundle, OfARunThatWasKilledHasItsCameras) {
    Job job("cup");
    job.run();
    for (const char* late : {"report.json", "cameras.json", "config.toml"}) fs::remove(job.folder / "out" / late);
    fs::create_directories(job.folder / "out/unverified");
    write_text(job.folder / "out/unverified/report.json", "{}");
    write_text(job.folder / "out/unverified/preview.png", "shows photographs");
    Progress quiet;
    EXPECT_THROW(bundle(job.folder / "out", job.folder / "b.zip", {}, quiet), UsageError);
    EXPECT_THROW(bundle(job.folder / "nowhere", job.folder / "b.tar.gz", {}, quiet), InputError);
    BundleOptions o;
    o.photos = true;
    for (const bool photos : {false, true}) {
        o.photos = photos;
        fs::remove_all(job.folder / "vdbcarve-bundle");
        bundle(job.folder / "out", job.folder / "b.tar.gz", o, quiet);
        ASSERT_EQ(std::system(("tar xzf '" + (job.folder / "b.tar.gz").string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
        const fs::path root = job.folder / "vdbcarve-bundle";
        EXPECT_TRUE(fs::exists(root / "scene/cameras.json"));
        EXPECT_TRUE(fs::exists(root / "unverified/report.json"));
        EXPECT_EQ(fs::exists(root / "unverified/preview.png"), photos);
        EXPECT_EQ(fs::exists(root / "scene/images"), photos);  // from where the run took them
    }
}

// Of a run that failed: what it failed with, and the scene that it failed on.
TEST(Bundle, OfARunThatFailedSaysWhatWith) {
    Job job("cup");
    job.options.grid.bounds = Box3d(Vec3d(50, 50, 50), Vec3d(51, 51, 51));  // nothing is there
    EXPECT_THROW(job.run(), Error);
    Progress quiet;
    bundle(job.folder / "out", job.folder / "b.tar.gz", {}, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + (job.folder / "b.tar.gz").string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    const json failure = json::parse(read_text(job.folder / "vdbcarve-bundle/failure/failure.json"));
    EXPECT_EQ(failure["failure"]["stage"], "carve");
    EXPECT_NE(failure["failure"]["text"].get<std::string>().find("bounds"), std::string::npos);
    job.options.views.scene = job.folder / "vdbcarve-bundle/scene";
    job.options.run.output = job.folder / "again";
    EXPECT_THROW(job.run(), Error);
    job.options.grid.bounds.reset();
    EXPECT_GT(job.run()["mesh"]["volume"], 0);
    EXPECT_FALSE(fs::exists(job.folder / "again/stages/failure.json"));  // it is mended
}

// A dent that silhouettes do not show: --stereo on takes it out, keeps what it made, and without texture leaves the hull alone.
TEST(Pipeline, ConcavitiesAreCarvedByDepth) {
    TemporaryFolder folder;
    const DentedScene dented(0.9, 24, 160, 48);
    Views views;
    fs::create_directories(folder / "scene/images");
    fs::create_directories(folder / "scene/masks");
    for (size_t v = 0; v < dented.cameras.size(); ++v) {
        View view;
        view.name = "images/" + std::to_string(v) + ".png";
        view.image_path = folder / ("scene/" + view.name);
        view.camera = dented.cameras[v];
        views.views.push_back(view);
        const auto photo = io::encode_png(dented.photos[v].pixels8.view()), mask = io::encode_png(dented.masks[v].coverage.view());
        write_text(view.image_path, std::string(photo.begin(), photo.end()));
        write_text(folder / ("scene/masks/" + std::to_string(v) + ".png"), std::string(mask.begin(), mask.end()));
    }
    views.up = "z";
    write_cameras(views, folder / "scene/cameras.json");
    ReconstructOptions o;
    o.views.scene = folder / "scene";
    o.run.output = folder / "out";
    o.grid.resolution = 48;
    o.result.mesh_formats = {"ply"};
    o.result.report = false;
    Progress quiet;
    const auto run = [&] { return json::parse(reconstruct(o, quiet).report_json); };
    const json hull = run();
    EXPECT_FALSE(hull.contains("stereo"));
    o.stereo.on = true;
    o.stereo.options.scale = 1;
    const json carved = run();
    const double truth = DentedBall().volume();
    EXPECT_GT(hull["mesh"]["volume"], 1.08 * truth);
    EXPECT_LT(carved["mesh"]["volume"], 1.03 * truth);
    EXPECT_GT(carved["mesh"]["volume"], 0.98 * truth);
    EXPECT_TRUE(carved["mesh"]["manifold"]);
    EXPECT_GT(carved["silhouette_iou"]["median"], 0.98);
    EXPECT_GT(carved["stereo"]["trusted_share"], 0.5);
    std::set<std::string> names;
    for (const auto& grid : read_vdb(folder / "out/volume.vdb")) names.insert(grid->getName());
    EXPECT_TRUE(names.count("stereo_confidence")) << names.size();
    const std::string mesh = read_text(folder / "out/mesh.ply");
    const json again = run();
    EXPECT_TRUE(Job::reused(again, "stereo"));
    EXPECT_EQ(read_text(folder / "out/mesh.ply"), mesh);
    EXPECT_GT(io::read_image8(folder / "out/stereo.png").width, 1000);
    EXPECT_FALSE(fs::exists(folder / "out/depth"));
    fs::create_directories(folder / "out/depth");
    write_text(folder / "out/depth/mine.txt", "not ours");
    o.stereo.maps = true;
    EXPECT_FALSE(Job::reused(run(), "stereo"));  // they had not been kept
    EXPECT_TRUE(Job::reused(run(), "stereo"));
    EXPECT_EQ(read_text(folder / "out/mesh.ply"), mesh);
    // Depths in the file are those of lines of sight that meet the ball.
    const cv::Mat depth = cv::imread((folder / "out/depth/0.depth.tiff").string(), cv::IMREAD_UNCHANGED);
    const Image8 sure = io::read_image8(folder / "out/depth/0.confidence.png");
    ASSERT_EQ(depth.type(), CV_32FC1);
    ASSERT_EQ(depth.cols, sure.width);
    std::vector<double> off;
    for (int y = 0; y < depth.rows; ++y)
        for (int x = 0; x < depth.cols; ++x) {
            const float d = depth.at<float>(y, x);
            EXPECT_EQ(d > 0, sure.at(x, y) > 0);
            const Camera& camera = dented.cameras[0];
            const Camera::Ray ray = camera.ray(Vec2d(x + 0.5, y + 0.5));
            if (const auto t = DentedBall().hit(ray); t && d > 0)
                off.push_back(std::fabs(static_cast<double>(d) - (camera.camera_from_world * (ray.origin + *t * ray.direction)).z()));
        }
    ASSERT_GT(off.size(), 1000u);
    EXPECT_LT(median(off), 0.01);
    o.stereo.maps = false;
    run();
    EXPECT_FALSE(fs::exists(folder / "out/depth/0.depth.tiff"));
    EXPECT_TRUE(fs::exists(folder / "out/depth/mine.txt"));
    o.color.leave_out = 2;  // views that are held back are held back from depths, too
    EXPECT_FALSE(Job::reused(run(), "stereo"));
    o.carve.occupancy = true;
    EXPECT_THROW(run(), UsageError);
    o.carve.occupancy = o.stereo.on = false;
    EXPECT_NE(run()["warnings"].dump().find("nothing without --stereo on"), std::string::npos);  // a result's config.toml may say --stereo-scale
    EXPECT_FALSE(fs::exists(folder / "out/stereo.png"));
}

// What silhouettes leave open of the cameras is what depths would be wrong by: texture closes it first.
TEST(Pipeline, CamerasOfStereoAreRefinedByTexture) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 30, 480, 360);
    spec.pattern = Pattern::Checks;
    spec.rig.shake_angle_deg = 2;
    spec.rig.shake_elevation_deg = 2;
    spec.rig.shake_position = spec.rig.shake_look_at = 0.01;
    Progress quiet;
    const SyntheticScene scene = synthesize(spec, quiet);
    write_scene(scene, folder / "scene");
    ReconstructOptions o;
    o.views.scene = folder / "scene";
    o.views.cameras = "none";
    o.run.output = folder / "out";
    o.grid.resolution = 48;
    o.result.mesh_formats = {"ply"};
    o.result.report = false;
    o.run.last_stage = LastStage::Align;
    std::vector<Vec3d> points;
    for (size_t n = 0; n < scene.truth.vertices.size(); n += 50)
        points.emplace_back(scene.truth.vertices[n][0], scene.truth.vertices[n][1], scene.truth.vertices[n][2]);
    const auto error_px = [&](bool stereo, size_t fewest_tracks) {
        o.stereo.on = stereo;
        EXPECT_GE(json::parse(reconstruct(o, quiet).report_json)["align"]["features"]["count"].get<size_t>(), fewest_tracks);
        ViewsOptions found;
        found.scene = folder / "scene";
        found.cameras = folder / "out/cameras.json";
        return compare_cameras(load_views(found, quiet).cameras(), scene.views.cameras(), points).reprojection_rms_px;
    };
    const double silhouettes = error_px(false, 0), texture = error_px(true, 100);
    EXPECT_LT(texture, 0.8 * silhouettes);
    EXPECT_LT(texture, 0.5);
}

TEST(Pipeline, TheTableIsFoundAndWhatLiesOnItGoes) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 24, 400, 300);
    spec.rig.kind = Rig::Kind::Rings;
    spec.rig.rings = {{14, 4}, {14, 22}};
    spec.look.table = true;
    spec.look.table_reflection = 0.3;
    spec.look.plates = true;
    Progress quiet;
    const SyntheticScene scene = synthesize(spec, quiet);
    write_scene(scene, folder / "scene");
    double foot = 1e9, top = -1e9;
    for (const auto& v : scene.truth.vertices) {
        foot = std::min<double>(foot, v[2]);
        top = std::max<double>(top, v[2]);
    }
    ReconstructOptions o;
    o.views.scene = folder / "scene";
    o.result.mesh_formats = {"ply"};
    o.color.options.mode = ColorMode::None;
    o.grid.resolution = 96;
    o.views.up = "z";
    const auto volume = [&](const char* out, const std::function<void(ReconstructOptions&)>& choose) {
        ReconstructOptions chosen = o;
        chosen.run.output = folder / out;
        choose(chosen);
        Progress progress;
        return json::parse(reconstruct(chosen, progress).report_json);
    };
    const json clean = volume("clean", [](ReconstructOptions&) {});
    const auto plates = [&](ReconstructOptions& c) {
        c.mask.method = MaskMethod::CleanPlate;
        c.mask.plate.plate = folder / "scene/plates";
        c.mask.plate.shadows = false;  // they count as object
    };
    const json dirty = volume("dirty", plates);
    // Masks of photographs lose a little at every contour; these lose the same, and know shadows by their colour.
    const json known = volume("known", [&](ReconstructOptions& c) {
        plates(c);
        c.mask.plate.shadows = true;
    });
    const json floor = volume("floor", [&](ReconstructOptions& c) {
        plates(c);
        c.floor.from = FloorOptions::From::Found;
    });
    const double true_volume = clean["mesh"]["volume"], kept = floor["mesh"]["volume"];
    EXPECT_GT(dirty["mesh"]["volume"].get<double>(), 1.05 * true_volume);
    EXPECT_NEAR(kept, known["mesh"]["volume"].get<double>(), 0.01 * true_volume);
    EXPECT_NEAR(kept, true_volume, 0.03 * true_volume);
    EXPECT_EQ(floor["floor"]["from"], "photographs");
    EXPECT_NEAR(floor["floor"]["height"].get<double>(), foot, 0.005 * (top - foot));
    EXPECT_TRUE(floor["mesh"]["manifold"]);
    // Silhouettes alone show the lowest contour.
    const json contour = volume("contour", [](ReconstructOptions& c) {
        c.floor.from = FloorOptions::From::Found;
        c.views.images = c.views.scene / "masks";
    });
    EXPECT_EQ(contour["floor"]["from"], "lowest contour");
    EXPECT_NEAR(contour["floor"]["height"].get<double>(), foot, 0.03 * (top - foot));
    EXPECT_NEAR(contour["mesh"]["volume"].get<double>(), true_volume, 0.03 * true_volume);
    // A height that is given; one above everything leaves nothing.
    const json given = volume("given", [&](ReconstructOptions& c) {
        c.floor.from = FloorOptions::From::Given;
        c.floor.height = 0.5 * (foot + top);
    });
    EXPECT_LT(given["mesh"]["volume"].get<double>(), 0.9 * true_volume);
    error_of(ExitCode::Input, [&] {
        volume("nothing", [&](ReconstructOptions& c) {
            c.floor.from = FloorOptions::From::Given;
            c.floor.height = top + 1;
        });
    });
}

TEST(Synthetic, SameSeedSameSceneOtherSeedAnother) {
    SyntheticSpec spec = small_spec("cup", 2, 64, 48);
    spec.rig.shake_angle_deg = 5;
    Progress quiet;
    const SyntheticScene a = synthesize(spec, quiet), b = synthesize(spec, quiet);
    spec.seed = 2;
    const SyntheticScene c = synthesize(spec, quiet);
    EXPECT_EQ(a.photos[1].data, b.photos[1].data);
    EXPECT_EQ(cameras_json(a.views), cameras_json(b.views));
    EXPECT_NE(cameras_json(a.views), cameras_json(c.views));
    EXPECT_EQ(cameras_json(a.nominal), cameras_json(c.nominal));
}

TEST(Synthetic, MasksOfABallHaveItsClosedForm) {
    SyntheticSpec spec;
    Solid ball;
    ball.size = Vec3d::Constant(0.5);
    spec.solids = {ball};
    spec.photos = false;
    spec.rig.views = 3;
    spec.rig.width_px = 90;
    spec.rig.height_px = 70;
    Progress quiet;
    const SyntheticScene s = synthesize(spec, quiet);
    for (size_t v = 0; v < 3; ++v) {
        const Camera& c = s.views.views[v].camera;
        const Vec3d axis = -c.centre_world();
        const double cosine = std::cos(std::asin(0.5 / axis.norm()));
        for (int y = 0; y < 70; ++y)
            for (int x = 0; x < 90; ++x) {
                int count = 0;
                for (int j = 0; j < 16; ++j)
                    for (int i = 0; i < 16; ++i) count += c.ray({x + (i + 0.5) / 16, y + (j + 0.5) / 16}).direction.dot(axis.normalized()) >= cosine;
                ASSERT_NEAR(s.masks[v].coverage.at(x, y), (count * 255 + 128) / 256, 2) << x << " " << y;
            }
    }
}

TEST(Synthetic, MeshAndSolidsGiveTheSameMasks) {
    SyntheticSpec spec = small_spec("ellipsoids", 3, 120, 90);
    spec.photos = false;
    spec.rig.distance = 4;
    Progress quiet;
    const SyntheticScene solids = synthesize(spec, quiet);
    EXPECT_TRUE(measure(solids.truth).manifold);
    SyntheticSpec mesh = spec;
    mesh.solids.clear();
    mesh.mesh = solids.truth;
    const SyntheticScene meshed = synthesize(mesh, quiet);
    for (size_t v = 0; v < 3; ++v) {
        double difference = 0, object = 0;
        for (size_t p = 0; p < solids.masks[v].coverage.data.size(); ++p) {
            difference += std::abs(solids.masks[v].coverage.data[p] - meshed.masks[v].coverage.data[p]) / 255.0;
            object += solids.masks[v].coverage.data[p] / 255.0;
        }
        EXPECT_LT(difference, 0.01 * object);
    }
}

// A disc less a ball's cap; rays end where its value is nought; patterns are what they are called.
TEST(Synthetic, TheBowlHasItsClosedForm) {
    SyntheticSpec spec = small_spec("bowl", 6, 200, 150);
    spec.rig.elevation_deg = 40;
    spec.look.flat = true;
    Progress quiet;
    const SyntheticScene scene = synthesize(spec, quiet);
    const double radius = 0.5, height = 0.28, depth = 0.2, rim = 0.86 * radius, pi = std::numbers::pi;
    const double volume = pi * radius * radius * height - pi * depth * (3 * rim * rim + depth * depth) / 6;
    EXPECT_NEAR(measure(scene.truth).volume, volume, 0.005 * volume);
    const Solid& bowl = spec.solids.front();
    EXPECT_NEAR(bowl.value({0, 0, 0.14}), 0.2, 1e-9);  // above the deepest place
    EXPECT_NEAR(bowl.value({0, 0, -0.14 + 0.04}), -0.04, 1e-9);
    size_t inside = 0;
    for (const View& v : scene.views.views)
        for (int y = 5; y < 150; y += 10)
            for (int x = 5; x < 200; x += 10) {
                const Camera::Ray ray = v.camera.ray(Vec2d(x, y));
                const auto t = bowl.hit(ray);
                if (!t) continue;
                const Vec3d p = ray.origin + *t * ray.direction;
                EXPECT_NEAR(bowl.value(p), 0, 1e-4);
                inside += p.z() < 0.1 && std::hypot(p.x(), p.y()) < 0.4;
            }
    EXPECT_GT(inside, 20u);
    const auto colors = [&](Pattern pattern) {
        spec.pattern = pattern;
        std::set<std::array<uint8_t, 3>> out;
        const SyntheticScene s = synthesize(spec, quiet);
        for (int y = 0; y < 150; ++y)
            for (int x = 0; x < 200; ++x)
                if (s.masks[0].coverage.at(x, y) == 255) out.insert({s.photos[0].at(x, y, 0), s.photos[0].at(x, y, 1), s.photos[0].at(x, y, 2)});
        return out.size();
    };
    EXPECT_EQ(colors(Pattern::Plain), 1u);
    EXPECT_GT(colors(Pattern::Checks), 1u);
    EXPECT_GT(colors(Pattern::Clay), 100u);
}

// Two sittings, a lens, breathing, an arc: masks belong to the true cameras all the same.
TEST(Synthetic, HardShootsStayConsistent) {
    struct Variant {
        const char* name;
        std::function<void(SyntheticSpec&)> set;
    };
    for (const Variant& v :
         {Variant{"two sittings", [](SyntheticSpec& s) { s.rig.sittings = 2; }},
          Variant{"lens",
                  [](SyntheticSpec& s) {
                      s.rig.lens = {Lens::Model::OpenCV, {-0.2, 0.05, 0.001, -0.002}};
                  }},
          Variant{"breathing", [](SyntheticSpec& s) { s.rig.breathing = 0.08; }}, Variant{"crop drift", [](SyntheticSpec& s) { s.rig.crop_drift_px = 8; }},
          Variant{"wide", [](SyntheticSpec& s) { s.rig.fov_deg = 100; }},
          Variant{"arc", [](SyntheticSpec& s) { s.rig.arc_deg = 500, s.rig.speed_variation = 0.6, s.rig.start_deg = 40; }}}) {
        TemporaryFolder folder;
        SyntheticSpec spec = small_spec("ellipsoids", 12, 200, 150);
        spec.photos = false;
        v.set(spec);
        Progress quiet;
        const SyntheticScene scene = synthesize(spec, quiet);
        write_scene(scene, folder / "scene");
        ReconstructOptions o;
        o.views.scene = folder / "scene";
        o.run.output = folder / "out";
        o.grid.resolution = 96;
        const Reconstruction r = reconstruct(o, quiet);
        EXPECT_GT(r.minimum_iou, 0.975) << v.name;
        EXPECT_TRUE(r.mesh.manifold) << v.name;
        EXPECT_GT(r.mesh.volume, measure(scene.truth).volume * 0.995) << v.name;
    }
}

TEST(Synthetic, ATurntableTurnsTheObjectUnderTheLight) {
    SyntheticSpec spec = small_spec("ellipsoids", 2, 96, 72);
    spec.rig.motion = Rig::Motion::Turntable;
    spec.look.gloss = 0.5;
    spec.look.table = true;
    Progress quiet;
    const SyntheticScene turned = synthesize(spec, quiet);
    spec.rig.motion = Rig::Motion::Camera;
    const SyntheticScene walked = synthesize(spec, quiet);
    EXPECT_EQ(turned.masks[1].coverage.data, walked.masks[1].coverage.data);  // the same silhouettes …
    EXPECT_NE(turned.photos[1].data, walked.photos[1].data);                  // … under another light
    // Above the table the room stands still behind a turntable, and moves for a walking camera.
    size_t still = 0, moves = 0;
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 96; ++x)
            if (turned.masks[0].coverage.at(x, y) == 0 && turned.masks[1].coverage.at(x, y) == 0) {
                still += turned.photos[0].at(x, y, 1) != turned.photos[1].at(x, y, 1);
                moves += walked.photos[0].at(x, y, 1) != walked.photos[1].at(x, y, 1);
            }
    EXPECT_EQ(still, 0u);
    EXPECT_GT(moves, 100u);
}

TEST(Synthetic, DamageIsAsMuchAsAskedFor) {
    SyntheticSpec spec = small_spec("ellipsoids", 4, 320, 240);
    spec.photos = false;
    Progress quiet;
    const auto displacement = [&](const MaskDamage& d) {
        spec.damage = d;
        const SyntheticScene s = synthesize(spec, quiet);
        double sum = 0, sum2 = 0, n = 0;
        for (size_t v = 0; v < 4; ++v) {
            const ImageF before = signed_distance(s.true_masks[v].coverage), after = signed_distance(s.masks[v].coverage);
            for (size_t p = 0; p < before.data.size(); ++p)
                if (std::fabs(before.data[p]) < 0.5) {
                    sum += before.data[p] - after.data[p];
                    sum2 += std::pow(before.data[p] - after.data[p], 2);
                    ++n;
                }
        }
        return std::pair(sum / n, std::sqrt(sum2 / n));
    };
    EXPECT_NEAR(displacement({.dilate_px = 2}).first, 2, 0.2);
    const auto [mean, rms] = displacement({.noise_px = 1.5, .correlation_px = 25});
    EXPECT_NEAR(mean, 0, 0.3);
    EXPECT_NEAR(rms, 1.5, 0.45);
    spec.damage = {.holes = 2, .radius_px = 6, .share = 0.5};
    const SyntheticScene s = synthesize(spec, quiet);
    size_t damaged = 0;
    for (size_t v = 0; v < 4; ++v) damaged += s.masks[v].coverage.data != s.true_masks[v].coverage.data;
    EXPECT_EQ(damaged, 2u);
}

TEST(Synthetic, SpecsAreReadAndMistakesNamed) {
    TemporaryFolder folder;
    write_text(folder / "s.json",
               R"({"solids":[{"type":"box","size":[1,2,3],"turn_deg":[0,0,30]}],"rig":{"type":"dome","views":5,"orthographic":true},"seed":9})");
    const SyntheticSpec spec = read_spec(folder / "s.json");
    EXPECT_EQ(spec.solids.size(), 1u);
    EXPECT_EQ(spec.rig.views, 5);
    EXPECT_TRUE(spec.rig.orthographic);
    for (const auto& [text, part] : {std::pair{R"({"solid":[]})", "'solid'"}, std::pair{R"({"rig":{"views":"many"}})", "type must be number"},
                                     std::pair{R"({"solids":[{"type":"cone","size":[1,1,1]}]})", "cone"}, std::pair{"{", "parse error"}}) {
        write_text(folder / "bad.json", text);
        EXPECT_NE(error_of(ExitCode::Input, [&] { read_spec(folder / "bad.json"); }).find(part), std::string::npos) << text;
    }
    write_text(folder / "bowl.json", R"({"builtin":"bowl","pattern":"checks"})");
    EXPECT_EQ(read_spec(folder / "bowl.json").pattern, Pattern::Checks);
    write_text(folder / "bad.json", R"({"builtin":"bowl","pattern":"tartan"})");
    EXPECT_NE(error_of(ExitCode::Input, [&] { read_spec(folder / "bad.json"); }).find("tartan"), std::string::npos);
    for (const char* name : {"cup.json", "ellipsoids_dome.json", "turntable_cup.json"}) read_spec(std::string(VDBCARVE_SOURCE_DIR) + "/data/" + name);
}

}  // namespace
}  // namespace vdbcarve::test
