// SPDX-License-Identifier: Apache-2.0
// Small scenes for tests: synthetic shoots turned into what carve() takes, and folders that vanish.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>

#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve::test {

/// Masks, fields and carve inputs that belong together.
struct Shoot {
    SyntheticScene scene;
    std::vector<DistanceField> fields;
    std::vector<CarveInput> inputs;
};

inline std::vector<MaskView> views_of(const std::vector<Mask>& masks) {
    std::vector<MaskView> out;
    for (const Mask& m : masks) out.push_back(view_of(m));
    return out;
}

/// A shoot without photographs; `adjust` may change cameras or masks before distances are taken.
inline Shoot shoot(const SyntheticSpec& given, const std::function<void(SyntheticScene&)>& adjust = {}) {
    SyntheticSpec spec = given;
    spec.photos = false;
    Progress quiet;
    Shoot out;
    out.scene = synthesize(spec, quiet);
    if (adjust) adjust(out.scene);
    out.fields = distance_fields(views_of(out.scene.masks), {}, quiet);
    const auto cameras = out.scene.views.cameras();
    for (size_t i = 0; i < cameras.size(); ++i) out.inputs.push_back({out.scene.views.views[i].name, cameras[i], &out.fields[i]});
    return out;
}

inline SyntheticSpec small_spec(const std::string& object, int views, int width = 128, int height = 96) {
    SyntheticSpec spec = builtin_spec(object);
    spec.rig.views = views;
    spec.rig.width_px = width;
    spec.rig.height_px = height;
    return spec;
}

/// Speckles on masks, in which views do not agree.
inline void add_speckles(SyntheticScene& scene) {
    for (Mask& m : scene.masks) {
        Image8& c = m.coverage;
        for (int y = 0; y < c.height; ++y)
            for (int x = 0; x < c.width; ++x)
                if ((x * 7 + y * 3) % 11 < 3 && (x / 5 + y / 5) % 3 == 0) c.at(x, y) = 255;
    }
}

/// Bounds around the truth, enlarged by a share, and a lattice over their longest side.
inline CarveOptions options_for(const Shoot& s, int resolution, double margin = 0.1) {
    CarveOptions o;
    for (const auto& v : s.scene.truth.vertices) o.bounds_world.extend(Vec3d(v[0], v[1], v[2]));
    const Vec3d pad = margin * o.bounds_world.sizes();
    o.bounds_world = Box3d(o.bounds_world.min() - pad, o.bounds_world.max() + pad);
    o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / resolution;
    return o;
}

/// A folder for one test, removed at its end.
class TemporaryFolder {
  public:
    TemporaryFolder() {
        const auto* info = testing::UnitTest::GetInstance()->current_test_info();
        path_ =
            std::filesystem::temp_directory_path() / ("vdbcarve-" + std::string(info->test_suite_name()) + "-" + info->name() + "-" + std::to_string(getpid()));
        std::filesystem::remove_all(path_);
        std::filesystem::create_directories(path_);
    }
    ~TemporaryFolder() { std::filesystem::remove_all(path_); }
    const std::filesystem::path& path() const { return path_; }
    std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

  private:
    std::filesystem::path path_;
};

inline void write_text(const std::filesystem::path& file, const std::string& text) { std::ofstream(file, std::ios::binary) << text; }
inline std::string read_text(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// The message of the Error that a call throws, with the exit code checked.
template <class Call>
std::string error_of(ExitCode code, const Call& call) {
    try {
        call();
    } catch (const Error& e) {
        EXPECT_EQ(e.code(), code) << e.what();
        return e.what();
    }
    ADD_FAILURE() << "no error was thrown";
    return {};
}

}  // namespace vdbcarve::test
