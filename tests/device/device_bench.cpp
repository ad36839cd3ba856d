// SPDX-License-Identifier: Apache-2.0
// The benchmark for a machine that it is carried to: no image codecs, no command-line library. Scenes are packed ones.
//   vdbcarve_device_bench paper FILE.svg          the paper's table, text and both plots
//   vdbcarve_device_bench sizes                   18, 36 and 72 views at 512 to 4096, spheres, device only
//   vdbcarve_device_bench scene FOLDER GRID…      a packed scene, device only
//   vdbcarve_device_bench hull FOLDER N FILE      carves a packed scene at resolution N on the device and writes the hull as .vdb
//   vdbcarve_device_bench color FOLDER GRID       colours a packed scene with photographs, step by step
//   vdbcarve_device_bench fair FOLDER GRID        the fair surface of a packed scene, step by step
//   vdbcarve_device_bench render FOLDER GRID      pictures of a packed scene; and, at 128, 256 and 512, carving and looking at it again and again
//   vdbcarve_device_bench add FOLDER N            views of a packed scene added one after another at resolution N, on the CPU and, where there is one, on the
//   device vdbcarve_device_bench ceilings                what the device can do at most vdbcarve_device_bench once GRID               one run of all stages,
//   for a profiler
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <functional>
#include <map>
#include <optional>
#include <utility>

#include "device_ceilings.h"
#include "support/packed_scene.h"
#include "vdbcarve/app/bench.h"
#include "vdbcarve/device.h"
#include "vdbcarve/export.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/slack.h"

namespace {

using namespace vdbcarve;

std::array<int, 3> grid_of(const std::string& text) {
    std::array<int, 3> out{};
    if (std::sscanf(text.c_str(), "%dx%dx%d", &out[0], &out[1], &out[2]) != 3) throw UsageError("'" + text + "' is no grid");
    return out;
}

BenchScene packed(const std::string& folder, int views) {
    test::PackedScene scene = test::read_packed_scene(folder);
    BenchScene out;
    out.name = std::filesystem::path(folder).filename().string();
    out.bounds = scene.bounds;
    for (int v = 0; v < views; ++v) {
        const size_t from = static_cast<size_t>(v) * scene.cameras.size() / static_cast<size_t>(views);
        out.cameras.push_back(scene.cameras[from]);
        out.masks.push_back(scene.masks[from]);
    }
    return out;
}

/// From masks to the level set, which stays on the device.
openvdb::FloatGrid::Ptr make_surface(Device& device, const test::PackedScene& scene, const std::array<int, 3>& grid, Progress& progress) {
    openvdb::initialize();
    CarveOptions c;
    c.bounds_world = scene.bounds;
    c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / *std::max_element(grid.begin(), grid.end());
    const FieldPlan plan = plan_fields(scene.cameras, c);
    DistanceOptions d;
    d.scale = plan.scale;
    d.reach_samples = plan.reach_samples;
    device.upload(scene.mask_views());
    device.distance(d);
    device.carve(scene.inputs(), c, progress);
    device.level_set({});
    return device.surface();
}

void print_medians(std::map<std::string, std::vector<double>>& steps) {
    for (auto& [name, ms] : steps) {
        std::sort(ms.begin(), ms.end());
        std::printf("  %-34s %8.2f ms\n", name.c_str(), ms[ms.size() / 2]);
    }
}

/// Medians of seven runs, the first thrown away; once more for `best`.
void bench_color(const test::PackedScene& scene, const std::array<int, 3>& grid, Progress& progress) {
    Device device;
    const auto surface = make_surface(device, scene, grid, progress);
    const std::vector<ColorInput> inputs = scene.color_inputs();
    for (const ColorMode mode : {ColorMode::Blend, ColorMode::Best}) {
        ColorOptions o;
        o.mode = mode;
        std::map<std::string, std::vector<double>> steps;
        ColorResult result;
        for (int run = 0; run < 8; ++run) {
            device.clear_times();
            const auto start = std::chrono::steady_clock::now();
            result = device.color(*surface, inputs, {}, o, progress);
            const double wall = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
            if (run == 0) continue;
            for (const auto& [name, ms] : device.milliseconds()) steps[name].push_back(ms);
            steps["wall, with the grids on the host"].push_back(wall);
        }
        std::printf("%s: %zu voxels of the contour, %.1f %% seen, %zu views, %.0f MB on the device\n", mode == ColorMode::Best ? "best" : "blend",
                    result.statistics.surface_voxels,
                    100.0 * static_cast<double>(result.statistics.colored) / static_cast<double>(result.statistics.surface_voxels), inputs.size(),
                    static_cast<double>(device.bytes()) / 1e6);
        print_medians(steps);
    }
}

/// What a view that arrives costs from its mask to the hull: extending, and carving anew; both give the same hull.
void bench_add(const test::PackedScene& scene, int resolution, Progress& progress) {
    using Clock = std::chrono::steady_clock;
    const auto ms_since = [](Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); };
    openvdb::initialize();
    CarveOptions c;
    c.bounds_world = scene.bounds;
    c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / resolution;
    c.allow_empty = true;
    const FieldPlan plan = plan_fields(scene.cameras, c);
    DistanceOptions d;
    d.scale = plan.scale;
    d.reach_samples = plan.reach_samples;
    const std::vector<MaskView> all_masks = scene.mask_views();
    const std::vector<CarveInput> all = scene.inputs();
    // A stride that leaves none out, so that they come from all around.
    std::vector<size_t> order;
    for (size_t i = 0; i < all.size(); ++i) order.push_back(i * 7 % all.size());
    const auto masks_of = [&](size_t first, size_t last) {
        std::vector<MaskView> out;
        for (size_t i = first; i < last; ++i) out.push_back(all_masks[order[i]]);
        return out;
    };
    const FieldSource source = [&](size_t first, size_t last) { return distance_fields(masks_of(first, last), d, progress); };
    const bool on_device = !cuda_devices().empty();
    Device* device = nullptr;
    std::optional<Device> here, one;
    if (on_device) device = &here.emplace(), one.emplace();
    std::map<std::string, std::vector<double>> steps;
    openvdb::FloatGrid::Ptr hull;
    size_t differing = 0;
    for (size_t n = 4; n <= all.size(); ++n) {
        std::vector<CarveInput> inputs;
        for (size_t i = 0; i < n; ++i) inputs.push_back(all[order[i]]);
        auto start = Clock::now();
        const std::vector<DistanceField> fields = distance_fields(masks_of(0, n), d, progress);
        for (size_t i = 0; i < n; ++i) inputs[i].field = &fields[i];
        const openvdb::FloatGrid::Ptr whole = carve(inputs, c, progress).hull;
        const double anew = ms_since(start);
        if (n > 4) {
            steps["CPU: carved anew"].push_back(anew);
            std::vector<CarveInput> framed = inputs;
            for (CarveInput& input : framed) input.field = nullptr;
            start = Clock::now();
            const std::vector<DistanceField> last = distance_fields(masks_of(n - 1, n), d, progress);
            steps["CPU: field of the new view"].push_back(ms_since(start));
            framed.back().field = &last.front();
            hull = extend_hull(hull, n - 1, framed, source, c, progress).hull;
            steps["CPU: added, field and hull"].push_back(ms_since(start));
            differing += !(whole->tree().hasSameTopology(hull->tree()));
            for (auto it = whole->cbeginValueAll(); it; ++it) differing += *it != hull->tree().getValue(it.getCoord());
        } else {
            hull = whole;
        }
        if (!device) continue;
        start = Clock::now();
        device->upload(masks_of(0, n));
        device->distance(d);
        device->carve(inputs, c, progress);
        device->wait();
        if (n > 4) steps["device: all masks up, fields, carved anew"].push_back(ms_since(start));
        start = Clock::now();
        one->upload(masks_of(n - 1, n));
        one->distance(d);
        one->wait();
        device->carve(inputs, c, progress);
        device->wait();
        if (n > 4) steps["device: new mask up, its field, carved anew from fields that are there"].push_back(ms_since(start));
        const openvdb::FloatGrid::Ptr home = device->hull();
        for (auto it = whole->cbeginValueAll(); it; ++it) differing += *it != home->tree().getValue(it.getCoord());
    }
    std::printf("%zu views one after another at %d, medians (largest):\n", all.size(), resolution);
    for (auto& [name, ms] : steps) {
        std::sort(ms.begin(), ms.end());
        std::printf("  %-72s %8.2f (%.2f) ms\n", name.c_str(), ms[ms.size() / 2], ms.back());
    }
    std::printf("  voxels that differ: %zu\n", differing);
}

double median_of(std::vector<double> v) {
    std::sort(v.begin(), v.end());
    return v[v.size() / 2];
}

/// Pictures of 1024 x 1024 of the coloured surface; then carving and looking, as with a model that grows.
void bench_render(const test::PackedScene& scene, const std::array<int, 3>& grid, Progress& progress) {
    Device device;
    const auto surface = make_surface(device, scene, grid, progress);
    openvdb::Vec3SGrid::Ptr colors;
    if (!scene.photos.empty()) colors = color(*surface, scene.color_inputs(), {}, progress).color;
    if (colors) device.set_colors(*colors);
    const Box3d box = box_of_inside(*surface);
    OrbitView view;
    const auto camera = [&](const Box3d& of, int frame) {
        view.azimuth_deg = 17.0 * frame;
        return orbit_camera(of, Vec3d::UnitY(), view);
    };
    const std::pair<const char*, std::function<void(RenderOptions&)>> kinds[] = {
        {"surface, ambient occlusion", [](RenderOptions&) {}},
        {"surface, four rays a pixel", [](RenderOptions& o) { o.samples = 2; }},
        {"surface, 6 rays of it", [](RenderOptions& o) { o.ambient_rays = 6; }},
        {"surface, no ambient occlusion", [](RenderOptions& o) { o.ambient_rays = 0; }},
        {"voxels", [](RenderOptions& o) { o.style = RenderStyle::Voxels; }},
        {"x-ray", [](RenderOptions& o) { o.style = RenderStyle::XRay; }},
    };
    for (const auto& [name, change] : kinds) {
        RenderOptions o;
        o.samples = 1;
        change(o);
        std::vector<double> ms;
        for (int frame = 0; frame < 22; ++frame) {
            device.clear_times();
            device.render(camera(box, frame), o);
            if (frame >= 2) ms.push_back(device.milliseconds("render"));
        }
        std::printf("render %-32s %8.3f ms (median of 20 azimuths, 1024 x 1024)\n", name, median_of(ms));
    }
    for (const int side : {128, 256, 512}) {
        CarveOptions c;
        c.bounds_world = scene.bounds;
        c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / side;
        const FieldPlan plan = plan_fields(scene.cameras, c);
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        Device live;
        live.upload(scene.mask_views());
        live.distance(d);
        const std::vector<CarveInput> inputs = scene.inputs();
        RenderOptions o;
        o.samples = 1;
        for (const bool fields_too : {false, true}) {
            std::vector<double> ms;
            for (int frame = 0; frame < 33; ++frame) {
                const auto start = std::chrono::steady_clock::now();
                if (fields_too) {
                    live.upload(scene.mask_views());
                    live.distance(d);
                }
                live.carve(inputs, c, progress);
                live.render(camera(scene.bounds, frame), o);
                if (frame >= 3) ms.push_back(1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
            }
            std::printf("%d: %scarve and render, picture home: %.2f ms, %.0f frames a second\n", side, fields_too ? "masks up, fields, " : "", median_of(ms),
                        1e3 / median_of(ms));
        }
    }
}

void bench_filter(const test::PackedScene& scene, const std::array<int, 3>& grid, Progress& progress) {
    Device device;
    const auto surface = make_surface(device, scene, grid, progress);
    std::printf("%u leaves\n", surface->tree().leafCount());
    for (const char* chain : {"median:1", "laplacian:1x2", "gaussian:1", "edge-preserving:2", "edge-preserving:2x2"}) {
        FilterOptions o;
        o.steps = parse_filters(chain);
        std::map<std::string, std::vector<double>> steps;
        for (int run = 0; run < 8; ++run) {
            device.set_surface(*surface);
            device.clear_times();
            const auto start = std::chrono::steady_clock::now();
            device.filter(o, progress);
            device.extract_mesh(false);
            device.wait();
            const double wall = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
            if (run == 0) continue;
            for (const auto& [name, ms] : device.milliseconds()) steps[name].push_back(ms);
            steps["wall, filter and mesh"].push_back(wall);
        }
        std::printf("%s\n", chain);
        print_medians(steps);
    }
}

/// Medians of five runs, the first thrown away.
void bench_fair(const test::PackedScene& scene, const std::array<int, 3>& grid, Progress& progress) {
    Device device;
    const auto hull = make_surface(device, scene, grid, progress);
    std::vector<FairView> views;
    for (size_t v = 0; v < scene.cameras.size(); ++v) views.push_back({scene.cameras[v], scene.mask_views()[v]});
    std::map<std::string, std::vector<double>> steps;
    for (int run = 0; run < 6; ++run) {
        device.clear_times();
        auto since = [start = std::chrono::steady_clock::now()]() mutable {
            const auto now = std::chrono::steady_clock::now();
            return std::chrono::duration<double, std::milli>(now - std::exchange(start, now)).count();
        };
        const FairResult made = device.fair(*hull, views, {}, progress);
        const double wall = since();
        slack(*hull, *made.surface);
        const double rest = since();
        if (run == 0) continue;
        for (const auto& [name, ms] : device.milliseconds()) steps[name].push_back(ms);
        for (size_t l = 0; l < made.level_seconds.size(); ++l) steps["wall, level " + std::to_string(l)].push_back(1e3 * made.level_seconds[l]);
        steps["wall, fair"].push_back(wall);
        steps["wall, slack"].push_back(rest);
    }
    std::printf("%u leaves\n", hull->tree().leafCount());
    print_medians(steps);
}

int run(const std::vector<std::string>& words) {
    Progress progress;
    progress.on_note = [](const std::string& note) { std::cerr << note << "\n"; };
    const std::string what = words.empty() ? "" : words[0];
    BenchOptions o;
    if (what == "add" && words.size() == 3) {  // here too, where there is no device
        bench_add(test::read_packed_scene(words[1]), std::stoi(words[2]), progress);
        return 0;
    }
    o.backend = choose_backend(Backend::Cuda, 0);
    o.cpu = false;
    if (what == "paper" && words.size() == 2) {
        o.cpu = o.single_thread = true;
        o.cases = paper_cases();
        const BenchResult result = run_bench(o, progress);
        std::ofstream(words[1]) << bench_svg(result, false);
        std::ofstream(words[1].substr(0, words[1].rfind('.')) + "_views.svg") << bench_svg(result, true);
        std::ofstream(words[1].substr(0, words[1].rfind('.')) + ".json") << bench_json(result);
        std::cout << bench_paper_table(result) << "\n" << bench_table(result);
    } else if (what == "sizes") {
        o.cases.clear();
        o.dense_limit_bytes = size_t{9} << 30;
        for (const int views : {18, 36, 72})
            for (const int side : {512, 1024, 2048, 4096}) o.cases.push_back({{side, side / 2, side}, views});
        std::cout << bench_table(run_bench(o, progress));
    } else if (what == "scene" && words.size() >= 3) {
        o.scene = [&](int views) { return packed(words[1], views); };
        o.cases.clear();
        const auto views = static_cast<int>(test::read_packed_scene(words[1]).cameras.size());
        for (size_t n = 2; n < words.size(); ++n) o.cases.push_back({grid_of(words[n]), views});
        std::cout << bench_table(run_bench(o, progress));
    } else if (what == "hull" && words.size() == 4) {
        openvdb::initialize();
        const test::PackedScene scene = test::read_packed_scene(words[1]);
        const std::vector<MaskView> masks = scene.mask_views();
        std::vector<CarveInput> inputs = scene.inputs();
        CarveOptions c;
        c.bounds_world = scene.bounds;
        c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / std::stoi(words[2]);
        const FieldPlan plan = plan_fields(scene.cameras, c);
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        openvdb::FloatGrid::Ptr hull;
        if (std::getenv("VDBCARVE_ON_CPU")) {
            const auto fields = distance_fields(masks, d, progress);
            for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
            hull = carve(inputs, c, progress).hull;
        } else {
            Device device;
            device.upload(masks);
            device.distance(d);
            device.carve(inputs, c, progress);
            hull = device.hull();
        }
        VdbMetadata metadata;
        metadata.voxel_size = c.lattice.voxel_size;
        write_vdb(words[3], {hull}, metadata);
    } else if (what == "color" && words.size() == 3) {
        bench_color(test::read_packed_scene(words[1]), grid_of(words[2]), progress);
    } else if (what == "filter" && words.size() == 3) {
        bench_filter(test::read_packed_scene(words[1]), grid_of(words[2]), progress);
    } else if (what == "fair" && words.size() == 3) {
        bench_fair(test::read_packed_scene(words[1]), grid_of(words[2]), progress);
    } else if (what == "render" && words.size() == 3) {
        bench_render(test::read_packed_scene(words[1]), grid_of(words[2]), progress);
    } else if (what == "ceilings") {
        const test::DeviceCeilings c = test::measure_ceilings();
        std::printf("copy within the device %.0f GB/s (read + written), upload %.1f GB/s, separate float operations %.0f G warp instructions/s\n", c.copy_gb_s,
                    c.upload_gb_s, c.instructions_g_s);
    } else if (what == "once" && words.size() == 2) {
        o.cases = {{grid_of(words[1]), 36}};
        o.dense = false;
        std::cout << bench_table(run_bench(o, progress));
    } else {
        std::cerr << "usage: paper FILE.svg | sizes | scene FOLDER GRID… | hull FOLDER N FILE | color FOLDER GRID | filter FOLDER GRID | fair FOLDER GRID | "
                     "render FOLDER GRID | "
                     "add FOLDER N | ceilings | once GRID\n";
        return 2;
    }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return run({argv + 1, argv + argc});
    } catch (const Error& e) {
        std::fprintf(stderr, "vdbcarve_device_bench: %s\n", e.what());
        return static_cast<int>(e.code());
    }
}
