// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>

#include "base/pixel_size.h"
#include "color/color_plan.h"
#include "volume/inside_tiles.h"
#include "surface/pieces.h"
#include "surface/redistance.h"
#include "volume/same_transform.h"
#include "stereo/stereo_plan.h"
#include "base/vector_loops.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

constexpr int kCell_px = 8;

/// Of StereoOptions::hull_margin_px, at most.
constexpr double kMostHullMargin_vox = 1.5;

/// Where a view lies in the lattice.
kernel::FusionView fusion_view(const StereoSource& s, const RenderFrame& frame, float weight) {
    kernel::FusionView f{};
    const Rigid3& pose = s.camera.camera_from_world;
    const double h = frame.voxel_size;
    Eigen::Matrix<double, 3, 4> in_camera;
    in_camera << h * pose.rotation, pose * frame.origin_world;
    Eigen::Matrix<double, 3, 4> m;
    const Intrinsics& k = s.camera.intrinsics;
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
    f.lens = s.lens;
    f.width = s.width;
    f.height = s.height;
    f.per_voxel = static_cast<float>(1 / h);
    f.weight = weight;
    return f;
}

/// A view with its depths, and how far away the farthest of every cell of pixels is: blocks behind it need not be asked about.
struct View {
    kernel::FusionView fusion{};
    std::vector<float> farthest_vox;  ///< minus infinity: the cell knows nothing
    int cells_per_row = 0, rows = 0;
};

View with_map(const kernel::FusionView& fusion, const StereoDepthMap& map) {
    View out;
    out.fusion = fusion;
    kernel::FusionView& f = out.fusion;
    f.planes = map.planes.data();
    f.confidence = map.confidence.data();
    out.cells_per_row = (f.width + kCell_px - 1) / kCell_px;
    out.rows = (f.height + kCell_px - 1) / kCell_px;
    out.farthest_vox.assign(static_cast<size_t>(out.cells_per_row) * static_cast<size_t>(out.rows), -std::numeric_limits<float>::infinity());
    for (int y = 0; y < f.height; ++y)
        for (int x = 0; x < f.width; ++x) {
            const size_t at = static_cast<size_t>(y) * static_cast<size_t>(f.width) + static_cast<size_t>(x);
            if (!(map.confidence[at] > 0.f)) continue;
            float& cell = out.farthest_vox[static_cast<size_t>(y / kCell_px) * static_cast<size_t>(out.cells_per_row) + static_cast<size_t>(x / kCell_px)];
            const kernel::StereoPlane& p = map.planes[at].plane;
            // A plane goes on over its pixel.
            for (const float du : {-0.5f, 0.5f})
                for (const float dv : {-0.5f, 0.5f}) cell = std::max(cell, kernel::depth_of(f.lens, kernel::moved(p, du, dv).s) * f.per_voxel);
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
    const float scale = std::max(f.lens.fx, f.lens.fy) + std::fabs(f.lens.skew),
                off_axis = (std::fabs(u - f.lens.cx) + std::fabs(y - f.lens.cy)) / std::min(f.lens.fx, f.lens.fy);
    const float reach = f.lens.orthographic ? radius_vox * scale / f.per_voxel : radius_vox * scale * (1 + off_axis) / (z - radius_vox);
    const int x0 = std::max(0, static_cast<int>((u - reach) / kCell_px)), x1 = std::min(v.cells_per_row - 1, static_cast<int>((u + reach) / kCell_px));
    const int y0 = std::max(0, static_cast<int>((y - reach) / kCell_px)), y1 = std::min(v.rows - 1, static_cast<int>((y + reach) / kCell_px));
    // Along the line of sight a slanted plane is farther than its distance.
    const float first = z - radius_vox - reach_vox / kernel::kLeastStereoCosine;
    for (int b = y0; b <= y1; ++b)
        for (int a = x0; a <= x1; ++a) {
            const float farthest = v.farthest_vox[static_cast<size_t>(b) * static_cast<size_t>(v.cells_per_row) + static_cast<size_t>(a)];
            if (farthest >= first) return true;
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

FusionPlan plan_fusion(const openvdb::FloatGrid& surface, const std::vector<StereoLevel>& levels, const StereoOptions& options) {
    const RenderFrame frame = stereo_frame(surface);
    FusionPlan out;
    out.base = openvdb::Coord(frame.base.i, frame.base.j, frame.base.k);
    for (size_t l = 0; l < levels.size(); ++l)
        for (size_t v = 0; v < levels[l].sources.size(); ++v)
            if (!levels[l].sources[v].pairs.empty())
                out.views.push_back(
                    {l, v, fusion_view(levels[l].sources[v], frame, static_cast<float>(std::pow(options.coarser_weight, static_cast<double>(l))))});
    std::vector<Camera> cameras;
    for (const StereoSource& s : levels.front().sources)
        if (!s.pairs.empty()) cameras.push_back(s.camera);
    const double pixel_vox = pixel_size_at(cameras, middle_of(surface)) / frame.voxel_size;
    out.rule.voxel = static_cast<float>(frame.voxel_size);
    out.rule.band = surface.background();
    out.rule.truncation = static_cast<float>(options.truncation_vox);
    out.rule.reach = static_cast<float>(std::max(2 * options.truncation_vox, options.reach_share * longest_side(surface) / frame.voxel_size));
    out.rule.full_weight = static_cast<float>(options.least_weight);
    out.rule.hull_margin = static_cast<float>(std::min(kMostHullMargin_vox, options.hull_margin_px * pixel_vox));
    out.blocks = blocks_of(surface.tree());
    return out;
}

FusedBlocks fuse_depths(const openvdb::FloatGrid& surface, const FusionPlan& plan, const std::vector<StereoLevel>& levels, Progress& progress) {
    std::vector<View> views(plan.views.size());
    tbb::parallel_for(size_t{0}, views.size(),
                      [&](size_t n) { views[n] = with_map(plan.views[n].fusion, levels[plan.views[n].level].maps[plan.views[n].view]); });
    const kernel::FusionRule& rule = plan.rule;
    struct Block {
        std::vector<float> values, confidence;  ///< empty: as it was, and nothing is known
    };
    std::vector<Block> done(plan.blocks.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, done.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
        const openvdb::FloatGrid::ConstAccessor hull = surface.getConstAccessor();
        std::vector<const kernel::FusionView*> asked;
        for (size_t b = range.begin(); b < range.end(); ++b) {
            const openvdb::Coord& first = plan.blocks[b];
            const auto i0 = static_cast<float>(first[0] - plan.base[0]), j0 = static_cast<float>(first[1] - plan.base[1]),
                       k0 = static_cast<float>(first[2] - plan.base[2]);
            asked.clear();
            for (const View& v : views)
                if (may_matter(v, i0 + 3.5f, j0 + 3.5f, k0 + 3.5f, 6.1f, rule.reach)) asked.push_back(&v.fusion);
            if (asked.size() < 2) continue;
            const Leaf* leaf = hull.probeConstLeaf(first);
            const float tile = leaf ? 0.f : hull.getValue(first);
            std::vector<float> values(kLeafVoxels), confidence(kLeafVoxels);
            bool matters = false;
            for (int at = 0; at < kLeafVoxels; ++at) {
                const float before = leaf ? leaf->getValue(static_cast<openvdb::Index>(at)) : tile;
                kernel::FusedVoxel voxel{before, 0.f};
                if (before < rule.band) {
                    kernel::Fused fused;
                    for (const kernel::FusionView* v : asked)
                        kernel::fuse_view(*v, i0 + static_cast<float>(at >> 6), j0 + static_cast<float>(at >> 3 & 7), k0 + static_cast<float>(at & 7),
                                          rule.reach, rule.truncation, fused);
                    voxel = kernel::carved_voxel(rule, fused, before);
                }
                values[static_cast<size_t>(at)] = voxel.value;
                confidence[static_cast<size_t>(at)] = voxel.confidence;
                matters = matters || voxel.value != before || voxel.confidence > 0.f;
            }
            if (matters) done[b] = {std::move(values), std::move(confidence)};
        }
        progress.check();
    });
    FusedBlocks out;
    for (size_t b = 0; b < done.size(); ++b)
        if (!done[b].values.empty()) out.block.push_back(static_cast<uint32_t>(b));
    out.values.resize(out.block.size() * kLeafVoxels);
    out.confidence.resize(out.block.size() * kLeafVoxels);
    tbb::parallel_for(size_t{0}, out.block.size(), [&](size_t n) {
        const Block& b = done[out.block[n]];
        std::copy(b.values.begin(), b.values.end(), out.values.begin() + static_cast<long>(n * kLeafVoxels));
        std::copy(b.confidence.begin(), b.confidence.end(), out.confidence.begin() + static_cast<long>(n * kLeafVoxels));
    });
    return out;
}

void finish_stereo(StereoResult& out, const openvdb::FloatGrid& surface, const FusionPlan& plan, const FusedBlocks& blocks, const StereoOptions& options,
                   const Redistance& redistance) {
    auto lap = [&, last = std::chrono::steady_clock::now()](const char* what) mutable {
        const auto now = std::chrono::steady_clock::now();
        add_milliseconds(out, what, std::chrono::duration<double, std::milli>(now - last).count());
        last = now;
    };
    out.confidence = openvdb::FloatGrid::create(0.f);
    out.confidence->setTransform(same_transform(surface.transform()));
    out.confidence->setName("stereo_confidence");
    openvdb::FloatGrid::Ptr field = surface.deepCopy();
    field->setTransform(same_transform(surface.transform()));
    struct Made {
        std::unique_ptr<Leaf> confidence;
        bool carved = false;
    };
    std::vector<Made> made(blocks.block.size());
    tbb::parallel_for(size_t{0}, made.size(), [&](size_t n) {
        const openvdb::Coord& first = plan.blocks[blocks.block[n]];
        const float *values = blocks.values.data() + n * kLeafVoxels, *confidence = blocks.confidence.data() + n * kLeafVoxels;
        if (std::any_of(confidence, confidence + kLeafVoxels, [](float c) { return c > 0.f; })) {
            made[n].confidence = std::make_unique<Leaf>(first, 0.f);
            for (openvdb::Index at = 0; at < kLeafVoxels; ++at)
                if (confidence[at] > 0.f) made[n].confidence->setValueOn(at, confidence[at]);
        }
        const Leaf* hull = surface.tree().probeConstLeaf(first);
        const float tile = hull ? 0.f : surface.tree().getValue(first);
        made[n].carved = hull ? !std::equal(values, values + kLeafVoxels, hull->buffer().data())
                              : std::any_of(values, values + kLeafVoxels, [&](float v) { return v != tile; });
    });
    openvdb::tree::ValueAccessor<openvdb::FloatTree> into(field->tree());
    bool carved = false;
    for (size_t n = 0; n < made.size(); ++n) {
        if (made[n].confidence) out.confidence->tree().addLeaf(made[n].confidence.release());
        if (!made[n].carved) continue;
        carved = true;
        // The new surface's band goes on into blocks around.
        for (int d = 0; d < 27; ++d) into.touchLeaf(plan.blocks[blocks.block[n]].offsetBy(8 * (d / 9 - 1), 8 * (d / 3 % 3 - 1), 8 * (d % 3 - 1)));
    }
    tbb::parallel_for(size_t{0}, made.size(), [&](size_t n) {
        if (!made[n].carved) return;
        Leaf* leaf = field->tree().probeLeaf(plan.blocks[blocks.block[n]]);
        for (openvdb::Index at = 0; at < kLeafVoxels; ++at) leaf->setValueOnly(at, blocks.values[n * kLeafVoxels + at]);
    });
    lap("leaves");
    const double unit = std::pow(surface.voxelSize()[0], 3) / static_cast<double>(kernel::kVolumeUnits);
    out.volume_before = unit * static_cast<double>(volume_units(surface));
    if (carved) {
        const Fragments loose = remove_fragments(*field, surface, options.least_piece);
        out.fragments = loose.fragments;
        out.voids = loose.voids;
        lap("fragments");
        out.surface = redistance(field, static_cast<int>(std::lround(surface.background() / surface.voxelSize()[0])));
    } else {
        out.surface = field;  // the very bits
    }
    out.volume = unit * static_cast<double>(volume_units(*out.surface));
    lap("level_set");
}

}  // namespace vdbcarve
