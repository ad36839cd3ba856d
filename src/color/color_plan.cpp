// SPDX-License-Identifier: Apache-2.0
#include "color/color_plan.h"

#include <openvdb/tree/LeafManager.h>

#include <cmath>

#include "mesh/marching_cubes.h"
#include "volume/same_transform.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"
#include "vdbcarve/kernel/color_fill.h"
#include "vdbcarve/kernel/level_set.h"
#include "base/vector_loops.h"

namespace vdbcarve {

void check_color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const ColorOptions& o) {
    if (surface.getGridClass() != openvdb::GRID_LEVEL_SET) throw InputError("color: grid '" + surface.getName() + "' is no level set");
    if (surface.tree().leafCount() == 0) throw InputError("color: the volume has no surface");
    if (surface.tree().leafCount() > UINT32_MAX / kLeafVoxels) throw InputError("color: more than 2^32 voxels in leaves. Remedy: a lower --resolution");
    if (surface.background() > 100.5 * surface.voxelSize()[0]) throw InputError("color: grid '" + surface.getName() + "' has a band of more than 100 voxels");
    const openvdb::CoordBBox box = leaf_box(surface);
    if (box.dim()[box.maxExtent()] >= kernel::kMortonBias - 8192) throw InputError("color: grid '" + surface.getName() + "' is more than 10^6 voxels wide");
    if (o.mode == ColorMode::None) throw UsageError("color: no mode");
    if (o.depth_vox < 1 || o.depth_vox > 1000) throw UsageError("color: the depth is " + std::to_string(o.depth_vox) + " layers, must be 1..1000");
    if (o.normal_radius_vox < 0 || o.normal_radius_vox > kMaxNormalRadius_vox)
        throw UsageError("color: the normals' window is " + std::to_string(o.normal_radius_vox) + " voxels, must be 0.." +
                         std::to_string(kMaxNormalRadius_vox));
    if (!o.gains.empty() && o.gains.size() != inputs.size())
        throw UsageError("color: " + std::to_string(o.gains.size()) + " gains for " + std::to_string(inputs.size()) + " views");
    const bool any = std::any_of(inputs.begin(), inputs.end(), [](const ColorInput& i) { return i.use; });
    if (!any) throw UsageError("color: no view to take colour from");
    for (const ColorInput& input : inputs) {
        const Intrinsics& k = input.camera.intrinsics;
        const ImageView<uint8_t>& m = input.mask.coverage;
        if (input.use && (m.width != k.width_px || m.height != k.height_px))
            throw InputError("color: view " + input.name + ": the mask has " + std::to_string(m.width) + " x " + std::to_string(m.height) +
                             " pixels, the camera " + std::to_string(k.width_px) + " x " + std::to_string(k.height_px));
    }
}

void check_photo(const char* stage, const ColorInput& input, const PhotoView& photo) {
    const Intrinsics& k = input.camera.intrinsics;
    if (photo.width() != k.width_px || photo.height() != k.height_px)
        throw InputError(std::string(stage) + ": view " + input.name + ": the photograph has " + std::to_string(photo.width()) + " x " +
                         std::to_string(photo.height()) + " pixels, the camera " + std::to_string(k.width_px) + " x " + std::to_string(k.height_px));
    const int c = photo.channels();
    if (c != 1 && c != 3 && c != 4)
        throw InputError(std::string(stage) + ": view " + input.name + ": the photograph has " + std::to_string(c) + " channels; grey, RGB and RGBA are read");
}

const std::vector<float>& linear_table(bool wide) {
    const auto make = [](int count) {
        std::vector<float> out(static_cast<size_t>(count));
        for (int v = 0; v < count; ++v) out[static_cast<size_t>(v)] = static_cast<float>(linear_from_srgb(v / static_cast<double>(count - 1)));
        return out;
    };
    static const std::vector<float> narrow = make(256), full = make(65536);
    return wide ? full : narrow;
}

std::vector<float> normal_weights(int radius) {
    if (radius <= 0) return {};
    const double sigma = 0.5 * radius;
    std::vector<float> out(static_cast<size_t>(3 * radius * radius) + 1);
    for (size_t d2 = 0; d2 < out.size(); ++d2) out[d2] = static_cast<float>(std::exp(-static_cast<double>(d2) / (2 * sigma * sigma)));
    return out;
}

SampledMasks::SampledMasks(const std::vector<ColorInput>& inputs, size_t first, size_t last) {
    for (size_t i = first; i < last; ++i) {
        const MaskView& m = inputs[i].mask;
        MaskView view{m.coverage, {}};
        if (!inputs[i].use) view.coverage = {};
        else if (!m.ignore.empty()) {
            Image8 both(m.coverage.width, m.coverage.height);
            for (size_t p = 0; p < both.data.size(); ++p) both.data[p] = m.ignore.data[p] ? 0 : m.coverage.data[p];
            owned_.push_back(std::move(both));
            view.coverage = owned_.back().view();  // moving the owner keeps its pixels where they are
        }
        views_.push_back(view);
    }
}

DistanceOptions margin_fields() {
    DistanceOptions o;
    o.reach_samples = kernel::kMarginReach_px;
    return o;
}

kernel::ColorView make_color_view(const ColorInput& input, const openvdb::math::Transform& transform, const kernel::ColorBase& base) {
    const Intrinsics& k = input.camera.intrinsics;
    const Rigid3& pose = input.camera.camera_from_world;
    const kernel::LatticeFrame frame = lattice_frame(transform);
    const double h = frame.voxel_size;
    const Vec3d origin = Vec3d(frame.first[0], frame.first[1], frame.first[2]) + h * Vec3d(base.i, base.j, base.k), first = pose * origin;
    kernel::ColorView v{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) v.camera_from_index[4 * r + c] = pose.rotation(r, c) * h;
        v.camera_from_index[4 * r + 3] = first[r];
    }
    v.fx = static_cast<float>(k.fx);
    v.skew = static_cast<float>(k.skew);
    v.fy = static_cast<float>(k.fy);
    v.cx = static_cast<float>(k.cx);
    v.cy = static_cast<float>(k.cy);
    v.orthographic = k.orthographic;
    const Vec3d eye = k.orthographic ? Vec3d(-input.camera.forward_world()) : Vec3d((input.camera.centre_world() - origin) / h);
    v.eye = {static_cast<float>(eye.x()), static_cast<float>(eye.y()), static_cast<float>(eye.z())};
    v.width = static_cast<float>(k.width_px);
    v.height = static_cast<float>(k.height_px);
    v.near_depth = kernel::kNearPlane_vox * static_cast<float>(h);
    v.voxel_px = static_cast<float>(std::sqrt(k.fx * k.fy) * h);
    for (float& g : v.gain) g = 1;
    if (!input.use) v.width = v.height = -1;  // nothing is in frame
    return v;
}

kernel::ColorRule color_rule(const ColorOptions& o, const openvdb::CoordBBox& leaves) {
    kernel::ColorRule rule{};
    rule.best = o.mode == ColorMode::Best;
    rule.test_occlusion = o.test_occlusion;
    rule.skip_upright = o.skip_upright;
    rule.up = {static_cast<float>(o.up.x()), static_cast<float>(o.up.y()), static_cast<float>(o.up.z())};
    const kernel::ColorBase b = color_base(leaves);
    const int base[3] = {b.i, b.j, b.k};
    // Wide enough that no line of sight begins outside.
    for (int a = 0; a < 3; ++a) {
        rule.box.lo[a] = static_cast<float>(leaves.min()[a] - base[a] - 4);
        rule.box.hi[a] = static_cast<float>(leaves.max()[a] - base[a] + 5);
    }
    return rule;
}

openvdb::CoordBBox leaf_box(const openvdb::FloatGrid& surface) {
    openvdb::CoordBBox box;
    for (auto leaf = surface.tree().cbeginLeaf(); leaf; ++leaf) box.expand(leaf->origin(), 8);
    return box;
}

kernel::ColorBase color_base(const openvdb::CoordBBox& leaves) { return {leaves.min()[0] & ~4095, leaves.min()[1] & ~4095, leaves.min()[2] & ~4095}; }

std::vector<uint64_t> sight_walls(const nanovdb::NanoGrid<float>& grid, float threshold) {
    const auto* leaves = grid.tree().getFirstNode<0>();
    std::vector<uint64_t> out(static_cast<size_t>(grid.tree().nodeCount(0)) * kernel::kWallWords);
    for_ranges(out.size() / kernel::kWallWords, 64, [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n)
            for (uint32_t at = 0; at < kLeafVoxels; ++at)
                out[n * kernel::kWallWords + at / 64] |= static_cast<uint64_t>(leaves[n].getValue(at) < threshold) << (at & 63);
    });
    return out;
}

std::vector<uint32_t> exposure_places(size_t contour_count) {
    const size_t every = std::max<size_t>(1, (contour_count + kExposurePlaces - 1) / kExposurePlaces);
    std::vector<uint32_t> out;
    for (size_t n = every / 2; n < contour_count; n += every) out.push_back(static_cast<uint32_t>(n));
    return out;
}

Exposure choose_exposure(const ColorOptions& options, size_t views, const std::function<Observations()>& observe) {
    if (options.gains.empty() && options.exposure) return estimate_exposure(observe(), options.exposure_options);
    Exposure out;
    out.gains = options.gains;
    if (out.gains.empty()) out.gains.assign(views, {1, 1, 1});
    out.places.assign(views, 0);
    return out;
}

void set_gains(std::vector<kernel::ColorView>& views, const std::vector<std::array<double, 3>>& gains) {
    for (size_t v = 0; v < views.size(); ++v)
        for (size_t c = 0; c < 3; ++c) views[v].gain[c] = static_cast<float>(gains[v][c]);
}

int spread_passes(const openvdb::FloatGrid& surface) {
    return kernel::level_set_passes(static_cast<int>(std::ceil(surface.background() / surface.voxelSize()[0] - 1e-6))) + 1;
}

openvdb::Vec3SGrid::Ptr empty_color(const openvdb::FloatGrid& surface) {
    openvdb::Vec3SGrid::Ptr out = openvdb::Vec3SGrid::create(std::make_shared<openvdb::Vec3STree>(surface.tree(), openvdb::Vec3s(0), openvdb::TopologyCopy()));
    out->setTransform(same_transform(surface.transform()));
    out->setName("color");
    out->setVectorType(openvdb::VEC_INVARIANT);
    openvdb::tree::LeafManager<openvdb::Vec3STree>(out->tree()).foreach ([](openvdb::Vec3STree::LeafNodeType& leaf, size_t) { leaf.setValuesOff(); });
    return out;
}

void carry_inwards(openvdb::Vec3SGrid& color, const openvdb::FloatGrid& surface, int depth_vox) {
    // Within the band layers follow from distance; beyond it each layer is the inner side of the one before, and one voxel deep.
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    const int band = static_cast<int>(std::lround(surface.background() / voxel));
    if (depth_vox <= band) return;
    std::vector<openvdb::Coord> front;
    for (auto it = color.cbeginValueOn(); it; ++it) front.push_back(it.getCoord());
    openvdb::Vec3SGrid::Accessor colors = color.getAccessor();
    for (int layer = band; layer < depth_vox; ++layer) {
        openvdb::FloatGrid::ConstAccessor values = surface.getConstAccessor();
        std::vector<openvdb::Coord> next;
        std::vector<openvdb::Vec3s> made;
        std::vector<openvdb::Coord> asked;
        for (const openvdb::Coord& c : front)
            for (int f = 0; f < 6; ++f) {
                openvdb::Coord n = c;
                n[f / 2] += f % 2 ? 1 : -1;
                if (values.getValue(n) < 0 && !colors.isValueOn(n)) asked.push_back(n);
            }
        std::sort(asked.begin(), asked.end());
        asked.erase(std::unique(asked.begin(), asked.end()), asked.end());
        for (const openvdb::Coord& c : asked) {
            kernel::RgbMean mean;
            for (int f = 0; f < 6; ++f) {
                openvdb::Coord n = c;
                n[f / 2] += f % 2 ? 1 : -1;
                openvdb::Vec3s v;
                if (colors.probeValue(n, v)) mean.add({v[0], v[1], v[2]}, 1.f);
            }
            const kernel::Rgb m = mean.value();
            made.emplace_back(m.r, m.g, m.b);
            next.push_back(c);
        }
        for (size_t n = 0; n < next.size(); ++n) colors.setValue(next[n], made[n]);
        if (next.empty()) return;
        front = std::move(next);
    }
}

void finish_color(ColorResult& result, const openvdb::FloatGrid& surface, const std::vector<uint32_t>& contour, const std::vector<uint8_t>& views_blended,
                  const std::vector<float>& confidence, const ColorOptions& options) {
    std::vector<const openvdb::FloatTree::LeafNodeType*> leaves;
    surface.tree().getNodes(leaves);
    const auto shell = [&](auto&& tree, auto background) {
        using Grid = openvdb::Grid<std::decay_t<decltype(tree)>>;
        auto grid = Grid::create(background);
        grid->setTransform(same_transform(surface.transform()));
        return grid;
    };
    result.views = shell(openvdb::Int32Tree(), 0);
    result.views->setName("views");
    result.confidence = shell(openvdb::FloatTree(), 0.f);
    result.confidence->setName("confidence");
    openvdb::Int32Grid::Accessor views = result.views->getAccessor();
    openvdb::FloatGrid::Accessor squareness = result.confidence->getAccessor();
    ColorStatistics& s = result.statistics;
    s.surface_voxels = contour.size();
    s.colored = 0;
    for (size_t n = 0; n < contour.size(); ++n) {
        const openvdb::Coord c = leaves[contour[n] / kLeafVoxels]->offsetToGlobalCoord(contour[n] % kLeafVoxels);
        views.setValue(c, views_blended[n]);
        squareness.setValue(c, confidence[n]);
        s.colored += views_blended[n] > 0;
    }
    s.synthesised = s.surface_voxels - s.colored;
    carry_inwards(*result.color, surface, options.depth_vox);
}

void explain_unseen(const std::vector<ColorInput>& inputs) {
    size_t used = 0;
    for (const ColorInput& i : inputs) used += i.use;
    throw ContradictionError("color: of " + std::to_string(used) +
                             " views none has a photograph that sees the surface from at least 6 degrees above it, 3 px inside its mask. Remedy: check cameras "
                             "and masks, or --color none");
}

}  // namespace vdbcarve
