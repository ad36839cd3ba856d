// SPDX-License-Identifier: Apache-2.0
// Apart from views.cpp, which reads pictures.
#include <algorithm>
#include <filesystem>
#include <set>

#include "base/output_names.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

std::vector<std::string> Views::names() const {
    std::vector<std::string> out;
    for (const View& v : views) out.push_back(v.name);
    return out;
}

std::vector<Camera> Views::cameras() const {
    std::vector<Camera> out;
    for (const View& v : views) {
        const auto sitting = std::find_if(sittings.begin(), sittings.end(), [&](const Sitting& s) { return s.id == v.sitting; });
        Camera camera = v.camera;
        if (sitting != sittings.end()) {
            // camera_from_sitting * sitting_from_scene, with depths counted in scene units.
            const Rigid3 sitting_from_scene = sitting->scene_from_sitting.inverse();
            camera.camera_from_world = camera.camera_from_world * sitting_from_scene;
            camera.camera_from_world.translation *= sitting->scale;
            if (camera.intrinsics.orthographic) {
                camera.intrinsics.fx /= sitting->scale;
                camera.intrinsics.fy /= sitting->scale;
                camera.intrinsics.skew /= sitting->scale;
            }
        }
        out.push_back(camera);
    }
    return out;
}

std::vector<std::string> mask_names(const Views& views) {
    std::set<std::string> stems;
    bool unique = true;
    for (const View& v : views.views) unique &= stems.insert(std::filesystem::path(v.name).stem().string()).second;
    std::vector<std::string> wanted;
    for (const View& v : views.views) wanted.push_back((unique ? std::filesystem::path(v.name).stem().string() : v.name) + ".png");
    return output_names(wanted, Folders::Joined);
}

}  // namespace vdbcarve
