// SPDX-License-Identifier: Apache-2.0
// Depth through the whole job.

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <set>

#include "support/job.h"
#include "image/image_io.h"
#include "base/statistics.h"
#include "support/dented_ball.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"

namespace vdbcarve::test {
namespace {

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
    using Use = StereoSettings::Use;
    o.stereo.use = Use::On;
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
    o.carve.occupancy = false;
    o.stereo.use = Use::Auto;
    EXPECT_EQ(run()["stereo"]["used"], true);
    o.stereo.use = Use::Off;
    EXPECT_NE(run()["warnings"].dump().find("nothing without --stereo on"), std::string::npos);  // a result's config.toml may say --stereo-scale
    EXPECT_FALSE(fs::exists(folder / "out/stereo.png"));
}

// One colour: no depth that others agree with. The result is that of silhouettes alone, and is found where that was made before.
TEST(Pipeline, StereoAutoLeavesAloneWhatHasNoTexture) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 12, 240, 180);
    spec.pattern = Pattern::Plain;
    spec.look.flat = true;
    Progress quiet;
    write_scene(synthesize(spec, quiet), folder / "scene");
    ReconstructOptions o;
    o.views.scene = folder / "scene";
    o.run.output = folder / "out";
    o.grid.resolution = 48;
    o.result.mesh_formats = {"ply"};
    const auto run = [&] { return json::parse(reconstruct(o, quiet).report_json); };
    run();
    const std::string mesh = read_text(folder / "out/mesh.ply");
    o.stereo.use = StereoSettings::Use::Auto;
    for (const bool again : {false, true}) {
        const json declined = run();
        EXPECT_EQ(declined["stereo"]["used"], false);
        EXPECT_LT(declined["stereo"]["trusted_share"], 0.2);
        EXPECT_FALSE(declined["stereo"].contains("volume"));
        EXPECT_EQ(Job::reused(declined, "stereo"), again);
        EXPECT_TRUE(Job::reused(declined, "fair"));
        EXPECT_EQ(read_text(folder / "out/mesh.ply"), mesh);
        EXPECT_FALSE(fs::exists(folder / "out/stereo.png"));
        EXPECT_EQ(read_text(folder / "out/report.html").find("Concavities"), std::string::npos);
        for (const auto& grid : read_vdb(folder / "out/volume.vdb")) EXPECT_NE(grid->getName(), "stereo_confidence");
    }
    o.stereo.use = StereoSettings::Use::On;
    const json on = run();
    EXPECT_TRUE(Job::reused(on, "stereo"));
    EXPECT_EQ(on["stereo"]["used"], true);
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
        o.stereo.use = stereo ? StereoSettings::Use::On : StereoSettings::Use::Off;
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

}  // namespace
}  // namespace vdbcarve::test
