// SPDX-License-Identifier: Apache-2.0
#include "pipeline/kept_grid.h"

#include <map>
#include <set>

#include "views/formats/camera_formats.h"
#include "pipeline/out_folder.h"
#include "pipeline/stages/views.h"
#include "result/result_json.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Scenes that the result was made of and this run is not.
std::vector<std::string> scenes_left_away(const json& report, const ReconstructOptions& o, const Shoot& shoot) {
    std::set<fs::path> here{fs::weakly_canonical(shoot.folder)};
    for (const fs::path& scene : o.views.added) here.insert(fs::weakly_canonical(scene));
    std::vector<std::string> out;
    const json scene = report.value("scene", json::object());
    for (const auto& folder : scene.value("added", std::vector<std::string>()))
        if (!here.count(fs::weakly_canonical(folder))) out.push_back(folder);
    return out;
}

/// The same camera, as far as a camera file keeps its numbers.
bool is_same(const Camera& a, const Camera& b) {
    const auto numbers = [](const Camera& c) {
        const Intrinsics& k = c.intrinsics;
        return Eigen::Matrix<double, 7, 1>{k.fx, k.fy, k.skew, k.cx, k.cy, static_cast<double>(k.width_px), static_cast<double>(k.height_px)};
    };
    const Vec3d &ta = a.camera_from_world.translation, &tb = b.camera_from_world.translation;
    return (a.camera_from_world.rotation - b.camera_from_world.rotation).norm() < 1e-9 && (ta - tb).norm() <= 1e-9 * (1 + ta.norm()) &&
           (numbers(a) - numbers(b)).norm() <= 1e-9 * numbers(a).norm();
}

KeptGrid grid_of(const json& report) {
    const json& g = report.at("grid");
    KeptGrid kept;
    const auto b = g.at("bounds").get<std::array<double, 6>>();
    kept.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
    kept.voxel_size = g.at("voxel_size").get<double>();
    const auto o = g.at("origin").get<std::array<double, 3>>();
    kept.origin = Vec3d(o[0], o[1], o[2]);
    kept.automatic = g.value("bounds_automatic", true);
    kept.floor_clips = g.value("floor_clips", false);
    return kept;
}

}  // namespace

std::optional<KeptGrid> grid_to_keep(const ReconstructOptions& o, const Shoot& shoot, Progress& progress) {
    const fs::path& output = o.run.output;
    if (o.views.added.empty() || finds_cameras(o, shoot.views) || !fs::exists(output / "report.json")) return std::nullopt;
    const json report = parse_or_empty(output / "report.json");
    std::map<std::string, Camera> before;
    KeptGrid kept;
    try {
        kept = grid_of(report);
        for (const io::ImportedView& v : io::read_transforms(output / "cameras.json").views) before.emplace(v.view.name, v.view.camera);
    } catch (const std::exception& e) {  // of nlohmann::json or an InputError
        progress.warn("the bounds are found again: " + (output / "report.json").string() + " does not say which they were (" + e.what() +
                      "). It is of mask, align, or an older vdbcarve");
        return std::nullopt;
    }
    std::vector<std::string> moved, gone;
    std::set<std::string> same;
    for (const View& v : shoot.views.views) {
        auto found = before.find(v.name);
        if (found == before.end()) found = before.find(fs::path(v.name).filename().string());
        if (found == before.end()) continue;
        if (is_same(v.camera, found->second)) same.insert(found->first);
        else moved.push_back(v.name);
    }
    for (const auto& [name, camera] : before)
        if (!same.count(name)) gone.push_back(name);
    if (moved.empty() && !same.empty()) {
        if (const std::vector<std::string> scenes = scenes_left_away(report, o, shoot); !gone.empty() && !scenes.empty())
            throw UsageError("--add: " + output.string() + " was made of " + some_of(scenes) + ", too, whose views (" + some_of(gone) +
                             ") it would lose. Remedy: --add " + scenes.front() + " besides, or another -o");
        if (!gone.empty())
            progress.warn("the result in " + output.string() + " was made of " + counted(gone.size(), "view") + " more, which " +
                          (gone.size() == 1 ? "is" : "are") + " not here any more: " + some_of(gone));
        return kept;
    }
    progress.warn("the result in " + output.string() + " is replaced, not extended, and its bounds are found again: its cameras are others" +
                  (moved.empty() ? "" : " (" + some_of(moved) + ")"));
    return std::nullopt;
}

ReconstructOptions repeatable(const ReconstructOptions& options, const std::optional<KeptGrid>& kept) {
    if (!kept) return options;
    ReconstructOptions out = options;
    out.grid = GridOptions();
    out.grid.bounds = kept->bounds;
    out.grid.voxel_size = kept->voxel_size;
    out.grid.origin = kept->origin;
    return out;
}

}  // namespace vdbcarve::pipeline
