// SPDX-License-Identifier: Apache-2.0
#include "carve/carve_plan.h"

#include <algorithm>
#include <cmath>

#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

constexpr int kMaxMisses = 15;  // a voxel keeps its largest k + 1 values on the stack

}  // namespace

openvdb::math::Transform::Ptr Lattice::transform() const {
    auto t = openvdb::math::Transform::createLinearTransform(voxel_size);
    t->postTranslate(openvdb::Vec3d(origin_world.x(), origin_world.y(), origin_world.z()) + openvdb::Vec3d(0.5 * voxel_size));
    return t;
}

IndexBox voxels_in_bounds(const Lattice& lattice, const Box3d& bounds, int margin_vox) {
    IndexBox box;
    for (int a = 0; a < 3; ++a) {
        // 1e-6 voxel forgives the rounding of bounds that were meant to fall on voxel faces.
        const double lo = (bounds.min()[a] - lattice.origin_world[a]) / lattice.voxel_size - 0.5;
        const double hi = (bounds.max()[a] - lattice.origin_world[a]) / lattice.voxel_size - 0.5;
        box.min[static_cast<size_t>(a)] = static_cast<int>(std::ceil(lo - 1e-6)) - margin_vox;
        box.max[static_cast<size_t>(a)] = static_cast<int>(std::floor(hi + 1e-6)) + 1 + margin_vox;
    }
    return box;
}

kernel::CarveView make_carve_view(const CarveInput& input, const CarveOptions& options) {
    const Intrinsics& k = input.camera.intrinsics;
    const double h = options.lattice.voxel_size;
    const Rigid3& pose = input.camera.camera_from_world;
    const Vec3d first = pose * options.lattice.world_from_index(Vec3d::Zero());
    kernel::CarveView v{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) v.camera_from_index[4 * r + c] = pose.rotation(r, c) * h;
        v.camera_from_index[4 * r + 3] = first[r];
    }
    // Coarser samples are an image of fewer pixels.
    const double scale = input.field ? 1.0 / input.field->scale : 1.0;
    v.fx = static_cast<float>(k.fx * scale);
    v.skew = static_cast<float>(k.skew * scale);
    v.fy = static_cast<float>(k.fy * scale);
    v.cx = static_cast<float>(k.cx * scale);
    v.cy = static_cast<float>(k.cy * scale);
    v.sigma_max = static_cast<float>(k.sigma_max() * scale * (1 + 1e-6));  // stays an upper bound after rounding
    v.frame_width = static_cast<float>(k.width_px * scale);
    v.frame_height = static_cast<float>(k.height_px * scale);
    v.orthographic = k.orthographic;
    v.outside = options.outside;
    if (input.field) {
        v.silhouette = input.field->silhouette.view();
        if (!input.field->ignored.empty()) v.ignored = input.field->ignored.view();
    }
    return v;
}

CarvePlan plan_carve(size_t views, const CarveOptions& options) {
    const double h = options.lattice.voxel_size;
    CarvePlan plan;
    plan.band = options.occupancy ? 0.0 : options.half_width_vox * h;
    plan.near_depth = kernel::kNearPlane_vox * static_cast<float>(h);
    plan.cell_radius = static_cast<float>(kernel::kCellRadius_vox * h);
    plan.need_seen = static_cast<int>(std::ceil(options.min_seen * static_cast<double>(views) - 1e-9));
    plan.range = voxels_in_bounds(options.lattice, options.bounds_world, options.occupancy ? 0 : options.half_width_vox + 1);
    if (options.brick)
        for (size_t a = 0; a < 3; ++a) {
            plan.range.min[a] = std::max(plan.range.min[a], options.brick->min[a]);
            plan.range.max[a] = std::min(plan.range.max[a], options.brick->max[a]);
        }
    return plan;
}

FieldPlan plan_fields(const std::vector<Camera>& cameras, const CarveOptions& options, int scale) {
    // Pixels across a voxel: largest over the bounds' corners, and at their middle.
    const double h = options.lattice.voxel_size;
    const Box3d& box = options.bounds_world;
    const double radius = 0.5 * box.sizes().norm();
    std::vector<double> middle;
    double most = 0, fewest = INFINITY;
    for (const Camera& camera : cameras) {
        const Intrinsics& k = camera.intrinsics;
        double at_middle = k.sigma_max() * h, nearest = at_middle, farthest = at_middle;
        if (!k.orthographic) {
            const double depth = (camera.camera_from_world * box.center()).z();
            if (depth <= 0) continue;
            at_middle /= depth;
            nearest = 0, farthest = INFINITY;
            for (int c = 0; c < 8; ++c) {
                const Vec3d y = camera.camera_from_world * Vec3d(box.corner(static_cast<Box3d::CornerType>(c)));
                // A camera within the bounds: what is nearer than a fifth of the way is left to the coarse bound.
                const double z = std::max(y.z(), 0.2 * std::min(depth, radius));
                nearest = std::max(nearest, k.sigma_max() * h / z * std::sqrt(1 + (y.x() * y.x() + y.y() * y.y()) / (z * z)));
                farthest = std::min(farthest, k.sigma_max() * h / z);
            }
        }
        middle.push_back(at_middle);
        most = std::max(most, nearest);
        fewest = std::min(fewest, farthest);
    }
    FieldPlan plan;
    if (middle.empty()) return plan;
    std::nth_element(middle.begin(), middle.begin() + static_cast<long>(middle.size() / 2), middle.end());
    plan.px_per_voxel = middle[middle.size() / 2];
    // The binary model asks the very pixel.
    plan.scale = options.occupancy ? 1 : (scale > 0 ? scale : std::max(1, static_cast<int>(fewest / kSamplesPerVoxel)));
    // A leaf (its voxel centres reach sqrt(3) * 3.5 voxels from its middle) is decided by the samples, larger nodes by blocks.
    const double band_vox = options.occupancy ? 0 : options.half_width_vox;
    // In whole steps, so that a view that comes later seldom changes it.
    const double reach = (band_vox + std::sqrt(3.0) * 3.5) * most / plan.scale * 1.05 + kernel::kFieldSlop_px + 1;
    plan.reach_samples = std::clamp(8 * std::ceil(reach / 8), 8.0, 0.9 * kernel::kMaxReach_px);
    return plan;
}

void check_field(const std::string& name, const Intrinsics& k, const DistanceField& field, const CarveOptions& options) {
    if (field.silhouette.samples.size() > 0x7fffffff) throw UsageError("carve: view " + name + ": more than 2^31 pixels");
    if (field.silhouette.empty() || field.mask_width != k.width_px || field.mask_height != k.height_px)
        throw UsageError("carve: view " + name + ": the distance field has not the camera's size");
    if (options.occupancy && field.scale != 1)
        throw UsageError("carve: the binary model wants a sample a pixel, view " + name + " has a field-scale of " + std::to_string(field.scale));
}

void check_carve(const std::vector<CarveInput>& inputs, const CarveOptions& o) {
    std::string bad;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) bad += (bad.empty() ? "" : "; ") + what;
    };
    need(!inputs.empty(), "no views");
    need(inputs.size() < 65536, "more than 65535 views");
    need(std::isfinite(o.lattice.voxel_size) && o.lattice.voxel_size > 0, "voxel size is " + std::to_string(o.lattice.voxel_size) + ", must be > 0");
    need(!o.bounds_world.isEmpty() && o.bounds_world.min().allFinite() && o.bounds_world.max().allFinite(), "bounds are empty or not finite");
    need(o.max_misses >= 0 && o.max_misses <= kMaxMisses, "max-misses is " + std::to_string(o.max_misses) + ", must be 0.." + std::to_string(kMaxMisses));
    need(o.min_seen >= 0 && o.min_seen <= 1, "min-seen is " + std::to_string(o.min_seen) + ", must be 0..1");
    need(o.half_width_vox >= 2 && o.half_width_vox <= 100, "half-width is " + std::to_string(o.half_width_vox) + " voxels, must be 2..100");
    if (o.brick)
        for (size_t a = 0; a < 3; ++a) need(o.brick->min[a] % 8 == 0 && o.brick->max[a] % 8 == 0, "the limits of a brick must be multiples of 8");
    if (!bad.empty()) throw UsageError("carve: " + bad);
    if (!o.lattice.origin_world.allFinite()) throw UsageError("carve: the origin is not finite");
    const Vec3d dims = o.bounds_world.sizes() / o.lattice.voxel_size;
    if (!(dims.maxCoeff() <= 65536))
        throw UsageError("carve: " + std::to_string(std::llround(dims.maxCoeff())) + " voxels along one side, at most 65536. Remedy: larger voxels");
    const Vec3d far = o.lattice.index_from_world(o.bounds_world.min()).cwiseAbs().cwiseMax(o.lattice.index_from_world(o.bounds_world.max()).cwiseAbs());
    if (far.maxCoeff() > 1e9)
        throw UsageError("carve: the bounds are " + std::to_string(far.maxCoeff()) + " voxels from the origin, at most 1e9. Remedy: --origin near the object");
    for (const CarveInput& i : inputs) {
        const Intrinsics& k = i.camera.intrinsics;
        if (i.field) check_field(i.name, k, *i.field, o);
    }
}

void explain_empty(const std::vector<CarveInput>& inputs, const CarveOptions& options) {
    for (const CarveInput& input : inputs)
        if (!input.field)
            throw ContradictionError(
                "the hull is empty: the silhouettes contradict each other. Remedy: a lower --resolution carves all views at once and names them");
    constexpr int kSide = 48;
    const auto n = inputs.size();
    std::vector<kernel::CarveView> views;
    for (const CarveInput& i : inputs) views.push_back(make_carve_view(i, options));
    const Vec3d lo = options.lattice.index_from_world(options.bounds_world.min());
    const Vec3d hi = options.lattice.index_from_world(options.bounds_world.max());
    struct Tally {
        int fewest = INT32_MAX, most_seen = 0;
        size_t points = 0;
        std::vector<size_t> blame;
    } tally;
    tally.blame.assign(n, 0);
    std::vector<size_t> out;
    for (int p = 0; p < kSide * kSide * kSide; ++p) {
        const Vec3d f((p % kSide + 0.5) / kSide, (p / kSide % kSide + 0.5) / kSide, (p / kSide / kSide + 0.5) / kSide);
        const Vec3d x = lo + f.cwiseProduct(hi - lo);
        int seen = 0;
        out.clear();
        for (size_t v = 0; v < n; ++v) {
            const double* m = views[v].camera_from_index;
            kernel::Vec3 c;
            c.x = static_cast<float>(m[0] * x[0] + m[1] * x[1] + m[2] * x[2] + m[3]);
            c.y = static_cast<float>(m[4] * x[0] + m[5] * x[1] + m[6] * x[2] + m[7]);
            c.z = static_cast<float>(m[8] * x[0] + m[9] * x[1] + m[10] * x[2] + m[11]);
            const kernel::BinaryAnswer a = kernel::binary_answer(views[v], c, 0.f);
            seen += a.seen;
            if (a.background) out.push_back(v);
        }
        tally.most_seen = std::max(tally.most_seen, seen);
        if (seen < std::ceil(options.min_seen * static_cast<double>(n) - 1e-9)) continue;
        if (static_cast<int>(out.size()) > tally.fewest) continue;
        if (static_cast<int>(out.size()) < tally.fewest) {
            tally.fewest = static_cast<int>(out.size());
            tally.points = 0;
            tally.blame.assign(n, 0);
        }
        ++tally.points;
        for (size_t v : out) ++tally.blame[v];
    }
    if (tally.fewest == INT32_MAX)
        throw UsageError("the bounds are not where the cameras look: no point of them is in frame of more than " + std::to_string(tally.most_seen) + " of " +
                         std::to_string(n) + " views, and --min-seen " + std::to_string(options.min_seen).substr(0, 4) +
                         " wants more. Remedy: mend --bounds (or leave them out), or lower --min-seen");
    std::vector<size_t> order(n);
    for (size_t v = 0; v < n; ++v) order[v] = v;
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return tally.blame[a] > tally.blame[b]; });
    std::string names;
    for (size_t i = 0; i < n && i < 5 && tally.blame[order[i]] > 0 && tally.blame[order[i]] * 5 >= tally.blame[order[0]]; ++i)
        names += (i ? ", " : "") + inputs[order[i]].name + " (" + std::to_string(100 * tally.blame[order[i]] / tally.points) + " %)";
    if (tally.fewest <= options.max_misses)
        throw ContradictionError("the hull is thinner than the voxels and got lost. Remedy: a finer --resolution, or tighter --bounds");
    throw ContradictionError("the hull is empty: every point in the bounds is background in at least " + std::to_string(tally.fewest) + " of " +
                             std::to_string(n) + " views. Where it is fewest, these views carve (share of such points): " + names +
                             ". Remedy: look at their masks and cameras, leave them out" +
                             (tally.fewest <= kMaxMisses ? ", or allow --max-misses " + std::to_string(tally.fewest) : std::string()) +
                             "; if those masks mean 'do not use', give them as --ignore-masks");
}

openvdb::FloatGrid::Ptr empty_hull(const CarveOptions& options) {
    openvdb::FloatGrid::Ptr hull = openvdb::FloatGrid::create(static_cast<float>(options.half_width_vox * options.lattice.voxel_size));
    hull->setTransform(options.lattice.transform());
    hull->setName("hull");
    hull->setGridClass(openvdb::GRID_LEVEL_SET);
    return hull;
}

openvdb::MaskGrid::Ptr empty_occupancy(const CarveOptions& options) {
    openvdb::MaskGrid::Ptr occupancy = openvdb::MaskGrid::create(false);
    occupancy->setTransform(options.lattice.transform());
    occupancy->setName("occupancy");
    return occupancy;
}

void measure_tree(CarveResult& result) {
    const auto& tree = result.occupancy ? static_cast<const openvdb::TreeBase&>(result.occupancy->tree()) : result.hull->tree();
    result.statistics.leaves = tree.leafCount();
    result.statistics.active_voxels = tree.activeVoxelCount();
    result.statistics.bytes = tree.memUsage();
}

}  // namespace vdbcarve
