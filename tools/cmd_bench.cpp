// SPDX-License-Identifier: Apache-2.0
#include <iostream>
#include <memory>

#include "../src/atomic_file.h"
#include "cli.h"
#include "vdbcarve/bench.h"

namespace vdbcarve::cli {
namespace {

struct Raw {
    BenchOptions options;
    std::vector<std::string> grids;
    std::string bounds, svg;
    bool paper = false, no_dense = false, carve_only = false;
    double dense_limit_gb = 6;
};

}  // namespace

Command add_bench(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("bench", "how fast this machine carves, against the paper's dense method");
    app->fallthrough();
    app->add_option("scene", raw->options.scene, "scene with masks to carve (default: 31 spheres, 1024 x 768)");
    app->add_option("--bounds", raw->bounds, "xmin,ymin,zmin,xmax,ymax,zmax of the scene (default: found from the silhouettes)");
    app->add_option("--grid", raw->grids, "grids, like 512x256x512,1024x512x1024")->delimiter(',');
    app->add_option("--views", raw->options.views, "numbers of views, like 18,36,72")->delimiter(',')->capture_default_str();
    app->add_option("--runs", raw->options.runs, "medians of so many runs")->capture_default_str()->check(CLI::Range(1, 100));
    app->add_flag("--paper", raw->paper, "the paper's sizes: 128 to 1024x512x1024, 36 views");
    app->add_flag("--no-dense", raw->no_dense, "leave the dense method out");
    app->add_option("--dense-limit", raw->dense_limit_gb, "GB of volume up to which the dense method is run")->capture_default_str();
    app->add_flag("--carve-only", raw->carve_only, "leave level_set and mesh out");
    app->add_option("--svg", raw->svg, "also a picture, seconds over voxels (or views)");
    return {app, [raw](Common& common, Progress& progress) {
                BenchOptions& o = raw->options;
                if (!raw->bounds.empty()) {
                    const auto b = numbers("--bounds", raw->bounds, 6);
                    o.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
                }
                if (raw->paper) raw->grids = {"128x128x128", "256x256x256", "512x512x512", "1024x512x1024"};
                if (!raw->grids.empty()) o.grids.clear();
                for (const std::string& text : raw->grids) {
                    const auto g = numbers("--grid", text, 3, 'x');
                    for (double d : g)
                        if (d < 8 || d > 16384 || d != static_cast<int>(d)) throw UsageError("--grid " + text + ": sides must be whole numbers within 8..16384");
                    o.grids.push_back({static_cast<int>(g[0]), static_cast<int>(g[1]), static_cast<int>(g[2])});
                }
                o.dense = !raw->no_dense;
                o.dense_limit_bytes = static_cast<size_t>(raw->dense_limit_gb * 1e9);
                o.stages = !raw->carve_only;
                const BenchResult result = run_bench(o, progress);
                if (!raw->svg.empty()) write_file(raw->svg, bench_svg(result));
                std::cout << (common.json == "-" ? bench_json(result) : bench_table(result));
                return 0;
            }};
}

}  // namespace vdbcarve::cli
