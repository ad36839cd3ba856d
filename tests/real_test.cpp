// SPDX-License-Identifier: Apache-2.0
// Real photographs, where VDBCARVE_TEST_DATA says they are.
#include <nlohmann/json.hpp>

#include "support/scenes.h"
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
    o.mask.threshold.close_px = close_px;
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
    o.output = folder / "out";
    o.resolution = 160;
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
                                         Set{"kai46_example", [](ReconstructOptions&) {}, 0.99, 0.98},
                                         Set{"nerf_lego", [](ReconstructOptions&) {}, 0.985, 0.97},
                                         Set{"scene_dragon_clean", [](ReconstructOptions&) {}, 0.99, 0.985},
                                         Set{"scene_dragon_handheld", [](ReconstructOptions& o) { o.views.cameras = "transforms_true.json"; }, 0.99, 0.985}),
                         [](const auto& instance) { return std::string(instance.param.name); });

}  // namespace
}  // namespace vdbcarve::test
