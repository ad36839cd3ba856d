// SPDX-License-Identifier: Apache-2.0
// Objects and patterns that are called by name.
#include "vdbcarve/synthetic.h"

#include "vdbcarve/error.h"

namespace vdbcarve {

Pattern pattern_called(const std::string& name) {
    if (name == "clay") return Pattern::Clay;
    if (name == "checks") return Pattern::Checks;
    if (name == "plain") return Pattern::Plain;
    throw InputError("synth: pattern '" + name + "' is none of clay, checks, plain");
}

SyntheticSpec builtin_spec(const std::string& name) {
    SyntheticSpec spec;
    spec.name = name;
    const auto add = [&](Solid::Kind kind, const Vec3d& size, const Vec3d& centre, const Vec3d& turn_deg) {
        Solid s;
        s.kind = kind;
        s.size = size;
        s.world_from_solid.rotation = turned(turn_deg);
        s.world_from_solid.translation = centre;
        spec.solids.push_back(s);
    };
    if (name == "cup") {
        add(Solid::Kind::Cup, {0.45, 0.5, 0.06}, {0, 0, 0}, {0, 0, 20});
    } else if (name == "bowl") {
        add(Solid::Kind::Bowl, {0.5, 0.14, 0.2}, {0, 0, 0}, {0, 0, 0});
    } else if (name == "ellipsoids") {
        add(Solid::Kind::Ellipsoid, {0.55, 0.35, 0.3}, {0, 0, 0}, {10, 20, 30});
        add(Solid::Kind::Ellipsoid, {0.2, 0.25, 0.45}, {0.35, 0.1, 0.3}, {25, -15, 0});
        add(Solid::Kind::Ellipsoid, {0.18, 0.4, 0.15}, {-0.4, -0.2, 0.1}, {0, 30, 40});
        add(Solid::Kind::Ellipsoid, {0.12, 0.12, 0.5}, {0, 0.3, -0.3}, {-20, 0, 0});
    } else if (name == "boxes") {
        add(Solid::Kind::Box, {0.4, 0.3, 0.2}, {0, 0, -0.1}, {0, 0, 25});
        add(Solid::Kind::Box, {0.12, 0.35, 0.3}, {0.1, 0, 0.25}, {20, 35, 0});
    } else if (name == "torus") {
        add(Solid::Kind::Torus, {0.45, 0.14, 0}, {0, 0, 0}, {60, 10, 0});
    } else if (name == "pair") {
        add(Solid::Kind::Ellipsoid, {0.2, 0.2, 0.32}, {0.5, 0, 0}, {0, 0, 0});
        spec.solids.back().color = Vec3d(0.6, 0.06, 0.05);
        add(Solid::Kind::Box, {0.1, 0.45, 0.4}, {-0.25, 0, 0}, {0, 0, 10});
        spec.solids.back().color = Vec3d(0.05, 0.25, 0.55);
    } else {
        throw UsageError("synth: no built-in object '" + name +
                         "' (cup, bowl, ellipsoids, boxes, torus, pair), and no such spec (.json) or mesh (.ply, .obj, .stl)");
    }
    return spec;
}

}  // namespace vdbcarve
