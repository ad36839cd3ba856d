// SPDX-License-Identifier: Apache-2.0
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "base/atomic_file.h"
#include "color/color_plan.h"
#include "image/image_io.h"
#include "vdbcarve/color.h"
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
    const std::vector<std::string> masks = mask_names(views);
    const std::vector<Camera> cameras = views.cameras();
    if (!options.save.empty()) make_folder(options.save);
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
        if (const fs::path file = options.result / "masks" / masks[i]; !options.result.empty() && fs::exists(file)) mask.coverage = io::read_image8(file);
        const Image8 rendered = render_colors(mesh, cameras[i], color_at);
        if (!mask.coverage.empty() && (mask.coverage.width != rendered.width || mask.coverage.height != rendered.height)) {
            progress.warn("view " + view.name + ": the result's mask has another size than the camera and is not used");
            mask = {};
        }
        out[i].agreement = compare_photo(rendered, view_of(photo), view_of(mask));
        if (options.save.empty()) continue;
        const auto png = io::encode_png(side_by_side(rendered, view_of(photo)));
        write_file(options.save / masks[i], png.data(), png.size());
    }
    return out;
}

}  // namespace vdbcarve
