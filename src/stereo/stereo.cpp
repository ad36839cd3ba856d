// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/stereo.h"

#include <tbb/parallel_for.h>

#include <chrono>
#include <cmath>

#include "color/color_plan.h"
#include "volume/nanovdb_bytes.h"
#include "surface/redistance.h"
#include "stereo/stereo_plan.h"
#include "base/vector_loops.h"

namespace vdbcarve {
namespace {

using kernel::StereoBest;
using kernel::Vec3;

/// The surface, for rays on the CPU.
class SeenVolume {
  public:
    explicit SeenVolume(const openvdb::FloatGrid& surface) : bytes_(to_nanovdb(surface, false)), frame_(stereo_frame(surface)) {
        const auto* grid = reinterpret_cast<const nanovdb::NanoGrid<float>*>(bytes_.data.get());
        const float near = kernel::kNearSurface_vox * static_cast<float>(frame_.voxel_size);
        near_ = sight_walls(*grid, near);
        solid_ = sight_walls(*grid, 0.f);
        view_ = {{grid, near_.data(), near, frame_.base}, {grid, solid_.data(), 0.f, frame_.base}, frame_.box, nullptr, static_cast<float>(frame_.voxel_size)};
    }
    const RenderFrame& frame() const { return frame_; }
    const kernel::RenderVolume& view() const { return view_; }
    kernel::FieldReader field() const { return {*view_.near.grid, view_.near.base, 1.f / view_.voxel_size}; }

  private:
    NanoBuffer bytes_;
    RenderFrame frame_;
    std::vector<uint64_t> near_, solid_;
    kernel::RenderVolume view_{};
};

class Matcher {
  public:
    Matcher(const openvdb::FloatGrid& surface, const SeenVolume& volume, const std::vector<StereoSource>& sources, const StereoOptions& options,
            Progress& progress)
        : sources_(sources),
          rule_(trust_rule(options.trust)),
          progress_(progress),
          volume_(volume),
          deepest_(options.depth_share * longest_side(surface)),
          voxel_(surface.voxelSize()[0]) {}

    /// Best planes of a view, and how likely they are by what it was compared with.
    StereoDepthMap match(size_t v, const StereoLevel* coarser, const StereoPasses& passes, StereoViewStatistics& statistics) {
        const StereoSource& s = sources_[v];
        StereoDepthMap out;
        statistics.pairs = s.pairs.size();
        if (s.pairs.empty()) return out;
        const std::vector<kernel::HullSight> hull = ask_hull(s);
        kernel::StereoReference reference = stereo_reference(sources_, v, voxel_);
        reference.image.grey = s.grey.data();
        for (size_t p = 0; p < s.pairs.size(); ++p) reference.other[p].grey = sources_[static_cast<size_t>(s.pairs[p].view)].grey.data();
        reference.hull = hull.data();
        if (coarser) {
            reference.coarse = coarser->maps[v].planes.data();
            reference.coarse_likely = coarser->maps[v].confidence.data();
            reference.coarse_width = coarser->sources[v].width;
            reference.coarse_height = coarser->sources[v].height;
        }
        out.planes.resize(s.grey.size());
        out.confidence.resize(s.grey.size());
        const VectorLoops& loops = vector_loops();
        for_rows(s, [&](int y) { loops.first_planes(reference, y, out.planes.data()); });
        for (int pass = passes.first; pass < passes.last; ++pass)
            for (const int color : {0, 1}) for_rows(s, [&](int y) { loops.better_planes(reference, y, pass, color, out.planes.data()); });
        for_rows(s, [&](int y) { loops.likelihoods(reference, rule_, y, out.planes.data(), out.confidence.data()); });
        for (size_t n = 0; n < hull.size(); ++n) {
            statistics.object_pixels += hull[n].front != 0.f;
            statistics.matched_pixels += out.confidence[n] > 0.f;
        }
        progress_.step();
        return out;
    }

    /// Keeps what other views find, too, away from the silhouettes' rims.
    void keep_agreed(std::vector<StereoDepthMap>& maps) const {
        std::vector<kernel::StereoDepths> depths(maps.size());
        for (size_t v = 0; v < maps.size(); ++v)
            if (!maps[v].planes.empty())
                depths[v] = {maps[v].planes.data(), maps[v].confidence.data(), sources_[v].lens, sources_[v].width, sources_[v].height};
        std::vector<std::vector<float>> agreed(maps.size());
        for (size_t v = 0; v < maps.size(); ++v) {
            if (maps[v].planes.empty()) continue;
            const kernel::StereoReference reference = stereo_reference(sources_, v, voxel_);
            agreed[v].resize(maps[v].confidence.size());
            const StereoSource& s = sources_[v];
            for_rows(s, [&](int y) {
                for (int x = 0; x < s.width; ++x) {
                    const size_t n = static_cast<size_t>(y) * static_cast<size_t>(s.width) + static_cast<size_t>(x);
                    agreed[v][n] = s.object[n] < 2 ? 0.f : kernel::agreed_likelihood(reference, depths.data(), rule_, x, y);
                }
            });
        }
        for (size_t v = 0; v < maps.size(); ++v) maps[v].confidence = std::move(agreed[v]);
    }

  private:
    template <class Work>
    void for_rows(const StereoSource& s, const Work& work) const {
        progress_.check();
        tbb::parallel_for(0, s.height, work);
    }

    std::vector<kernel::HullSight> ask_hull(const StereoSource& s) const {
        std::vector<kernel::HullSight> out(s.grey.size(), {0.f, 0.f, {0.f, 0.f, -1.f}});
        const kernel::HullView view = hull_view(volume_.frame(), s, deepest_);
        tbb::parallel_for(0, s.height, [&](int y) {
            kernel::FieldReader field = volume_.field();
            kernel::SightCells cells(volume_.view().near);
            for (int x = 0; x < s.width; ++x) {
                const size_t n = static_cast<size_t>(y) * static_cast<size_t>(s.width) + static_cast<size_t>(x);
                if (s.object[n]) out[n] = kernel::hull_sight(field, cells, volume_.view(), view, x, y);
            }
        });
        return out;
    }

    const std::vector<StereoSource>& sources_;
    kernel::StereoTrustRule rule_;
    Progress& progress_;
    const SeenVolume& volume_;
    double deepest_, voxel_;
};

}  // namespace

StereoResult stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const StereoOptions& options,
                    Progress& progress) {
    check_stereo(surface, inputs, options);
    StereoResult out;
    const size_t n = inputs.size();
    out.scale = stereo_scale(surface, inputs, options);
    const auto start = std::chrono::steady_clock::now();
    auto lap = [&, last = start](const char* what) mutable {
        const auto now = std::chrono::steady_clock::now();
        add_milliseconds(out, what, std::chrono::duration<double, std::milli>(now - last).count());
        last = now;
    };
    const SeenVolume volume(surface);
    lap("hull");
    std::vector<StereoLevel> levels = stereo_levels(surface, inputs, photos, out.scale, options);
    lap("photographs");
    progress.begin("stereo", steps_of(levels) + 1);
    for (size_t l = levels.size(); l-- > 0;) {
        StereoLevel& level = levels[l];
        out.views.assign(n, {});
        level.maps.resize(n);
        Matcher matcher(surface, volume, level.sources, options, progress);
        for (size_t v = 0; v < n; ++v)
            level.maps[v] = matcher.match(v, l + 1 < levels.size() ? &levels[l + 1] : nullptr, stereo_passes(l, levels.size(), options), out.views[v]);
        lap("match");
        matcher.keep_agreed(level.maps);
        lap("agree");
    }
    leave_to_finer(levels);
    const FusionPlan plan = plan_fusion(surface, levels, options);
    const FusedBlocks fused = fuse_depths(surface, plan, levels, progress);
    progress.step();
    lap("fuse");
    Progress quiet;
    finish_stereo(out, surface, plan, fused, options,
                  [&](openvdb::FloatGrid::Ptr field, int half_width_vox) { return redistance(std::move(field), half_width_vox, nullptr, quiet); });
    out.maps.resize(n);
    tbb::parallel_for(size_t{0}, n, [&](size_t v) {
        const StereoSource& s = levels.front().sources[v];
        StereoDepthMap& map = levels.front().maps[v];
        if (map.planes.empty()) return;
        DepthMap& m = out.maps[v];
        m.depth = ImageF(s.width, s.height);
        m.confidence = ImageF(s.width, s.height);
        m.confidence.data = std::move(map.confidence);
        for (size_t p = 0; p < m.depth.data.size(); ++p)
            if (m.confidence.data[p] > 0.f) m.depth.data[p] = kernel::depth_of(s.lens, map.planes[p].plane.s);
    });
    count_trusted(out);
    return out;
}

}  // namespace vdbcarve
