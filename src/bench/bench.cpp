// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/app/bench.h"

#include <sys/resource.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <functional>
#include <map>
#include <numbers>
#include <random>

#include "device/dense_device.h"
#include "bench/dense_reference.h"
#include "base/memory.h"
#include "base/statistics.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/device.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "base/vector_loops.h"

namespace vdbcarve {

DenseRows dense_rows_generic();
#if defined(VDBCARVE_X86_SETS)
DenseRows dense_rows_avx2();
DenseRows dense_rows_avx512();
#endif

BenchScene bench_spheres(int views) {
    struct Ball {
        Vec3d centre;
        double radius;
    };
    std::mt19937 engine(3);
    const auto random = [&] { return 2.0 * engine() / 4294967295.0 - 1.0; };
    std::vector<Ball> balls{{Vec3d::Zero(), 0.33}};
    for (int i = 0; i < 30; ++i) {
        const double a = random() * std::numbers::pi, r = 0.45 + 0.2 * random(), y = 0.25 * random();
        balls.push_back({Vec3d(r * std::cos(a), y, r * std::sin(a)), 0.12 + 0.08 * random()});
    }
    BenchScene out;
    out.name = "31 spheres";
    out.bounds = Box3d(Vec3d(-0.9, -0.45, -0.9), Vec3d(0.9, 0.45, 0.9));
    Intrinsics k;
    k.fx = k.fy = 1500;
    k.width_px = 1024;
    k.height_px = 768;
    k.cx = 512;
    k.cy = 384;
    for (int v = 0; v < views; ++v) {
        const double a = 2 * std::numbers::pi * v / views;
        Camera c;
        c.intrinsics = k;
        c.camera_from_world.rotation << std::cos(a), 0, -std::sin(a), 0, 1, 0, std::sin(a), 0, std::cos(a);
        c.camera_from_world.translation = Vec3d(0, 0, 4);
        out.cameras.push_back(c);
    }
    out.masks.resize(static_cast<size_t>(views));
    // Silhouettes of balls, counted 4 x 4 rays a pixel.
    tbb::parallel_for(size_t{0}, out.masks.size(), [&](size_t v) {
        const Camera& camera = out.cameras[v];
        Image8& mask = out.masks[v].coverage = Image8(k.width_px, k.height_px);
        std::vector<uint16_t> count(mask.pixels(), 0);
        const auto covered = [&](double u, double w) {
            const Camera::Ray ray = camera.ray({u, w});
            return std::any_of(balls.begin(), balls.end(),
                               [&](const Ball& b) { return (b.centre - ray.origin).cross(ray.direction).squaredNorm() < b.radius * b.radius; });
        };
        std::vector<char> corner(static_cast<size_t>((k.width_px + 1) * (k.height_px + 1)));
        for (int y = 0; y <= k.height_px; ++y)
            for (int x = 0; x <= k.width_px; ++x) corner[static_cast<size_t>(y * (k.width_px + 1) + x)] = covered(x, y);
        for (int y = 0; y < k.height_px; ++y)
            for (int x = 0; x < k.width_px; ++x) {
                const auto at = [&](int i, int j) { return corner[static_cast<size_t>((y + j) * (k.width_px + 1) + x + i)] != 0; };
                const bool first = at(0, 0);
                if (at(1, 0) == first && at(0, 1) == first && at(1, 1) == first) {
                    mask.at(x, y) = first ? 255 : 0;
                    continue;
                }
                int n = 0;
                for (int s = 0; s < 16; ++s) n += covered(x + (s % 4 + 0.5) / 4, y + (s / 4 + 0.5) / 4);
                mask.at(x, y) = static_cast<uint8_t>((n * 255 + 8) / 16);
            }
    });
    return out;
}

namespace {

double cpu_seconds() {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto s = [](const timeval& t) { return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec); };
    return s(usage.ru_utime) + s(usage.ru_stime);
}

struct Timed {
    std::vector<double> wall, cpu;
    void operator()(const std::function<void()>& work) {
        const auto start = std::chrono::steady_clock::now();
        const double before = cpu_seconds();
        work();
        cpu.push_back(cpu_seconds() - before);
        wall.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
};

DenseRows dense_rows() {
#if defined(VDBCARVE_X86_SETS)
    const std::string set = vector_loops().name;
    if (set == "avx512") return dense_rows_avx512();
    if (set == "avx2") return dense_rows_avx2();
#endif
    return dense_rows_generic();
}

/// From index coordinates to homogeneous pixels.
std::vector<std::array<float, 12>> matrices_of(const BenchScene& scene, const CarveOptions& options) {
    std::vector<std::array<float, 12>> out(scene.cameras.size());
    for (size_t v = 0; v < out.size(); ++v) {
        const kernel::CarveView view = make_carve_view({"", scene.cameras[v], nullptr}, options);
        const double k[9] = {view.fx, view.skew, view.cx, 0, view.fy, view.cy, 0, 0, 1};
        for (size_t r = 0; r < 3; ++r)
            for (size_t c = 0; c < 4; ++c)
                out[v][4 * r + c] = static_cast<float>(k[3 * r] * view.camera_from_index[c] + k[3 * r + 1] * view.camera_from_index[4 + c] +
                                                       k[3 * r + 2] * view.camera_from_index[8 + c]);
    }
    return out;
}

size_t carve_dense(const BenchScene& shoot, const std::vector<Image8>& binary, const CarveOptions& options, const std::array<int, 3>& dims) {
    const size_t n = binary.size();
    std::vector<const uint8_t*> masks;
    for (const Image8& m : binary) masks.push_back(m.data.data());
    const std::vector<std::array<float, 12>> pixel_from_index = matrices_of(shoot, options);
    const DenseViews views{static_cast<int>(n), binary[0].width, binary[0].height, masks.data(), reinterpret_cast<const float(*)[12]>(pixel_from_index.data())};
    const DenseGrid grid{0, 0, 0, dims[0], dims[1], dims[2]};
    std::vector<uint8_t> volume(static_cast<size_t>(dims[0]) * static_cast<size_t>(dims[1]) * static_cast<size_t>(dims[2]));
    const DenseRows rows = dense_rows();
    tbb::parallel_for(0, dims[0], [&](int i) { rows(views, grid, i, 0, dims[1], volume.data()); });
    // Counting is not part of the method, but keeps the compiler honest; bytes are summed as they lie.
    return static_cast<size_t>(std::count(volume.begin(), volume.end(), 1));
}

std::vector<DistanceField> bench_fields(const BenchScene& scene, const std::vector<MaskView>& masks, const CarveOptions& o) {
    const FieldPlan plan = plan_fields(scene.cameras, o);
    DistanceOptions options;
    options.scale = plan.scale;
    options.reach_samples = plan.reach_samples;
    Progress quiet;
    return distance_fields(masks, options, quiet);
}

std::vector<CarveInput> inputs_of(const BenchScene& scene, const std::vector<DistanceField>& fields) {
    std::vector<CarveInput> out;
    for (size_t i = 0; i < fields.size(); ++i) out.push_back({std::to_string(i), scene.cameras[i], &fields[i]});
    return out;
}

/// Milliseconds of wall time.
double wall_ms(const std::function<void()>& work) {
    const auto start = std::chrono::steady_clock::now();
    work();
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

void set_medians(std::map<std::string, std::vector<double>>& steps, BenchDevice& out) {
    const auto middle = [&](const char* name) { return median(steps[name]); };
    out.upload = middle("upload");
    out.distance = middle("distance");
    out.nodes = middle("carve: nodes");
    out.leaves = middle("carve: leaves");
    out.topology = middle("carve: topology");
    out.level_set = middle("level_set");
    out.mesh = middle("mesh");
    out.fields_to_hull = middle("fields_to_hull");
    out.host_to_hull = middle("host_to_hull");
    out.host_to_mesh = middle("host_to_mesh");
    out.device_to_mesh = middle("device_to_mesh");
    out.download_hull = middle("download_hull");
    out.openvdb_hull = middle("openvdb_hull");
    out.download_mesh = middle("download_mesh");
}

BenchDevice bench_device(const BenchScene& scene, const std::vector<MaskView>& masks, const std::vector<Image8>& binary, const CarveOptions& o,
                         const BenchCase& c, const BenchOptions& options, Device& device) {
    Progress quiet;
    std::vector<CarveInput> inputs;
    for (size_t i = 0; i < scene.cameras.size(); ++i) inputs.push_back({std::to_string(i), scene.cameras[i], nullptr});
    const FieldPlan plan = plan_fields(scene.cameras, o);
    DistanceOptions d;
    d.scale = plan.scale;
    d.reach_samples = plan.reach_samples;
    std::map<std::string, std::vector<double>> steps;
    const auto note = [&](const char* name, double ms) { steps[name].push_back(ms); };
    BenchDevice out;
    // The first two runs find memory and warm up.
    constexpr int kWarm = 2;
    const int runs = std::max(9, options.runs);
    for (int run = -kWarm; run < runs; ++run) {
        CarveStatistics s;
        device.clear_times();
        device.wait();
        const double to_hull = wall_ms([&] {
            device.upload(masks);
            device.distance(d);
            s = device.carve(inputs, o, quiet);
            device.wait();
        });
        double to_mesh = 0, from_device = 0;
        if (options.stages) {
            to_mesh = to_hull + wall_ms([&] {
                          device.level_set({});
                          device.extract_mesh(false);
                          device.wait();
                      });
        }
        const auto times = device.milliseconds();
        device.clear_times();
        const double fields_to_hull = wall_ms([&] {
            device.carve(inputs, o, quiet);
            device.wait();
        });
        if (options.stages)
            from_device = wall_ms([&] {
                device.distance(d);
                device.carve(inputs, o, quiet);
                device.level_set({});
                device.extract_mesh(false);
                device.wait();
            });
        device.clear_times();
        if (run < 0) continue;
        for (const auto& [name, ms] : times) note(name.c_str(), ms);
        note("host_to_hull", to_hull);
        note("fields_to_hull", fields_to_hull);
        note("host_to_mesh", to_mesh);
        note("device_to_mesh", from_device);
        out.leaf_count = s.leaves;
        out.node_tests = s.node_tests;
        out.voxel_lookups = s.voxel_lookups;
    }
    for (int run = 0; run < 3; ++run) {
        NanoBuffer buffer;
        note("download_hull", wall_ms([&] { buffer = device.hull_bytes(); }));
        note("openvdb_hull", wall_ms([&] { device.hull(); }));
        if (!options.stages || !device.extract_mesh(false)) continue;
        Mesh mesh;
        note("download_mesh", wall_ms([&] { mesh = device.fetch_mesh(false); }));
        out.vertices = mesh.vertices.size();
        out.triangles = mesh.triangles.size();
    }
    set_medians(steps, out);
    out.bytes = device.bytes();
    const size_t dense_bytes = static_cast<size_t>(c.dims[0]) * static_cast<size_t>(c.dims[1]) * static_cast<size_t>(c.dims[2]);
    if (options.dense && dense_bytes <= options.dense_limit_bytes) {
        std::vector<const uint8_t*> bits;
        for (const Image8& m : binary) bits.push_back(m.data.data());
        const DenseTimes dense = dense_on_device(bits, binary[0].width, binary[0].height, matrices_of(scene, o), c.dims, options.device, runs);
        out.dense = dense.carve_ms;
        out.dense_upload = dense.upload_ms;
    }
    return out;
}

std::string cpu_name() {
    std::ifstream in("/proc/cpuinfo");
    for (std::string line; std::getline(in, line);)
        if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
    return "unknown processor";
}

/// A byte a pixel, 1 for object, as the dense method wants it.
std::vector<Image8> binary_masks(const BenchScene& scene) {
    std::vector<Image8> binary;
    for (const Mask& m : scene.masks) {
        if (m.coverage.width != scene.masks[0].coverage.width || m.coverage.height != scene.masks[0].coverage.height)
            throw UsageError("bench: the masks of " + scene.name + " have several sizes; the dense method wants one. Remedy: another scene");
        binary.emplace_back(m.coverage.width, m.coverage.height);
        for (size_t p = 0; p < m.coverage.data.size(); ++p) binary.back().data[p] = m.coverage.data[p] >= 128;
    }
    return binary;
}

/// Cubic voxels: the bounds are made to have the grid's shape around their middle.
CarveOptions carve_options(const BenchScene& scene, const BenchCase& c) {
    const Vec3d d(c.dims[0], c.dims[1], c.dims[2]);
    CarveOptions o;
    o.lattice.voxel_size = scene.bounds.sizes().cwiseQuotient(d).maxCoeff();
    o.bounds_world = Box3d(scene.bounds.center() - 0.5 * o.lattice.voxel_size * d, scene.bounds.center() + 0.5 * o.lattice.voxel_size * d);
    o.lattice.origin_world = o.bounds_world.min();
    o.outside = Outside::Background;
    o.min_seen = 0;
    return o;
}

/// The stages on all threads, several times over; medians and peaks go into the row.
void time_stages(const BenchScene& scene, const std::vector<MaskView>& masks, const std::vector<Image8>& binary, const CarveOptions& o, const BenchCase& c,
                 const BenchOptions& options, bool dense, const std::string& what, BenchRow& row, Progress& progress) {
    Progress quiet;
    Timed fields_time, carve_time, level_set_time, mesh_time, cubes_time, dense_time;
    for (int run = 0; run < (options.cpu ? options.runs : 0); ++run) {
        progress.check();
        progress.note(what + ": run " + std::to_string(run + 1) + " of " + std::to_string(options.runs));
        reset_peak_memory();
        std::vector<DistanceField> fields;
        fields_time([&] { fields = bench_fields(scene, masks, o); });
        const std::vector<CarveInput> inputs = inputs_of(scene, fields);
        row.field_bytes = 0;
        for (const DistanceField& field : fields) row.field_bytes += field.bytes();
        CarveResult result;
        carve_time([&] { result = carve(inputs, o, quiet); });
        row.carve_peak_bytes = std::max(row.carve_peak_bytes, peak_memory_bytes());
        row.hull_bytes = result.statistics.bytes;
        row.leaves = result.statistics.leaves;
        row.active_voxels = result.statistics.active_voxels;
        row.node_tests = result.statistics.node_tests;
        row.voxel_lookups = result.statistics.voxel_lookups;
        fields = {};
        if (options.stages) {
            openvdb::FloatGrid::Ptr surface;
            reset_peak_memory();
            level_set_time([&] { surface = level_set(std::move(result.hull), {}, quiet); });
            row.level_set_peak_bytes = std::max(row.level_set_peak_bytes, peak_memory_bytes());
            mesh_time([&] { extract_mesh(*surface, {}, quiet); });
            MeshOptions cubes;
            cubes.mesher = Mesher::MarchingCubes;
            cubes_time([&] { extract_mesh(*surface, cubes, quiet); });
        }
        result = {};
        if (dense) {
            reset_peak_memory();
            dense_time([&] { row.dense_object_voxels = carve_dense(scene, binary, o, c.dims); });
            row.dense_peak_bytes = std::max(row.dense_peak_bytes, peak_memory_bytes());
        }
    }
    row.fields_s = median(fields_time.wall);
    row.fields_cpu_s = median(fields_time.cpu);
    row.carve_s = median(carve_time.wall);
    row.carve_cpu_s = median(carve_time.cpu);
    row.level_set_s = median(level_set_time.wall);
    row.mesh_s = median(mesh_time.wall);
    row.cubes_s = median(cubes_time.wall);
    row.dense_s = median(dense_time.wall);
    row.dense_cpu_s = median(dense_time.cpu);
}

void time_one_thread(const BenchScene& scene, const std::vector<MaskView>& masks, const std::vector<Image8>& binary, const CarveOptions& o, const BenchCase& c,
                     bool dense, BenchRow& row) {
    Progress quiet;
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    Timed fields_one, carve_one, dense_one;
    std::vector<DistanceField> fields;
    fields_one([&] { fields = bench_fields(scene, masks, o); });
    const std::vector<CarveInput> inputs = inputs_of(scene, fields);
    carve_one([&] { carve(inputs, o, quiet); });
    if (dense) dense_one([&] { carve_dense(scene, binary, o, c.dims); });
    row.fields_one_s = median(fields_one.wall);
    row.carve_one_s = median(carve_one.wall);
    row.dense_one_s = median(dense_one.wall);
}

}  // namespace

std::vector<BenchCase> paper_cases() {
    return {{{128, 128, 128}, 36},   {{256, 128, 256}, 36}, {{256, 256, 256}, 36}, {{512, 256, 512}, 36}, {{512, 512, 512}, 36},
            {{1024, 512, 1024}, 36}, {{512, 512, 512}, 9},  {{512, 512, 512}, 18}, {{512, 512, 512}, 72}};
}

BenchResult run_bench(const BenchOptions& options, Progress& progress) {
    openvdb::initialize();
    if (options.runs < 1) throw UsageError("bench: " + std::to_string(options.runs) + " runs, at least 1");
    BenchResult out;
    out.machine = cpu_name();
    out.loops = vector_loops().name;
    out.threads = static_cast<int>(tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
    out.dense_flags = std::string("-O3 -ffast-math ") +
                      (out.loops == "avx512" ? "-march=x86-64-v4"
                       : out.loops == "avx2" ? "-march=x86-64-v3"
                                             : "") +
                      ", TBB over slices, one byte a voxel and a mask pixel, nearest pixel, runs of 64 voxels left early";
    std::optional<Device> device;
    if (options.backend == Backend::Cuda) {
        device.emplace(options.device);
        const DeviceInfo info = cuda_devices().at(static_cast<size_t>(options.device));
        out.device = info.name + ", " + std::to_string(info.multiprocessors) + " multiprocessors";
    }
    BenchScene scene;
    std::vector<Image8> binary;
    for (const BenchCase& c : options.cases) {
        if (c.views < 0 || c.views > kMaxDenseViews)
            throw UsageError("bench: " + std::to_string(c.views) + " views, must be 1.." + std::to_string(kMaxDenseViews));
        if (scene.cameras.empty() || (c.views != 0 && scene.cameras.size() != static_cast<size_t>(c.views))) {
            scene = options.scene(c.views);
            binary = binary_masks(scene);
        }
        out.scene = scene.name;
        const auto views = static_cast<int>(scene.cameras.size());
        if (views > kMaxDenseViews)
            throw UsageError("bench: " + scene.name + " has " + std::to_string(views) + " views, at most " + std::to_string(kMaxDenseViews) +
                             ". Remedy: --views 36");
        std::vector<MaskView> masks;
        for (const Mask& m : scene.masks) masks.push_back(view_of(m));
        BenchRow row;
        row.dims = c.dims;
        row.views = views;
        const CarveOptions o = carve_options(scene, c);
        const std::string what =
            std::to_string(c.dims[0]) + "x" + std::to_string(c.dims[1]) + "x" + std::to_string(c.dims[2]) + ", " + std::to_string(views) + " views";
        const size_t dense_bytes = static_cast<size_t>(c.dims[0]) * static_cast<size_t>(c.dims[1]) * static_cast<size_t>(c.dims[2]);
        const bool dense = options.dense && dense_bytes <= options.dense_limit_bytes;

        time_stages(scene, masks, binary, o, c, options, dense, what, row, progress);
        if (options.cpu && options.single_thread) {
            progress.note(what + ": one thread");
            time_one_thread(scene, masks, binary, o, c, dense, row);
        }
        if (device) {
            progress.note(what + ": device");
            row.device = bench_device(scene, masks, binary, o, c, options, *device);
        }
        out.rows.push_back(row);
    }
    return out;
}

}  // namespace vdbcarve
