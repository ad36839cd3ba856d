// SPDX-License-Identifier: Apache-2.0
// Stage `carve`: silhouettes and cameras become the raw hull on a sparse grid.
//
// After Denkowski, "GPU accelerated 3D object reconstruction", ICCS 2013, listing 4.1, with three changes:
// the depth divides both image coordinates (the listing divides y by the image-x coordinate); the value of
// a voxel is the signed distance to the silhouette cones instead of one bit; and nodes of the tree are
// decided whole wherever an exact bound (docs/stages/derivations.md) allows it.
#pragma once

#include <openvdb/openvdb.h>

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/distance.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

using kernel::Outside;

/// The voxel lattice: voxel (i, j, k) has its centre at origin + (i + 1/2, j + 1/2, k + 1/2) * voxel_size.
struct Lattice {
    Vec3d origin_world = Vec3d::Zero();
    double voxel_size = 0;

    Vec3d world_from_index(const Vec3d& index) const { return origin_world + (index + Vec3d::Constant(0.5)) * voxel_size; }
    Vec3d index_from_world(const Vec3d& world) const { return (world - origin_world) / voxel_size - Vec3d::Constant(0.5); }
    openvdb::math::Transform::Ptr transform() const;
};

/// Voxels min <= index < max.
struct IndexBox {
    std::array<int, 3> min{}, max{};
};

/// One camera, that of the mask, with the mask's distance field, borrowed.
struct CarveInput {
    std::string name;
    Camera camera;
    const DistanceField* field = nullptr;
};

struct CarveOptions {
    Lattice lattice;
    Box3d bounds_world;     ///< the hull is clipped to this box (flat caps)
    int max_misses = 0;     ///< so many views may show background and the voxel stays (k of n)
    double min_seen = 0.6;  ///< share of the views that must have a point in frame
    Outside outside = Outside::Unknown;
    int half_width_vox = 3;         ///< narrow band on either side of the surface
    bool occupancy = false;         ///< the paper's binary model: nearest pixel >= 1/2 in every view
    bool allow_empty = false;       ///< an empty hull is a result, not an error
    std::optional<IndexBox> brick;  ///< carve this part only; limits are multiples of 8
};

struct CarveStatistics {
    size_t node_tests = 0;     ///< node-view pairs asked
    size_t voxel_lookups = 0;  ///< voxel-view pairs asked
    size_t leaves = 0;         ///< leaves with surface
    size_t active_voxels = 0;
    size_t bytes = 0;          ///< of the tree
    size_t inside_voxels = 0;  ///< voxels of those leaves that are inside
    double clipped_share = 0;  ///< share of the surface that is cap of the bounds
};

struct CarveResult {
    /// v = max over views (or the (max_misses + 1)-th largest) of the signed distance to the silhouette cone,
    /// world units, clamped to the band. Zero set and sign are right; outside it is a lower bound of the
    /// distance, not the distance. Stage level_set makes one.
    openvdb::FloatGrid::Ptr hull;
    openvdb::MaskGrid::Ptr occupancy;  ///< instead of hull, when asked for
    CarveStatistics statistics;
    std::string backend_used = "cpu";
};

/// Carves top-down over node sizes 128..8, each node with the list of views that still matter.
/// Same bits for any number of threads. Cost: about (surface voxels) x (views that see their silhouette edge
/// there). Throws ContradictionError naming the views when nothing is left, UsageError for bad options.
CarveResult carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress);

/// The same without all fields in memory at once: `fields_of(first, last)` makes those of the views first <= i < last,
/// `batch` views at a time; the inputs' own are not looked at. Same bits as carve().
using FieldSource = std::function<std::vector<DistanceField>(size_t first, size_t last)>;
CarveResult carve_in_batches(const std::vector<CarveInput>& inputs, size_t batch, const FieldSource& fields_of, const CarveOptions& options,
                             Progress& progress);

/// A hull with more views: `hull` is what carve() makes of the inputs i < known, with these options; the result is what it makes of all, bit for bit, in
/// whatever order views come. Without allowed misses, and where enough views have a place in frame before and after, a new view can only take away: the places
/// that its silhouette's edge cuts are asked about it alone. Elsewhere (misses, --min-seen) the places where the new views say anything are asked of all views,
/// whose fields `fields_of` then makes. Fields that must be there: those of the new views, and of known ones that ignore pixels. Not for occupancy or bricks.
/// Cost: about the part of the new cones' edges that is in the bounds. The hull is used up. Statistics count what was asked now. Errors like carve().
CarveResult extend_hull(openvdb::FloatGrid::Ptr hull, size_t known, const std::vector<CarveInput>& inputs, const FieldSource& fields_of,
                        const CarveOptions& options, Progress& progress);

/// How finely and how far out distance fields must be sampled for a carve.
struct FieldPlan {
    int scale = 1;             ///< DistanceOptions::scale
    double reach_samples = 0;  ///< DistanceOptions::reach_samples
    double px_per_voxel = 0;   ///< pixels of the photographs across a voxel at the bounds' middle, median over views
};

/// `scale` 0 chooses the coarsest samples that still are at least kSamplesPerVoxel to a voxel in every view: with them the
/// normals of a ball of 35 voxels radius are within a degree (rms; a contour is known to about 0.05 samples).
inline constexpr double kSamplesPerVoxel = 2.5;
FieldPlan plan_fields(const std::vector<Camera>& cameras, const CarveOptions& options, int scale = 0);

/// Joins hulls of disjoint bricks into exactly the hull carved whole. The bricks are emptied.
openvdb::FloatGrid::Ptr merge_bricks(const std::vector<openvdb::FloatGrid::Ptr>& bricks);

/// The voxels whose centres lie in the bounds, and with the band around them.
IndexBox voxels_in_bounds(const Lattice& lattice, const Box3d& bounds_world, int margin_vox);

/// A box that holds the hull: found from the silhouettes and cameras alone by carving coarse grids.
/// Uses max_misses, min_seen and outside of the options. Throws UndeterminedError when the silhouettes do
/// not bound the object, ContradictionError naming views when no hull is left.
Box3d automatic_bounds(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress);
/// The same from masks (of the views, in their order), with fields of its own: of at most 1024 samples a side, from silhouettes
/// that never shrink, so the box may be a sample too large. The views' fields are not looked at.
Box3d automatic_bounds(const std::vector<CarveInput>& views, const std::vector<MaskView>& masks, double silhouette_offset_px, const CarveOptions& options,
                       Progress& progress);

/// What the kernels see of a view on a lattice. Borrows the input's fields.
kernel::CarveView make_carve_view(const CarveInput& input, const CarveOptions& options);

}  // namespace vdbcarve
