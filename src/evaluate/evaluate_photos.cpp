// SPDX-License-Identifier: Apache-2.0
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "base/atomic_file.h"
#include "base/output_names.h"
#include "color/color_plan.h"
#include "image/image_io.h"
#include "views/formats/camera_formats.h"
#include "vdbcarve/color.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/volume.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

std::set<std::string> left_out_of(const fs::path& result, Progress& progress) {
    std::set<std::string> out;
    bool any = false, colored = false;
    try {
        std::ifstream in(result / "report.json");
        const nlohmann::json report = nlohmann::json::parse(in);
        for (const auto& view : report.at("views")) {
            any = true;
            colored |= view.contains("color_used");
            if (!view.value("color_used", false)) out.insert(view.at("name"));
        }
    } catch (const nlohmann::json::exception&) {
        progress.warn((result / "report.json").string() + ": cannot be read; all views count as used for colour");
    }
    if (any && !colored) {
        progress.warn((result / "report.json").string() + ": says nothing about colour; all views count as used for it");
        out.clear();
    }
    return out;
}

/// Throws OutputError where pictures would be saved among those that are read.
void refuse_to_save_among_inputs(const fs::path& folder, const Views& views, const fs::path& result) {
    std::set<fs::path> read;
    for (const View& v : views.views) {
        if (!v.image_path.empty()) read.insert(v.image_path.parent_path());
        if (!v.mask_path.empty()) read.insert(v.mask_path.parent_path());
    }
    const fs::path cameras = fs::is_directory(views.camera_file) ? views.camera_file : views.camera_file.parent_path();
    for (const char* part : {"", "images", "masks", "ignore"}) read.insert(cameras / part);
    if (!result.empty()) read.insert({result, result / "masks"});
    for (const fs::path& input : read)
        if (is_same_place(folder, input))
            throw OutputError(folder.string() + ": photographs, masks or cameras lie in this folder, and could be replaced. Remedy: another one");
}

/// Files of the result's masks, by view of a scene; empty where there is none. The result may be of more views, or of fewer: names are as its own views have
/// them.
std::vector<fs::path> masks_of(const fs::path& result, const Views& views) {
    std::vector<fs::path> out(views.views.size());
    std::map<std::string, std::string> files;
    Views made;
    try {
        for (const io::ImportedView& v : io::read_transforms(result / "cameras.json").views) made.views.push_back(v.view);
    } catch (const InputError&) {  // without cameras
        made = views;
    }
    const std::vector<std::string> names = mask_names(made);
    for (size_t i = 0; i < names.size(); ++i) files[made.views[i].name] = names[i];
    // cameras.json has base names where they tell the result's views apart; here they have to do so, too.
    std::map<std::string, int> base_names;
    const auto base = [&](size_t i) { return fs::path(views.views[i].name).filename().string(); };
    for (size_t i = 0; i < out.size(); ++i) ++base_names[base(i)];
    for (size_t i = 0; i < out.size(); ++i) {
        auto found = files.find(views.views[i].name);
        if (found == files.end() && base_names[base(i)] == 1) found = files.find(base(i));
        if (found != files.end() && fs::exists(result / "masks" / found->second)) out[i] = result / "masks" / found->second;
    }
    return out;
}

/// Photograph left, rendering right, on black.
Image8 side_by_side(const Image8& rendered, const PhotoView& photo) {
    Image8 out(2 * rendered.width, rendered.height, 3);
    for (int y = 0; y < rendered.height; ++y)
        for (int x = 0; x < rendered.width; ++x)
            for (int c = 0; c < 3; ++c) {
                const int from = photo.channels() < 3 ? 0 : c;
                out.at(x, y, c) = photo.pixels8.empty() ? static_cast<uint8_t>(photo.pixels16.at(x, y, from) >> 8) : photo.pixels8.at(x, y, from);
                out.at(rendered.width + x, y, c) = rendered.at(x, y, c);
            }
    return out;
}

}  // namespace

std::vector<PhotoComparison> compare_photos(const Mesh& mesh, const Views& views, const PhotoOptions& options, Progress& progress) {
    openvdb::Vec3SGrid::Ptr volume;
    if (options.from_volume) {
        if (options.result.empty()) throw UsageError("--from-volume wants the folder of a result");
        for (const openvdb::GridBase::Ptr& grid : read_vdb(options.result / "volume.vdb"))
            if (auto colors = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grid)) volume = colors;
        if (!volume) throw InputError((options.result / "volume.vdb").string() + ": holds no colour grid");
    }
    std::function<std::array<float, 3>(const Vec3d&)> color_at;
    if (volume)
        color_at = [reader = ColorReader(*volume)](const Vec3d& p) {
            kernel::Rgb c{0.f, 0.f, 0.f};
            reader.interpolate(reader.index_of(p), c);
            return std::array<float, 3>{c.r, c.g, c.b};
        };
    const std::set<std::string> left_out = options.result.empty() ? std::set<std::string>() : left_out_of(options.result, progress);
    const std::vector<std::string> pictures = mask_names(views);
    const std::vector<fs::path> masks = options.result.empty() ? std::vector<fs::path>(views.views.size()) : masks_of(options.result, views);
    const std::vector<Camera> cameras = views.cameras();
    if (!options.save.empty()) {
        refuse_to_save_among_inputs(options.save, views, options.result);
        make_folder(options.save);
    }
    std::vector<PhotoComparison> out(views.views.size());
    progress.begin("evaluate", out.size());
    for (size_t i = 0; i < out.size(); ++i) {
        const View& view = views.views[i];
        out[i].name = view.name;
        out[i].used = !left_out.count(view.name);
        progress.step();
        if (view.image_path.empty()) continue;
        const Photo photo = load_photo(view);
        Mask mask;
        if (!masks[i].empty()) mask.coverage = io::read_image8(masks[i]);
        const Image8 rendered = render_colors(mesh, cameras[i], color_at);
        if (!mask.coverage.empty() && (mask.coverage.width != rendered.width || mask.coverage.height != rendered.height)) {
            progress.warn("view " + view.name + ": the result's mask has another size than the camera and is not used");
            mask = {};
        }
        out[i].agreement = compare_photo(rendered, view_of(photo), view_of(mask));
        if (options.save.empty()) continue;
        io::write_png(options.save / pictures[i], side_by_side(rendered, view_of(photo)));
    }
    return out;
}

}  // namespace vdbcarve
