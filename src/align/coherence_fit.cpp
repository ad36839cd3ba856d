// SPDX-License-Identifier: Apache-2.0
#include "align/coherence_fit.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>
#include <random>
#include <set>
#include <utility>

#include "base/statistics.h"

namespace vdbcarve {
namespace {

double huber_cost(double r, double limit) { return r <= 0 ? 0 : r < limit ? r * r : limit * (2 * r - limit); }
double huber_weight(double r, double limit) { return r <= 0 ? 0 : r < limit ? 1 : limit / r; }

/// `count` of the points, without repetition.
std::vector<ContourPoint> drawn(std::vector<ContourPoint> all, size_t count, uint64_t seed) {
    std::mt19937_64 random(seed);
    const size_t kept = std::min(count, all.size());
    for (size_t k = 0; k < kept; ++k) std::swap(all[k], all[k + random() % (all.size() - k)]);
    all.resize(kept);
    return all;
}

/// What a line of sight costs that no other view says anything about: without a price, cameras that look past the object would be the best of all.
constexpr double kUnseen_px = 100;

// ------------------------------------------------------------------------------------- features

/// Derivatives of a place's image: by the camera's directions, and by the place.
struct ImageOfPlace {
    Vec2d px;
    Eigen::Matrix<double, 2, kCameraDirections> by_camera;
    Eigen::Matrix<double, 2, 3> by_place;
    double depth = 0;
};
ImageOfPlace image_of(const OrbitCamera& c, const Vec3d& place) {
    const Vec3d q = c.camera_from_world * (place - c.centre);
    ImageOfPlace out;
    out.depth = q.z();
    const double fy = c.fx * c.aspect, x = q.x() / q.z(), y = q.y() / q.z();
    out.px = {c.fx * x + c.cx, fy * y + c.cy};
    Eigen::Matrix<double, 2, 3> by_q;
    by_q << c.fx / q.z(), 0, -c.fx * x / q.z(), 0, fy / q.z(), -fy * y / q.z();
    Mat3d cross;
    cross << 0, -q.z(), q.y(), q.z(), 0, -q.x(), -q.y(), q.x(), 0;
    out.by_camera.block<2, 3>(0, kTurn) = -by_q * cross;
    out.by_place = by_q * c.camera_from_world;
    out.by_camera.block<2, 3>(0, kCentre) = -out.by_place;
    out.by_camera.col(kLnFocal) = Vec2d(c.fx * x, fy * y);
    out.by_camera.col(kCentreX) = Vec2d(1, 0);
    out.by_camera.col(kCentreY) = Vec2d(0, 1);
    return out;
}

}  // namespace

double track_cost(const CoherenceFit& f, const CoherencePass& pass) {
    if (!f.tracks) return 0;
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    std::vector<double> costs(f.tracks->size());
    tbb::parallel_for(size_t{0}, costs.size(), [&](size_t t) {
        const TrackedPlace at = place_of(cameras, (*f.tracks)[t]);
        for (const Vec2d& r : at.residuals_px) costs[t] += huber_cost(at.in_front ? r.norm() : kUnseen_px, pass.track_huber_px);
    });
    double sum = 0;
    for (double c : costs) sum += c;
    return sum / square(pass.track_sigma_px);
}

TrackNormal normal_of_tracks(const CoherenceFit& f, const CoherencePass& pass, size_t size) {
    TrackNormal out;
    if (!f.tracks) return out;
    out.curvature = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(size), static_cast<Eigen::Index>(size));
    out.gradient = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(size));
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    const auto columns = f.model.columns();
    struct Reduced {
        std::vector<int> parameters;
        Eigen::MatrixXd curvature;
        Eigen::VectorXd gradient;
        double cost = 0;
    };
    std::vector<Reduced> all(f.tracks->size());
    tbb::parallel_for(size_t{0}, all.size(), [&](size_t t) {
        const FeatureTrack& track = (*f.tracks)[t];
        const TrackedPlace at = place_of(cameras, track);
        if (!at.in_front) return;
        Reduced& r = all[t];
        std::set<int> which;
        for (const Sighting& s : track.sightings)
            for (const CameraColumn& c : columns[static_cast<size_t>(s.view)]) which.insert(c.parameter);
        r.parameters.assign(which.begin(), which.end());
        const auto rows = static_cast<Eigen::Index>(2 * track.sightings.size());
        Eigen::MatrixXd by = Eigen::MatrixXd::Zero(rows, static_cast<Eigen::Index>(r.parameters.size()));
        Eigen::MatrixX3d by_place(rows, 3);
        Eigen::VectorXd residual(rows);
        for (size_t k = 0; k < track.sightings.size(); ++k) {
            const auto view = static_cast<size_t>(track.sightings[k].view);
            const ImageOfPlace image = image_of(cameras[view], at.place);
            const double weight = std::sqrt(huber_weight(at.residuals_px[k].norm(), pass.track_huber_px)) / pass.track_sigma_px;
            const auto row = static_cast<Eigen::Index>(2 * k);
            residual.segment<2>(row) = weight * at.residuals_px[k];
            by_place.block<2, 3>(row, 0) = weight * image.by_place;
            for (const CameraColumn& c : columns[view]) {
                const auto column = std::lower_bound(r.parameters.begin(), r.parameters.end(), c.parameter) - r.parameters.begin();
                for (int d = 0; d < kCameraDirections; ++d)
                    by.block<2, 1>(row, column) += weight * c.direction[static_cast<size_t>(d)] * image.by_camera.col(d);
            }
        }
        const Eigen::MatrixXd q = Eigen::HouseholderQR<Eigen::MatrixXd>(by_place).householderQ();
        const Eigen::MatrixXd across = q.rightCols(rows - 3).transpose();
        const Eigen::MatrixXd reduced = across * by;
        const Eigen::VectorXd left = across * residual;
        r.curvature = reduced.transpose() * reduced;
        r.gradient = reduced.transpose() * left;
        r.cost = left.squaredNorm();
    });
    for (const Reduced& r : all)
        for (size_t k = 0; k < r.parameters.size(); ++k) {
            out.gradient[r.parameters[k]] += r.gradient[static_cast<Eigen::Index>(k)];
            for (size_t l = 0; l < r.parameters.size(); ++l)
                out.curvature(r.parameters[k], r.parameters[l]) += r.curvature(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(l));
        }
    // So that the prediction agrees with the cost at x = 0, Huber's linear parts included.
    out.cost = track_cost(f, pass);
    return out;
}

namespace {

// ------------------------------------------------------------------------------------- silhouettes

double cost_of(const CoherenceFit& f, const CoherencePass& pass) {
    double sum = 0;
    for (const Touch& t : f.touches) sum += huber_cost(std::isnan(t.residual_px) ? kUnseen_px : t.residual_px, pass.huber_px);
    return sum / square(pass.sigma_px) + f.model.prior_cost() + track_cost(f, pass);
}

/// A residual near the present state: the least over the line of sight of the largest of its supports, whose distances change with the free
/// parameters.
struct Row {
    double residual_px = 0;
    double reach = 0;  ///< along the line, within which the supports' tangents are believed
    std::vector<double> values, slopes;
    std::vector<int> parameters;
    std::vector<double> by;  ///< supports x parameters

    /// Distances of the supports after a step.
    void values_after(const Eigen::VectorXd& step, std::vector<double>& out) const {
        out = values;
        for (size_t s = 0; s < values.size(); ++s)
            for (size_t k = 0; k < parameters.size(); ++k) out[s] += by[s * parameters.size() + k] * step[parameters[k]];
    }
    double residual_after(const Minimax& held, const std::vector<double>& moved) const { return moved[held.first] + slopes[held.first] * held.t; }
};

std::vector<Row> rows_of(const CoherenceFit& f, const std::vector<CoherenceView>& views, const CoherencePass& pass) {
    const std::vector<OrbitCamera> cameras = f.model.cameras();
    const auto columns = f.model.columns();
    std::vector<Row> rows(f.points.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, f.points.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t p = range.begin(); p != range.end(); ++p) {
            Row& row = rows[p];
            row.residual_px = f.touches[p].residual_px;
            if (std::isnan(row.residual_px) || row.residual_px <= -pass.margin_px) continue;
            const std::vector<Support> supports = supports_of(views, cameras, f.points[p], f.touches[p], pass.support_px, 8, pass.misses);
            const auto add = [&](size_t support, const double* by_camera, size_t camera) {
                for (const CameraColumn& column : columns[camera]) {
                    double sum = 0;
                    for (int d = 0; d < kCameraDirections; ++d) sum += by_camera[d] * column.direction[static_cast<size_t>(d)];
                    const auto at = static_cast<size_t>(std::find(row.parameters.begin(), row.parameters.end(), column.parameter) - row.parameters.begin());
                    row.by[support * row.parameters.size() + at] += sum;
                }
            };
            std::set<int> which;
            for (const CameraColumn& column : columns[static_cast<size_t>(f.points[p].view)]) which.insert(column.parameter);
            for (const Support& s : supports)
                for (const CameraColumn& column : columns[static_cast<size_t>(s.view)]) which.insert(column.parameter);
            row.parameters.assign(which.begin(), which.end());
            row.by.assign(supports.size() * which.size(), 0);
            double steepest = 0;
            for (size_t s = 0; s < supports.size(); ++s) {
                row.values.push_back(supports[s].distance_px);
                row.slopes.push_back(supports[s].slope);
                steepest = std::max(steepest, std::fabs(supports[s].slope));
                add(s, supports[s].by_own, static_cast<size_t>(f.points[p].view));
                add(s, supports[s].by_view, static_cast<size_t>(supports[s].view));
            }
            row.reach = steepest > 0 ? 2 * pass.support_px / steepest : 0;
        }
    });
    return rows;
}

/// Cost where supports change as their derivatives say and parameters are those of `moved`.
double predicted_cost(const std::vector<Row>& rows, const TrackNormal& tracks, const Eigen::VectorXd& step, const OrbitModel& moved,
                      const CoherencePass& pass) {
    double sum = 0;
    std::vector<double> values;
    for (const Row& row : rows) {
        if (std::isnan(row.residual_px)) sum += huber_cost(kUnseen_px, pass.huber_px);
        if (row.values.empty()) continue;
        row.values_after(step, values);
        sum += huber_cost(row.residual_after(minimax(values.data(), row.slopes.data(), values.size(), row.reach), values), pass.huber_px);
    }
    return sum / square(pass.sigma_px) + moved.prior_cost() + tracks.after(step);
}

OrbitModel stepped(const OrbitModel& model, const std::vector<size_t>& free, const Eigen::VectorXd& step) {
    OrbitModel out = model;
    for (size_t c = 0; c < free.size(); ++c) out.at(free[c]).value += step[static_cast<Eigen::Index>(c)];
    return out;
}

/// The rows' normal equations where supports hold them after a step: curvature x = right (lower triangle), and what the rows cost there.
struct RowNormal {
    Eigen::MatrixXd curvature;
    Eigen::VectorXd right;
    double cost = 0;
};

void add_rows(RowNormal& out, const Row* begin, const Row* end, const Eigen::VectorXd& x, const CoherencePass& pass) {
    const double weight = 1 / square(pass.sigma_px);
    std::vector<double> values;
    std::vector<std::pair<int, double>> line;
    for (const Row* row = begin; row != end; ++row) {
        if (row->values.empty()) continue;
        row->values_after(x, values);
        const Minimax held = minimax(values.data(), row->slopes.data(), values.size(), row->reach);
        const double r = row->residual_after(held, values);
        out.cost += huber_cost(r, pass.huber_px) * weight;
        const double w = huber_weight(r, pass.huber_px) * weight;
        if (w == 0) continue;
        const size_t n = row->parameters.size();
        line.clear();
        double start = r;  // of the row at x = 0
        for (size_t k = 0; k < n; ++k) {
            const double by = held.share * row->by[held.first * n + k] + (1 - held.share) * row->by[held.second * n + k];
            if (by == 0) continue;
            line.emplace_back(row->parameters[k], by);
            start -= by * x[row->parameters[k]];
        }
        for (size_t k = 0; k < line.size(); ++k) {
            const double wk = w * line[k].second;
            for (size_t l = 0; l <= k; ++l) out.curvature(line[k].first, line[l].first) += wk * line[l].second;  // parameters ascend
            out.right[line[k].first] -= wk * start;
        }
    }
}

/// Solves symmetric positive systems that resemble each other: conjugate gradients with the factor of an earlier one as preconditioner, which a step's turns
/// and the steps of a pass share; where it has aged, factored anew. (Of 200 views, 1200 unknowns, a factor takes fifty times as long as an iteration.)
class SimilarSystems {
  public:
    /// a x = b, of a the lower triangle.
    Eigen::VectorXd solve(const Eigen::MatrixXd& a, const Eigen::VectorXd& b) {
        constexpr int kMostIterations = 20;  // then a new factor costs less
        constexpr double kResidual = 1e-10;
        if (usable_ && factor_.rows() == a.rows()) {
            Eigen::VectorXd x = factor_.solve(b), r = b - a.selfadjointView<Eigen::Lower>() * x, z = factor_.solve(r), p = z;
            double rz = r.dot(z);
            for (int i = 0; i < kMostIterations; ++i) {
                if (r.norm() <= kResidual * b.norm()) return x;
                const Eigen::VectorXd ap = a.selfadjointView<Eigen::Lower>() * p;
                const double curved = p.dot(ap);
                if (!(curved > 0) || !std::isfinite(rz)) break;
                x += rz / curved * p;
                r -= rz / curved * ap;
                z = factor_.solve(r);
                const double before = std::exchange(rz, r.dot(z));
                p = z + rz / before * p;
            }
        }
        factor_.compute(a);
        usable_ = factor_.info() == Eigen::Success;
        return factor_.solve(b);
    }

  private:
    Eigen::LLT<Eigen::MatrixXd> factor_;
    bool usable_ = false;
};

/// What steps of one pass use again and again.
struct StepSpace {
    static constexpr size_t kParts = 4;  ///< of the rows, summed in this order whatever the number of threads
    std::array<RowNormal, kParts> parts;
    SimilarSystems systems;
};

/// Minimum of the cost as rows predict it, damped: Newton's method on which supports hold each residual, and on which residuals count. (Taking the
/// ones of the present state for granted makes steps too long: they are then rejected, and the optimisation creeps.)
Eigen::VectorXd step_of(const std::vector<Row>& rows, const TrackNormal& tracks, const OrbitModel& model, const std::vector<size_t>& free,
                        const CoherencePass& pass, double damping, StepSpace& space) {
    constexpr size_t kParts = StepSpace::kParts;
    auto& parts = space.parts;
    const auto size = static_cast<Eigen::Index>(free.size());
    Eigen::VectorXd x = Eigen::VectorXd::Zero(size), best = x, diagonal;
    double least = std::numeric_limits<double>::infinity();
    for (int turn = 0; turn < pass.turns; ++turn) {
        tbb::parallel_for(size_t{0}, kParts, [&](size_t p) {
            parts[p].curvature.setZero(size, size);
            parts[p].right.setZero(size);
            parts[p].cost = 0;
            add_rows(parts[p], rows.data() + rows.size() * p / kParts, rows.data() + rows.size() * (p + 1) / kParts, x, pass);
        });
        Eigen::MatrixXd& a = parts[0].curvature;
        Eigen::VectorXd& b = parts[0].right;
        double cost = parts[0].cost + tracks.after(x);
        for (size_t p = 1; p < kParts; ++p) a += parts[p].curvature, b += parts[p].right, cost += parts[p].cost;
        if (tracks.curvature.size() > 0) a += tracks.curvature, b -= tracks.gradient;
        for (Eigen::Index c = 0; c < size; ++c) {
            const Parameter& q = model.at(free[static_cast<size_t>(c)]);
            a(c, c) += 1 / square(q.sigma);
            b[c] -= (q.value - q.mean) / square(q.sigma);
        }
        if (turn == 0) diagonal = a.diagonal();
        const OrbitModel moved = stepped(model, free, x);
        cost += moved.prior_cost() + damping * x.cwiseAbs2().dot(diagonal);
        if (cost < least) least = cost, best = x;
        else if (turn > 2) break;
        a.diagonal() += damping * diagonal;
        const Eigen::VectorXd next = space.systems.solve(a, b);
        if (pass.turns == 1) return next;
        const bool settled = (next - x).norm() < 0.01 * next.norm();
        x = turn < 2 ? next : (0.5 * (x + next)).eval();
        if (settled) return x;
    }
    return best;
}

}  // namespace

std::vector<double> CoherenceFit::outside_px() const {
    std::vector<double> out;
    for (const Touch& t : touches)
        if (!std::isnan(t.residual_px)) out.push_back(std::max(0.0, t.residual_px));
    if (2 * out.size() < touches.size()) out.assign(1, std::numeric_limits<double>::infinity());
    return out;
}

double CoherenceFit::rms_px() const { return rms(outside_px()); }

double CoherenceFit::typical_px() const {
    std::vector<double> all = outside_px();
    std::sort(all.begin(), all.end());
    all.resize(all.size() - all.size() * 15 / 100);
    return rms(all);
}

Silhouettes::Extent Silhouettes::extent_of(ImageView<uint8_t> m) {
    Silhouettes::Extent e{1e9, 1e9, -1e9, -1e9, 0, 0};
    double sum = 0, moment = 0;
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x)
            if (kernel::is_object(m.at(x, y))) {
                e.x0 = std::min<double>(e.x0, x), e.x1 = std::max<double>(e.x1, x + 1);
                e.y0 = std::min<double>(e.y0, y), e.y1 = std::max<double>(e.y1, y + 1);
                sum += 1, moment += x + 0.5;
            }
    if (sum > 0) e.cx = moment / sum, e.cy = 0.5 * (e.y0 + e.y1);
    return e;
}

Silhouettes::Silhouettes(const std::vector<MaskView>& masks) : masks_(masks), extents_(masks.size()), bad_(masks.size(), false), views_(masks.size()) {
    std::vector<double> sizes;
    for (size_t i = 0; i < masks.size(); ++i) {
        if (masks[i].coverage.empty()) continue;
        views_[i].width_px = masks[i].coverage.width;
        views_[i].height_px = masks[i].coverage.height;
        extents_[i] = extent_of(masks[i].coverage);
        if (extents_[i].size() <= 0) continue;
        seen_.push_back(i);
        sizes.push_back(extents_[i].size());
        find_open_sides(masks[i], views_[i]);
    }
    size_px_ = median(sizes);
}

std::vector<size_t> Silhouettes::good() const {
    std::vector<size_t> out;
    std::copy_if(seen_.begin(), seen_.end(), std::back_inserter(out), [&](size_t i) { return !bad_[i]; });
    return out;
}

const std::vector<DistanceField>& Silhouettes::fields(int scale) {
    auto& out = fields_[scale];
    if (out.empty()) {
        DistanceOptions d;
        d.scale = scale;
        // Coarse fields reach far enough that a camera half an object off is still led back; fine ones are asked about details.
        d.reach_samples = size_px_ / scale < 160 ? 96 : 64;
        Progress quiet;
        out = distance_fields(masks_, d, quiet);
    }
    return out;
}

const std::vector<CoherenceView>& Silhouettes::at_scale(int scale) {
    const auto& all = fields(scale);
    for (size_t i = 0; i < count(); ++i) views_[i].field = masks_[i].coverage.empty() || bad_[i] ? nullptr : &all[i];
    return views_;
}

std::vector<ContourPoint> Silhouettes::contour(int scale, size_t count, uint64_t seed, int sectors, Which which) {
    auto& contours = contours_[scale];
    if (contours.empty()) {
        const auto& all = fields(scale);
        contours.resize(masks_.size());
        tbb::parallel_for(size_t{0}, seen_.size(), [&](size_t s) {
            CoherenceView view = views_[seen_[s]];
            view.field = &all[seen_[s]];
            contours[seen_[s]] = contour_of(view, static_cast<int>(seen_[s]));
        });
    }
    std::vector<ContourPoint> out;
    for (size_t i : seen_) {
        if (which != Which::All && bad_[i] != (which == Which::Bad)) continue;
        std::vector<ContourPoint> some = drawn(contours[i], sectors ? 2 * count : count, seed * 0x9e3779b97f4a7c15ULL + i);
        if (sectors)
            std::erase_if(some, [&](const ContourPoint& p) {
                const double angle = std::atan2(p.y_px - extents_[i].cy, p.x_px - extents_[i].cx) + std::numbers::pi;
                return (static_cast<int>(angle * (6 / std::numbers::pi)) & 1) != (sectors - 1);
            });
        out.insert(out.end(), some.begin(), some.end());
    }
    return out;
}

double TrackedPlace::rms_px() const {
    double sum = 0;
    for (const Vec2d& r : residuals_px) sum += r.squaredNorm();
    return std::sqrt(sum / static_cast<double>(residuals_px.size()));
}

TrackedPlace place_of(const std::vector<OrbitCamera>& cameras, const FeatureTrack& track) {
    TrackedPlace out;
    out.residuals_px.assign(track.sightings.size(), Vec2d::Zero());
    std::vector<Camera::Ray> rays;
    for (const Sighting& s : track.sightings) {
        const OrbitCamera& c = cameras[static_cast<size_t>(s.view)];
        const Vec3d sight((s.x_px - c.cx) / c.fx, (s.y_px - c.cy) / (c.fx * c.aspect), 1);
        rays.push_back({c.centre, (c.camera_from_world.transpose() * sight).normalized()});
    }
    const auto start = point_nearest_to(rays, 1e-6);
    if (!start) return out;
    out.place = *start;
    for (int iteration = 0; iteration < 4; ++iteration) {
        Mat3d a = Mat3d::Zero();
        Vec3d b = Vec3d::Zero();
        out.in_front = true;
        for (size_t k = 0; k < track.sightings.size(); ++k) {
            const Sighting& s = track.sightings[k];
            const ImageOfPlace image = image_of(cameras[static_cast<size_t>(s.view)], out.place);
            if (!(image.depth > 1e-6)) return out.in_front = false, out;
            out.residuals_px[k] = image.px - Vec2d(s.x_px, s.y_px);
            a += image.by_place.transpose() * image.by_place;
            b += image.by_place.transpose() * out.residuals_px[k];
        }
        if (iteration < 3) out.place -= a.ldlt().solve(b);
    }
    return out;
}

double ball_radius(const Silhouettes& silhouettes, const OrbitModel& m) {
    std::vector<double> radii;
    for (size_t i : silhouettes.seen()) {
        const OrbitCamera c = m.camera(i);
        const double distance = c.centre.norm();
        const Vec3d to_origin = -c.camera_from_world * c.centre / distance;
        const Silhouettes::Extent& e = silhouettes.extent(i);
        double farthest = 0;
        for (const auto& [x, y] : {std::pair{e.x0, e.y0}, {e.x1, e.y0}, {e.x0, e.y1}, {e.x1, e.y1}}) {
            const Vec3d sight = Vec3d((x - c.cx) / c.fx, (y - c.cy) / (c.fx * c.aspect), 1).normalized();
            farthest = std::max(farthest, std::acos(std::clamp(sight.dot(to_origin), -1.0, 1.0)));
        }
        radii.push_back(distance * std::sin(std::min(farthest, 1.2)));
    }
    return std::min(0.9, 1.1 * percentile(radii, 0.9));
}

std::vector<Touch> touches_of(Silhouettes& silhouettes, const OrbitModel& model, const std::vector<ContourPoint>& points, const CoherencePass& pass) {
    return find_touches(silhouettes.at_scale(pass.scale), model.cameras(), points,
                        {ball_radius(silhouettes, model), pass.margin_px, pass.resolution_px, pass.misses}, {});
}

void refine(CoherenceFit& f, Silhouettes& silhouettes, const CoherencePass& pass, Progress& progress) {
    const std::vector<CoherenceView>& views = silhouettes.at_scale(pass.scale);
    f.ball_radius = ball_radius(silhouettes, f.model);
    const SearchOptions search{f.ball_radius, pass.margin_px, pass.resolution_px, pass.misses};
    f.touches = find_touches(views, f.model.cameras(), f.points, search, {});
    f.cost = cost_of(f, pass);
    const std::vector<size_t> free = f.model.free();
    double damping = 1e-3;
    StepSpace space;
    for (int iteration = 0; iteration < pass.iterations; ++iteration) {
        progress.check();
        const std::vector<Row> rows = rows_of(f, views, pass);
        const TrackNormal tracks = normal_of_tracks(f, pass, free.size());
        double gain = 0, grow = 4;
        for (int trial = 0; trial < 6; ++trial, grow *= 2) {
            const Eigen::VectorXd step = step_of(rows, tracks, f.model, free, pass, damping, space);
            CoherenceFit next = f;
            next.model = stepped(f.model, free, step);
            next.touches = find_touches(views, next.model.cameras(), f.points, search, f.touches);
            next.cost = cost_of(next, pass);
            if (!(next.cost < f.cost)) {
                damping *= grow;
                continue;
            }
            // Nielsen's rule: how well the step was predicted says how far the next may go.
            const double predicted = f.cost - predicted_cost(rows, tracks, step, next.model, pass);
            const double quality = (f.cost - next.cost) / std::max(predicted, 1e-12);
            damping = std::max(1e-7, damping * std::clamp(1 - std::pow(2 * quality - 1, 3), 0.1, 4.0));
            gain = (f.cost - next.cost) / f.cost;
            f = std::move(next);
            break;
        }
        if (gain < pass.least_gain || (iteration >= 3 && f.rms_px() > pass.give_up_px)) break;
    }
}

}  // namespace vdbcarve
