// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <algorithm>
#include <memory>

#include "cli.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve::cli {
namespace {

struct Raw {
    std::string object, output, rig;
    int views = 0, width = 0, height = 0;
    double fov = 0, shake = 0;
    uint64_t seed = 0;
    bool masks_only = false, force = false, orthographic = false;
};

SyntheticSpec spec_of(const Raw& raw) {
    namespace fs = std::filesystem;
    const fs::path file(raw.object);
    SyntheticSpec spec;
    if (file.extension() == ".json") {
        spec = read_spec(file);
    } else if (fs::is_regular_file(file)) {
        spec.name = file.stem().string();
        spec.mesh = read_mesh(file);
        if (const MeshMeasures m = measure(spec.mesh); m.boundary_edges > 0)
            throw InputError(raw.object + ": the mesh is open (" + std::to_string(m.boundary_edges) + " border edges); truth must be a closed surface");
    } else {
        spec = builtin_spec(raw.object);
    }
    Rig& rig = spec.rig;
    if (raw.rig == "orbit") rig.kind = Rig::Kind::Orbit;
    if (raw.rig == "dome") rig.kind = Rig::Kind::Dome;
    if (raw.views) rig.views = raw.views;
    if (raw.rig == "rings" || (raw.views && rig.kind == Rig::Kind::Rings)) {
        rig.kind = Rig::Kind::Rings;
        rig.rings = {{(rig.views + 1) / 2, 0}, {rig.views / 2, 35}};
    }
    if (raw.width) rig.width_px = raw.width;
    if (raw.height) rig.height_px = raw.height;
    if (raw.fov > 0) rig.fov_deg = raw.fov;
    if (raw.orthographic) rig.orthographic = true;
    if (raw.seed) spec.seed = raw.seed;
    if (raw.shake > 0) {
        rig.shake_angle_deg = 4 * raw.shake;
        rig.shake_elevation_deg = 3 * raw.shake;
        rig.shake_roll_deg = 1.5 * raw.shake;
        rig.shake_position = rig.shake_look_at = 0.02 * raw.shake;
    }
    spec.photos = !raw.masks_only;
    return spec;
}

}  // namespace

Command add_synth(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("synth", "make a synthetic shoot: photos, exact soft masks, cameras, truth");
    app->fallthrough();
    app->add_option("object", raw->object, "cup, ellipsoids, boxes, torus, a spec (.json) or a closed mesh (.ply, .obj, .stl)")->required();
    app->add_option("-o,--output", raw->output, "folder for the scene")->required();
    app->add_option("--rig", raw->rig, "orbit, rings (level and 35 degrees) or dome")->check(CLI::IsMember({"orbit", "rings", "dome"}));
    app->add_option("--views", raw->views, "number of views (36)")->check(CLI::Range(1, 10000));
    app->add_option("--width", raw->width, "image width, px (640)")->check(CLI::Range(2, 16384));
    app->add_option("--height", raw->height, "image height, px (480)")->check(CLI::Range(2, 16384));
    app->add_option("--fov", raw->fov, "vertical field of view, degrees (30)")->check(CLI::Range(1.0, 160.0));
    app->add_option("--shake", raw->shake, "unsteady hand: 1 = 4 deg of angle, 3 of elevation, 1.5 of roll, 2 % of position and aim")->check(CLI::Range(0.0, 5.0));
    app->add_option("--seed", raw->seed, "of everything random (1)");
    app->add_flag("--orthographic", raw->orthographic, "parallel projection");
    app->add_flag("--masks-only", raw->masks_only, "no photographs");
    app->add_flag("--force", raw->force, "write into a folder that is not empty");
    return {app, [raw](Common&, Progress& progress) {
                const SyntheticSpec spec = spec_of(*raw);
                if (!raw->force && std::filesystem::is_directory(raw->output) && !std::filesystem::is_empty(raw->output))
                    throw OutputError(raw->output + ": is not empty. Remedy: another -o, or --force");
                const SyntheticScene scene = synthesize(spec, progress);
                write_scene(scene, raw->output);
                spdlog::info("{} views of '{}' in {}: images/, masks/, transforms.json (true cameras), transforms_nominal.json, truth.ply",
                             scene.views.views.size(), spec.name, raw->output);
                return 0;
            }};
}

}  // namespace vdbcarve::cli
