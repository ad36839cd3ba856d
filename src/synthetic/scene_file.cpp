// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "vdbcarve/error.h"
#include "vdbcarve/synthetic.h"
#include "vdbcarve/video.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

using nlohmann::json;

Vec3d vec(const json& a) { return Vec3d(a.at(0), a.at(1), a.at(2)); }

/// A spec's parts; fields that nobody knows are refused.
class SpecReader {
  public:
    explicit SpecReader(const fs::path& file) : file_(file) {}

    void known(const json& node, std::initializer_list<const char*> keys, const std::string& where) const {
        for (auto it = node.begin(); it != node.end(); ++it)
            if (std::none_of(keys.begin(), keys.end(), [&](const char* k) { return it.key() == k; }))
                throw InputError(file_.string() + ": " + where + "unknown field '" + it.key() + "'");
    }

    Solid solid(const json& s) const {
        static const std::pair<const char*, Solid::Kind> kinds[] = {{"ellipsoid", Solid::Kind::Ellipsoid},
                                                                    {"box", Solid::Kind::Box},
                                                                    {"torus", Solid::Kind::Torus},
                                                                    {"cup", Solid::Kind::Cup},
                                                                    {"bowl", Solid::Kind::Bowl}};
        known(s, {"type", "size", "centre", "turn_deg", "color"}, "solids: ");
        Solid solid;
        const std::string type = s.at("type");
        const auto kind = std::find_if(std::begin(kinds), std::end(kinds), [&](const auto& k) { return type == k.first; });
        if (kind == std::end(kinds)) throw InputError(file_.string() + ": solids: type '" + type + "' is none of ellipsoid, box, torus, cup, bowl");
        solid.kind = kind->second;
        solid.size = vec(s.at("size"));
        if (s.contains("centre")) solid.world_from_solid.translation = vec(s["centre"]);
        if (s.contains("turn_deg")) solid.world_from_solid.rotation = turned(vec(s["turn_deg"]));
        if (s.contains("color")) solid.color = vec(s["color"]);
        return solid;
    }

    void rig(const json& r, Rig& rig) const {
        known(r, {"type",           "motion",         "start_deg",    "arc_deg",       "speed_variation", "sittings",        "lens",
                  "breathing",      "crop_drift_px",  "views",        "elevation_deg", "rings",           "fov_deg",         "distance",
                  "fill",           "orthographic",   "width",        "height",        "pixel_aspect",    "shake_angle_deg", "shake_elevation_deg",
                  "shake_roll_deg", "shake_position", "shake_look_at"},
              "rig: ");
        const std::string type = r.value("type", "orbit");
        if (type == "orbit") rig.kind = Rig::Kind::Orbit;
        else if (type == "rings") rig.kind = Rig::Kind::Rings;
        else if (type == "dome") rig.kind = Rig::Kind::Dome;
        else throw InputError(file_.string() + ": rig: type '" + type + "' is none of orbit, rings, dome");
        const std::string motion = r.value("motion", "camera");
        if (motion != "camera" && motion != "turntable") throw InputError(file_.string() + ": rig: motion '" + motion + "' is none of camera, turntable");
        rig.motion = motion == "turntable" ? Rig::Motion::Turntable : Rig::Motion::Camera;
        rig.start_deg = r.value("start_deg", rig.start_deg);
        rig.arc_deg = r.value("arc_deg", rig.arc_deg);
        rig.speed_variation = r.value("speed_variation", rig.speed_variation);
        rig.sittings = r.value("sittings", rig.sittings);
        rig.breathing = r.value("breathing", rig.breathing);
        rig.crop_drift_px = r.value("crop_drift_px", rig.crop_drift_px);
        if (r.contains("lens")) {
            rig.lens.model = Lens::Model::OpenCV;
            rig.lens.coefficients = r["lens"].get<std::vector<double>>();
        }
        rig.views = r.value("views", rig.views);
        rig.elevation_deg = r.value("elevation_deg", rig.elevation_deg);
        for (const json& ring : r.value("rings", json::array())) rig.rings.push_back({ring.at("views"), ring.at("elevation_deg")});
        rig.fov_deg = r.value("fov_deg", rig.fov_deg);
        rig.distance = r.value("distance", rig.distance);
        rig.fill = r.value("fill", rig.fill);
        rig.orthographic = r.value("orthographic", rig.orthographic);
        rig.width_px = r.value("width", rig.width_px);
        rig.height_px = r.value("height", rig.height_px);
        rig.pixel_aspect = r.value("pixel_aspect", rig.pixel_aspect);
        rig.shake_angle_deg = r.value("shake_angle_deg", 0.0);
        rig.shake_elevation_deg = r.value("shake_elevation_deg", 0.0);
        rig.shake_roll_deg = r.value("shake_roll_deg", 0.0);
        rig.shake_position = r.value("shake_position", 0.0);
        rig.shake_look_at = r.value("shake_look_at", 0.0);
    }

    void look(const json& l, PhotoLook& look) const {
        known(l,
              {"gloss", "table", "table_reflection", "blur_px", "noise", "jpeg_quality", "exif", "film_rate_hz", "exposure_jitter", "flat", "light_drift",
               "backdrop", "spill", "plates"},
              "look: ");
        look.gloss = l.value("gloss", look.gloss);
        look.table = l.value("table", look.table);
        look.table_reflection = l.value("table_reflection", look.table_reflection);
        look.blur_px = l.value("blur_px", look.blur_px);
        look.noise = l.value("noise", look.noise);
        look.jpeg_quality = l.value("jpeg_quality", look.jpeg_quality);
        look.exif = l.value("exif", look.exif);
        look.film_rate_hz = l.value("film_rate_hz", look.film_rate_hz);
        look.exposure_jitter = l.value("exposure_jitter", look.exposure_jitter);
        look.flat = l.value("flat", look.flat);
        look.light_drift = l.value("light_drift", look.light_drift);
        if (l.contains("backdrop")) look.backdrop = vec(l["backdrop"]);
        look.spill = l.value("spill", look.spill);
        look.plates = l.value("plates", look.plates);
    }

    void damage(const json& d, MaskDamage& m) const {
        known(d, {"noise_px", "correlation_px", "dilate_px", "holes", "blobs", "radius_px", "share"}, "damage: ");
        m.noise_px = d.value("noise_px", m.noise_px);
        m.correlation_px = d.value("correlation_px", m.correlation_px);
        m.dilate_px = d.value("dilate_px", m.dilate_px);
        m.holes = d.value("holes", m.holes);
        m.blobs = d.value("blobs", m.blobs);
        m.radius_px = d.value("radius_px", m.radius_px);
        m.share = d.value("share", m.share);
    }

  private:
    const fs::path& file_;
};

}  // namespace

SyntheticSpec read_spec(const fs::path& file) {
    SyntheticSpec spec;
    const SpecReader read(file);
    try {
        std::ifstream in(file);
        if (!in) throw InputError(file.string() + ": cannot be opened");
        const json j = json::parse(in);
        read.known(j, {"name", "builtin", "solids", "mesh", "texture", "pattern", "rig", "look", "damage", "seed"}, "");
        if (j.contains("builtin")) spec = builtin_spec(j["builtin"]);
        spec.name = j.value("name", file.stem().string());
        spec.seed = j.value("seed", uint64_t{1});
        if (j.contains("mesh")) spec.mesh = read_mesh(file.parent_path() / j["mesh"].get<std::string>());
        if (j.contains("texture")) spec.texture = read_texture(file.parent_path() / j["texture"].get<std::string>());
        if (j.contains("pattern")) spec.pattern = pattern_called(j["pattern"]);
        for (const json& s : j.value("solids", json::array())) spec.solids.push_back(read.solid(s));
        if (j.contains("rig")) read.rig(j["rig"], spec.rig);
        if (j.contains("look")) read.look(j["look"], spec.look);
        if (j.contains("damage")) read.damage(j["damage"], spec.damage);
    } catch (const json::exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
    return spec;
}

Image8 read_texture(const fs::path& file) { return io::read_photo8(file); }

void write_scene(const SyntheticScene& scene, const fs::path& folder) {
    make_folder(folder / "masks");
    make_folder(folder / "images");
    if (!scene.true_masks.empty()) make_folder(folder / "masks_true");
    if (!scene.plates.empty()) make_folder(folder / "plates");
    tbb::parallel_for(size_t{0}, scene.masks.size(), [&](size_t i) {
        io::write_png(folder / scene.views.views[i].mask_path, scene.masks[i].coverage);
        const View& view = scene.views.views[i];
        if (!scene.plates.empty()) io::write_png((folder / "plates" / fs::path(view.name).filename()).replace_extension(".png"), scene.plates[i]);
        // Without photographs the silhouettes stand in for them.
        if (!scene.true_masks.empty()) io::write_png(folder / "masks_true" / view.mask_path.filename(), scene.true_masks[i].coverage);
        if (!scene.photos.empty() && scene.look.jpeg_quality > 0) {
            const Intrinsics& k = view.camera.intrinsics;
            const auto jpeg = io::encode_jpeg(scene.photos[i], scene.look.jpeg_quality, scene.look.exif && !k.orthographic ? 36.0 * k.fx / k.width_px : 0);
            write_file(folder / view.name, jpeg.data(), jpeg.size());
        } else {
            io::write_png(folder / view.name, scene.photos.empty() ? scene.masks[i].coverage : scene.photos[i]);
        }
    });
    const auto cameras = [&](const Views& views, const char* name) {
        Views named = views;
        for (View& v : named.views) v.image_path = folder / v.name;
        write_file(folder / name, cameras_json(named, folder));
    };
    if (scene.look.film_rate_hz > 0 && !scene.photos.empty()) write_film(scene.photos, scene.look.film_rate_hz, folder / "film.mp4");
    cameras(scene.views, "transforms.json");
    cameras(scene.nominal, "transforms_nominal.json");
    write_mesh(folder / "truth.ply", scene.truth);
}

}  // namespace vdbcarve
