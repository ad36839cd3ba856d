// SPDX-License-Identifier: Apache-2.0
// Real photographs, where VDBCARVE_TEST_DATA says they are.
#include <nlohmann/json.hpp>

#include "support/color_scene.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

struct Set {
    const char* name;
    std::function<void(ReconstructOptions&)> change;
    double median_iou, minimum_iou;
};

void PrintTo(const Set& s, std::ostream* out) { *out << s.name; }

void threshold(ReconstructOptions& o, double level, int close_px) {
    o.mask.method = MaskMethod::Threshold;
    o.mask.threshold.level = level;
    o.mask.clean_up.close_px = close_px;
}

class Real : public testing::TestWithParam<Set> {};

TEST_P(Real, BecomesAClosedMeshThatFitsItsSilhouettes) {
    const char* data = std::getenv("VDBCARVE_TEST_DATA");
    if (!data) GTEST_SKIP() << "VDBCARVE_TEST_DATA is not set";
    const fs::path scene = fs::path(data) / GetParam().name;
    if (!fs::is_directory(scene)) GTEST_SKIP() << scene << " is not there";
    TemporaryFolder folder;
    ReconstructOptions o;
    o.views.scene = scene;
    o.run.output = folder / "out";
    o.grid.resolution = 160;
    GetParam().change(o);
    Progress quiet;
    const Reconstruction r = reconstruct(o, quiet);
    EXPECT_TRUE(r.mesh.manifold);
    EXPECT_GT(r.mesh.volume, 0);
    EXPECT_GE(r.median_iou, GetParam().median_iou);
    EXPECT_GE(r.minimum_iou, GetParam().minimum_iou);
}

INSTANTIATE_TEST_SUITE_P(Sets, Real,
                         testing::Values(Set{"dinoSparseRing", [](ReconstructOptions& o) { threshold(o, 25, 3); }, 0.97, 0.9},
                                         Set{"dinoRing", [](ReconstructOptions& o) { threshold(o, 25, 3); }, 0.97, 0.88},
                                         Set{"templeRing", [](ReconstructOptions& o) { threshold(o, 64, 10); }, 0.97, 0.9},
                                         Set{"david_sfs", [](ReconstructOptions& o) { threshold(o, 110, 3); }, 0.96, 0.9},
                                         // A file that MATLAB wrote, of a projective and mirrored world; a blue cloth.
                                         Set{"vgg_dino",
                                             [](ReconstructOptions& o) {
                                                 o.mask.method = MaskMethod::Chroma;
                                                 o.views.accept_non_metric = true;
                                             },
                                             0.97, 0.96},
                                         Set{"aruco_board02",
                                             [](ReconstructOptions& o) {
                                                 o.align.method = AlignMethod::Mat;
                                                 o.align.mat = read_mat("grid:5x7:0.035:0.005:6X6_250");
                                                 o.cameras.find_again = true;
                                                 o.mask.masks = "silhouette";
                                             },
                                             0.97, 0.95},
                                         Set{"kai46_example", [](ReconstructOptions&) {}, 0.99, 0.98},
                                         Set{"nerf_lego", [](ReconstructOptions&) {}, 0.985, 0.97},
                                         Set{"scene_dragon_clean", [](ReconstructOptions&) {}, 0.99, 0.985},
                                         Set{"scene_dragon_handheld", [](ReconstructOptions& o) { o.views.cameras = "transforms_true.json"; }, 0.99, 0.985}),
                         [](const auto& instance) { return std::string(instance.param.name); });

// Keenan Crane's textured models, photographed: of what cameras truly see 3 px inside their masks 98 % is coloured, and rightly.
struct TexturedModel {
    const char* mesh;
    const char* texture;
};

void PrintTo(const TexturedModel& m, std::ostream* out) { *out << m.mesh; }

class Textured : public testing::TestWithParam<TexturedModel> {};

TEST_P(Textured, ComesBackWithItsColours) {
    const char* data = std::getenv("VDBCARVE_TEST_DATA");
    if (!data) GTEST_SKIP() << "VDBCARVE_TEST_DATA is not set";
    const fs::path mesh = fs::path(data) / "meshes" / GetParam().mesh;
    if (!fs::exists(mesh)) GTEST_SKIP() << mesh << " is not there";
    SyntheticSpec spec;
    spec.mesh = read_mesh(mesh);
    spec.texture = read_texture(fs::path(data) / "meshes" / GetParam().texture);
    spec.rig.width_px = 1024;
    spec.rig.height_px = 768;
    const ColorScene s = color_scene(spec, 192);
    judge_both_modes(s, mesh.stem().string(), [](const ColorResult&, const ColorVerdict& v) {
        EXPECT_LT(v.median, 2);
        EXPECT_LT(v.p95, 8);
    });
}

INSTANTIATE_TEST_SUITE_P(Models, Textured,
                         testing::Values(TexturedModel{"spot_triangulated.obj", "spot_texture.png"}, TexturedModel{"bob_tri.obj", "bob_diffuse.png"}));

}  // namespace
}  // namespace vdbcarve::test
