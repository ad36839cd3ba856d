// SPDX-License-Identifier: Apache-2.0
// Apart from bench.cpp, which thereby needs no image codecs and can be carried to a machine without them.
#include "vdbcarve/app/bench.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

BenchScene load_bench_scene(const std::filesystem::path& folder, const std::optional<Box3d>& bounds, int views, Progress& progress) {
    ViewsOptions options;
    options.scene = folder;
    const Views loaded = load_views(options, progress);
    Masks masks = make_masks(loaded, folder, {}, std::vector<std::filesystem::path>(loaded.views.size()), progress);
    const std::vector<Camera> cameras = loaded.cameras();
    const auto there = static_cast<int>(cameras.size());
    if (views == 0) views = there;
    if (views > there)
        throw UsageError("bench: " + folder.string() + " has " + std::to_string(there) + " views, " + std::to_string(views) +
                         " are asked for. Remedy: --views " + std::to_string(there));
    BenchScene out;
    out.name = folder.filename().string();
    std::vector<CarveInput> inputs;
    std::vector<MaskView> mask_views;
    for (int v = 0; v < views; ++v) {
        const auto from = static_cast<size_t>(static_cast<long>(v) * there / views);
        out.cameras.push_back(cameras[from]);
        out.masks.push_back(std::move(masks.masks[from]));
    }
    for (size_t v = 0; v < out.cameras.size(); ++v) {
        inputs.push_back({std::to_string(v), out.cameras[v], nullptr});
        mask_views.push_back(view_of(out.masks[v]));
    }
    out.bounds = bounds ? *bounds : automatic_bounds(inputs, mask_views, 0, {}, progress);
    return out;
}

}  // namespace vdbcarve
