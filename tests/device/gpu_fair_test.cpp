// SPDX-License-Identifier: Apache-2.0
// The fair surface that the device finds against the CPU's, bit for bit.
#include <algorithm>
#include <functional>

#include "device/gpu_fixture.h"
#include "support/depth_scene.h"
#include "support/same_grid.h"
#include "support/scenes.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::test {
namespace {

struct FairCase {
    const char* name;
    SyntheticSpec spec;
    int resolution;
    double fairness = 0.06;
    std::function<void(SyntheticScene&)> adjust{};
    int max_misses = 0;
};

/// The lowest third of every picture says nothing: the surface shrinks there, and what other views ask for is reached by bridges.
void ignore_below(SyntheticScene& scene) {
    for (Mask& m : scene.masks) {
        m.ignore = Image8(m.coverage.width, m.coverage.height);
        std::fill(m.ignore.data.begin() + m.coverage.width * (m.coverage.height * 2 / 3), m.ignore.data.end(), uint8_t{255});
    }
}

/// Two rows of pixels across every picture: a thin plate, which is not there for all views alike.
void cross_by_bar(SyntheticScene& scene) {
    for (Mask& m : scene.masks) {
        const auto middle = m.coverage.data.begin() + m.coverage.width * (m.coverage.height / 2 - 1);
        std::fill(middle, middle + 2 * m.coverage.width, uint8_t{255});
    }
}

std::vector<FairCase> fair_cases() {
    SyntheticSpec flat = small_spec("boxes", 8, 160, 120);
    flat.rig.orthographic = true;
    return {{"cup", small_spec("cup", 10, 160, 120), 90},
            {"ellipsoids", small_spec("ellipsoids", 8, 240, 180), 160},
            {"two levels, samples of two pixels", small_spec("cup", 6, 400, 300), 200},
            {"ignored below", small_spec("cup", 8, 160, 120), 160, 0.06, ignore_below},
            {"bars", small_spec("torus", 10, 160, 120), 90, 0.06, cross_by_bar},
            {"speckles", small_spec("ellipsoids", 5, 96, 72), 64, 0.15, add_speckles, 2},
            {"orthographic", flat, 90}};
}

class GpuFair : public Gpu {
  protected:
    struct Scene {
        Shoot shoot;
        openvdb::FloatGrid::Ptr hull;
        std::vector<FairView> views;
    };
    Scene scene_of(const FairCase& c) {
        Scene out{shoot(c.spec, c.adjust), {}, {}};
        CarveOptions o = options_for(out.shoot, c.resolution);
        o.max_misses = c.max_misses;
        out.hull = level_set(carve(out.shoot.inputs, o, quiet_).hull, {}, quiet_);
        const auto cameras = out.shoot.scene.views.cameras();
        for (size_t u = 0; u < cameras.size(); ++u) out.views.push_back({cameras[u], view_of(out.shoot.scene.masks[u])});
        return out;
    }
    static void expect_equal(const FairResult& cpu, const FairResult& gpu) {
        expect_same(*cpu.surface, *gpu.surface);
        EXPECT_EQ(cpu.hull_volume, gpu.hull_volume);
        EXPECT_EQ(cpu.volume, gpu.volume);
        EXPECT_EQ(cpu.lines_of_sight, gpu.lines_of_sight);
        EXPECT_EQ(cpu.uncovered, gpu.uncovered);
        EXPECT_EQ(cpu.pieces_dropped, gpu.pieces_dropped);
        EXPECT_EQ(cpu.level_seconds.size(), gpu.level_seconds.size());
    }
};

TEST_F(GpuFair, SurfacesEqualTheCpus) {
    Device device;  // one for all: buffers are used again, by smaller and larger ones
    size_t dropped = 0;
    for (const FairCase& c : fair_cases()) {
        SCOPED_TRACE(c.name);
        const Scene s = scene_of(c);
        FairOptions o;
        o.fairness = c.fairness;
        const FairResult cpu = fair(*s.hull, s.views, o, quiet_);
        expect_equal(cpu, fair(device, *s.hull, s.views, o, quiet_));
        expect_equal(cpu, device.fair(*s.hull, s.views, o, quiet_));  // the hull is still there
        dropped += cpu.pieces_dropped;
    }
    EXPECT_GT(dropped, 0u);
    EXPECT_GT(device.milliseconds("fair: repair"), 0);
}

TEST_F(GpuFair, SurfacesThatDepthsLeadEqualTheCpus) {
    Device device;
    for (const auto& [object, resolution] : {std::pair{"cup", 90}, {"ellipsoids", 160}, {"cup", 200}}) {
        SCOPED_TRACE(object);
        const Scene s = scene_of({object, small_spec(object, 8, 240, 180), resolution});
        const DepthScene depths = depth_scene(*s.hull, s.shoot.scene.truth, 0.5, 0);
        const FairEvidence evidence = depths.evidence();
        const FairResult cpu = fair(*s.hull, s.views, {}, quiet_, &evidence);
        EXPECT_NE(cpu.volume, fair(*s.hull, s.views, {}, quiet_).volume);
        expect_equal(cpu, fair(device, *s.hull, s.views, {}, quiet_, &evidence));
        expect_equal(cpu, device.fair(*s.hull, s.views, {}, quiet_, &evidence));
    }
}

TEST_F(GpuFair, RefusesAlike) {
    const Scene s = scene_of({"small", small_spec("ellipsoids", 4, 96, 72), 32});
    Device device;
    FairOptions o;
    o.fairness = 0.7;
    EXPECT_THROW(fair(device, *s.hull, s.views, o, quiet_), UsageError);
    openvdb::FloatGrid::Ptr empty = openvdb::FloatGrid::create(1.f);
    empty->setGridClass(openvdb::GRID_LEVEL_SET);
    EXPECT_THROW(fair(device, *empty, s.views, {}, quiet_), InputError);
    o.fairness = 0;
    const FairResult same = fair(device, *s.hull, s.views, o, quiet_);
    expect_same(*s.hull, *same.surface);
    EXPECT_EQ(same.volume, fair(*s.hull, s.views, o, quiet_).volume);
}

}  // namespace
}  // namespace vdbcarve::test
