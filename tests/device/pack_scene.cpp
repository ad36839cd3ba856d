// SPDX-License-Identifier: Apache-2.0
// pack_scene SCENE FOLDER [--bounds xmin,ymin,zmin,xmax,ymax,zmax] [--threshold LEVEL CLOSE_PX] [--photos]: a scene's cameras and masks as a packed scene
// (support/packed_scene.h).
#include <cstdio>

#include "support/packed_scene.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/views.h"

int main(int argc, char** argv) {
    using namespace vdbcarve;
    if (argc < 3) {
        std::fprintf(stderr, "usage: pack_scene SCENE FOLDER [--bounds xmin,ymin,zmin,xmax,ymax,zmax] [--threshold LEVEL CLOSE_PX] [--photos]\n");
        return 2;
    }
    try {
        openvdb::initialize();
        Progress quiet;
        ViewsOptions options;
        options.scene = argv[1];
        MaskOptions mask;
        std::string bounds;
        bool photos = false;
        for (int n = 3; n < argc; ++n) {
            if (std::string(argv[n]) == "--bounds" && n + 1 < argc) {
                bounds = argv[++n];
            } else if (std::string(argv[n]) == "--photos") {
                photos = true;
            } else if (std::string(argv[n]) == "--threshold" && n + 2 < argc) {
                mask.method = MaskMethod::Threshold;
                mask.threshold.level = std::stod(argv[++n]);
                mask.clean_up.close_px = std::stoi(argv[++n]);
            }
        }
        const Views views = load_views(options, quiet);
        Masks masks = make_masks(views, options.scene, mask, std::vector<std::filesystem::path>(views.views.size()), quiet);
        test::PackedScene scene;
        scene.cameras = views.cameras();
        for (const View& v : views.views) scene.names.push_back(v.name);
        scene.masks = std::move(masks.masks);
        for (size_t i = 0; photos && i < views.views.size(); ++i) {
            Photo photo = load_photo(views.views[i]);
            const Image8& mask = scene.masks[i].coverage;
            for (size_t n = 0; n < photo.pixels8.data.size(); ++n)
                if (mask.data[n / static_cast<size_t>(photo.pixels8.channels)] == 0) photo.pixels8.data[n] = 0;
            scene.photos.push_back(std::move(photo));
        }
        double b[6];
        if (std::sscanf(bounds.c_str(), "%lf,%lf,%lf,%lf,%lf,%lf", b, b + 1, b + 2, b + 3, b + 4, b + 5) == 6) {
            scene.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
        } else {
            scene.bounds = automatic_bounds(scene.inputs(), scene.mask_views(), 0, {}, quiet);
        }
        test::write_packed_scene(argv[2], scene);
        return 0;
    } catch (const Error& e) {
        std::fprintf(stderr, "pack_scene: %s\n", e.what());
        return static_cast<int>(e.code());
    }
}
