// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <algorithm>
#include <memory>
#include <optional>

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
    std::string motion, lens;
    std::optional<double> elevation, start, arc, speed, breathing, crop_drift, gloss, blur, noise, mask_noise, mask_correlation, mask_dilate, mask_radius,
        mask_share;
    std::optional<int> sittings, jpeg, holes, blobs;
    bool table = false, exif = false, flat = false, plates = false;
    std::optional<double> exposure_jitter, light_drift, spill, film;
    std::string texture, pattern, backdrop;
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
    const auto set = [](auto& target, const auto& given) {
        if (given) target = *given;
    };
    if (!raw.motion.empty()) rig.motion = raw.motion == "turntable" ? Rig::Motion::Turntable : Rig::Motion::Camera;
    set(rig.elevation_deg, raw.elevation);
    set(rig.start_deg, raw.start);
    set(rig.arc_deg, raw.arc);
    set(rig.speed_variation, raw.speed);
    set(rig.sittings, raw.sittings);
    set(rig.breathing, raw.breathing);
    set(rig.crop_drift_px, raw.crop_drift);
    if (!raw.lens.empty()) {
        rig.lens.model = Lens::Model::OpenCV;
        rig.lens.coefficients = numbers("--lens", raw.lens, 4);
    }
    PhotoLook& look = spec.look;
    if (!raw.texture.empty()) spec.texture = read_texture(raw.texture);
    if (!raw.pattern.empty()) spec.pattern = pattern_called(raw.pattern);
    set(look.gloss, raw.gloss);
    set(look.exposure_jitter, raw.exposure_jitter);
    set(look.light_drift, raw.light_drift);
    set(look.spill, raw.spill);
    set(look.film_rate_hz, raw.film);
    if (!raw.backdrop.empty()) {
        const auto c = numbers("--backdrop", raw.backdrop, 3);
        look.backdrop = Vec3d(c[0], c[1], c[2]);
    }
    look.plates = look.plates || raw.plates;
    look.flat = look.flat || raw.flat;
    set(look.blur_px, raw.blur);
    set(look.noise, raw.noise);
    set(look.jpeg_quality, raw.jpeg);
    look.table = look.table || raw.table;
    look.exif = look.exif || raw.exif;
    if (raw.exif && look.jpeg_quality == 0) look.jpeg_quality = 92;
    MaskDamage& damage = spec.damage;
    set(damage.noise_px, raw.mask_noise);
    set(damage.correlation_px, raw.mask_correlation);
    set(damage.dilate_px, raw.mask_dilate);
    set(damage.radius_px, raw.mask_radius);
    set(damage.share, raw.mask_share);
    set(damage.holes, raw.holes);
    set(damage.blobs, raw.blobs);
    spec.photos = !raw.masks_only;
    return spec;
}

}  // namespace

Command add_synth(CLI::App& program) {
    // Reads better whole: one option after the other, in the order in which --help lists them.
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("synth", "make a synthetic shoot: photos, exact soft masks, cameras, truth");
    app->fallthrough();
    app->add_option("object", raw->object, "cup, bowl, ellipsoids, boxes, torus, pair, a spec (.json) or a closed mesh (.ply, .obj, .stl)")->required();
    app->add_option("-o,--output", raw->output, "folder for the scene")->required();
    app->add_option("--rig", raw->rig, "orbit, rings (level and 35 degrees) or dome")->check(CLI::IsMember({"orbit", "rings", "dome"}));
    app->add_option("--views", raw->views, "number of views (36)")->check(CLI::Range(1, 10000));
    app->add_option("--width", raw->width, "image width, px (640)")->check(CLI::Range(2, 16384));
    app->add_option("--height", raw->height, "image height, px (480)")->check(CLI::Range(2, 16384));
    app->add_option("--fov", raw->fov, "vertical field of view, degrees (30)")->check(CLI::Range(1.0, 160.0));
    app->add_option("--shake", raw->shake, "unsteady hand: 1 = 4 deg of angle, 3 of elevation, 1.5 of roll, 2 % of position and aim")
        ->check(CLI::Range(0.0, 5.0));
    app->add_option("--seed", raw->seed, "of everything random (1)");
    app->add_flag("--orthographic", raw->orthographic, "parallel projection");
    app->add_option("--elevation", raw->elevation, "of an orbit, degrees (10)")->check(CLI::Range(-85.0, 85.0))->group("Motion");
    app->add_option("--motion", raw->motion, "camera: it walks around; turntable: the object turns, light and shadow stay with the camera")
        ->check(CLI::IsMember({"camera", "turntable"}))
        ->group("Motion");
    app->add_option("--start", raw->start, "azimuth of the first view, degrees")->group("Motion");
    app->add_option("--arc", raw->arc, "degrees that the views are spread over (360); more than 360: arcs overlap")->group("Motion");
    app->add_option("--speed-variation", raw->speed, "smooth changes of angular speed, share of the mean")->check(CLI::Range(0.0, 0.9))->group("Motion");
    app->add_option("--sittings", raw->sittings,
                    "2: half of the views show the object laid on its side; each half goes once half around (align: --sittings N,N --arc 180, where the rig "
                    "has one ring)")
        ->check(CLI::Range(1, 2))
        ->group("Motion");
    app->add_option("--lens", raw->lens, "k1,k2,p1,p2: distortion of photos and masks (OpenCV's model)")->group("Camera");
    app->add_option("--breathing", raw->breathing, "the focal length wanders by up to this share")->check(CLI::Range(0.0, 0.5))->group("Camera");
    app->add_option("--crop-drift", raw->crop_drift, "the principal point wanders by up to so many pixels (a stabiliser's crop)")
        ->check(CLI::Range(0.0, 1000.0))
        ->group("Camera");
    app->add_option("--film", raw->film, "the photographs also as film.mp4, with so many frames a second (--views says how many)")
        ->check(CLI::Range(1.0, 240.0))
        ->group("Camera");
    app->add_option("--blur", raw->blur, "defocus, standard deviation in px")->check(CLI::Range(0.0, 50.0))->group("Camera");
    app->add_option("--noise", raw->noise, "sensor noise, standard deviation in 8-bit steps")->check(CLI::Range(0.0, 100.0))->group("Camera");
    app->add_option("--jpeg", raw->jpeg, "photos as .jpg of this quality")->check(CLI::Range(1, 100))->group("Camera");
    app->add_flag("--exif", raw->exif, ".jpg with the focal length in EXIF")->group("Camera");
    app->add_option("--texture", raw->texture, "picture for a mesh with texture coordinates (.obj)")->group("Light");
    app->add_option("--pattern", raw->pattern, "of what has no colours: clay (veins and blotches), checks (repeat themselves), plain (one colour)")
        ->check(CLI::IsMember({"clay", "checks", "plain"}))
        ->group("Light");
    app->add_option("--exposure-jitter", raw->exposure_jitter, "photographs' exposures are off by up to this share")
        ->check(CLI::Range(0.0, 0.9))
        ->group("Light");
    app->add_option("--backdrop", raw->backdrop, "r,g,b: a cloth of this colour (linear, 0..1) behind everything, unevenly lit")->group("Light");
    app->add_option("--spill", raw->spill, "share of the cloth's light on the object's rim")->check(CLI::Range(0.0, 1.0))->group("Light");
    app->add_option("--light-drift", raw->light_drift, "lamps wander by up to this share, colour and side too")->check(CLI::Range(0.0, 0.9))->group("Light");
    app->add_flag("--plates", raw->plates, "the photographs again without the object, into plates/")->group("Light");
    app->add_flag("--flat", raw->flat, "no lamps: the object's own colours")->group("Light");
    app->add_option("--gloss", raw->gloss, "strength of highlights, 0..1")->check(CLI::Range(0.0, 1.0))->group("Light");
    app->add_flag("--table", raw->table, "a table under the object, with its shadow and reflection")->group("Light");
    app->add_option("--mask-noise", raw->mask_noise, "masks' contours off by this many px (standard deviation)")
        ->check(CLI::Range(0.0, 50.0))
        ->group("Bad masks");
    app->add_option("--mask-correlation", raw->mask_correlation, "over this many px (0: every pixel by itself)")
        ->check(CLI::Range(0.0, 500.0))
        ->group("Bad masks");
    app->add_option("--mask-dilate", raw->mask_dilate, "masks too large by this many px (negative: too small)")
        ->check(CLI::Range(-50.0, 50.0))
        ->group("Bad masks");
    app->add_option("--mask-holes", raw->holes, "holes a mask")->check(CLI::Range(0, 100))->group("Bad masks");
    app->add_option("--mask-blobs", raw->blobs, "blobs a mask")->check(CLI::Range(0, 100))->group("Bad masks");
    app->add_option("--mask-radius", raw->mask_radius, "of holes and blobs, px (14)")->check(CLI::Range(1.0, 500.0))->group("Bad masks");
    app->add_option("--mask-share", raw->mask_share, "share of the views with holes and blobs (1)")->check(CLI::Range(0.0, 1.0))->group("Bad masks");
    app->add_flag("--masks-only", raw->masks_only, "no photographs");
    app->add_flag("--force", raw->force, "write into a folder that is not empty");
    app->footer(
        "Examples:\n"
        "  vdbcarve synth cup -o shoot                                              36 views around\n"
        "  vdbcarve synth statue.ply --rig dome --views 72 -o shoot                 a mesh of your own\n"
        "  vdbcarve synth cup --masks-only --mask-holes 2 --mask-share 0.1 -o shoot   masks with mistakes");
    return {app, [raw](Common&, Progress& progress) {
                // --force replaces an earlier shoot, not the mesh or texture that this one is made from.
                const std::filesystem::path folder = std::filesystem::weakly_canonical(raw->output) / "";
                for (const std::string& input : {raw->object, raw->texture})
                    if (std::filesystem::is_regular_file(input) && std::filesystem::canonical(input).string().rfind(folder.string(), 0) == 0)
                        throw OutputError(raw->output + ": holds " + input + ", which the shoot is made from. Remedy: another -o");
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
