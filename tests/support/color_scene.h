// SPDX-License-Identifier: Apache-2.0
// Synthetic shoots with photographs, carved, and what is true about their colours.
#pragma once

#include "support/scenes.h"
#include "vdbcarve/color.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/level_set.h"

namespace vdbcarve::test {

/// A carved object with what color() takes.
struct ColorScene {
    SyntheticSpec spec;
    SyntheticScene scene;
    openvdb::FloatGrid::Ptr surface;
    std::vector<ColorInput> inputs;
    std::vector<Photo> photos;

    float voxel() const { return static_cast<float>(surface->voxelSize()[0]); }
};

inline void lend_photos(ColorScene& s) {
    s.inputs.clear();
    const auto cameras = s.scene.views.cameras();
    for (size_t i = 0; i < cameras.size(); ++i)
        s.inputs.push_back({s.scene.views.views[i].name, cameras[i], view_of(s.scene.masks[i]), view_of(s.photos[i]), true});
}

inline ColorScene color_scene(const SyntheticSpec& spec, int resolution) {
    openvdb::initialize();
    Progress quiet;
    ColorScene out;
    out.spec = spec;
    out.scene = synthesize(spec, quiet);
    Shoot s;
    s.scene.truth = out.scene.truth;
    std::vector<MaskView> masks;
    for (const Mask& m : out.scene.masks) masks.push_back(view_of(m));
    s.fields = distance_fields(masks, {}, quiet);
    const auto cameras = out.scene.views.cameras();
    for (size_t i = 0; i < cameras.size(); ++i) s.inputs.push_back({out.scene.views.views[i].name, cameras[i], &s.fields[i]});
    out.surface = level_set(carve(s.inputs, options_for(s, resolution), quiet).hull, {}, quiet);
    for (const Image8& p : out.scene.photos) out.photos.push_back({p, {}});
    lend_photos(out);
    return out;
}

/// How right colours are where the surface is within a voxel of the truth, and sees a camera.
struct ColorVerdict {
    size_t visible = 0, colored = 0;        ///< contour voxels that a camera truly sees (cosine 0.2 or more), and those of them coloured from a photograph
    size_t inside = 0, inside_colored = 0;  ///< the same of those that a camera sees at least 3 px inside its true mask
    double median = 0, p95 = 0;             ///< CIEDE2000 of those
    double wrong = 0;                       ///< share of those farther off than 20
    double inside_share() const { return inside ? static_cast<double>(inside_colored) / static_cast<double>(inside) : 0; }
    double share() const { return visible ? static_cast<double>(colored) / static_cast<double>(visible) : 0; }
};
ColorVerdict judge(const ColorScene& s, const ColorResult& result);

/// One line for a table.
std::string line_of(const std::string& name, const ColorVerdict& verdict, const ColorResult& result);

/// Colours the scene by best and by blend, prints a line of each, and expects of what cameras truly see 3 px inside their masks 98 %, of all they
/// see 96 % to be coloured; `check` looks at the rest.
void judge_both_modes(const ColorScene& s, const std::string& name, const std::function<void(const ColorResult&, const ColorVerdict&)>& check);

/// Bit for bit.
void expect_same_colors(const ColorResult& a, const ColorResult& b);

}  // namespace vdbcarve::test
