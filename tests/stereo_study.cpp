// SPDX-License-Identifier: Apache-2.0
// Stereo with other settings than the usual ones, against the truth: what src/stereo.md's tables are made with.
//
//   vdbcarve_stereo_study FOLDER N [--cpu] [--meshes PREFIX] [name=value,name=value ...]
//
// FOLDER is a packed scene with photographs (tests/pack_scene.cpp), and may hold truth.ply; N the voxels along the longest side. A row for the hull and one for each list of settings ("usual": none changed).
#include <openvdb/openvdb.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <sstream>

#include "support/packed_scene.h"
#include "vdbcarve/backend.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/stereo.h"

namespace {

using namespace vdbcarve;

int median = 0;  ///< passes afterwards

StereoOptions settings(const std::string& list) {
    StereoOptions o;
    median = 0;
    const std::map<std::string, std::function<void(double)>> names{{"pairs", [&](double v) { o.pairs = static_cast<int>(v); }},
                                                                   {"scale", [&](double v) { o.scale = static_cast<int>(v); }},
                                                                   {"levels", [&](double v) { o.levels = static_cast<int>(v); }},
                                                                   {"coarser", [&](double v) { o.coarser_weight = v; }},
                                                                   {"passes", [&](double v) { o.passes = static_cast<int>(v); }},
                                                                   {"least_angle", [&](double v) { o.least_angle_deg = v; }},
                                                                   {"most_angle", [&](double v) { o.most_angle_deg = v; }},
                                                                   {"depth", [&](double v) { o.depth_share = v; }},
                                                                   {"cost", [&](double v) { o.trust.most_cost = v; }},
                                                                   {"contrast", [&](double v) { o.trust.least_contrast = v; }},
                                                                   {"margin", [&](double v) { o.trust.least_margin = v; }},
                                                                   {"agreeing", [&](double v) { o.trust.agreeing = static_cast<int>(v); }},
                                                                   {"agreement", [&](double v) { o.trust.agreement_px = v; }},
                                                                   {"normal", [&](double v) { o.trust.normal_deg = v; }},
                                                                   {"rim", [&](double v) { o.trust.rim_px = v; }},
                                                                   {"reach", [&](double v) { o.reach_share = v; }},
                                                                   {"median", [](double v) { median = static_cast<int>(v); }},
                                                                   {"truncation", [&](double v) { o.truncation_vox = v; }},
                                                                   {"weight", [&](double v) { o.least_weight = v; }}};
    std::istringstream words(list);
    for (std::string word; list != "usual" && std::getline(words, word, ',');) {
        const size_t equals = word.find('=');
        if (equals == std::string::npos || !names.count(word.substr(0, equals))) throw UsageError(word + ": is no setting");
        names.at(word.substr(0, equals))(std::atof(word.c_str() + equals + 1));
    }
    return o;
}

void print_row(const std::string& name, const Mesh& mesh, const Mesh& truth, Progress& progress) {
    std::printf("%-40s", name.c_str());
    if (!truth.triangles.empty()) {
        EvaluateOptions o;
        const Evaluation e = evaluate(mesh, truth, o, progress);
        std::printf(" excess %6.2f %% lost %5.2f %% IoU %.4f | accuracy %.3f p90 %.3f | completeness %.3f, %.1f %% | normals %.1f", 100 * e.volume_excess, 100 * e.truth_lost, e.iou, e.to_truth.mean, e.to_truth.p90, e.from_truth.mean, 100 * e.from_truth.within, e.normal_error_mean_deg);
    }
    std::printf("\n");
    std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 3) return std::fprintf(stderr, "usage: vdbcarve_stereo_study FOLDER N [--cpu] [--meshes PREFIX] [name=value,name=value ...]\n"), 2;
    openvdb::initialize();
    try {
        const std::filesystem::path folder = argv[1];
        const int resolution = std::atoi(argv[2]);
        bool cpu = false;
        std::string meshes;
        std::vector<std::string> lists;
        for (int a = 3; a < argc; ++a) {
            const std::string word = argv[a];
            if (word == "--cpu") cpu = true;
            else if (word == "--meshes" && a + 1 < argc) meshes = argv[++a];
            else lists.push_back(word);
        }
        if (lists.empty()) lists = {"usual"};
        Progress progress;
        const test::PackedScene scene = test::read_packed_scene(folder);
        const Mesh truth = std::filesystem::exists(folder / "truth.ply") ? read_mesh(folder / "truth.ply") : Mesh();
        CarveOptions c;
        c.bounds_world = scene.bounds;
        c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / resolution;
        const FieldPlan plan = plan_fields(scene.cameras, c);
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        const std::vector<DistanceField> fields = distance_fields(scene.mask_views(), d, progress);
        std::vector<CarveInput> inputs = scene.inputs();
        for (size_t v = 0; v < inputs.size(); ++v) inputs[v].field = &fields[v];
        const openvdb::FloatGrid::Ptr surface = level_set(carve(inputs, c, progress).hull, {}, progress);
        print_row("hull", extract_mesh(*surface, {}, progress), truth, progress);
        for (const std::string& list : lists) {
            StereoOptions o = settings(list);
            o.backend = choose_backend(cpu ? Backend::Cpu : Backend::Auto, 0);
            const auto start = std::chrono::steady_clock::now();
            const StereoResult r = stereo(*surface, scene.color_inputs(), {}, o, progress);
            const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
            openvdb::FloatGrid::Ptr result = r.surface;
            if (median) {
                FilterOptions filters;
                filters.steps = parse_filters("median:1x" + std::to_string(median));
                filters.repair_volume = false;
                result = filter(result, filters, progress).surface;
            }
            const Mesh mesh = extract_mesh(*result, {}, progress);
            std::printf("%zu pieces ", component_volumes(*result).size());
            print_row(list, mesh, truth, progress);
            size_t object = 0, matched = 0, trusted = 0;
            for (const StereoViewStatistics& v : r.views) object += v.object_pixels, matched += v.matched_pixels, trusted += v.trusted_pixels;
            std::printf("    %s, scale %d: %zu pixels, %.1f %% matched, %.1f %% trusted; %.3f s:", r.backend_used.c_str(), r.scale, object, 100.0 * static_cast<double>(matched) / static_cast<double>(object), 100.0 * static_cast<double>(trusted) / static_cast<double>(object), seconds);
            for (const auto& [name, ms] : r.milliseconds) std::printf(" %s %.0f", name.c_str(), ms);
            std::printf(" ms\n");
            if (!meshes.empty()) write_mesh(meshes + list + ".ply", mesh);
        }
    } catch (const Error& e) {
        return std::fprintf(stderr, "error: %s\n", e.what()), static_cast<int>(e.code());
    }
    return 0;
}
