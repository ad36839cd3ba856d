// SPDX-License-Identifier: Apache-2.0
// Photographs, masks and cameras in a folder become one .glb: photos_to_glb SCENE OUT [FACES]
#include <cstdio>
#include <cstdlib>

#include "vdbcarve/error.h"
#include "vdbcarve/pipeline.h"

int main(int count, char** words) {
    using namespace vdbcarve;
    if (count < 3) {
        std::fprintf(stderr, "usage: photos_to_glb SCENE OUT [FACES]\n");
        return 2;
    }
    ReconstructOptions options;
    options.views.scene = words[1];
    options.run.output = words[2];
    options.grid.resolution = 384;
    options.filter.steps = parse_filters("edge-preserving:1");
    options.result.mesh_formats = {"glb"};
    if (count > 3) options.smooth.faces = static_cast<size_t>(std::atol(words[3]));

    Progress progress;
    progress.on_note = [](const std::string& text) { std::printf("%s\n", text.c_str()); };
    progress.on_warning = [](const std::string& text) { std::printf("warning: %s\n", text.c_str()); };
    try {
        const Reconstruction result = reconstruct(options, progress);
        std::printf("%s/mesh.glb: %zu faces, %s, agrees with the silhouettes by %.3f (median IoU)\n", words[2], result.mesh.faces,
                    result.mesh.manifold ? "closed and manifold" : "not closed", result.median_iou);
    } catch (const Error& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return static_cast<int>(error.code());
    }
}
