// SPDX-License-Identifier: Apache-2.0
// Shoots and options of which colours are compared between backends.
#pragma once

#include <functional>
#include <random>
#include <string>
#include <vector>

#include "support/color_scene.h"
#include "support/scenes.h"

namespace vdbcarve::test {

struct ColorCase {
    std::string name;
    std::function<ColorScene()> make;
    std::function<void(ColorOptions&)> change;
};

inline void PrintTo(const ColorCase& c, std::ostream* out) { *out << c.name; }

inline ColorScene colored(const std::string& object, int views, int resolution, const std::function<void(SyntheticSpec&)>& adjust = {}) {
    SyntheticSpec spec = small_spec(object, views, 200, 150);
    spec.look.exposure_jitter = 0.2;
    if (adjust) adjust(spec);
    return color_scene(spec, resolution);
}

inline ColorScene odd_photographs() {
    ColorScene s = colored("torus", 12, 48);
    for (size_t i = 0; i < s.photos.size(); ++i) {
        const Image8 rgb = s.photos[i].pixels8;
        if (i % 4 == 1) {  // 16 bits
            s.photos[i].pixels16 = Image16(rgb.width, rgb.height, 3);
            for (size_t n = 0; n < rgb.data.size(); ++n) s.photos[i].pixels16.data[n] = static_cast<uint16_t>(rgb.data[n] * 251 + n % 97);
            s.photos[i].pixels8 = {};
        } else if (i % 4 == 2) {  // RGBA
            Image8 rgba(rgb.width, rgb.height, 4, 9);
            for (size_t n = 0; n < rgb.data.size(); ++n) rgba.data[n / 3 * 4 + n % 3] = rgb.data[n];
            s.photos[i].pixels8 = rgba;
        } else if (i % 4 == 3) {  // grey
            Image8 grey(rgb.width, rgb.height, 1);
            for (size_t n = 0; n < grey.data.size(); ++n) grey.data[n] = rgb.data[3 * n + 1];
            s.photos[i].pixels8 = grey;
        }
    }
    s.photos[5] = {};
    s.scene.masks[4].ignore = Image8(200, 150);
    for (int y = 50; y < 100; ++y)
        for (int x = 70; x < 120; ++x) s.scene.masks[4].ignore.at(x, y) = 255;
    lend_photos(s);
    s.inputs[7].use = false;
    return s;
}

inline const std::vector<ColorCase>& color_cases() {
    static const std::vector<ColorCase> all{
        {"blend", [] { return colored("cup", 14, 80); }, [](ColorOptions&) {}},
        {"best", [] { return colored("cup", 14, 80); }, [](ColorOptions& o) { o.mode = ColorMode::Best; }},
        {"paper", [] { return colored("boxes", 9, 64); },
         [](ColorOptions& o) {
             o.mode = ColorMode::Best;
             o.skip_upright = true;
             o.test_occlusion = false;
             o.exposure = false;
         }},
        {"pair", [] { return colored("pair", 24, 96); }, [](ColorOptions& o) { o.exposure_options.per_channel = true; }},
        {"batches", [] { return colored("ellipsoids", 17, 64); }, [](ColorOptions& o) { o.batch = 5; }},
        {"best_in_batches", [] { return colored("ellipsoids", 17, 64); },
         [](ColorOptions& o) {
             o.batch = 1;
             o.mode = ColorMode::Best;
         }},
        {"many_views",
         [] {
             return colored("ellipsoids", 90, 40, [](SyntheticSpec& s) {
                 s.rig.width_px = 96;
                 s.rig.height_px = 72;
             });
         },
         [](ColorOptions&) {}},
        {"orthographic", [] { return colored("boxes", 10, 64, [](SyntheticSpec& s) { s.rig.orthographic = true; }); }, [](ColorOptions&) {}},
        {"windowed_normals", [] { return colored("torus", 10, 64); }, [](ColorOptions& o) { o.normal_radius_vox = 3; }},
        {"shallow", [] { return colored("torus", 10, 64); }, [](ColorOptions& o) { o.depth_vox = 1; }},
        {"deep", [] { return colored("torus", 10, 64); }, [](ColorOptions& o) { o.depth_vox = 7; }},
        {"two_views", [] { return colored("ellipsoids", 2, 64, [](SyntheticSpec& s) { s.rig.arc_deg = 180; }); }, [](ColorOptions&) {}},
        {"fine_photographs",
         [] {
             return colored("ellipsoids", 8, 40, [](SyntheticSpec& s) {
                 s.rig.width_px = 640;
                 s.rig.height_px = 480;
             });
         },
         [](ColorOptions&) {}},
        {"odd_photographs", odd_photographs, [](ColorOptions&) {}},
        {"odd_photographs_one_by_one", odd_photographs, [](ColorOptions& o) { o.batch = 1; }},
        {"large", [] { return colored("cup", 12, 300); }, [](ColorOptions&) {}},
    };
    return all;
}

}  // namespace vdbcarve::test
