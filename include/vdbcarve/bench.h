// SPDX-License-Identifier: Apache-2.0
// How fast this machine carves, against the paper's dense method on the same masks.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct BenchOptions {
    /// A scene folder whose masks are carved; empty: 31 spheres, silhouettes in closed form, `views` of 1024 x 768.
    std::filesystem::path scene;
    std::optional<Box3d> bounds;               ///< of the scene; none: found from the silhouettes
    std::vector<std::array<int, 3>> grids{{512, 256, 512}, {1024, 512, 1024}};  ///< voxels; the bounds are stretched to their shape
    std::vector<int> views{36};                ///< numbers of views: the spheres' are made, a scene's are thinned out evenly
    int runs = 3;                              ///< medians of so many
    bool dense = true;                         ///< also the dense method, where its volume fits dense_limit_bytes
    size_t dense_limit_bytes = size_t{6} << 30;
    bool stages = true;                        ///< also level_set and mesh
};

/// One grid and number of views. Seconds are wall time, medians; CPU seconds are those of all threads.
struct BenchRow {
    std::array<int, 3> dims{};
    int views = 0;
    double fields_s = 0, carve_s = 0, fields_cpu_s = 0, carve_cpu_s = 0;
    double level_set_s = 0, mesh_s = 0;
    size_t carve_peak_bytes = 0;      ///< of the process while fields are made and carved
    size_t level_set_peak_bytes = 0;
    size_t field_bytes = 0, hull_bytes = 0, leaves = 0, active_voxels = 0, node_tests = 0, voxel_lookups = 0;
    double dense_s = 0, dense_cpu_s = 0;  ///< 0: not run
    size_t dense_peak_bytes = 0, dense_object_voxels = 0;

    double ratio_with_fields() const { return dense_s / (fields_s + carve_s); }
    double ratio_without_fields() const { return dense_s / carve_s; }
};

struct BenchResult {
    std::string scene, machine, loops, dense_flags;
    int threads = 0;
    std::vector<BenchRow> rows;
};

/// Peak memory is read from the kernel's high-water mark, reset before each part where that is allowed (Linux).
BenchResult run_bench(const BenchOptions& options, Progress& progress);

/// As a table in Markdown, as JSON, and seconds over voxels (or over views, where the grid stays the same) as SVG.
std::string bench_table(const BenchResult& result);
std::string bench_json(const BenchResult& result);
std::string bench_svg(const BenchResult& result);

}  // namespace vdbcarve
