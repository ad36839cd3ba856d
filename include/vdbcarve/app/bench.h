// SPDX-License-Identifier: Apache-2.0
// How fast this machine carves, against the paper's dense method on the same masks: on the CPU and, where there is one, on the GPU.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/backend.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct BenchScene {
    std::string name;
    std::vector<Camera> cameras;
    std::vector<Mask> masks;  ///< all of one size
    Box3d bounds;
};

/// A large ball and 30 small ones, seen by a level ring of cameras of 1024 x 768; silhouettes in closed form.
BenchScene bench_spheres(int views);
/// A scene folder, thinned out evenly to `views` (0: all); bounds found from the silhouettes where none are given. Throws Error.
BenchScene load_bench_scene(const std::filesystem::path& folder, const std::optional<Box3d>& bounds, int views, Progress& progress);

struct BenchCase {
    std::array<int, 3> dims;  ///< voxels; the bounds are stretched to their shape
    int views;                ///< 0: all that the scene has
};

/// The paper's six volumes with 36 views, then 512^3 with other numbers of views.
std::vector<BenchCase> paper_cases();

struct BenchOptions {
    std::function<BenchScene(int views)> scene = bench_spheres;
    std::vector<BenchCase> cases{{{512, 256, 512}, 36}, {{1024, 512, 1024}, 36}};
    int runs = 3;                ///< medians of so many; the device, being quick, runs more often
    bool cpu = true;             ///< time the CPU
    bool single_thread = false;  ///< and with one thread
    bool dense = true;           ///< also the dense method, where its volume fits dense_limit_bytes
    size_t dense_limit_bytes = size_t{6} << 30;
    bool stages = true;              ///< also level_set and mesh
    Backend backend = Backend::Cpu;  ///< Cuda: also on the device. Not Auto: see choose_backend
    int device = 0;
};

/// Milliseconds on the device, medians. Steps are timed by events on the device; sums "from ... to" are wall time and hold
/// launches, waits and allocations too.
struct BenchDevice {
    double upload = 0;  ///< masks to the device
    double distance = 0, nodes = 0, leaves = 0, topology = 0, level_set = 0, mesh = 0;
    double fields_to_hull = 0;  ///< wall: fields on the device to hull on the device
    double host_to_hull = 0;    ///< wall: masks in host memory to hull on the device, fields included
    double device_to_mesh = 0;  ///< wall: masks on the device to closed mesh (marching cubes of the level set) on the device
    double host_to_mesh = 0;    ///< wall: masks in host memory to closed mesh on the device
    double download_hull = 0, openvdb_hull = 0, download_mesh = 0;  ///< wall: NanoVDB to the host; that and conversion to OpenVDB; mesh to the host
    double dense = 0, dense_upload = 0;                             ///< the dense method on the same device
    size_t bytes = 0, leaf_count = 0, vertices = 0, triangles = 0, node_tests = 0, voxel_lookups = 0;
};

/// One grid and number of views. Seconds are wall time, medians; CPU seconds are those of all threads.
struct BenchRow {
    std::array<int, 3> dims{};
    int views = 0;
    double fields_s = 0, carve_s = 0, fields_cpu_s = 0, carve_cpu_s = 0;
    double level_set_s = 0, mesh_s = 0, cubes_s = 0;
    size_t carve_peak_bytes = 0;  ///< of the process while fields are made and carved
    size_t level_set_peak_bytes = 0;
    size_t field_bytes = 0, hull_bytes = 0, leaves = 0, active_voxels = 0, node_tests = 0, voxel_lookups = 0;
    double dense_s = 0, dense_cpu_s = 0;  ///< 0: not run
    size_t dense_peak_bytes = 0, dense_object_voxels = 0;
    double fields_one_s = 0, carve_one_s = 0, dense_one_s = 0;  ///< one thread; 0: not run
    std::optional<BenchDevice> device;

    double ratio_with_fields() const { return dense_s / (fields_s + carve_s); }
    double ratio_without_fields() const { return dense_s / carve_s; }
};

struct BenchResult {
    std::string scene, machine, loops, dense_flags, device;
    int threads = 0;
    std::vector<BenchRow> rows;
};

/// Peak memory is read from the kernel's high-water mark, reset before each part where that is allowed (Linux).
BenchResult run_bench(const BenchOptions& options, Progress& progress);

/// As tables in Markdown; as the paper's Table 1, the paper's own figures beside it; as JSON.
std::string bench_table(const BenchResult& result);
std::string bench_paper_table(const BenchResult& result);
std::string bench_json(const BenchResult& result);
/// Seconds over voxels (rows of the commonest number of views) or over views (rows of the commonest grid), as SVG.
std::string bench_svg(const BenchResult& result, bool over_views);
/// Both, into `file` and beside it, with `_views` behind its name. Appear by rename. Throws OutputError.
void write_bench_svgs(const BenchResult& result, const std::filesystem::path& file);

}  // namespace vdbcarve
