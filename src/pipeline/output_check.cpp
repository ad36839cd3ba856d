// SPDX-License-Identifier: Apache-2.0
#include "pipeline/output_check.h"

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "base/atomic_file.h"
#include "base/output_names.h"
#include "base/text.h"
#include "vdbcarve/error.h"
#include "views/scene_path.h"

namespace vdbcarve {

namespace fs = std::filesystem;

void refuse_output_among_inputs(const fs::path& output, const ViewsOptions& scene, const MaskOptions& masks, const Views& views) {
    std::map<fs::path, std::string> read;  // folder -> what is read from it
    const auto add = [&](const fs::path& folder, const char* what) {
        if (!folder.empty()) read.emplace(folder, what);
    };
    std::vector<fs::path> scenes{scene.scene};
    scenes.insert(scenes.end(), scene.added.begin(), scene.added.end());
    for (const fs::path& folder : scenes) {
        std::error_code error;
        if (fs::is_regular_file(folder, error)) continue;  // a video
        add(folder, "the scene's files");
        add(folder / "images", "photographs");
        add(folder / "masks", "masks");
        add(folder / "ignore", "ignore masks");
        add(io::in_scene(masks.masks, folder), "masks");
        if (!masks.pattern.empty()) add((folder / masks.pattern).parent_path(), "masks");
        add(io::in_scene(masks.ignore_masks, folder), "ignore masks");
        if (const fs::path plates = io::in_scene(masks.plate.plate, folder); fs::is_directory(plates, error)) add(plates, "clean plates");
    }
    add(io::in_scene(scene.images, scene.scene), "photographs");
    for (const View& v : views.views) {
        if (!v.image_path.empty()) add(v.image_path.parent_path(), "photographs");
        if (!v.mask_path.empty()) add(v.mask_path.parent_path(), "masks");
    }
    // Everywhere that files of the result are written to. stages/ itself holds nothing that is read by name; a video's frames lie in a folder of it.
    for (const char* part : {"", "masks", "overlays", "depth", "hull_bricks", "unverified", "stages"}) {
        const fs::path written = *part ? output / part : output;
        for (const auto& [folder, what] : read)
            if (is_same_place(written, folder))
                throw OutputError(written.string() + ": " + what + " are read from this folder" + (folder == written ? "" : " (" + folder.string() + ")") +
                                  ", and the result would be written over them. Remedy: another -o; --force does not allow this");
    }
    if (const fs::path cameras = output / "cameras.json"; !views.camera_file.empty() && is_same_place(views.camera_file, cameras))
        throw OutputError(cameras.string() + ": the cameras are read from this file, and the result's would replace it. Remedy: another -o");
}

void refuse_foreign_results(const fs::path& output) {
    std::error_code error;
    // A result without its stages/, by which it is known otherwise: somebody made room.
    const auto says = [&](const char* file, const char* text) {
        return fs::is_regular_file(output / file, error) && read_file(output / file).find(text) != std::string::npos;
    };
    if (says("masks/.written_by_vdbcarve.json", "{") || says("report.json", "\"peak_rss_bytes\"")) return;
    std::vector<std::string> foreign;
    for (const char* name : {"cameras.json", "config.toml", "depth",       "energy_map.png", "hull.vdb",   "hull_bricks", "mat.png",
                             "mesh.glb",     "mesh.mtl",    "mesh.obj",    "mesh.ply",       "mesh.stl",   "orbit.svg",   "overlays",
                             "preview.png",  "report.html", "report.json", "stages",         "stereo.png", "unverified",  "volume.vdb"}) {
        const fs::path path = output / name;
        const auto is_empty = [&] {  // but for the lock of a run that was killed before it wrote anything
            return fs::is_directory(path, error) && std::all_of(fs::directory_iterator(path, error), fs::directory_iterator(),
                                                                [](const fs::directory_entry& entry) { return entry.path().filename() == "lock"; });
        };
        if (fs::exists(path, error) && !is_empty()) foreign.push_back(path.string());
    }
    if (!foreign.empty())
        throw OutputError(some_of(foreign) + ": not made by vdbcarve; --force writes beside other files, never over them. Remedy: another -o, or move " +
                          (foreign.size() == 1 ? "it" : "them") + " away");
}

}  // namespace vdbcarve
