// SPDX-License-Identifier: Apache-2.0
#include "pipeline/memory_plan.h"

#include <algorithm>
#include <cmath>

#include "vdbcarve/error.h"
#include "vdbcarve/mesh.h"

namespace vdbcarve::pipeline {

namespace {

// On the device: candidate leaves (1.35 for each that stays) with values, views and cells, and the grid; the level set's two sets
// of values, its grid and neighbours; edges, vertices with normals and triangles.
constexpr double kDeviceHullPerLeaf = 1.35 * (2048 + 64 + 240) + 2148, kDeviceSurfacePerLeaf = 2 * 2048 + 64 + 24 + 2148,
                 kDeviceMeshPerLeaf = 256 + 50 * 24 + 100 * 12;
constexpr double kDeviceFilterPerLeaf = 1.3 * (4 * 2048 + 2148 + 176);
constexpr double kCarveBase = 20e6, kMeshBase = 40e6, kExportBase = 70e6;

}  // namespace

std::string gigabytes(double bytes) { return std::to_string(bytes / 1e9).substr(0, 5) + " GB"; }

MemoryPlan unlimited_memory(size_t views) {
    MemoryPlan plan;
    plan.batch = views;
    return plan;
}

MemoryPlan plan_memory(const JobSize& job, double resident, double limit) {
    MemoryPlan plan = unlimited_memory(job.views);
    const double leaves = job.leaves, hull = leaves * (job.occupancy ? 200 : kHullPerLeaf);
    const double carve_peak = resident + kCarveBase + job.field_bytes + hull;
    const double color_grid = job.colored ? kColorGridPerLeaf : 0, glb = job.glb ? kGlbPerLeaf : 0;
    const double mesher = job.slabs ? kMesherBytesPerLeaf / kMostSlabs : kMesherBytesPerLeaf;
    const double later_peak = std::max({resident + leaves * kLevelSetPerLeaf, job.fair ? resident + leaves * kFairPerLeaf : 0.0,
                                        job.colored ? resident + leaves * kColorPerLeaf : 0.0, resident + leaves * (kFilterPerLeaf + color_grid),
                                        resident + kMeshBase + leaves * (kMeshBytesPerLeaf + mesher + color_grid),
                                        resident + kExportBase + leaves * (kExportPerLeaf + glb + 1.5 * color_grid)});
    plan.expected = {leaves, leaves * kTreePerLeaf, job.field_bytes, job.whole ? std::max(carve_peak, later_peak) : carve_peak, limit};
    if (job.whole && later_peak > limit) {
        const double fits = job.longest_vox * std::sqrt(std::max(0.0, (limit - resident - kExportBase) / (later_peak - resident)));
        throw UsageError(
            "this resolution needs about " + gigabytes(later_peak) + " of memory, the limit is " + gigabytes(limit) +
            " (--memory-limit). Remedy: " + (fits >= 16 ? "--resolution " + std::to_string(static_cast<long>(0.97 * fits)) + " fits; " : std::string()) +
            (job.fair ? "--surface hull needs less; " : "") + "`carve` alone goes further, in bricks");
    }
    plan.field_bytes = job.field_bytes;
    plan.hull_bytes = job.occupancy ? 0 : hull;
    plan.limit_bytes = limit;
    return plan;
}

void share_out(MemoryPlan& plan, const JobSize& job, double resident, bool on_device) {
    plan.batch = job.views;
    plan.bricks = on_device ? plan.device_bricks : 1;
    if (plan.limit_bytes <= 0 || job.occupancy) return;  // the binary model is small: a bit a voxel
    const double fields = on_device ? 0 : plan.field_bytes;
    if (resident + kCarveBase + fields + plan.hull_bytes <= plan.limit_bytes) return;
    // Half of the room for fields, half for leaves.
    const double room = std::max(plan.limit_bytes - resident - kCarveBase, 2e6), views = static_cast<double>(job.views);
    if (fields > 0.5 * room) plan.batch = static_cast<size_t>(std::clamp(std::floor(0.5 * room / (fields / views)), 1.0, views));
    const double held = std::min(fields, 0.5 * room);
    if (plan.hull_bytes > room - held) plan.bricks = std::max(plan.bricks, static_cast<int>(std::ceil(plan.hull_bytes * 1.3 / (room - held))));
}

DeviceFit fit_device(const JobSize& job, double free_bytes) {
    const double colors_and_filter = (job.colored ? kDeviceColorPerLeaf : 0) + (job.filtered ? kDeviceFilterPerLeaf : 0);
    const double later = kDeviceSurfacePerLeaf + std::max(job.fair ? kDeviceFairPerLeaf : 0, colors_and_filter);
    const double per_leaf = kDeviceHullPerLeaf + (job.whole ? later : 0) + (job.device_mesh ? kDeviceMeshPerLeaf : 0);
    const double room = 0.95 * free_bytes - job.device_base_bytes;
    DeviceFit fit{job.leaves * per_leaf <= room, 1, job.leaves * per_leaf + job.device_base_bytes};
    if (!fit.fits) fit.bricks = !job.whole && room > 1e8 ? static_cast<int>(std::ceil(job.leaves * per_leaf * 1.3 / room)) : 0;
    return fit;
}

}  // namespace vdbcarve::pipeline
