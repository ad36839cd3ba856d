// SPDX-License-Identifier: Apache-2.0
// Colours through the whole job.

#include <cmath>
#include <set>

#include "support/job.h"
#include "image/image_io.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::test {
namespace {

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
    EXPECT_EQ(names, (std::set<std::string>{"surface", "density", "slack", "Cd", "views", "confidence"}));
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

// Which photograph was taken from where is part of what colours depend on, also where the hull does not tell.
TEST(Pipeline, PhotographsThatChangePlacesGiveOtherColours) {
    Job job("ellipsoids", true);
    job.options.carve.max_misses = 2;
    fs::copy_file(job.folder / "scene/masks/0000.png", job.folder / "scene/masks/0001.png", fs::copy_options::overwrite_existing);
    job.run();
    const std::string before = job.bytes("mesh.ply");
    json cameras = json::parse(read_text(job.folder / "scene/transforms.json"));
    std::swap(cameras["frames"][0]["transform_matrix"], cameras["frames"][1]["transform_matrix"]);
    write_text(job.folder / "scene/transforms.json", cameras.dump());
    const json r = job.run();
    EXPECT_TRUE(Job::reused(r, "carve"));
    EXPECT_FALSE(Job::reused(r, "color"));
    EXPECT_NE(job.bytes("mesh.ply"), before);
}

// Silhouettes in three channels are known as such wherever the scene lies.
TEST(Pipeline, PhotographsThatAreMasksGiveNoColourFromAnotherPathEither) {
    Job job;
    for (const auto& entry : fs::directory_iterator(job.folder / "scene/images")) {
        const Image8 grey = io::read_image8(entry.path());
        Image8 three(grey.width, grey.height, 3);
        for (size_t p = 0; p < grey.pixels(); ++p)
            for (size_t c = 0; c < 3; ++c) three.data[3 * p + c] = grey.data[p];
        io::write_png(entry.path(), three);
    }
    fs::remove_all(job.folder / "scene/masks");
    json cameras = json::parse(read_text(job.folder / "scene/transforms.json"));
    for (json& frame : cameras["frames"]) frame.erase("mask_path");
    write_text(job.folder / "scene/transforms.json", cameras.dump());
    EXPECT_FALSE(job.run().contains("color"));
    job.options.views.scene = job.folder / "scene/../scene";
    const json again = job.run();
    EXPECT_TRUE(Job::reused(again, "mask"));
    EXPECT_FALSE(again.contains("color"));
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

}  // namespace
}  // namespace vdbcarve::test
