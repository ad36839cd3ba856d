// SPDX-License-Identifier: Apache-2.0
// A video through the whole job.

#include "support/job.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"

namespace vdbcarve::test {
namespace {

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

}  // namespace
}  // namespace vdbcarve::test
