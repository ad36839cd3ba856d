// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/bench.h"

#include <sys/resource.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <sstream>

#include "dense_reference.h"
#include "memory.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/views.h"
#include "vector_loops.h"

namespace vdbcarve {

DenseRows dense_rows_generic();
#if defined(VDBCARVE_X86_SETS)
DenseRows dense_rows_avx2();
DenseRows dense_rows_avx512();
#endif

namespace {

struct Shoot {
    std::vector<Camera> cameras;
    std::vector<Mask> masks;
    Box3d bounds;
};

/// A large ball and 30 small ones around it, seen by a level ring of cameras; silhouettes are discs' images, counted
/// 4 x 4 rays a pixel.
Shoot spheres(int views) {
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
    Shoot out;
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
    tbb::parallel_for(size_t{0}, out.masks.size(), [&](size_t v) {
        const Camera& camera = out.cameras[v];
        Image8& mask = out.masks[v].coverage = Image8(k.width_px, k.height_px);
        std::vector<uint16_t> count(mask.pixels(), 0);
        const auto covered = [&](double u, double w) {
            const Camera::Ray ray = camera.ray({u, w});
            return std::any_of(balls.begin(), balls.end(), [&](const Ball& b) { return (b.centre - ray.origin).cross(ray.direction).squaredNorm() < b.radius * b.radius; });
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

Shoot load(const BenchOptions& options, int views, Progress& progress) {
    ViewsOptions vo;
    vo.scene = options.scene;
    const Views loaded = load_views(vo, progress);
    Masks masks = make_masks(loaded, options.scene, {}, std::vector<std::filesystem::path>(loaded.views.size()), progress);
    const std::vector<Camera> cameras = loaded.cameras();
    const auto there = static_cast<int>(cameras.size());
    if (views > there) throw UsageError("bench: " + options.scene.string() + " has " + std::to_string(there) + " views, " + std::to_string(views) + " are asked for");
    Shoot out;
    for (int v = 0; v < views; ++v) {
        const auto from = static_cast<size_t>(static_cast<long>(v) * there / views);
        out.cameras.push_back(cameras[from]);
        out.masks.push_back(std::move(masks.masks[from]));
    }
    if (options.bounds) {
        out.bounds = *options.bounds;
    } else {
        std::vector<MaskView> views_of;
        for (const Mask& m : out.masks) views_of.push_back(view_of(m));
        Progress quiet;
        const std::vector<DistanceField> fields = distance_fields(views_of, {}, quiet);
        std::vector<CarveInput> inputs;
        for (size_t i = 0; i < fields.size(); ++i) inputs.push_back({std::to_string(i), out.cameras[i], &fields[i]});
        out.bounds = automatic_bounds(inputs, {}, quiet);
    }
    return out;
}

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
    static double median(std::vector<double> v) {
        std::sort(v.begin(), v.end());
        return v.empty() ? 0 : v[v.size() / 2];
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

size_t carve_dense(const Shoot& shoot, const std::vector<Image8>& binary, const CarveOptions& options, const std::array<int, 3>& dims) {
    const size_t n = binary.size();
    std::vector<const uint8_t*> masks;
    std::vector<std::array<float, 12>> pixel_from_index(n);
    for (size_t v = 0; v < n; ++v) {
        masks.push_back(binary[v].data.data());
        const kernel::CarveView view = make_carve_view({"", shoot.cameras[v], nullptr}, options);
        const double k[9] = {view.fx, view.skew, view.cx, 0, view.fy, view.cy, 0, 0, 1};
        for (size_t r = 0; r < 3; ++r)
            for (size_t c = 0; c < 4; ++c)
                pixel_from_index[v][4 * r + c] = static_cast<float>(k[3 * r] * view.camera_from_index[c] + k[3 * r + 1] * view.camera_from_index[4 + c] + k[3 * r + 2] * view.camera_from_index[8 + c]);
    }
    const DenseViews views{static_cast<int>(n), binary[0].width, binary[0].height, masks.data(), reinterpret_cast<const float(*)[12]>(pixel_from_index.data())};
    const DenseGrid grid{0, 0, 0, dims[0], dims[1], dims[2]};
    std::vector<uint8_t> volume(static_cast<size_t>(dims[0]) * static_cast<size_t>(dims[1]) * static_cast<size_t>(dims[2]));
    const DenseRows rows = dense_rows();
    tbb::parallel_for(0, dims[0], [&](int i) { rows(views, grid, i, 0, dims[1], volume.data()); });
    // Counting is not part of the method, but keeps the compiler honest; bytes are summed as they lie.
    return static_cast<size_t>(std::count(volume.begin(), volume.end(), 1));
}

std::string cpu_name() {
    std::ifstream in("/proc/cpuinfo");
    for (std::string line; std::getline(in, line);)
        if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
    return "unknown processor";
}

}  // namespace

BenchResult run_bench(const BenchOptions& options, Progress& progress) {
    openvdb::initialize();
    if (options.runs < 1) throw UsageError("bench: " + std::to_string(options.runs) + " runs, at least 1");
    BenchResult out;
    out.scene = options.scene.empty() ? "31 spheres" : options.scene.filename().string();
    out.machine = cpu_name();
    out.loops = vector_loops().name;
    out.threads = static_cast<int>(tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
    out.dense_flags = std::string("-O3 -ffast-math ") + (out.loops == "avx512" ? "-march=x86-64-v4" : out.loops == "avx2" ? "-march=x86-64-v3" : "") +
                      ", TBB over slices, one byte a voxel and a mask pixel, nearest pixel, runs of 64 voxels left early";
    Progress quiet;
    for (const int views : options.views) {
        if (views < 1 || views > kMaxDenseViews) throw UsageError("bench: " + std::to_string(views) + " views, must be 1.." + std::to_string(kMaxDenseViews));
        const Shoot shoot = options.scene.empty() ? spheres(views) : load(options, views, quiet);
        std::vector<MaskView> masks;
        std::vector<Image8> binary;
        for (const Mask& m : shoot.masks) {
            if (m.coverage.width != shoot.masks[0].coverage.width || m.coverage.height != shoot.masks[0].coverage.height)
                throw UsageError("bench: the masks of " + out.scene + " have several sizes; the dense method wants one. Remedy: another scene");
            masks.push_back(view_of(m));
            binary.emplace_back(m.coverage.width, m.coverage.height);
            for (size_t p = 0; p < m.coverage.data.size(); ++p) binary.back().data[p] = m.coverage.data[p] >= 128;
        }
        for (const std::array<int, 3>& dims : options.grids) {
            BenchRow row;
            row.dims = dims;
            row.views = views;
            // Cubic voxels: the bounds are made to have the grid's shape around their middle.
            const Vec3d d(dims[0], dims[1], dims[2]);
            CarveOptions o;
            o.lattice.voxel_size = shoot.bounds.sizes().cwiseQuotient(d).maxCoeff();
            o.bounds_world = Box3d(shoot.bounds.center() - 0.5 * o.lattice.voxel_size * d, shoot.bounds.center() + 0.5 * o.lattice.voxel_size * d);
            o.lattice.origin_world = o.bounds_world.min();
            o.outside = Outside::Background;
            o.min_seen = 0;
            const std::string what = std::to_string(dims[0]) + "x" + std::to_string(dims[1]) + "x" + std::to_string(dims[2]) + ", " + std::to_string(views) + " views";

            Timed fields_time, carve_time, level_set_time, mesh_time, dense_time;
            for (int run = 0; run < options.runs; ++run) {
                progress.check();
                progress.note(what + ": run " + std::to_string(run + 1));
                reset_peak_memory();
                std::vector<DistanceField> fields;
                fields_time([&] {
                    const FieldPlan plan = plan_fields(shoot.cameras, o);
                    DistanceOptions d_options;
                    d_options.scale = plan.scale;
                    d_options.reach_samples = plan.reach_samples;
                    fields = distance_fields(masks, d_options, quiet);
                });
                std::vector<CarveInput> inputs;
                row.field_bytes = 0;
                for (size_t i = 0; i < fields.size(); ++i) {
                    inputs.push_back({std::to_string(i), shoot.cameras[i], &fields[i]});
                    row.field_bytes += fields[i].bytes();
                }
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
                }
                result = {};
                const size_t dense_bytes = static_cast<size_t>(dims[0]) * static_cast<size_t>(dims[1]) * static_cast<size_t>(dims[2]);
                if (options.dense && dense_bytes <= options.dense_limit_bytes) {
                    reset_peak_memory();
                    dense_time([&] { row.dense_object_voxels = carve_dense(shoot, binary, o, dims); });
                    row.dense_peak_bytes = std::max(row.dense_peak_bytes, peak_memory_bytes());
                }
            }
            row.fields_s = Timed::median(fields_time.wall);
            row.fields_cpu_s = Timed::median(fields_time.cpu);
            row.carve_s = Timed::median(carve_time.wall);
            row.carve_cpu_s = Timed::median(carve_time.cpu);
            row.level_set_s = Timed::median(level_set_time.wall);
            row.mesh_s = Timed::median(mesh_time.wall);
            row.dense_s = Timed::median(dense_time.wall);
            row.dense_cpu_s = Timed::median(dense_time.cpu);
            out.rows.push_back(row);
        }
    }
    return out;
}

std::string bench_table(const BenchResult& r) {
    std::ostringstream out;
    out << "scene: " << r.scene << "; " << r.machine << ", " << r.threads << " threads, vector loops " << r.loops << "\n"
        << "dense method: " << r.dense_flags << "\n\n"
        << "| grid | views | fields s (cpu) | carve s (cpu) | peak MB | hull MB | leaves | look-ups M | dense s (cpu) | dense peak MB | dense / (fields + carve) | dense / carve | level_set s | mesh s |\n"
        << "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
    const auto number = [](double v, int digits) {
        char text[32];
        std::snprintf(text, sizeof text, "%.*f", digits, v);
        return std::string(text);
    };
    for (const BenchRow& b : r.rows) {
        const auto mb = [&](size_t bytes) { return number(static_cast<double>(bytes) / 1e6, 0); };
        const bool dense = b.dense_s > 0;
        out << "| " << b.dims[0] << "x" << b.dims[1] << "x" << b.dims[2] << " | " << b.views << " | " << number(b.fields_s, 3) << " (" << number(b.fields_cpu_s, 2) << ") | "
            << number(b.carve_s, 3) << " (" << number(b.carve_cpu_s, 2) << ") | " << mb(b.carve_peak_bytes) << " | " << mb(b.hull_bytes) << " | " << b.leaves << " | "
            << number(static_cast<double>(b.voxel_lookups) / 1e6, 1) << " | " << (dense ? number(b.dense_s, 3) + " (" + number(b.dense_cpu_s, 2) + ")" : "–") << " | "
            << (dense ? mb(b.dense_peak_bytes) : "–") << " | " << (dense ? number(b.ratio_with_fields(), 1) : "–") << " | " << (dense ? number(b.ratio_without_fields(), 1) : "–") << " | "
            << (b.level_set_s > 0 ? number(b.level_set_s, 2) : "–") << " | " << (b.mesh_s > 0 ? number(b.mesh_s, 2) : "–") << " |\n";
    }
    return out.str();
}

std::string bench_json(const BenchResult& r) {
    nlohmann::ordered_json j{{"scene", r.scene}, {"machine", r.machine}, {"threads", r.threads}, {"vector_loops", r.loops}, {"dense_method", r.dense_flags}, {"rows", nlohmann::json::array()}};
    for (const BenchRow& b : r.rows) {
        nlohmann::ordered_json row{{"dims", b.dims}, {"views", b.views}, {"fields_s", b.fields_s}, {"fields_cpu_s", b.fields_cpu_s}, {"carve_s", b.carve_s}, {"carve_cpu_s", b.carve_cpu_s},
                                   {"carve_peak_bytes", b.carve_peak_bytes}, {"field_bytes", b.field_bytes}, {"hull_bytes", b.hull_bytes}, {"leaves", b.leaves},
                                   {"active_voxels", b.active_voxels}, {"node_tests", b.node_tests}, {"voxel_lookups", b.voxel_lookups}};
        if (b.level_set_s > 0) {
            row["level_set_s"] = b.level_set_s;
            row["level_set_peak_bytes"] = b.level_set_peak_bytes;
            row["mesh_s"] = b.mesh_s;
        }
        if (b.dense_s > 0) {
            row["dense_s"] = b.dense_s;
            row["dense_cpu_s"] = b.dense_cpu_s;
            row["dense_peak_bytes"] = b.dense_peak_bytes;
            row["dense_object_voxels"] = b.dense_object_voxels;
            row["ratio_with_fields"] = b.ratio_with_fields();
            row["ratio_without_fields"] = b.ratio_without_fields();
        }
        j["rows"].push_back(row);
    }
    return j.dump(1) + "\n";
}

std::string bench_svg(const BenchResult& r) {
    // Log-log: seconds over voxels, or over views where only they vary.
    bool by_views = true;
    for (const BenchRow& b : r.rows) by_views = by_views && b.dims == r.rows.front().dims;
    by_views = by_views && r.rows.size() > 1;
    struct Point {
        double x, y;
    };
    std::vector<std::pair<std::string, std::vector<Point>>> lines{{"dense method", {}}, {"distance fields + carve", {}}, {"carve", {}}, {"level_set", {}}};
    const char* colours[] = {"#b04a3a", "#2a6f97", "#61a5c2", "#7a7a4a"};
    double x_low = 1e300, x_high = 0, y_low = 1e300, y_high = 0;
    for (const BenchRow& b : r.rows) {
        const double x = by_views ? b.views : static_cast<double>(b.dims[0]) * b.dims[1] * b.dims[2];
        const double ys[] = {b.dense_s, b.fields_s + b.carve_s, b.carve_s, b.level_set_s};
        for (size_t l = 0; l < 4; ++l) {
            if (!(ys[l] > 0)) continue;
            lines[l].second.push_back({x, ys[l]});
            x_low = std::min(x_low, x);
            x_high = std::max(x_high, x);
            y_low = std::min(y_low, ys[l]);
            y_high = std::max(y_high, ys[l]);
        }
    }
    y_low = std::pow(10, std::floor(std::log10(y_low)));
    y_high = std::pow(10, std::ceil(std::log10(y_high)));
    constexpr double kWidth = 720, kHeight = 440, kLeft = 80, kRight = 80, kTop = 40, kBottom = 60;
    const auto px = [&](double x) { return kLeft + (x_high > x_low ? std::log(x / x_low) / std::log(x_high / x_low) : 0.5) * (kWidth - kLeft - kRight); };
    const auto py = [&](double y) { return kHeight - kBottom - std::log(y / y_low) / std::log(y_high / y_low) * (kHeight - kTop - kBottom); };
    std::ostringstream s;
    s << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " << kWidth << " " << kHeight << "\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
    s << "<text x=\"" << kLeft << "\" y=\"22\" font-size=\"14\">" << r.scene << ": seconds on " << r.threads << " threads</text>\n";
    for (double y = y_low; y <= y_high * 1.001; y *= 10)
        s << "<line x1=\"" << kLeft << "\" x2=\"" << kWidth - kRight << "\" y1=\"" << py(y) << "\" y2=\"" << py(y) << "\" stroke=\"#ddd\"/><text x=\"" << kLeft - 8 << "\" y=\"" << py(y) + 4
          << "\" text-anchor=\"end\">" << y << " s</text>\n";
    std::vector<double> marked;
    for (const BenchRow& b : r.rows) {
        const double x = by_views ? b.views : static_cast<double>(b.dims[0]) * b.dims[1] * b.dims[2];
        if (std::find(marked.begin(), marked.end(), x) != marked.end()) continue;
        marked.push_back(x);
        s << "<text x=\"" << px(x) << "\" y=\"" << kHeight - kBottom + 18 << "\" text-anchor=\"middle\">";
        if (by_views) s << b.views << " views";
        else s << b.dims[0] << "×" << b.dims[1] << "×" << b.dims[2];
        s << "</text>\n";
    }
    for (size_t l = 0; l < 4; ++l) {
        if (lines[l].second.empty()) continue;
        std::sort(lines[l].second.begin(), lines[l].second.end(), [](const Point& a, const Point& b) { return a.x < b.x; });
        s << "<polyline fill=\"none\" stroke=\"" << colours[l] << "\" stroke-width=\"2\" points=\"";
        for (const Point& p : lines[l].second) s << px(p.x) << "," << py(p.y) << " ";
        s << "\"/>\n";
        for (const Point& p : lines[l].second) s << "<circle cx=\"" << px(p.x) << "\" cy=\"" << py(p.y) << "\" r=\"3\" fill=\"" << colours[l] << "\"/>\n";
        s << "<text x=\"" << kLeft - 20 + 165 * static_cast<double>(l) << "\" y=\"" << kHeight - 12 << "\" fill=\"" << colours[l] << "\">" << lines[l].first << "</text>\n";
    }
    s << "</svg>\n";
    return s.str();
}

}  // namespace vdbcarve
