// SPDX-License-Identifier: Apache-2.0
// Automatic bounds: where could the object be, judged by the silhouettes alone?
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>

#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/carve.h"

namespace vdbcarve {
namespace {

/// Bounding box of what a silhouette covers, image coordinates.
std::optional<Eigen::AlignedBox2d> silhouette_box(const CarveInput& input) {
    const DistanceField& f = *input.field;
    if (!f.shows_object()) return std::nullopt;
    return Eigen::AlignedBox2d(Vec2d(f.object_box[0], f.object_box[1]) * f.scale, Vec2d(f.object_box[2] + 1, f.object_box[3] + 1) * f.scale);
}

/// The (max_misses + 1)-th largest distance to the silhouette cones, frames left out of account.
float beyond_frames(const std::vector<kernel::CarveView>& views, const openvdb::Coord& c, int max_misses, float near_depth, float band) {
    std::vector<float> values;
    for (const kernel::CarveView& view : views) {
        const kernel::Vec3 p = kernel::leaf_to_camera(view, c.x(), c.y(), c.z()).origin;
        if (view.orthographic || p.z > near_depth) values.push_back(kernel::silhouette_value(view, view.silhouette, kernel::project(view, p), p.z, band));
    }
    const auto rank = static_cast<size_t>(max_misses);
    if (values.size() <= rank) return -band;
    std::nth_element(values.begin(), values.begin() + static_cast<long>(rank), values.end(), std::greater<>());
    return values[rank];
}

/// Box of the voxels that may hold a piece of the hull, grown by half a voxel. A point of the hull is at most
/// sqrt(3)/2 voxel from a voxel centre, and there v, a lower bound of the distance, is below one voxel.
/// Where the views' frames end together, "seen as background" and "hardly seen" meet and v comes near zero
/// without any hull; silhouettes continued beyond the frames tell such places apart.
Box3d box_of_hull(const openvdb::FloatGrid& hull, const std::vector<CarveInput>& inputs, const CarveOptions& options) {
    std::vector<kernel::CarveView> views;
    for (const CarveInput& input : inputs) views.push_back(make_carve_view(input, options));
    const auto one = static_cast<float>(options.lattice.voxel_size);
    const float near_depth = kernel::kNearPlane_vox * one, band = hull.background();
    openvdb::CoordBBox found;
    for (auto it = hull.cbeginValueOn(); it; ++it) {
        const openvdb::Coord c = it.getCoord();
        if (*it >= one || (!found.empty() && found.isInside(c))) continue;
        if (*it >= 0 && beyond_frames(views, c, options.max_misses, near_depth, band) >= one) continue;
        found.expand(c);
    }
    Box3d box;
    if (found.empty()) return box;
    const auto corner = [&](const openvdb::Coord& c, double shift) {
        return options.lattice.world_from_index(Vec3d(c.x() + shift, c.y() + shift, c.z() + shift));
    };
    box.extend(corner(found.min(), -0.5));
    box.extend(corner(found.max(), 0.5));
    return box;
}

}  // namespace

Box3d automatic_bounds(const std::vector<CarveInput>& inputs, const CarveOptions& given, Progress& progress) {
    // Reads better whole: a start, a coarse hull, and the box around it, each from the one before.
    // Start: the point nearest to the rays through the silhouettes' middles, and their size there.
    std::vector<Camera::Ray> rays;
    std::vector<std::pair<const CarveInput*, Eigen::AlignedBox2d>> boxes;
    for (const CarveInput& input : inputs) {
        const auto box = silhouette_box(input);
        if (!box) continue;
        boxes.emplace_back(&input, *box);
        rays.push_back(input.camera.ray(box->center()));
    }
    if (boxes.empty()) throw InputError("no view shows the object: all silhouettes are empty");
    const std::optional<Vec3d> meeting = point_nearest_to(rays, 1e-6);
    if (!meeting) throw UndeterminedError("all views look along the same line, so how deep the object is cannot be told. Remedy: give --bounds");
    const Vec3d centre = *meeting;
    std::vector<double> radii;
    for (const auto& [input, box] : boxes) {
        const Intrinsics& k = input->camera.intrinsics;
        const double depth = k.orthographic ? 1.0 : (input->camera.camera_from_world * centre).z();
        if (depth > 0) radii.push_back(0.5 * box.diagonal().norm() * depth / std::min(k.fx, k.fy));
    }
    if (radii.size() * 2 < boxes.size())
        throw ContradictionError(
            "the silhouettes' lines of sight meet behind most cameras: the cameras look away from the object. "
            "Remedy: check the camera file's axes (OpenGL cameras in an OpenCV format, or the reverse?)");
    Box3d box(centre - Vec3d::Constant(1.5 * median(radii)), centre + Vec3d::Constant(1.5 * median(radii)));

    CarveOptions options = given;
    options.occupancy = false;
    options.brick.reset();
    options.half_width_vox = 3;
    options.allow_empty = true;  // at coarse voxels a thin object may fall between them
    const auto carve_in = [&](const Box3d& b, int side_vox) {
        options.bounds_world = b;
        options.lattice.voxel_size = b.sizes().maxCoeff() / side_vox;
        options.lattice.origin_world = b.min();
        Progress quiet;
        progress.check();
        return carve(inputs, options, quiet);
    };
    // Grow until the hull stands free of the box.
    constexpr int kGrowths = 6;
    for (int growth = 0;; ++growth) {
        const CarveResult coarse = carve_in(box, 64);
        const Box3d hull = box_of_hull(*coarse.hull, inputs, options);
        if (hull.isEmpty()) {
            options.allow_empty = false;
            try {
                carve_in(box, 64);         // says why
            } catch (const UsageError&) {  // of bounds that nobody gave
                throw ContradictionError(
                    text_of("the cameras do not look at one object: no place is in frame of as many views as --min-seen %.2f wants. Remedy: mend the cameras, "
                            "or lower --min-seen",
                            options.min_seen));
            }
            throw ContradictionError("the silhouettes leave no hull");
        }
        const double margin = 1.5 * options.lattice.voxel_size;
        bool free = true;
        for (int a = 0; a < 3; ++a) {
            if (hull.min()[a] < box.min()[a] + margin || hull.max()[a] > box.max()[a] - margin) free = false;
        }
        if (free) {
            box = hull;
            break;
        }
        if (growth == kGrowths)
            throw UndeterminedError("the silhouettes do not bound the object: the hull still reaches the border of a box of " +
                                    std::to_string(box.sizes().maxCoeff()) + " units around (" + std::to_string(centre.x()) + ", " +
                                    std::to_string(centre.y()) + ", " + std::to_string(centre.z()) +
                                    "). Remedy: give --bounds, or add views from other directions");
        // Only the sides that were reached move out; the others close in.
        Vec3d lo = hull.min() - Vec3d::Constant(2 * margin), hi = hull.max() + Vec3d::Constant(2 * margin);
        const Vec3d size = box.sizes();
        for (int a = 0; a < 3; ++a) {
            if (hull.min()[a] < box.min()[a] + margin) lo[a] = box.min()[a] - 0.75 * size[a];
            if (hull.max()[a] > box.max()[a] - margin) hi[a] = box.max()[a] + 0.75 * size[a];
        }
        box = Box3d(lo, hi);
    }
    // Close in with finer voxels: the box ends within a percent of the hull.
    for (const int side_vox : {96, 160}) {
        const Vec3d pad = Vec3d::Constant(0.02 * box.sizes().maxCoeff());
        const CarveResult finer = carve_in(Box3d(box.min() - pad, box.max() + pad), side_vox);
        const Box3d hull = box_of_hull(*finer.hull, inputs, options);
        if (!hull.isEmpty()) box = hull;
    }
    const Vec3d pad = Vec3d::Constant(0.005 * box.sizes().maxCoeff());
    return {box.min() - pad, box.max() + pad};
}

Box3d automatic_bounds(const std::vector<CarveInput>& views, const std::vector<MaskView>& masks, double silhouette_offset_px, const CarveOptions& options,
                       Progress& progress) {
    constexpr int kPixels = 1024;
    int longest = 0;
    for (const MaskView& m : masks) longest = std::max({longest, m.coverage.width, m.coverage.height});
    DistanceOptions coarse;
    coarse.silhouette_offset_px = std::max(0.0, silhouette_offset_px);
    coarse.conservative = true;
    coarse.reach_samples = 200;  // the growing box's coarse voxels are up to that wide
    coarse.scale = std::max(1, (longest + kPixels - 1) / kPixels);
    const std::vector<DistanceField> fields = distance_fields(masks, coarse, progress);
    std::vector<CarveInput> inputs = views;
    for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
    CarveOptions graded = options;
    graded.occupancy = false;
    return automatic_bounds(inputs, graded, progress);
}

}  // namespace vdbcarve
