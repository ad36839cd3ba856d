// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/statistics.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"

namespace vdbcarve {
namespace {

/// Gauss-Newton on the seven parameters of a similarity: the estimate's cameras, moved by it, see the points where the true ones do.
double reprojection_rms(const std::vector<Camera>& estimate, const std::vector<Camera>& truth, const std::vector<Vec3d>& points,
                        Similarity& truth_from_estimate) {
    const auto inverse = [](const Similarity& s) {
        return Similarity{1 / s.scale, s.rotation.transpose(), -(s.rotation.transpose() * s.translation) / s.scale};
    };
    Similarity estimate_from_truth = inverse(truth_from_estimate);
    double rms = 0;
    for (int iteration = 0; iteration < 8; ++iteration) {
        Eigen::Matrix<double, 7, 7> a = Eigen::Matrix<double, 7, 7>::Zero();
        Eigen::Matrix<double, 7, 1> b = Eigen::Matrix<double, 7, 1>::Zero();
        double sum = 0;
        size_t n = 0;
        for (size_t v = 0; v < truth.size(); ++v)
            for (const Vec3d& p : points) {
                const auto want = truth[v].project(p);
                const Vec3d turned = estimate_from_truth.scale * (estimate_from_truth.rotation * p), moved = turned + estimate_from_truth.translation;
                const auto have = estimate[v].project(moved);
                if (!want || !have) continue;
                const Intrinsics& k = estimate[v].intrinsics;
                const Vec3d x = estimate[v].camera_from_world * moved;
                Eigen::Matrix<double, 2, 3> by_x;
                by_x << k.fx / x.z(), k.skew / x.z(), -(k.fx * x.x() + k.skew * x.y()) / (x.z() * x.z()), 0, k.fy / x.z(), -k.fy * x.y() / (x.z() * x.z());
                Eigen::Matrix<double, 3, 7> by_similarity;
                for (int c = 0; c < 3; ++c) by_similarity.col(c) = Vec3d::Unit(c).cross(turned);
                by_similarity.block<3, 3>(0, 3).setIdentity();
                by_similarity.col(6) = turned;
                const Eigen::Matrix<double, 2, 7> j = by_x * estimate[v].camera_from_world.rotation * by_similarity;
                const Vec2d r = *have - *want;
                a += j.transpose() * j;
                b -= j.transpose() * r;
                sum += r.squaredNorm();
                ++n;
            }
        if (n == 0) return 0;
        rms = std::sqrt(sum / static_cast<double>(n));
        const Eigen::Matrix<double, 7, 1> step = a.ldlt().solve(b);
        const double angle = step.head<3>().norm();
        if (angle > 0) estimate_from_truth.rotation = Eigen::AngleAxisd(angle, step.head<3>() / angle).toRotationMatrix() * estimate_from_truth.rotation;
        estimate_from_truth.translation += step.segment<3>(3);
        estimate_from_truth.scale *= std::exp(step[6]);
        if (step.norm() < 1e-10) break;
    }
    truth_from_estimate = inverse(estimate_from_truth);
    return rms;
}

}  // namespace

CameraErrors compare_cameras(const std::vector<Camera>& estimate, const std::vector<Camera>& truth, const std::vector<Vec3d>& points_truth) {
    if (estimate.size() != truth.size()) throw InputError("cameras: " + std::to_string(estimate.size()) + " are compared with " + std::to_string(truth.size()));
    const size_t n = truth.size();
    if (n < 3) throw UndeterminedError("cameras: at least three are needed for a comparison");
    Mat3d sum = Mat3d::Zero();
    Vec3d mean_estimate = Vec3d::Zero(), mean_truth = Vec3d::Zero();
    std::vector<double> focal;
    for (size_t i = 0; i < n; ++i) {
        sum += truth[i].camera_from_world.rotation.transpose() * estimate[i].camera_from_world.rotation;
        mean_estimate += estimate[i].centre_world() / static_cast<double>(n);
        mean_truth += truth[i].centre_world() / static_cast<double>(n);
        focal.push_back(estimate[i].intrinsics.fx / truth[i].intrinsics.fx);
    }
    CameraErrors out;
    Similarity& s = out.truth_from_estimate;
    s.rotation = nearest_rotation(sum);
    double across = 0, within = 0;
    for (size_t i = 0; i < n; ++i) {
        const Vec3d a = s.rotation * (estimate[i].centre_world() - mean_estimate);
        across += a.dot(truth[i].centre_world() - mean_truth);
        within += a.squaredNorm();
    }
    s.scale = within > 0 ? across / within : 1;
    s.translation = mean_truth - s.scale * (s.rotation * mean_estimate);
    const auto target = look_at_point(truth);
    std::vector<double> distance;
    for (const Camera& c : truth) distance.push_back((c.centre_world() - target.value_or(mean_truth)).norm());
    const double unit = median(distance);
    double rotation = 0, centre = 0;
    for (size_t i = 0; i < n; ++i) {
        const Mat3d difference = estimate[i].camera_from_world.rotation * s.rotation.transpose() * truth[i].camera_from_world.rotation.transpose();
        out.rotation_deg.push_back(Eigen::AngleAxisd(difference).angle() * 180 / std::numbers::pi);
        out.centre.push_back((s * estimate[i].centre_world() - truth[i].centre_world()).norm() / unit);
        rotation += out.rotation_deg.back() * out.rotation_deg.back();
        centre += out.centre.back() * out.centre.back();
    }
    out.rotation_rms_deg = std::sqrt(rotation / static_cast<double>(n));
    out.rotation_max_deg = *std::max_element(out.rotation_deg.begin(), out.rotation_deg.end());
    out.centre_rms = std::sqrt(centre / static_cast<double>(n));
    out.centre_median = median(out.centre);
    out.centre_max = *std::max_element(out.centre.begin(), out.centre.end());
    out.focal_ratio = median(focal);
    if (!points_truth.empty()) out.reprojection_rms_px = reprojection_rms(estimate, truth, points_truth, s);
    return out;
}

}  // namespace vdbcarve
