// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/stereo.h"

#include <algorithm>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "base/memory.h"
#include "pipeline/fair_inputs.h"
#include "stereo/stereo_sheet.h"
#include "base/text.h"
#include "vdbcarve/silhouettes_kept.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char *kFile = "surface.vdb", *kSheet = "sheet.png", *kMaps = "maps";
/// Bytes of a working pixel: grey, object, plane, cost, confidence, depths; of the coarser ones a third more.
constexpr double kStereoPerPixel = 40, kStereoPerPixelBesideGpu = 14;

/// The fair surface keeps silhouettes covered, and evens out noise: depths may say more near the hull.
constexpr double kLedMargin_px = 0.6;

double share_of(size_t part, size_t whole) { return whole ? static_cast<double>(part) / static_cast<double>(whole) : 0; }

}  // namespace

void Stereo::prepare(Run& run) {
    stereo_ = options.stereo.options;
    if (!stereo_.scale) stereo_.scale = default_stereo_scale(*surface.grid, used_cameras(shoot, masks));
    if (makes_fair(options)) stereo_.hull_margin_px = kLedMargin_px;
    idle_ = photos_are_masks(shoot, masks);
    if (idle_) run.progress().warn("--stereo: the images are the silhouettes themselves, which have no texture; the silhouettes alone make the surface");
    if (idle_ || options.stereo.use == StereoSettings::Use::On) return;
    try {
        check_memory(run);
    } catch (const InputError& e) {
        idle_ = true;
        run.progress().warn(std::string(e.what()) + ". --stereo auto: the silhouettes alone make the surface");
    }
}

Key Stereo::key() const {
    Key key(kName);
    key.of(surface.key).of(stereo_).of(options.color.leave_out);
    add_photographs(key, shoot, masks);
    return key;
}

void Stereo::check_memory(Run& run) const {
    const bool gpu = run.on_gpu();  // keeps planes itself
    const double pixels = largest_photo_bytes(shoot, masks) / kPhotoBytesPerPixel, views = static_cast<double>(masks.used.size());
    const auto bytes_at = [&](int scale) {
        return views * pixels * (kPhotoBytesPerPixel + (gpu ? kStereoPerPixelBesideGpu : kStereoPerPixel) * 4 / 3 / (scale * scale));
    };
    const double room = run.memory_limit() - static_cast<double>(resident_memory_bytes()), bytes = bytes_at(stereo_.scale);
    if (bytes <= room) return;
    int smaller = 2 * stereo_.scale;
    while (smaller < kMostStereoScale && bytes_at(smaller) > room) smaller *= 2;
    const std::string remedy =
        smaller <= kMostStereoScale && bytes_at(smaller) <= room ? text_of("--stereo-scale %d, fewer photographs", smaller) : "fewer photographs (--views)";
    throw InputError(
        text_of("--stereo: %zu photographs and their depths take %.1f GB at 1/%d of their size, and %.1f GB of --memory-limit are left. Remedy: %s, or "
                "a larger --memory-limit",
                masks.used.size(), bytes / 1e9, stereo_.scale, std::max(room, 0.0) / 1e9, remedy.c_str()));
}

Surface Stereo::run(Run& run) {
    check_memory(run);
    const std::vector<ColorInput> inputs = color_inputs(shoot, masks, options.color.leave_out);
    Photographs photographs(shoot, masks, run.progress());
    hull_ = surface.grid;
    const bool done = run.device().run("stereo", [&](Device& device) {
        if (!run.is_on_device(hull_)) device.set_surface(*hull_);
        run.forget_device_grid();  // until it is whole again
        result_ = device.stereo(*hull_, inputs, photographs.source(), stereo_, run.progress());
        run.set_on_device(result_.surface);
    });
    if (!done) {
        run.forget_device_grid();
        result_ = stereo(*hull_, inputs, photographs.source(), stereo_, run.progress());
    }
    Surface made = surface;
    made.grid = result_.surface;
    made.stereo_confidence = result_.confidence;
    made.stereo = summary(result_, inputs);
    made.trusted_share = made.stereo.at("trusted_share");
    if (makes_fair(options)) {
        const int wanted = options.carve.half_width_vox;
        const openvdb::FloatGrid::Ptr before = to_fair_band(hull_, wanted, run.progress()), after = to_fair_band(made.grid, wanted, run.progress());
        made.silhouettes_kept = silhouettes_kept(*before, {*after, *result_.confidence}, fair_views(shoot, masks));
        made.stereo["silhouettes_kept"] = made.silhouettes_kept;
    }
    return made;
}

bool Stereo::is_used(const StereoSettings& settings, const Surface& made) {
    return settings.use == StereoSettings::Use::On || made.stereo.is_null() || made.trusted_share >= kLeastTrusted;
}

void Stereo::report(const Surface& made, json& report) const {
    if (made.stereo.is_null()) return;
    json& said = report["stereo"] = made.stereo;
    said["used"] = is_used(options.stereo, made);
    if (said["used"]) return;
    for (const char* of_surface : {"volume_before", "volume", "fragments_dropped", "voids_filled", "silhouettes_kept"}) said.erase(of_surface);
}

void Stereo::say(const Surface& made, Progress& progress) const {
    if (made.stereo.is_null()) return;
    if (!is_used(options.stereo, made)) {
        progress.note(
            text_of("--stereo auto: only %.1f %% of the object's pixels have a depth that other photographs agree with, and %.0f %% are needed: the "
                    "silhouettes alone make the surface. --stereo on takes the depths all the same",
                    100 * made.trusted_share, 100 * kLeastTrusted));
        return;
    }
    progress.note(text_of("stereo: %.0f %% of the object's pixels have a depth that other views bear out; volume %+.2f %%", 100 * made.trusted_share,
                          100 * (made.stereo.at("volume").get<double>() / made.stereo.at("volume_before").get<double>() - 1)));
    size_t with_photo = made.stereo.at("views_with_photograph"), alone = made.stereo.at("views_alone");
    if (alone)
        progress.warn(text_of(
            "stereo: %zu of %zu views have no two others at %.0f to %.0f degrees from them, and give no depth. Remedy: photographs nearer to each other", alone,
            with_photo, stereo_.least_angle_deg, stereo_.most_angle_deg));
    if (alone < with_photo && made.trusted_share < 0.05)
        progress.warn(
            text_of("stereo: only %.1f %% of the object's pixels have a depth that other views bear out: the hull stands nearly everywhere. It needs "
                    "texture, and cameras right to a pixel (--method refine)",
                    100 * made.trusted_share));
}

json Stereo::summary(const StereoResult& result, const std::vector<ColorInput>& inputs) {
    json ms, of_views;
    size_t object = 0, trusted = 0, with_photo = 0, without = 0;
    for (size_t u = 0; u < inputs.size(); ++u) {
        const StereoViewStatistics& v = result.views[u];
        object += v.object_pixels;
        trusted += v.trusted_pixels;
        with_photo += inputs[u].use;
        without += inputs[u].use && v.pairs == 0;
        of_views.push_back({{"name", inputs[u].name},
                            {"compared_with", v.pairs},
                            {"matched_share", share_of(v.matched_pixels, v.object_pixels)},
                            {"trusted_share", share_of(v.trusted_pixels, v.object_pixels)}});
    }
    for (const auto& [name, value] : result.milliseconds) ms[name] = value;
    return {{"scale", result.scale},
            {"trusted_share", share_of(trusted, object)},
            {"volume_before", result.volume_before},
            {"volume", result.volume},
            {"fragments_dropped", result.fragments},
            {"voids_filled", result.voids},
            {"views_with_photograph", with_photo},
            {"views_alone", without},
            {"milliseconds", ms},
            {"views", of_views}};
}

void Stereo::save(Slot& slot, Surface& made) const {
    std::vector<size_t> with_map;
    for (size_t u = 0; u < result_.maps.size(); ++u)
        if (!result_.maps[u].depth.data.empty()) with_map.push_back(u);
    Progress said_already;
    std::vector<StereoTile> tiles;  // four views, spread evenly
    for (size_t n = with_map.size(), shown = std::min<size_t>(n, 4), s = 0; s < shown; ++s) {
        const size_t u = with_map[s * n / shown];
        const View& v = shoot.views.views[masks.used[u]];
        tiles.push_back({v.name, v.camera, photo_to_show(v, said_already), &result_.maps[u]});
    }
    io::write_png(slot.file(kSheet), stereo_sheet(*hull_, *made.grid, tiles));
    made.stereo_sheet = slot.later(kSheet);
    const std::vector<std::string> names = options.stereo.maps ? map_names() : std::vector<std::string>();
    if (options.stereo.maps) {
        for (const std::string& name : names) make_folder((slot.file(kMaps) / name).parent_path());
        write_depth_maps(slot.file(kMaps), names, result_.maps);
        made.depth_maps = slot.later(kMaps);
    }
    write_vdb(slot.file(kFile), {made.grid, made.stereo_confidence}, metadata_of(shoot, masks, grid.voxel_size));
    slot.note = {{"stereo", made.stereo}, {"maps", names}};
}

std::vector<std::string> Stereo::map_names() const {
    std::vector<std::string> names;
    for (const size_t u : masks.used) names.push_back(fs::path(masks.names[u]).replace_extension("").string());
    return names;
}

Surface Stereo::load(const Slot& slot) const {
    Surface out = surface;
    out.grid.reset();
    for (const openvdb::GridBase::Ptr& stored : read_vdb(slot.file(kFile))) {
        if (stored->getName() == "surface") out.grid = openvdb::gridPtrCast<openvdb::FloatGrid>(stored);
        if (stored->getName() == "stereo_confidence") out.stereo_confidence = stored;
    }
    if (!out.grid) throw InputError(slot.file(kFile).string() + ": holds no surface");
    out.stereo = slot.note.at("stereo");
    out.trusted_share = out.stereo.at("trusted_share");
    out.silhouettes_kept = out.stereo.value("silhouettes_kept", 1.0);
    for (size_t u = 0; u < masks.used.size(); ++u)
        out.stereo.at("views").at(u)["name"] = shoot.views.views[masks.used[u]].name;  // photographs may be called otherwise now
    out.stereo_sheet = slot.file(kSheet);
    if (options.stereo.maps) {
        if (slot.note.at("maps") != json(map_names())) throw InputError(slot.folder().string() + ": was made without depth maps, or with others' names");
        out.depth_maps = slot.file(kMaps);
    }
    return out;
}

}  // namespace vdbcarve::pipeline
