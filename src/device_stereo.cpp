// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#if defined(VDBCARVE_WITH_CUDA)

#include <chrono>

#include "device_parts.h"
#include "stereo_plan.h"

namespace vdbcarve {

StereoResult DevicePipeline::stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const StereoOptions& options, Progress& progress) {
    Parts& p = *parts_;
    p.use();
    check_stereo(surface, inputs, options);
    const Parts::Volume& volume = p.need(p.surface, "level set");
    StereoResult out;
    out.backend_used = "cuda";
    out.scale = options.scale ? options.scale : 1;
    const size_t n = inputs.size();
    progress.begin("stereo", static_cast<size_t>(options.levels) * n + 1);
    const RenderFrame frame = stereo_frame(surface);
    const double deepest = options.depth_share * longest_side(surface), voxel = surface.voxelSize()[0];
    const kernel::StereoTrustRule rule = trust_rule(options.trust);
    auto lap = [&, last = std::chrono::steady_clock::now()](const char* what) mutable {
        const auto now = std::chrono::steady_clock::now();
        add_milliseconds(out, what, std::chrono::duration<double, std::milli>(now - last).count());
        last = now;
    };
    const auto match = [&](StereoLevel& level, const StereoLevel* coarser) {
        lap("photographs");
        const std::vector<StereoSource>& sources = level.sources;
        std::vector<cuda::StereoPixels> pixels(n);
        for (size_t v = 0; v < n; ++v)
            if (!sources[v].grey.empty()) pixels[v] = {sources[v].grey.data(), sources[v].object.data(), sources[v].width, sources[v].height, sources[v].lens};
        p.stereo.begin(pixels, coarser != nullptr, volume.grid, frame.base, frame.box, p.stream, p.times);
        std::vector<kernel::StereoReference> references;
        for (size_t v = 0; v < n; ++v)
            if (!sources[v].pairs.empty()) references.push_back(stereo_reference(sources, v, voxel));
        for (const kernel::StereoReference& r : references) {
            p.stereo.match(r, hull_view(frame, sources[static_cast<size_t>(r.view)], deepest), options.passes, rule, p.stream, p.times);
            progress.check();
        }
        p.stereo.agree(references, rule, p.stream, p.times);
        const std::vector<uint32_t> counts = p.stereo.counts(p.stream);
        lap("match");
        level.maps.resize(n);
        out.views.assign(n, {});
        for (const kernel::StereoReference& r : references) {
            const auto v = static_cast<size_t>(r.view);
            out.views[v].pairs = static_cast<size_t>(r.pairs);
            out.views[v].object_pixels = counts[2 * v];
            out.views[v].matched_pixels = counts[2 * v + 1];
            level.maps[v].planes.resize(sources[v].grey.size());
            level.maps[v].confidence.resize(sources[v].grey.size());
            p.fetcher.fetch_to(level.maps[v].planes.data(), p.stereo.planes(v), level.maps[v].planes.size() * sizeof(kernel::StereoBest), p.stream);
            p.fetcher.fetch_to(level.maps[v].confidence.data(), p.stereo.agreed(v), level.maps[v].confidence.size() * sizeof(float), p.stream);
            progress.step();
        }
        lap("home");
    };
    finish_stereo(out, surface, stereo_levels(surface, inputs, photos, out.scale, options, match), options, progress);
    return out;
}

}  // namespace vdbcarve

#endif
