// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/evaluate.h"

#include <openvdb/openvdb.h>
#include <openvdb/tools/Composite.h>
#include <openvdb/tools/LevelSetMeasure.h>
#include <openvdb/tools/MeshToVolume.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>

#include "mesh/triangle_tree.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

double share(const std::vector<double>& sorted, double s) { return sorted[static_cast<size_t>(s * static_cast<double>(sorted.size() - 1))]; }

SurfaceDistances distances(const std::vector<TriangleTree::Sample>& points, const TriangleTree& to, double threshold, std::vector<double>* angles_deg,
                           const std::function<void(size_t, const TriangleTree::Nearest&)>& visit = {}) {
    std::vector<double> d(points.size());
    if (angles_deg) angles_deg->resize(points.size());
    tbb::parallel_for(size_t{0}, points.size(), [&](size_t n) {
        const TriangleTree::Nearest nearest = to.nearest(points[n].point);
        d[n] = nearest.distance;
        if (visit) visit(n, nearest);
        if (angles_deg) {
            const double cosine = std::clamp(points[n].normal.dot(to.triangle(nearest.triangle).normal().normalized()), -1.0, 1.0);
            (*angles_deg)[n] = std::acos(cosine) * 180 / std::numbers::pi;
        }
    });
    std::sort(d.begin(), d.end());
    SurfaceDistances out;
    double sum = 0, sum2 = 0;
    for (double x : d) {
        sum += x;
        sum2 += x * x;
        out.within += x <= threshold;
    }
    const auto n = static_cast<double>(d.size());
    out.within /= n;
    out.mean = sum / n;
    out.rms = std::sqrt(sum2 / n);
    out.median = share(d, 0.5);
    out.p90 = share(d, 0.9);
    out.p95 = share(d, 0.95);
    out.max = d.back();
    return out;
}

TriangleTree::Place place_of(const Similarity& s) {
    return [s](const Vec3d& p) { return s * p; };
}

openvdb::FloatGrid::Ptr level_set_of(const Mesh& mesh, const Similarity& place, double voxel) {
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    for (const auto& v : mesh.vertices) {
        const Vec3d p = place * Vec3d(v[0], v[1], v[2]);
        points.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()));
    }
    for (const auto& t : mesh.triangles) triangles.emplace_back(t[0], t[1], t[2]);
    return openvdb::tools::meshToLevelSet<openvdb::FloatGrid>(*openvdb::math::Transform::createLinearTransform(voxel), points, triangles, 3.f);
}

}  // namespace

Similarity align_points(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to) {
    if (from.size() != to.size()) throw UsageError("align: " + std::to_string(from.size()) + " points against " + std::to_string(to.size()));
    if (from.size() < 3) throw UndeterminedError("align: " + std::to_string(from.size()) + " pairs of points, at least three are needed");
    Eigen::Matrix3Xd a(3, from.size()), b(3, to.size());
    for (size_t i = 0; i < from.size(); ++i) {
        a.col(static_cast<Eigen::Index>(i)) = from[i];
        b.col(static_cast<Eigen::Index>(i)) = to[i];
    }
    for (const auto& points : {a, b}) {
        const Eigen::Matrix3Xd centred = points.colwise() - points.rowwise().mean();
        const Eigen::Vector3d spread = Eigen::JacobiSVD<Eigen::MatrixXd>(centred * centred.transpose()).singularValues();
        if (!(spread[1] > 1e-9 * spread[0]))
            throw UndeterminedError("align: the points lie on one line (or in one place), so the rotation about it cannot be told");
    }
    const Eigen::Matrix4d m = Eigen::umeyama(a, b, true);
    Similarity out;
    out.scale = std::cbrt(m.topLeftCorner<3, 3>().determinant());
    out.rotation = m.topLeftCorner<3, 3>() / out.scale;
    out.translation = m.topRightCorner<3, 1>();
    return out;
}

Evaluation evaluate(const Mesh& mesh, const Mesh& truth, const EvaluateOptions& options, Progress& progress) {
    if (mesh.triangles.empty()) throw InputError("evaluate: the mesh has no faces");
    if (truth.triangles.empty()) throw InputError("evaluate: the truth has no faces");
    if (options.samples == 0) throw UsageError("evaluate: no samples");
    progress.begin("evaluate", 4);
    Evaluation out;
    out.align = options.align.value_or(Similarity());
    const TriangleTree a(mesh, place_of(out.align)), b(truth);
    out.truth_size = b.box().sizes().maxCoeff();
    out.threshold = options.threshold > 0 ? options.threshold : 0.01 * out.truth_size;
    progress.step();
    std::vector<double> angles;
    const std::vector<TriangleTree::Sample> points = a.samples(options.samples, options.seed);
    std::vector<double> colors(points.size(), -1);
    std::function<void(size_t, const TriangleTree::Nearest&)> compare_colors;
    if (!mesh.colors.empty() && !truth.colors.empty())
        compare_colors = [&](size_t n, const TriangleTree::Nearest& nearest) {
            if (nearest.distance > out.threshold) return;
            const auto color = [](const Mesh& of, const TriangleTree& tree, int triangle, const Vec3d& p) {
                const Vec3d w = tree.triangle(triangle).weights(p);
                std::array<double, 3> c{};
                for (size_t i = 0; i < 3; ++i)
                    for (size_t k = 0; k < 3; ++k) c[i] += w[static_cast<Eigen::Index>(k)] * of.colors[of.triangles[static_cast<size_t>(triangle)][k]][i];
                return lab_from_linear(c);
            };
            colors[n] = ciede2000(color(mesh, a, points[n].triangle, points[n].point),
                                  color(truth, b, nearest.triangle, b.nearest_on(nearest.triangle, points[n].point)));
        };
    out.to_truth = distances(points, b, out.threshold, &angles, compare_colors);
    colors.erase(std::remove(colors.begin(), colors.end(), -1.0), colors.end());
    std::sort(colors.begin(), colors.end());
    out.color_median = out.color_p95 = out.color_mean = NAN;
    if (!colors.empty()) {
        out.color_median = share(colors, 0.5);
        out.color_p95 = share(colors, 0.95);
        out.color_mean = std::accumulate(colors.begin(), colors.end(), 0.0) / static_cast<double>(colors.size());
    }
    progress.step();
    out.from_truth = distances(b.samples(options.samples, options.seed + 1), a, out.threshold, nullptr);
    progress.step();
    std::sort(angles.begin(), angles.end());
    double sum = 0;
    for (double x : angles) sum += x;
    out.normal_error_mean_deg = sum / static_cast<double>(angles.size());
    out.normal_error_median_deg = share(angles, 0.5);
    out.chamfer = 0.5 * (out.to_truth.mean + out.from_truth.mean);
    out.accuracy90 = out.to_truth.p90;
    const double precision = out.to_truth.within, recall = out.from_truth.within;
    out.f_score = precision + recall > 0 ? 2 * precision * recall / (precision + recall) : 0;
    out.hausdorff = std::max(out.to_truth.max, out.from_truth.max);
    out.hausdorff95 = std::max(out.to_truth.p95, out.from_truth.p95);
    const MeshMeasures mesh_measures = measure(mesh), truth_measures = measure(truth);
    out.volume = mesh_measures.volume * std::pow(out.align.scale, 3);
    out.truth_volume = truth_measures.volume;
    out.volume_excess = out.volume / out.truth_volume - 1;
    out.iou = out.truth_lost = NAN;
    if (mesh_measures.boundary_edges == 0 && truth_measures.boundary_edges == 0) {
        openvdb::initialize();
        Eigen::AlignedBox3d both = a.box();
        both.extend(b.box());
        const double voxel = both.sizes().maxCoeff() / options.volume_resolution;
        const auto ga = level_set_of(mesh, out.align, voxel), gb = level_set_of(truth, {}, voxel);
        const auto common = openvdb::tools::csgIntersectionCopy(*ga, *gb), either = openvdb::tools::csgUnionCopy(*ga, *gb);
        const double in_common = common->empty() ? 0 : openvdb::tools::levelSetVolume(*common);
        out.iou = in_common / openvdb::tools::levelSetVolume(*either);
        const double whole = openvdb::tools::levelSetVolume(*gb);
        out.truth_lost = whole > 0 ? std::max(0.0, 1 - in_common / whole) : NAN;
    }
    progress.step();
    return out;
}

std::string evaluation_json(const Evaluation& e) {
    const auto one = [](const SurfaceDistances& d) {
        return nlohmann::ordered_json{{"mean", d.mean}, {"median", d.median},          {"rms", d.rms}, {"p90", d.p90}, {"p95", d.p95},
                                      {"max", d.max},   {"within_threshold", d.within}};
    };
    const auto number = [](double v) { return std::isfinite(v) ? nlohmann::ordered_json(v) : nlohmann::ordered_json(nullptr); };
    std::vector<double> r;
    for (int i = 0; i < 9; ++i) r.push_back(e.align.rotation(i / 3, i % 3));
    const nlohmann::ordered_json j{
        {"chamfer", e.chamfer},
        {"accuracy90", e.accuracy90},
        {"completeness", e.from_truth.within},
        {"precision", e.to_truth.within},
        {"recall", e.from_truth.within},
        {"f_score", e.f_score},
        {"hausdorff", e.hausdorff},
        {"hausdorff95", e.hausdorff95},
        {"volume", e.volume},
        {"truth_volume", e.truth_volume},
        {"volume_excess", e.volume_excess},
        {"iou", number(e.iou)},
        {"truth_lost", number(e.truth_lost)},
        {"normal_error_mean_deg", e.normal_error_mean_deg},
        {"normal_error_median_deg", e.normal_error_median_deg},
        {"threshold", e.threshold},
        {"truth_size", e.truth_size},
        {"color_ciede2000_median", number(e.color_median)},
        {"color_ciede2000_p95", number(e.color_p95)},
        {"color_ciede2000_mean", number(e.color_mean)},
        {"mesh_to_truth", one(e.to_truth)},
        {"truth_to_mesh", one(e.from_truth)},
        {"align", {{"scale", e.align.scale}, {"rotation", r}, {"translation", {e.align.translation.x(), e.align.translation.y(), e.align.translation.z()}}}}};
    return j.dump(1);
}

}  // namespace vdbcarve
