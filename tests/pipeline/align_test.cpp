// SPDX-License-Identifier: Apache-2.0
// Cameras that are found, through the whole job.
#include "vdbcarve/align.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <tbb/global_control.h>

#include <cmath>
#include <numbers>
#include <random>

#include "base/atomic_file.h"
#include "align/coherence.h"
#include "align/coherence_fit.h"
#include "image/image_io.h"
#include "align/orbit_model.h"
#include "support/align_scene.h"
#include "support/scenes.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {
namespace {

Progress quiet;

struct Folder {
    TemporaryFolder folder;
    ReconstructOptions options;

    explicit Folder(const SyntheticSpec& spec) {
        write_scene(synthesize(spec, quiet), folder / "scene");
        for (const char* file : {"transforms.json", "transforms_nominal.json"}) std::filesystem::remove(folder / "scene" / file);
        options.views.scene = folder / "scene";
        options.run.output = folder / "out";
        options.grid.resolution = 64;
        options.color.options.mode = ColorMode::None;
        options.result.mesh_formats = {"ply"};
        options.align.restarts = 1;
    }
    nlohmann::json run() {
        Progress progress;
        return nlohmann::json::parse(reconstruct(options, progress).report_json);
    }
};

TEST(AlignPipeline, MasksAloneBecomeAMeshAndAgainTheSame) {
    Folder f(small_orbit(1, 14));
    const nlohmann::json first = f.run();
    EXPECT_TRUE(first["align"]["verified"]);
    EXPECT_EQ(first["align"]["units"], "arbitrary");
    EXPECT_EQ(first["align"]["views"].size(), 14u);
    EXPECT_GT(first["silhouette_iou"]["minimum"], 0.95);
    EXPECT_TRUE(first["mesh"]["manifold"]);
    EXPECT_TRUE(std::filesystem::exists(f.folder / "out/orbit.svg"));
    const std::string mesh = read_text(f.folder / "out/mesh.ply"), cameras = read_text(f.folder / "out/cameras.json");
    const nlohmann::json again = f.run();
    for (const auto& stage : again["stages"])
        if (stage["name"] == "align" || stage["name"] == "carve") {
            EXPECT_TRUE(stage["reused"]) << stage["name"];
        }
    EXPECT_EQ(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_EQ(read_text(f.folder / "out/cameras.json"), cameras);
    EXPECT_EQ(again["align"], first["align"]);
    // What was found is a camera file like any other, and carves to the same bits.
    std::filesystem::copy_file(f.folder / "out/cameras.json", f.folder / "scene/cameras.json");
    f.options.run.output = f.folder / "out2";
    f.options.align = {};
    f.run();
    EXPECT_EQ(read_text(f.folder / "out2/mesh.ply"), mesh);
}

TEST(AlignPipeline, CamerasThatCannotBeTrustedEndTheRunUnlessAccepted) {
    Folder f(small_orbit(1, 14));
    f.run();
    const std::string mesh = read_text(f.folder / "out/mesh.ply"), cameras = read_text(f.folder / "out/cameras.json"),
                      report = read_text(f.folder / "out/report.json");
    f.options.align.direction = Turn::Counterclockwise;
    const std::string said = error_of(ExitCode::Undetermined, [&] { f.run(); });
    EXPECT_NE(said.find("do not fit together"), std::string::npos) << said;
    EXPECT_NE(said.find("--accept-unobservable"), std::string::npos) << said;
    // What was there before stays, and what was found lies apart.
    EXPECT_EQ(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_EQ(read_text(f.folder / "out/cameras.json"), cameras);
    EXPECT_EQ(read_text(f.folder / "out/report.json"), report);
    EXPECT_TRUE(std::filesystem::exists(f.folder / "out/stages/unfinished_masks.json"));  // what `bundle` sends are this run's masks
    for (const char* file : {"preview.png", "cameras.json", "report.json"}) EXPECT_TRUE(std::filesystem::exists(f.folder / "out/unverified" / file)) << file;
    EXPECT_FALSE(nlohmann::json::parse(read_text(f.folder / "out/unverified/report.json"))["align"]["verified"]);
    // Nor are such cameras carved with by another run that does not ask for it.
    std::filesystem::copy_file(f.folder / "out/unverified/cameras.json", f.folder / "doubtful.json");
    const ReconstructOptions searching = f.options;
    f.options.align = {};
    f.options.views.cameras = f.folder / "doubtful.json";
    f.options.run.output = f.folder / "out2";
    f.options.carve.max_misses = 4;  // or nothing is left
    EXPECT_NE(error_of(ExitCode::Undetermined, [&] { f.run(); }).find("UNVERIFIED"), std::string::npos);
    f.options.cameras.accept_unobservable = true;
    f.run();
    EXPECT_TRUE(std::filesystem::exists(f.folder / "out2/mesh.ply"));
    EXPECT_NE(read_text(f.folder / "out2/cameras.json").find("unverified"), std::string::npos);
    f.options = searching;
    f.options.cameras.accept_unobservable = true;
    f.options.carve.max_misses = 4;
    const nlohmann::json r = f.run();
    EXPECT_FALSE(r["align"]["verified"]);
    EXPECT_NE(read_text(f.folder / "out/mesh.ply"), mesh);
    EXPECT_FALSE(std::filesystem::exists(f.folder / "out/unverified"));
}

TEST(AlignPipeline, ABrokenMaskIsNotCarvedWith) {
    Folder f(small_orbit(1, 20));
    const double clean = f.run()["mesh"]["volume"];
    const std::filesystem::path file = f.folder / "scene/masks/0007.png";
    std::filesystem::copy_file(file, f.folder / "clean.png");
    Image8 mask = io::read_image8(file);
    for (int y = 0; y < mask.height; ++y)
        for (int x = mask.width / 2; x < mask.width; ++x) mask.at(x, y) = 0;
    const std::vector<uint8_t> png = io::encode_png(mask);
    write_file(file, png.data(), png.size());
    const nlohmann::json broken = f.run();
    EXPECT_NEAR(broken["mesh"]["volume"].get<double>() / clean, 1, 0.03);
    for (size_t i = 0; i < 20; ++i) EXPECT_EQ(broken["views"][i]["used"], i != 7) << i;
    // The camera file says so too.
    const std::string mesh = read_text(f.folder / "out/mesh.ply");
    std::filesystem::copy_file(f.folder / "out/cameras.json", f.folder / "scene/cameras.json");
    f.options.run.output = f.folder / "out2";
    f.options.align = {};
    EXPECT_FALSE(f.run()["views"][7]["used"]);
    EXPECT_EQ(read_text(f.folder / "out2/mesh.ply"), mesh);
    EXPECT_NE(read_text(f.folder / "out2/cameras.json").find("\"unused\": \"its silhouette contradicts"), std::string::npos);
    // A mended mask has its say again when cameras are refined.
    std::filesystem::remove(file);
    std::filesystem::copy_file(f.folder / "clean.png", file);
    f.options.run.output = f.folder / "out3";
    f.options.align.method = AlignMethod::Refine;
    f.options.align.features = false;
    f.options.cameras.find_again = true;
    EXPECT_TRUE(f.run()["views"][7]["used"]);
}

TEST(AlignPipeline, PhotographsSayTheirFocalLength) {
    SyntheticSpec spec = small_orbit(1, 4);
    spec.photos = true;
    spec.look.jpeg_quality = 90;
    spec.look.exif = true;
    Folder f(spec);
    ViewsOptions options;
    options.scene = f.folder / "scene";
    EXPECT_NE(error_of(ExitCode::Input, [&] { load_views(options, quiet); }).find("vdbcarve align"), std::string::npos);
    options.allow_unposed = true;
    const Views views = load_views(options, quiet);
    EXPECT_FALSE(views.posed);
    ASSERT_EQ(views.views.size(), 4u);
    // EXIF has whole millimetres.
    const double true_px = 0.5 * 360 / std::tan(0.5 * spec.rig.fov_deg * kRadians);
    EXPECT_NEAR(views.views[0].camera.intrinsics.fx / true_px, 1, 0.5 / (true_px / 480 * 36));
    EXPECT_EQ(views.views[0].camera.intrinsics.width_px, 480);
}

}  // namespace
}  // namespace vdbcarve::test
