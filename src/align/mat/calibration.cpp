// SPDX-License-Identifier: Apache-2.0
#include "align/mat/calibration.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "base/statistics.h"
#include "vdbcarve/error.h"

namespace vdbcarve::mat {

std::vector<double> errors_of(const Calibration& c, size_t index, const Seen& s) {
    std::vector<cv::Point2f> projected;
    cv::projectPoints(s.world_m, c.rvecs[index], c.tvecs[index], c.k, c.distortion, projected);
    std::vector<double> out;
    for (size_t k = 0; k < projected.size(); ++k) out.push_back(std::hypot(projected[k].x - s.image_px[k].x, projected[k].y - s.image_px[k].y));
    return out;
}

Calibrator::Calibrator(const Views& views, const AlignOptions& o)
    : intrinsics_(views.views.front().camera.intrinsics), size_(intrinsics_.width_px, intrinsics_.height_px) {
    focal_px_ = o.fov_deg > 0 ? 0.5 * size_.width / std::tan(o.fov_deg * std::numbers::pi / 360) : intrinsics_.fx > 0 ? intrinsics_.fx : 0;
    centre_ = o.principal_point_px.value_or(intrinsics_.fx > 0 ? Vec2d(intrinsics_.cx, intrinsics_.cy) : Vec2d(0.5 * size_.width, 0.5 * size_.height));
    centre_known_ = o.principal_point_px.has_value();
    calibrated_ = views.posed;
}

int Calibrator::flags_of(const LensRung& rung) const {
    return rung.fixed | cv::CALIB_USE_INTRINSIC_GUESS | (centre_known_ ? static_cast<int>(cv::CALIB_FIX_PRINCIPAL_POINT) : 0);
}

Calibration Calibrator::fit(const std::vector<Seen>& seen, const LensRung& rung) const {
    Calibration out;
    const double f = focal_px_ > 0 ? focal_px_ : 1.2 * std::max(size_.width, size_.height);
    out.k = (cv::Mat_<double>(3, 3) << f, 0, centre_.x(), 0, f, centre_.y(), 0, 0, 1);
    out.distortion = cv::Mat::zeros(1, 5, CV_64F);
    std::vector<std::vector<cv::Point3f>> world;
    std::vector<std::vector<cv::Point2f>> image;
    for (const Seen& s : seen) world.push_back(s.world_m), image.push_back(s.image_px);
    if (calibrated_) {
        out.k = (cv::Mat_<double>(3, 3) << intrinsics_.fx, 0, intrinsics_.cx, 0, intrinsics_.fy, intrinsics_.cy, 0, 0, 1);
        out.rvecs.resize(seen.size());
        out.tvecs.resize(seen.size());
    } else {
        cv::Mat sd, unused, errors;
        if (focal_px_ == 0) {  // what the plane's homographies say; their principal point is half a pixel off, and is not taken
            const double found = cv::initCameraMatrix2D(world, image, size_, 1).at<double>(0, 0);
            if (std::isfinite(found) && found > 0.2 * size_.width && found < 50 * size_.width) out.k.at<double>(0, 0) = out.k.at<double>(1, 1) = found;
        }
        const double found = cv::calibrateCamera(world, image, size_, out.k, out.distortion, out.rvecs, out.tvecs, sd, unused, errors, flags_of(rung),
                                                 {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-10});
        if (!std::isfinite(found))
            throw UndeterminedError("--method mat: the camera cannot be calibrated from these views of the mat. Remedy: --fov, and views from several heights");
        out.focal_sd_px = std::max(sd.at<double>(0), sd.at<double>(1));  // one of them is tied to the other
    }
    // A plane seen from afar has two places that look almost alike: the better one, for every view.
    for (size_t i = 0; i < seen.size(); ++i) {
        std::vector<cv::Mat> rs, ts;
        cv::solvePnPGeneric(world[i], image[i], out.k, out.distortion, rs, ts, false, cv::SOLVEPNP_IPPE);
        double best = std::numeric_limits<double>::infinity();
        if (!calibrated_) best = rms(errors_of(out, i, seen[i]));
        for (size_t s = 0; s < rs.size(); ++s) {
            Calibration c = out;
            cv::solvePnPRefineLM(world[i], image[i], out.k, out.distortion, rs[s], ts[s]);
            c.rvecs[i] = rs[s], c.tvecs[i] = ts[s];
            const double e = rms(errors_of(c, i, seen[i]));
            if (e < 0.99 * best) best = e, out.rvecs[i] = rs[s], out.tvecs[i] = ts[s];
        }
    }
    return out;
}

void set_print(std::vector<Seen>& seen, const Print& print) {
    for (Seen& s : seen)
        for (size_t k = 0; k < s.layout_m.size(); ++k)
            if (const auto at = print.find({s.layout_m[k].x, s.layout_m[k].y}); at != print.end()) s.world_m[k] = at->second;
}

void bundle(Calibration& c, std::vector<Seen>& seen, std::optional<int> lens_flags, Print* print) {
    // Reads better whole: what a residual adds to each block of the normal equations, and what the blocks are solved for, belong together.
    constexpr double kCorner_px = 0.3, kInPlane_m = 0.001, kOffPlane_m = 0.005;
    std::map<std::pair<float, float>, int> corner_of;
    if (print)
        for (const Seen& s : seen)
            for (const cv::Point3f& p : s.layout_m) corner_of.try_emplace({p.x, p.y}, 0);
    // Of the lens f, cx, cy, k1, k2, as calibrateCamera() would free them.
    std::vector<int> free_lens;
    if (lens_flags) {
        free_lens = {0};
        if (!(*lens_flags & cv::CALIB_FIX_PRINCIPAL_POINT)) free_lens.insert(free_lens.end(), {1, 2});
        if (!(*lens_flags & cv::CALIB_FIX_K1)) free_lens.push_back(3);
        if (!(*lens_flags & cv::CALIB_FIX_K2)) free_lens.push_back(4);
    }
    const int poses = static_cast<int>(6 * seen.size()), lens = static_cast<int>(free_lens.size());
    int size = poses + lens;
    for (auto& [key, at] : corner_of) at = size, size += 3;
    double last = std::numeric_limits<double>::infinity(), damping = 1e-6, observations = 0;
    for (const Seen& s : seen) observations += 2.0 * static_cast<double>(s.groups.size());
    Calibration best = c.copy();
    Print best_print = print ? *print : Print();
    Eigen::MatrixXd best_h;
    Eigen::VectorXd best_g;
    int rejected = 0;
    for (int iteration = 0; iteration < 30; ++iteration) {
        Eigen::MatrixXd h = Eigen::MatrixXd::Zero(size, size);
        Eigen::VectorXd g = Eigen::VectorXd::Zero(size);
        double cost = 0;
        for (size_t i = 0; i < seen.size(); ++i) {
            cv::Mat jacobian, rotation;
            std::vector<cv::Point2f> projected;
            cv::projectPoints(seen[i].world_m, c.rvecs[i], c.tvecs[i], c.k, c.distortion, projected, jacobian);
            cv::Rodrigues(c.rvecs[i], rotation);
            for (size_t k = 0; k < projected.size(); ++k) {
                const double dx = projected[k].x - seen[i].image_px[k].x, dy = projected[k].y - seen[i].image_px[k].y;
                const double off = std::hypot(dx, dy) / kCorner_px, weight = (off < 3 ? 1 : 3 / off) / (kCorner_px * kCorner_px);  // Huber's
                cost += weight * (dx * dx + dy * dy);
                std::vector<int> at;
                std::vector<Vec2d> by;
                const auto column = [&](int from) {
                    return Vec2d(jacobian.at<double>(static_cast<int>(2 * k), from), jacobian.at<double>(static_cast<int>(2 * k + 1), from));
                };
                for (int q = 0; q < 6; ++q) at.push_back(static_cast<int>(6 * i) + q), by.push_back(column(q));
                for (int q = 0; q < lens; ++q) {
                    const int which = free_lens[static_cast<size_t>(q)];
                    at.push_back(poses + q), by.push_back(which == 0 ? column(6) + column(7) : column(7 + which));
                }
                if (print) {
                    const int first = corner_of.at({seen[i].layout_m[k].x, seen[i].layout_m[k].y});
                    for (int q = 0; q < 3; ++q) {
                        Vec2d sum = Vec2d::Zero();
                        for (int r = 0; r < 3; ++r) sum += rotation.at<double>(r, q) * column(3 + r);  // as the translation moves it
                        at.push_back(first + q), by.push_back(sum);
                    }
                }
                for (size_t p = 0; p < at.size(); ++p) {
                    g[at[p]] += weight * by[p].dot(Vec2d(dx, dy));
                    for (size_t q = 0; q < at.size(); ++q) h(at[p], at[q]) += weight * by[p].dot(by[q]);
                }
            }
        }
        if (print)
            for (const auto& [key, first] : corner_of) {
                const cv::Point3f now = print->count(key) ? print->at(key) : cv::Point3f(key.first, key.second, 0);
                const double off[3] = {now.x - key.first, now.y - key.second, now.z}, sigma[3] = {kInPlane_m, kInPlane_m, kOffPlane_m};
                for (int q = 0; q < 3; ++q) {
                    h(first + q, first + q) += 1 / (sigma[q] * sigma[q]);
                    g[first + q] += off[q] / (sigma[q] * sigma[q]);
                    cost += off[q] * off[q] / (sigma[q] * sigma[q]);
                }
            }
        if (!(cost < last)) {  // the last step was none
            c = best.copy();
            if (print) *print = best_print, set_print(seen, *print);
            if (++rejected > 3) break;
            damping *= 30;
        } else {
            const bool settled = cost > (1 - 1e-5) * last && iteration > 4;
            last = cost, best_h = h, best_g = g;
            if (lens > 0) {
                const double freedom = std::max(1.0, observations - size),
                             variance = h.ldlt().solve(Eigen::VectorXd::Unit(size, poses))[poses] * std::max(1.0, cost / freedom);
                c.focal_sd_px = variance > 0 ? std::sqrt(variance) : 0;
            }
            best = c.copy();
            if (print) best_print = *print;
            if (settled) break;
            damping *= 0.3;
        }
        h = best_h, g = best_g;
        Eigen::MatrixXd damped = h;
        damped.diagonal() *= 1 + damping;
        const Eigen::VectorXd step = -damped.ldlt().solve(g);
        for (size_t i = 0; i < seen.size(); ++i)
            for (int q = 0; q < 3; ++q) {
                c.rvecs[i].at<double>(q) += step[static_cast<Eigen::Index>(6 * i) + q];
                c.tvecs[i].at<double>(q) += step[static_cast<Eigen::Index>(6 * i) + 3 + q];
            }
        for (int q = 0; q < lens; ++q) {
            const int which = free_lens[static_cast<size_t>(q)];
            const double by = step[poses + q];
            if (which == 0) c.k.at<double>(0, 0) += by, c.k.at<double>(1, 1) += by;
            else if (which < 3) c.k.at<double>(which - 1, 2) += by;
            else c.distortion.at<double>(which - 3) += by;
        }
        if (!print) continue;
        for (const auto& [key, first] : corner_of) {
            cv::Point3f& at = print->try_emplace(key, cv::Point3f(key.first, key.second, 0)).first->second;
            at.x += static_cast<float>(step[first]), at.y += static_cast<float>(step[first + 1]), at.z += static_cast<float>(step[first + 2]);
        }
        set_print(seen, *print);
    }
    c = best;
    if (print) *print = best_print, set_print(seen, *print);
}

}  // namespace vdbcarve::mat
