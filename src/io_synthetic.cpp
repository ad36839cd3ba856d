// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include "atomic_file.h"
#include "io_image.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve {

namespace fs = std::filesystem;

void write_scene(const SyntheticScene& scene, const fs::path& folder) {
    make_folder(folder / "masks");
    make_folder(folder / "images");
    if (!scene.true_masks.empty()) make_folder(folder / "masks_true");
    tbb::parallel_for(size_t{0}, scene.masks.size(), [&](size_t i) {
        const auto write = [&](const fs::path& file, const Image8& image) {
            const auto png = io::encode_png(image);
            write_file(file, png.data(), png.size());
        };
        write(folder / scene.views.views[i].mask_path, scene.masks[i].coverage);
        // Without photographs the silhouettes stand in for them.
        const View& view = scene.views.views[i];
        if (!scene.true_masks.empty()) write(folder / "masks_true" / view.mask_path.filename(), scene.true_masks[i].coverage);
        if (!scene.photos.empty() && scene.look.jpeg_quality > 0) {
            const Intrinsics& k = view.camera.intrinsics;
            const auto jpeg = io::encode_jpeg(scene.photos[i], scene.look.jpeg_quality, scene.look.exif && !k.orthographic ? 36.0 * k.fx / k.width_px : 0);
            write_file(folder / view.name, jpeg.data(), jpeg.size());
        } else {
            write(folder / view.name, scene.photos.empty() ? scene.masks[i].coverage : scene.photos[i]);
        }
    });
    const auto cameras = [&](const Views& views, const char* name) {
        Views named = views;
        for (View& v : named.views) v.image_path = folder / v.name;
        write_file(folder / name, cameras_json(named, folder));
    };
    cameras(scene.views, "transforms.json");
    cameras(scene.nominal, "transforms_nominal.json");
    write_mesh(folder / "truth.ply", scene.truth);
}

}  // namespace vdbcarve
