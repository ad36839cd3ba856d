// SPDX-License-Identifier: Apache-2.0
#include "mask/mask_files.h"

#include <algorithm>
#include <cmath>

#include "views/scene_path.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using io::in_scene;

Image8 grey_of(const Image8& file, const fs::path& path) {
    if (file.channels == 1) return file;
    Image8 out(file.width, file.height);
    const auto channels = static_cast<size_t>(file.channels);
    bool alpha_varies = false;
    size_t coloured = 0;
    if (channels == 4)
        for (size_t i = 0; i < out.data.size(); ++i) alpha_varies |= file.data[i * 4 + 3] != file.data[3];
    for (size_t i = 0; i < out.data.size(); ++i) {
        const uint8_t* p = &file.data[i * channels];
        if (alpha_varies) {
            out.data[i] = p[3];
            continue;
        }
        coloured += std::abs(p[0] - p[1]) > 8 || std::abs(p[1] - p[2]) > 8;
        out.data[i] = std::max(std::min(p[0], p[1]), std::min(std::max(p[0], p[1]), p[2]));  // the middle one
    }
    // A stray pixel is a writer's slip; more is another kind of picture.
    if (static_cast<double>(coloured) > 0.005 * static_cast<double>(out.data.size()))
        throw InputError(path.string() + ": is coloured; a mask is grey (white = object). Is it a photograph, or a map of class colours?");
    return out;
}

void refuse_class_numbers(const Image8& mask, const fs::path& path) {
    const auto high = *std::max_element(mask.data.begin(), mask.data.end());
    if (high > 0 && high < 16)
        throw InputError(path.string() + ": its largest value is " + std::to_string(high) +
                         " of 255: it looks like class numbers. Remedy: write the object's class as 255 and the rest as 0");
}

bool is_two_level(const Image8& grey) {
    size_t between = 0, high = 0;
    for (uint8_t v : grey.data) {
        between += v > 8 && v < 247;
        high += v >= 247;
    }
    return high > 0 && static_cast<double>(between) < 0.02 * static_cast<double>(grey.data.size());
}

namespace {

fs::path existing(const fs::path& p) { return fs::is_regular_file(p) ? p : fs::path(); }

}  // namespace

fs::path file_in_folder(const fs::path& folder, const View& view) {
    const fs::path image(view.image_path.empty() ? view.name : view.image_path.string());
    const std::string file = image.filename().string(), stem = image.stem().string();
    for (const fs::path& place : {folder / fs::path(view.name).parent_path(), folder})
        for (const std::string& candidate : {file + ".png", stem + ".png", stem + "_mask.png", stem + ".mask.png", file + ".mask.png", file})
            if (fs::path p = existing(place / candidate); !p.empty()) return p;
    return {};
}

fs::path object_mask_file(const View& view, const fs::path& scene, const MaskOptions& options) {
    if (!options.masks.empty()) return file_in_folder(in_scene(options.masks, scene), view);
    const fs::path image(view.image_path.empty() ? view.name : view.image_path.string());
    if (!options.pattern.empty()) {
        std::string p = options.pattern;
        const auto replace = [&](const std::string& key, const std::string& value) {
            for (size_t at; (at = p.find(key)) != std::string::npos;) p.replace(at, key.size(), value);
        };
        replace("{stem}", image.stem().string());
        replace("{name}", image.filename().string());
        return existing(scene / p);
    }
    if (!view.mask_path.empty()) {
        if (!fs::is_regular_file(view.mask_path))
            throw InputError(view.mask_path.string() + ": the camera file names this mask for view " + view.name + ", and it is not there");
        return view.mask_path;
    }
    if (fs::is_directory(scene / "masks"))
        if (fs::path p = file_in_folder(scene / "masks", view); !p.empty()) return p;
    for (const std::string& candidate : {image.stem().string() + "_mask.png", image.stem().string() + ".mask.png", image.filename().string() + ".mask.png"})
        if (fs::path p = existing(image.parent_path() / candidate); !p.empty()) return p;
    return {};
}

fs::path ignore_mask_file(const View& view, const fs::path& scene, const MaskOptions& options) {
    const fs::path folder = options.ignore_masks.empty() ? scene / "ignore" : in_scene(options.ignore_masks, scene);
    return fs::is_directory(folder) ? file_in_folder(folder, view) : fs::path();
}

fs::path plate_file(const View& view, const fs::path& scene, const MaskOptions& options) {
    const fs::path plate = in_scene(options.plate.plate, scene);
    if (fs::is_regular_file(plate)) return plate;
    if (!fs::is_directory(plate)) throw InputError(options.plate.plate.string() + ": --clean-plate is neither a photograph nor a folder of them");
    const fs::path image(view.image_path.empty() ? view.name : view.image_path.string());
    for (const std::string& candidate : {image.filename().string(), image.stem().string() + ".png", image.stem().string() + ".jpg",
                                         image.stem().string() + ".JPG", image.stem().string() + ".tif"})
        if (fs::path p = existing(plate / candidate); !p.empty()) return p;
    throw InputError(plate.string() + ": no clean plate is called like view " + view.name +
                     ". Remedy: one of its name for each view, or --clean-plate FILE for all");
}

}  // namespace vdbcarve
