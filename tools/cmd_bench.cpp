// SPDX-License-Identifier: Apache-2.0
#include <iostream>
#include <map>
#include <memory>
#include <optional>

#include "cli.h"
#include "vdbcarve/app/bench.h"

namespace vdbcarve::cli {
namespace {

struct Raw {
    BenchOptions options;
    std::filesystem::path scene;
    std::vector<std::string> grids;
    std::vector<int> views{36};
    std::string bounds, svg;
    bool paper = false, no_dense = false, carve_only = false, no_cpu = false;
    double dense_limit_gb = 6;
};

std::array<int, 3> grid_of(const std::string& text) {
    const auto g = numbers("--grid", text, 3, 'x');
    for (double d : g)
        if (d < 8 || d > 16384 || d != static_cast<int>(d)) throw UsageError("--grid " + text + ": sides must be whole numbers within 8..16384");
    return {static_cast<int>(g[0]), static_cast<int>(g[1]), static_cast<int>(g[2])};
}

}  // namespace

Command add_bench(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("bench", "how fast this machine carves, against the paper's dense method");
    app->fallthrough();
    app->footer(
        "Examples:\n"
        "  vdbcarve bench                                                           several grids and numbers of views, GPU too where there is one\n"
        "  vdbcarve bench shoot --grid 512x512x512 --svg bench.svg                  on photographs of your own\n"
        "  vdbcarve bench --paper                                                   the paper's table and figure");
    app->add_option("scene", raw->scene, "scene with masks to carve (default: 31 spheres, 1024 x 768)");
    app->add_option("--bounds", raw->bounds, "xmin,ymin,zmin,xmax,ymax,zmax of the scene (default: found from the silhouettes)");
    app->add_option("--grid", raw->grids, "grids, like 512x256x512,1024x512x1024")->delimiter(',');
    CLI::Option* views = app->add_option("--views", raw->views, "numbers of views, like 18,36,72 (default: 36, or all of a scene)")->delimiter(',');
    app->add_option("--runs", raw->options.runs, "medians of so many runs")->capture_default_str()->check(CLI::Range(1, 100));
    app->add_flag("--paper", raw->paper,
                  "the paper's Table 1 (six volumes; CPU with one thread and all, GPU; dense and sparse) and Fig. 8 (over volumes, over views at 512^3); takes "
                  "minutes")
        ->excludes(views)
        ->excludes(app->get_option("--grid"));
    app->add_flag("--no-dense", raw->no_dense, "leave the dense method out");
    app->add_option("--dense-limit", raw->dense_limit_gb, "GB of volume up to which the dense method is run")->capture_default_str();
    app->add_flag("--carve-only", raw->carve_only, "leave level_set and mesh out");
    app->add_flag("--no-cpu", raw->no_cpu, "time the GPU only");
    raw->options.backend = Backend::Auto;
    add_choice(*app, "--backend", raw->options.backend, Words(kBackendWords), "auto (also the GPU where there is one), cpu or cuda");
    app->add_option("--device", raw->options.device, "number of the CUDA device")->capture_default_str()->check(zero_or_more());
    app->add_option("--svg", raw->svg, "also pictures: FILE.svg, seconds over voxels, and FILE_views.svg, over views");
    return {app,
            [raw, views](Common& common, Progress& progress) {
                BenchOptions& o = raw->options;
                std::optional<Box3d> bounds;
                if (!raw->bounds.empty()) {
                    const auto b = numbers("--bounds", raw->bounds, 6);
                    bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
                }
                if (!raw->scene.empty()) o.scene = [&](int count) { return load_bench_scene(raw->scene, bounds, count, progress); };
                if (raw->paper) {
                    o.cases = paper_cases();
                    o.single_thread = true;
                } else {
                    if (raw->grids.empty()) raw->grids = {"512x256x512", "1024x512x1024"};
                    o.cases.clear();
                    if (!raw->scene.empty() && views->count() == 0) raw->views = {0};  // all there are
                    for (const int count : raw->views)
                        for (const std::string& text : raw->grids) o.cases.push_back({grid_of(text), count});
                }
                o.backend = choose_backend(o.backend, o.device);
                o.cpu = !raw->no_cpu;
                if (raw->no_cpu && o.backend == Backend::Cpu)
                    throw UsageError("--no-cpu leaves nothing to time: " + (why_no_cuda().empty() ? "--backend is cpu" : why_no_cuda()));
                o.dense = !raw->no_dense;
                o.dense_limit_bytes = static_cast<size_t>(raw->dense_limit_gb * 1e9);
                o.stages = !raw->carve_only;
                const BenchResult result = run_bench(o, progress);
                if (!raw->svg.empty()) write_bench_svgs(result, raw->svg);
                if (common.json == "-") std::cout << bench_json(result);
                else std::cout << (raw->paper ? bench_paper_table(result) + "\n" : std::string()) << bench_table(result);
                return 0;
            },
            Says::Document};
}

}  // namespace vdbcarve::cli
