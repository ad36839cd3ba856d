// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <numeric>

#include "device/device_parts.h"
#include "stereo/stereo_plan.h"

namespace vdbcarve {

namespace {

FusedBlocks fuse_on_device(const FusionPlan& plan, cuda::StereoStage& stage, Fetcher& fetcher, const cuda::Stream& stream, cuda::StageTimes& times) {
    std::vector<cuda::StereoStage::FusedView> views;
    for (const FusionPlan::View& v : plan.views) views.push_back({v.level, v.view, v.fusion});
    FusedBlocks out;
    constexpr size_t kAtOnce = size_t{1} << 14;  ///< blocks: 64 MB of answers, and threads enough to fill a device many times
    for (size_t begin = 0; begin < plan.blocks.size(); begin += kAtOnce) {
        std::vector<std::array<int, 3>> first;
        for (size_t b = begin; b < std::min(begin + kAtOnce, plan.blocks.size()); ++b)
            first.push_back({plan.blocks[b][0], plan.blocks[b][1], plan.blocks[b][2]});
        const cuda::StereoStage::Fused found = stage.fuse(plan.rule, views, first, stream, times);
        // Slots were taken as threads came.
        std::vector<uint32_t> block(found.count), at(found.count);
        fetcher.fetch_to(block.data(), found.block, block.size() * sizeof(uint32_t), stream);
        std::iota(at.begin(), at.end(), 0u);
        std::sort(at.begin(), at.end(), [&](uint32_t a, uint32_t b) { return block[a] < block[b]; });
        const size_t before = out.block.size();
        std::vector<size_t> place(found.count);
        for (uint32_t n = 0; n < found.count; ++n) {
            out.block.push_back(static_cast<uint32_t>(begin) + block[at[n]]);
            place[at[n]] = before + n;
        }
        const auto bring = [&](std::vector<float>& to, const float* from) {
            constexpr size_t kBytes = cuda::kLeafVoxels * sizeof(float);
            to.resize(out.block.size() * static_cast<size_t>(cuda::kLeafVoxels));
            fetcher.fetch(from, found.count * kBytes, kBytes, stream, [&](const uint8_t* piece, size_t offset, size_t bytes) {
                const size_t first_slot = offset / kBytes;
                tbb::parallel_for(size_t{0}, bytes / kBytes, [&](size_t s) {
                    std::memcpy(to.data() + place[first_slot + s] * static_cast<size_t>(cuda::kLeafVoxels), piece + s * kBytes, kBytes);
                });
            });
        };
        bring(out.values, found.values);
        bring(out.confidence, found.confidence);
    }
    return out;
}

}  // namespace

StereoResult Device::stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const StereoOptions& options,
                            Progress& progress) {
    Parts& p = *parts_;
    p.use();
    check_stereo(surface, inputs, options);
    const Parts::Volume& volume = p.need(p.surface, "level set");
    StereoResult out;
    out.backend_used = "cuda";
    out.scale = stereo_scale(surface, inputs, options);
    const size_t n = inputs.size();
    const RenderFrame frame = stereo_frame(surface);
    const double deepest = options.depth_share * longest_side(surface), voxel = surface.voxelSize()[0];
    const kernel::StereoTrustRule rule = trust_rule(options.trust);
    auto lap = [&, last = std::chrono::steady_clock::now()](const char* what) mutable {
        const auto now = std::chrono::steady_clock::now();
        if (what) add_milliseconds(out, what, std::chrono::duration<double, std::milli>(now - last).count());
        last = now;
    };
    const std::vector<StereoLevel> levels = stereo_levels(surface, inputs, photos, out.scale, options);
    lap("photographs");
    progress.begin("stereo", steps_of(levels) + 1);
    p.stereo.set_hull(volume.grid, frame.base, frame.box, p.stream, p.times);
    for (size_t l = levels.size(); l-- > 0;) {
        const std::vector<StereoSource>& sources = levels[l].sources;
        std::vector<cuda::StereoPixels> pixels(n);
        for (size_t v = 0; v < n; ++v)
            if (!sources[v].grey.empty()) pixels[v] = {sources[v].grey.data(), sources[v].object.data(), sources[v].width, sources[v].height, sources[v].lens};
        p.stereo.begin(l, pixels, l + 1 < levels.size(), p.stream, p.times);
        std::vector<cuda::StereoStage::Work> work;
        for (size_t v = 0; v < n; ++v)
            if (!sources[v].pairs.empty()) work.push_back({stereo_reference(sources, v, voxel), hull_view(frame, sources[v], deepest)});
        const StereoPasses passes = stereo_passes(l, levels.size(), options);
        p.stereo.match(work, passes.first, passes.last, rule, p.stream, p.times);
        p.stereo.agree(work, rule, p.stream, p.times);
        const std::vector<uint32_t> counts = p.stereo.counts(p.stream);
        out.views.assign(n, {});
        for (const cuda::StereoStage::Work& w : work) {
            const auto v = static_cast<size_t>(w.reference.view);
            out.views[v].pairs = static_cast<size_t>(w.reference.pairs);
            out.views[v].object_pixels = counts[2 * v];
            out.views[v].matched_pixels = counts[2 * v + 1];
        }
        progress.step(work.size());
    }
    p.stereo.leave_to_finer(levels.size(), p.stream, p.times);
    lap("match");
    const FusionPlan plan = plan_fusion(surface, levels, options);
    const FusedBlocks fused = fuse_on_device(plan, p.stereo, p.fetcher, p.stream, p.times);
    progress.step();
    lap("fuse");
    finish_stereo(out, surface, plan, fused, options, [&](const openvdb::FloatGrid::Ptr& field, int half_width_vox) {
        p.upload(p.fused, *field);
        p.surface.topology = nullptr;
        p.render.clear_colors();
        if (!p.redistance(p.fused.grid, *p.fused.topology, half_width_vox, nullptr)) throw InputError("stereo: nothing is left of the object");
        return this->surface();
    });
    lap(nullptr);  // finish_stereo() has its own
    out.maps.resize(n);
    tbb::parallel_for(size_t{0}, n, [&](size_t v) {  // fresh memory is dear
        const StereoSource& s = levels.front().sources[v];
        if (!s.pairs.empty()) out.maps[v] = {ImageF(s.width, s.height), ImageF(s.width, s.height)};
    });
    for (size_t v = 0; v < n; ++v) {
        DepthMap& m = out.maps[v];
        if (m.depth.data.empty()) continue;
        p.fetcher.fetch_to(m.depth.data.data(), p.stereo.depths(v, p.stream, p.times), m.depth.data.size() * sizeof(float), p.stream);
        p.fetcher.fetch_to(m.confidence.data.data(), p.stereo.confidence(v), m.confidence.data.size() * sizeof(float), p.stream);
    }
    p.stereo.release();
    count_trusted(out);
    lap("maps home");
    return out;
}

}  // namespace vdbcarve
