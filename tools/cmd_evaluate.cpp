// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>

#include "cli.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/views.h"

namespace vdbcarve::cli {
namespace {

namespace fs = std::filesystem;

struct Raw {
    EvaluateOptions options;
    fs::path mesh, truth, cameras, truth_cameras, points, photos, save;
    bool from_volume = false;
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
            throw InputError(raw.cameras.string() + " and " + raw.truth_cameras.string() + " share " + std::to_string(from.size()) +
                             " views by file name, at least three are needed");
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
                throw InputError(raw.points.string() + ": line " + std::to_string(number) +
                                 ": six numbers are expected, a point of the mesh and the same point of the truth");
            from.push_back(p);
            to.push_back(q);
        }
    }
    return align_points(from, to);
}

/// Over views used for colouring, or left out of it.
struct PhotoMean {
    size_t views = 0;
    double psnr_db = 0, ssim = 0;
};
PhotoMean mean_of(const std::vector<PhotoComparison>& rows, bool used) {
    PhotoMean m;
    for (const PhotoComparison& r : rows) {
        if (r.used != used || r.agreement.pixels == 0) continue;
        ++m.views;
        m.psnr_db += r.agreement.psnr_db;
        m.ssim += r.agreement.ssim;
    }
    if (m.views) {
        m.psnr_db /= static_cast<double>(m.views);
        m.ssim /= static_cast<double>(m.views);
    }
    return m;
}

void print_photos(const std::vector<PhotoComparison>& rows, bool of_result, bool verbose) {
    for (const bool used : {true, false})
        if (const PhotoMean m = mean_of(rows, used); m.views)
            std::printf("photographs, %zu views %s  PSNR %.2f dB, SSIM %.4f inside the silhouette (means)\n", m.views,
                        !of_result ? ""
                        : used     ? "used for colour    "
                                   : "left out of colour ",
                        m.psnr_db, m.ssim);
    if (!verbose) return;
    for (const PhotoComparison& r : rows)
        std::printf("  %-32s %s  PSNR %6.2f dB  SSIM %.4f  %zu px\n", r.name.c_str(), r.used ? "used    " : "left out", r.agreement.psnr_db, r.agreement.ssim,
                    r.agreement.pixels);
}

nlohmann::ordered_json photos_json(const std::vector<PhotoComparison>& rows) {
    nlohmann::ordered_json views = nlohmann::ordered_json::array(), out;
    for (const PhotoComparison& r : rows)
        views.push_back({{"name", r.name},
                         {"color_used", r.used},
                         {"psnr_db", std::isfinite(r.agreement.psnr_db) ? nlohmann::ordered_json(r.agreement.psnr_db) : nlohmann::ordered_json()},
                         {"ssim", r.agreement.ssim},
                         {"pixels", r.agreement.pixels}});
    for (const bool used : {true, false})
        if (const PhotoMean m = mean_of(rows, used); m.views) out[used ? "used" : "left_out"] = {{"views", m.views}, {"psnr_db", m.psnr_db}, {"ssim", m.ssim}};
    out["views"] = views;
    return out;
}

}  // namespace

Command add_evaluate(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand(
        "evaluate", "how far a mesh is from the truth (accuracy, completeness, Chamfer, F-score, volume, IoU, colour) or its photographs (PSNR, SSIM)");
    app->fallthrough();
    app->add_option("mesh", raw->mesh, "mesh, or a result folder")->required();
    app->add_option("--truth", raw->truth, "the true mesh; with vertex colours, colours are compared too");
    app->add_option("--photos", raw->photos, "a scene: the coloured mesh is rendered into its cameras and compared with its photographs (PSNR, SSIM)");
    app->add_flag("--from-volume", raw->from_volume, "render the colour of volume.vdb instead of the vertices' (--photos)");
    app->add_option("--save", raw->save, "folder for pictures, photograph and rendering side by side (--photos)");
    app->add_option("--align", raw->align, "similarity before comparing: none, cameras, points")
        ->capture_default_str()
        ->check(CLI::IsMember({"none", "cameras", "points"}));
    app->add_option("--cameras", raw->cameras, "cameras that belong to the mesh (--align cameras), or of the photographs (--photos)");
    app->add_option("--truth-cameras", raw->truth_cameras, "the same cameras in the truth's frame");
    app->add_option("--points", raw->points, "text file, six numbers a line: a point of the mesh, the same of the truth (--align points)");
    app->add_option("--threshold", raw->options.threshold, "distance for completeness and F-score (0: 1 % of the truth's largest side)")->check(zero_or_more());
    app->add_option("--samples", raw->options.samples, "points on each surface")->capture_default_str()->check(CLI::Range(100, 100000000));
    app->footer(
        "Examples:\n"
        "  vdbcarve evaluate out --truth shoot/truth.ply                            distances, volume, F-score\n"
        "  vdbcarve evaluate out --truth scan.stl --align cameras --truth-cameras true.json   a scan in a frame of its own\n"
        "  vdbcarve evaluate out --photos shoot --save pairs                        how like its photographs it is");
    return {app,
            [raw](Common& common, Progress& progress) {
                if (raw->truth.empty() && raw->photos.empty()) throw UsageError("evaluate: give --truth, --photos or both");
                const fs::path result = fs::is_directory(raw->mesh) ? raw->mesh : fs::path();
                require_finished(result);
                const fs::path mesh_file = result.empty() ? raw->mesh : result / "mesh.ply";
                // A result for another program lies in that one's axes and units: back to the scene's.
                const FileFrame frame = frame_from_scene(mesh_file.parent_path(), mesh_file.filename().string());
                if (raw->from_volume && !result.empty() && frame_from_scene(result, "volume.vdb").moves())
                    throw UsageError("--from-volume: the volume was made for another program (--dcc), and lies elsewhere than the cameras");
                const Mesh mesh = in_frame(read_mesh(mesh_file), inverse(frame));
                std::vector<PhotoComparison> photos;
                if (!raw->photos.empty()) {
                    if (mesh.colors.empty() && !raw->from_volume)
                        throw InputError(mesh_file.string() + ": has no vertex colours. Remedy: reconstruct with --color blend, from photographs");
                    ViewsOptions o;
                    o.scene = raw->photos;
                    if (raw->align != "cameras") o.cameras = raw->cameras;
                    photos = compare_photos(mesh, load_views(o, progress), {result, raw->from_volume, raw->save}, progress);
                }
                if (raw->truth.empty()) {
                    if (common.json == "-") std::cout << nlohmann::ordered_json{{"photos", photos_json(photos)}}.dump(1) << "\n";
                    else print_photos(photos, !result.empty(), common.verbose);
                    return 0;
                }
                if (raw->align != "none") raw->options.align = alignment(*raw, progress);
                const Evaluation e = evaluate(mesh, read_mesh(raw->truth), raw->options, progress);
                if (common.json == "-") {
                    auto j = nlohmann::ordered_json::parse(evaluation_json(e));
                    if (!photos.empty()) j["photos"] = photos_json(photos);
                    std::cout << j.dump(1) << "\n";
                    return 0;
                }
                if (raw->align != "none")
                    std::printf("lengths are the truth's; the mesh was brought there by --align %s, scale x%.6g\n", raw->align.c_str(),
                                raw->options.align->scale);
                std::printf("accuracy (mesh to truth)      mean %.6g  median %.6g  90 %% %.6g  max %.6g\n", e.to_truth.mean, e.to_truth.median, e.to_truth.p90,
                            e.to_truth.max);
                std::printf("completeness (truth to mesh)  mean %.6g  median %.6g  90 %% %.6g  max %.6g\n", e.from_truth.mean, e.from_truth.median,
                            e.from_truth.p90, e.from_truth.max);
                std::printf("Chamfer %.6g, Hausdorff 95 %% %.6g, max %.6g\n", e.chamfer, e.hausdorff95, e.hausdorff);
                std::printf("within %.6g: precision %.2f %%, recall %.2f %%, F-score %.2f %%\n", e.threshold, 100 * e.to_truth.within,
                            100 * e.from_truth.within, 100 * e.f_score);
                std::printf("volume %.6g, truth %.6g, excess %+.2f %%; IoU %.4f, truth lost %.3f %%\n", e.volume, e.truth_volume, 100 * e.volume_excess, e.iou,
                            100 * e.truth_lost);
                if (!std::isnan(e.color_median))
                    std::printf("colours off by (CIEDE2000)    mean %.2f  median %.2f  95 %% %.2f\n", e.color_mean, e.color_median, e.color_p95);
                std::printf("normals off by %.2f degrees on average, median %.2f\n", e.normal_error_mean_deg, e.normal_error_median_deg);
                print_photos(photos, !result.empty(), common.verbose);
                return 0;
            },
            Says::Document};
}

}  // namespace vdbcarve::cli
