// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "color_plan.h"
#include "inside_tiles.h"
#include "same_transform.h"
#include "statistics.h"
#include "stereo_plan.h"
#include "vector_loops.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

constexpr int kCell_px = 8;

/// The larger of hull and depth is what is left, so that noise of depths would eat into a hull that is right. Where they nearly agree the hull is: near it depths have to say more by a pixel of the object, which is how far they may be off.
constexpr double kHullMargin_px = 1, kMostHullMargin_vox = 1.5;

/// How much of the object a pixel covers, world units; median of the views.
double pixel_on_object(const std::vector<StereoSource>& sources, const Vec3d& object) {
    std::vector<double> out;
    for (const StereoSource& s : sources) {
        if (s.pairs.empty()) continue;
        const Intrinsics& k = s.camera.intrinsics;
        out.push_back((k.orthographic ? 1 : std::max((s.camera.camera_from_world * object).z(), 0.0)) / std::sqrt(k.fx * k.fy));
    }
    return out.empty() ? 0 : median(out);
}

/// A view's depths, and how far away the farthest trusted one of every cell of pixels is: blocks behind it need not be asked about.
struct View {
    kernel::FusionView fusion{};
    std::vector<float> farthest_vox;  ///< 0: the cell knows nothing
    int cells_per_row = 0, rows = 0;
};

View view_of_map(const StereoSource& s, const StereoDepthMap& map, const RenderFrame& frame) {
    View out;
    kernel::FusionView& f = out.fusion;
    const Camera& c = s.camera;
    const Rigid3& pose = c.camera_from_world;
    const double h = frame.voxel_size;
    Eigen::Matrix<double, 3, 4> in_camera;
    in_camera << h * pose.rotation, pose * frame.origin_world;
    Eigen::Matrix<double, 3, 4> m;
    const Intrinsics& k = c.intrinsics;
    if (k.orthographic) {
        m.topRows<2>() = k.matrix().topLeftCorner<2, 2>() * in_camera.topRows<2>();
        m(0, 3) += k.cx;
        m(1, 3) += k.cy;
        m.row(2) << 0, 0, 0, 1;
    } else {
        m = k.matrix() * in_camera;
    }
    for (int r = 0; r < 3; ++r)
        for (int n = 0; n < 4; ++n) f.pixel_from_index[4 * r + n] = static_cast<float>(m(r, n));
    for (int n = 0; n < 4; ++n) f.depth_from_index[n] = static_cast<float>(in_camera(2, n) / h);
    f.planes = map.planes.data();
    f.confidence = map.confidence.data();
    f.lens = s.lens;
    f.width = s.width;
    f.height = s.height;
    f.per_voxel = static_cast<float>(1 / h);
    out.cells_per_row = (s.width + kCell_px - 1) / kCell_px;
    out.rows = (s.height + kCell_px - 1) / kCell_px;
    out.farthest_vox.assign(static_cast<size_t>(out.cells_per_row) * static_cast<size_t>(out.rows), 0.f);
    for (int y = 0; y < s.height; ++y)
        for (int x = 0; x < s.width; ++x) {
            const size_t at = static_cast<size_t>(y) * static_cast<size_t>(s.width) + static_cast<size_t>(x);
            if (!(map.confidence[at] > 0.f)) continue;
            float& cell = out.farthest_vox[static_cast<size_t>(y / kCell_px) * static_cast<size_t>(out.cells_per_row) + static_cast<size_t>(x / kCell_px)];
            const kernel::StereoPlane& p = map.planes[at].plane;
            // A plane goes on over its pixel.
            for (const float du : {-0.5f, 0.5f})
                for (const float dv : {-0.5f, 0.5f}) cell = std::max(cell, kernel::depth_of(s.lens, kernel::moved(p, du, dv).s) * f.per_voxel);
        }
    return out;
}

/// False where the view says nothing of any voxel within so many voxels of a place.
bool may_matter(const View& v, float i, float j, float k, float radius_vox, float reach_vox) {
    const kernel::FusionView& f = v.fusion;
    const float* m = f.pixel_from_index;
    const float w = m[8] * i + m[9] * j + m[10] * k + m[11];
    const float z = f.depth_from_index[0] * i + f.depth_from_index[1] * j + f.depth_from_index[2] * k + f.depth_from_index[3];
    if (!f.lens.orthographic && z < 2 * radius_vox) return true;
    const float u = (m[0] * i + m[1] * j + m[2] * k + m[3]) / w, y = (m[4] * i + m[5] * j + m[6] * k + m[7]) / w;
    const float scale = std::max(f.lens.fx, f.lens.fy) + std::fabs(f.lens.skew), off_axis = (std::fabs(u - f.lens.cx) + std::fabs(y - f.lens.cy)) / std::min(f.lens.fx, f.lens.fy);
    const float reach = f.lens.orthographic ? radius_vox * scale / f.per_voxel : radius_vox * scale * (1 + off_axis) / (z - radius_vox);
    const int x0 = std::max(0, static_cast<int>((u - reach) / kCell_px)), x1 = std::min(v.cells_per_row - 1, static_cast<int>((u + reach) / kCell_px));
    const int y0 = std::max(0, static_cast<int>((y - reach) / kCell_px)), y1 = std::min(v.rows - 1, static_cast<int>((y + reach) / kCell_px));
    // Along the line of sight a slanted plane is farther than its distance.
    const float first = z - radius_vox - reach_vox / kernel::kLeastStereoCosine;
    for (int b = y0; b <= y1; ++b)
        for (int a = x0; a <= x1; ++a) {
            const float farthest = v.farthest_vox[static_cast<size_t>(b) * static_cast<size_t>(v.cells_per_row) + static_cast<size_t>(a)];
            if (farthest != 0.f && farthest >= first) return true;
        }
    return false;
}

/// First voxels of all blocks of 8^3 that hold some of the inside, in order.
std::vector<openvdb::Coord> blocks_of(const openvdb::FloatTree& tree) {
    std::vector<openvdb::Coord> out;
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) out.push_back(leaf->origin());
    for_inside_tiles(tree, [&](const openvdb::Coord& first, int side) {
        for (int i = 0; i < side; i += 8)
            for (int j = 0; j < side; j += 8)
                for (int k = 0; k < side; k += 8) out.push_back(first.offsetBy(i, j, k));
    });
    return out;
}

}  // namespace

FusedSurface fuse_depths(const openvdb::FloatGrid& surface, const std::vector<StereoLevel>& levels, const StereoOptions& options, Progress& progress) {
    const RenderFrame frame = stereo_frame(surface);
    const size_t count = levels.front().sources.size();
    std::vector<View> views(levels.size() * count);
    tbb::parallel_for(size_t{0}, views.size(), [&](size_t n) {
        const StereoLevel& level = levels[n / count];
        if (level.maps[n % count].planes.empty()) return;
        views[n] = view_of_map(level.sources[n % count], level.maps[n % count], frame);
        views[n].fusion.weight = static_cast<float>(std::pow(options.coarser_weight, static_cast<double>(n / count)));
    });
    std::erase_if(views, [](const View& v) { return v.farthest_vox.empty(); });

    const openvdb::CoordBBox box = leaf_box(surface);
    const openvdb::Vec3d middle = surface.indexToWorld(0.5 * (box.min().asVec3d() + box.max().asVec3d()));
    const auto hull_margin = static_cast<float>(std::min(kMostHullMargin_vox, kHullMargin_px * pixel_on_object(levels.front().sources, Vec3d(middle[0], middle[1], middle[2])) / frame.voxel_size));
    const std::vector<openvdb::Coord> blocks = blocks_of(surface.tree());
    const auto voxel = static_cast<float>(frame.voxel_size), band = surface.background();
    const auto truncation = static_cast<float>(options.truncation_vox), reach = static_cast<float>(std::max(2 * options.truncation_vox, options.reach_share * longest_side(surface) / frame.voxel_size)), full = static_cast<float>(options.least_weight);
    struct Block {
        std::vector<float> values, confidence;  ///< empty: as it was; nothing is known
    };
    std::vector<Block> done(blocks.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, blocks.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
        const openvdb::FloatGrid::ConstAccessor hull = surface.getConstAccessor();
        std::vector<const kernel::FusionView*> asked;
        for (size_t b = range.begin(); b < range.end(); ++b) {
            const openvdb::Coord& first = blocks[b];
            const auto i0 = static_cast<float>(first[0] - frame.base.i), j0 = static_cast<float>(first[1] - frame.base.j), k0 = static_cast<float>(first[2] - frame.base.k);
            asked.clear();
            for (const View& v : views)
                if (may_matter(v, i0 + 3.5f, j0 + 3.5f, k0 + 3.5f, 6.1f, reach)) asked.push_back(&v.fusion);
            if (asked.size() < 2) continue;
            const Leaf* leaf = hull.probeConstLeaf(first);
            const float tile = leaf ? 0.f : hull.getValue(first);
            std::vector<float> values(kLeafVoxels), confidence(kLeafVoxels, 0.f);
            bool changed = false, known = false;
            for (int at = 0; at < kLeafVoxels; ++at) {
                const float before = leaf ? leaf->getValue(static_cast<openvdb::Index>(at)) : tile;
                values[static_cast<size_t>(at)] = before;
                if (before >= band) continue;
                kernel::Fused fused;
                for (const kernel::FusionView* v : asked) kernel::fuse_view(*v, i0 + static_cast<float>(at >> 6), j0 + static_cast<float>(at >> 3 & 7), k0 + static_cast<float>(at & 7), reach, truncation, fused);
                if (fused.views < 2) continue;
                // From half the weight on depths begin to count; up to there the hull stands.
                const float trust = std::clamp(2.f * fused.weight / full - 1.f, 0.f, 1.f);
                confidence[static_cast<size_t>(at)] = std::min(1.f, 0.5f * fused.nearest_weight / full);
                known = known || confidence[static_cast<size_t>(at)] > 0.f;
                const float near_hull = std::clamp(1.f + before / band, 0.f, 1.f);
                const float distance = (trust * (fused.sum / fused.weight) - (1.f - trust) * truncation - hull_margin * near_hull) * voxel;
                if (distance <= before) continue;
                values[static_cast<size_t>(at)] = std::clamp(distance, -band, band);
                changed = true;
            }
            if (changed) done[b].values = std::move(values);
            if (known) done[b].confidence = std::move(confidence);
        }
        progress.check();
    });

    FusedSurface out;
    out.surface = surface.deepCopy();
    out.surface->setTransform(same_transform(surface.transform()));
    out.confidence = openvdb::FloatGrid::create(0.f);
    out.confidence->setTransform(same_transform(surface.transform()));
    out.confidence->setName("stereo_confidence");
    openvdb::FloatTree& tree = out.surface->tree();
    for (size_t b = 0; b < blocks.size(); ++b) {
        if (!done[b].confidence.empty()) {
            Leaf* leaf = out.confidence->tree().touchLeaf(blocks[b]);
            for (openvdb::Index at = 0; at < kLeafVoxels; ++at)
                if (done[b].confidence[at] > 0.f) leaf->setValueOn(at, done[b].confidence[at]);
        }
        if (done[b].values.empty()) continue;
        out.carved = true;
        Leaf* leaf = tree.touchLeaf(blocks[b]);
        for (openvdb::Index at = 0; at < kLeafVoxels; ++at) leaf->setValueOnly(at, done[b].values[at]);
        // The new surface's band goes on into blocks around.
        for (int n = 0; n < 27; ++n) tree.touchLeaf(blocks[b].offsetBy(8 * (n / 9 - 1), 8 * (n / 3 % 3 - 1), 8 * (n % 3 - 1)));
    }
    return out;
}

}  // namespace vdbcarve
