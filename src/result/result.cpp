// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/result.h"

#include "result/result_json.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// The cameras of a file with their photographs, from where `said` (a report, or what a run failed with) has them, or from the folder `images`.
Views views_of(const fs::path& output, const json& said, const fs::path& camera_file, const fs::path& images, Progress& progress) {
    ViewsOptions options;
    std::vector<std::string> added;
    try {
        options.scene = said.at("scene").at("folder").get<std::string>();
        options.images = said.at("scene").at("images").get<std::string>();
        added = said.at("scene").value("added", added);
    } catch (const json::exception&) {
        // A report of before says nothing; --images may.
    }
    if (!images.empty()) options.images = images;
    if (!fs::is_directory(options.scene)) options.scene = output;
    options.cameras = fs::absolute(camera_file);
    options.cameras_only = true;
    Views views = load_views(options, progress);
    if (!images.empty()) return views;
    const fs::path first = options.scene;
    for (const std::string& folder : added) {
        std::error_code error;
        if (!fs::is_directory(folder) || fs::equivalent(folder, first, error)) continue;
        options.scene = folder;
        options.images.clear();  // those of the first
        const Views other = load_views(options, progress);
        for (size_t i = 0; i < views.views.size(); ++i)
            if (views.views[i].image_path.empty()) views.views[i].image_path = other.views[i].image_path;
    }
    return views;
}

}  // namespace

bool made_by_us(const fs::path& output) { return fs::exists(output / kMarker); }

void require_finished(const fs::path& output) {
    if (!fs::is_directory(output) || !made_by_us(output) || fs::exists(output / "report.json")) return;
    throw InputError(
        output.string() +
        ": holds no finished result: the run that worked in it was stopped, or is not done. Remedy: the same command with the same -o goes on from there");
}

Views result_views(const fs::path& output, const fs::path& images, Progress& progress) {
    return views_of(output, parse_or_empty(output / "report.json"), output / "cameras.json", images, progress);
}

Views last_views(const fs::path& output, const fs::path& images, Progress& progress) {
    return views_of(output, parse_or_empty(output / kMarker), output / "stages" / "cameras.json", images, progress);
}

FileFrame frame_from_scene(const fs::path& output, const std::string& file) {
    const json report = parse_or_empty(output / "report.json");
    FileFrame out;
    try {
        const json& said = report.at("files").at(file);
        out.axes = said.at("axes").get<decltype(out.axes)>();
        out.scale = said.at("scale").get<double>();
    } catch (const json::exception&) {
        return {};
    }
    return out;
}

}  // namespace vdbcarve
