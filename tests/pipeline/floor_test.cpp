// SPDX-License-Identifier: Apache-2.0
// The table under the object, and which way is up.

#include <functional>

#include "support/job.h"

namespace vdbcarve::test {
namespace {

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

}  // namespace
}  // namespace vdbcarve::test
