// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>

#include "cli.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/views.h"

namespace vdbcarve::cli {
namespace {

namespace fs = std::filesystem;

struct Raw {
    EvaluateOptions options;
    fs::path mesh, truth, cameras, truth_cameras, points;
    std::string align = "none";
};

std::map<std::string, Vec3d> centres(const fs::path& file, Progress& progress) {
    ViewsOptions o;
    o.scene = fs::is_directory(file) ? file : (file.parent_path().empty() ? fs::path(".") : file.parent_path());
    if (!fs::is_directory(file)) o.cameras = fs::absolute(file);
    o.cameras_only = true;
    const Views views = load_views(o, progress);
    const std::vector<Camera> cameras = views.cameras();
    std::map<std::string, Vec3d> out;
    for (size_t i = 0; i < cameras.size(); ++i) out[fs::path(views.views[i].name).filename().string()] = cameras[i].centre_world();
    return out;
}

Similarity alignment(const Raw& raw, Progress& progress) {
    std::vector<Vec3d> from, to;
    if (raw.align == "cameras") {
        if (raw.cameras.empty() || raw.truth_cameras.empty()) throw UsageError("--align cameras wants --cameras and --truth-cameras");
        const auto a = centres(raw.cameras, progress), b = centres(raw.truth_cameras, progress);
        for (const auto& [name, centre] : a)
            if (const auto other = b.find(name); other != b.end()) {
                from.push_back(centre);
                to.push_back(other->second);
            }
        if (from.size() < 3)
            throw InputError(raw.cameras.string() + " and " + raw.truth_cameras.string() + " share " + std::to_string(from.size()) + " views by file name, at least three are needed");
    } else {
        std::ifstream in(raw.points);
        if (!in) throw InputError(raw.points.string() + ": cannot be opened");
        size_t number = 0;
        for (std::string line; std::getline(in, line);) {
            ++number;
            if (line.empty() || line[0] == '#') continue;
            std::istringstream words(line);
            Vec3d p, q;
            if (!(words >> p[0] >> p[1] >> p[2] >> q[0] >> q[1] >> q[2]))
                throw InputError(raw.points.string() + ": line " + std::to_string(number) + ": six numbers are expected, a point of the mesh and the same point of the truth");
            from.push_back(p);
            to.push_back(q);
        }
    }
    return align_points(from, to);
}

}  // namespace

Command add_evaluate(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("evaluate", "how far a mesh is from the truth: accuracy, completeness, Chamfer, F-score, volume, IoU");
    app->fallthrough();
    app->add_option("mesh", raw->mesh, "mesh, or a result folder")->required();
    app->add_option("--truth", raw->truth, "the true mesh")->required();
    app->add_option("--align", raw->align, "similarity before comparing: none, cameras, points")->capture_default_str()->check(CLI::IsMember({"none", "cameras", "points"}));
    app->add_option("--cameras", raw->cameras, "cameras that belong to the mesh (--align cameras)");
    app->add_option("--truth-cameras", raw->truth_cameras, "the same cameras in the truth's frame");
    app->add_option("--points", raw->points, "text file, six numbers a line: a point of the mesh, the same of the truth (--align points)");
    app->add_option("--threshold", raw->options.threshold, "distance for completeness and F-score (0: 1 % of the truth's largest side)")->check(CLI::NonNegativeNumber);
    app->add_option("--samples", raw->options.samples, "points on each surface")->capture_default_str()->check(CLI::Range(100, 100000000));
    return {app, [raw](Common& common, Progress& progress) {
                if (fs::is_directory(raw->mesh)) raw->mesh /= "mesh.ply";
                if (raw->align != "none") raw->options.align = alignment(*raw, progress);
                const Evaluation e = evaluate(read_mesh(raw->mesh), read_mesh(raw->truth), raw->options, progress);
                if (common.json == "-") {
                    std::cout << evaluation_json(e) << "\n";
                    return 0;
                }
                std::printf("accuracy (mesh to truth)      mean %.6g  median %.6g  90 %% %.6g  max %.6g\n", e.to_truth.mean, e.to_truth.median, e.to_truth.p90, e.to_truth.max);
                std::printf("completeness (truth to mesh)  mean %.6g  median %.6g  90 %% %.6g  max %.6g\n", e.from_truth.mean, e.from_truth.median, e.from_truth.p90, e.from_truth.max);
                std::printf("Chamfer %.6g, Hausdorff 95 %% %.6g, max %.6g\n", e.chamfer, e.hausdorff95, e.hausdorff);
                std::printf("within %.6g: precision %.2f %%, recall %.2f %%, F-score %.2f %%\n", e.threshold, 100 * e.to_truth.within, 100 * e.from_truth.within, 100 * e.f_score);
                std::printf("volume %.6g, truth %.6g, excess %+.2f %%; IoU %.4f, truth lost %.3f %%\n", e.volume, e.truth_volume, 100 * e.volume_excess, e.iou, 100 * e.truth_lost);
                std::printf("normals off by %.2f degrees on average, median %.2f\n", e.normal_error_mean_deg, e.normal_error_median_deg);
                return 0;
            }};
}

}  // namespace vdbcarve::cli
