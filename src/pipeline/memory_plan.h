// SPDX-License-Identifier: Apache-2.0
// How a job fits into memory: what it will take, and into how many batches and bricks it is cut so that it keeps within a limit. Pure arithmetic.
#pragma once

#include <cstddef>
#include <optional>
#include <string>

namespace vdbcarve::pipeline {

// Bytes a leaf of the surface, measured on the dragon at 512 to 2048 (BENCHMARKS.md).
inline constexpr double kTreePerLeaf = 2215;  ///< values, masks and nodes
inline constexpr double kHullPerLeaf = 2270;
inline constexpr double kLevelSetPerLeaf = 4450;  ///< the level set's second set of values and its bookkeeping
inline constexpr double kExportPerLeaf = 8300;    ///< two volumes, one mesh and compressed buffers while files are written
inline constexpr double kGlbPerLeaf = 7200;
inline constexpr double kColorPerLeaf = 17000;
inline constexpr double kColorGridPerLeaf = 6300;
inline constexpr double kFilterPerLeaf = 9000;
/// The hull, the fair surface and their coarser levels: 24 to 30 kB on three scenes. 37 to 41 kB where depths lead, which is not counted: stage `stereo` asks
/// for more by itself.
inline constexpr double kFairPerLeaf = 30000;
inline constexpr double kMostSlabs = 64;  ///< that the mesher goes through a grid in
inline constexpr double kProgramBase = 120e6;
/// On the device, reckoned: five values of each voxel in about 1.6 leaves for one of the hull, coarser levels, lines of sight.
inline constexpr double kDeviceFairPerLeaf = 24000;
/// On the device: colours and layers of all voxels in leaves, candidates and the fill's cells of those of the contour.
inline constexpr double kDeviceColorPerLeaf = 14000;

/// What a job is, as far as memory goes.
struct JobSize {
    double leaves = 0;       ///< of the hull, predicted
    double longest_vox = 0;  ///< side of the bounds
    size_t views = 0;
    double field_bytes = 0;        ///< distance fields, with what making them needs besides
    double device_base_bytes = 0;  ///< masks and fields on a device, with what making the fields needs there
    bool whole = true;             ///< to the files of a result; false: the raw hull only
    bool occupancy = false, fair = true, colored = true, filtered = true, glb = true;
    bool slabs = true;         ///< the mesher can go through the grid in slabs
    bool device_mesh = false;  ///< the mesh is made on the device, too
};

struct MemoryExpected {
    double leaves = 0, bytes = 0, field_bytes = 0, peak_bytes = 0, limit_bytes = 0;
};

struct MemoryPlan {
    std::optional<MemoryExpected> expected;  ///< none: not asked, everything at once
    double field_bytes = 0, hull_bytes = 0, limit_bytes = 0;
    int device_bricks = 1;
    size_t batch = 0;  ///< views whose fields are in memory together
    int bricks = 1;    ///< that the hull is carved in
};

/// Everything at once, for a small job on a whole machine.
MemoryPlan unlimited_memory(size_t views);

/// Throws UsageError with the largest --resolution that fits, where the job does not fit `limit` however it is cut. `resident`: bytes held now.
/// Batches and bricks are left at one: share_out() sets them.
MemoryPlan plan_memory(const JobSize& job, double resident, double limit);

/// Batches of fields and bricks of the hull, so that the host keeps within the limit. Where a device carves, fields need no room here.
void share_out(MemoryPlan& plan, const JobSize& job, double resident, bool on_device);

/// How the job fits a device with so many free bytes.
struct DeviceFit {
    bool fits = true;
    int bricks = 1;  ///< that the hull alone fits in; 0: none does, or more than the hull is wanted
    double needed_bytes = 0;
};
DeviceFit fit_device(const JobSize& job, double free_bytes);

/// "1.234 GB".
std::string gigabytes(double bytes);

}  // namespace vdbcarve::pipeline
