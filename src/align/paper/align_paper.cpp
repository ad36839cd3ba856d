// SPDX-License-Identifier: Apache-2.0
#include "align/paper/align_paper.h"

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/core/optim.hpp>
#include <opencv2/imgproc.hpp>

#include "image/opencv_image.h"
#include "base/statistics.h"
#include "base/text.h"
#include "views/view_called.h"
#include "vdbcarve/error.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {
namespace {

constexpr int kObject_px = 90;                     ///< of the object's longer side in the small pictures that are compared
constexpr int kSide_px = 160;                      ///< of those pictures
constexpr int kTurns = 360;                        ///< simulated views
constexpr int kModel_vox = 80;                     ///< height of the model
constexpr double kLeastStep = 0.3, kMostStep = 2;  ///< of the mean: what the path may advance from view to view

/// A silhouette around its own middle, one bit a pixel, and where it was.
struct Small {
    static constexpr int kWords = (kSide_px + 63) / 64;
    std::array<uint64_t, static_cast<size_t>(kSide_px) * kWords> bits{};
    Image8 grey;
    double x_px = 0, y_px = 0;  ///< of its middle (of the area in x, of the box in y) in the small picture it came from
};

/// With `a` moved by whole pixels.
double iou_of(const Small& a, const Small& b, int dx = 0, int dy = 0) {
    size_t both = 0, either = 0;
    for (int y = 0; y < kSide_px; ++y) {
        const int from = y - dy;
        std::array<uint64_t, Small::kWords> row{};
        if (from >= 0 && from < kSide_px)
            for (int w = 0; w < Small::kWords; ++w) {
                const uint64_t* r = &a.bits[static_cast<size_t>(from) * Small::kWords];
                const auto n = static_cast<unsigned>(std::abs(dx));
                if (n == 0) row[static_cast<size_t>(w)] = r[w];
                else if (dx > 0) row[static_cast<size_t>(w)] = (r[w] << n) | (w > 0 ? r[w - 1] >> (64 - n) : 0);
                else row[static_cast<size_t>(w)] = (r[w] >> n) | (w + 1 < Small::kWords ? r[w + 1] << (64 - n) : 0);
            }
        for (int w = 0; w < Small::kWords; ++w) {
            const uint64_t other = b.bits[static_cast<size_t>(y) * Small::kWords + static_cast<size_t>(w)];
            both += static_cast<size_t>(std::popcount(row[static_cast<size_t>(w)] & other));
            either += static_cast<size_t>(std::popcount(row[static_cast<size_t>(w)] | other));
        }
    }
    return either ? static_cast<double>(both) / static_cast<double>(either) : 0;
}

/// `picture` turned by an angle about (x, y), which comes to the middle.
Small small_of(const cv::Mat& picture, double x, double y, double roll_rad = 0) {
    Small out;
    const double c = std::cos(roll_rad), s = std::sin(roll_rad), middle = 0.5 * kSide_px - 0.5;
    // From the small picture to the other.
    const cv::Mat back = (cv::Mat_<double>(2, 3) << c, s, x - 0.5 - c * middle - s * middle, -s, c, y - 0.5 + s * middle - c * middle);
    cv::Mat grey;
    cv::warpAffine(picture, grey, back, {kSide_px, kSide_px}, cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
    out.grey = io::unwrap(grey);
    for (int v = 0; v < kSide_px; ++v)
        for (int u = 0; u < kSide_px; ++u)
            if (out.grey.at(u, v) >= 128) out.bits[static_cast<size_t>(v) * Small::kWords + static_cast<size_t>(u / 64)] |= uint64_t{1} << (u % 64);
    out.x_px = x, out.y_px = y;
    return out;
}

/// The camera that looks at the model, by what is fitted: everything is in units of the model's height.
struct Virtual {
    double ln_size = 0;      ///< pixels of one unit at the axis, in small pictures
    double ln_distance = 0;  ///< of the camera from the axis
    double elevation = 0, yaw = 0, roll = 0;

    double focal_px() const { return std::exp(ln_size + ln_distance); }
    Camera camera(double azimuth) const {
        Camera c;
        Intrinsics& k = c.intrinsics;
        k.fx = k.fy = focal_px();
        k.width_px = k.height_px = kPicture_px;
        k.cx = k.cy = 0.5 * kPicture_px;
        OrbitView v;
        v.width_px = v.height_px = kPicture_px;
        v.focal_px = k.fx, v.cx = k.cx, v.cy = k.cy, v.azimuth_rad = azimuth + yaw;
        OrbitModel m({v}, 1);
        m.ring(0, OrbitModel::Elevation).value = elevation;
        m.ring(0, OrbitModel::RingDistance).value = ln_distance;
        m.ring(0, OrbitModel::RingRoll).value = roll;
        return m.camera(0).camera(kPicture_px, kPicture_px);
    }
    static constexpr int kPicture_px = 240;  ///< room for a model off the axis

    /// What it sees, around its middle; nothing where it sees nothing.
    std::optional<Small> look(const Mesh& model, double azimuth) const {
        const Image8 seen = silhouette_of(model, camera(azimuth));
        const Silhouettes::Extent e = Silhouettes::extent_of(seen.view());
        if (e.size() <= 0) return std::nullopt;
        return small_of(io::wrap(seen.view()), e.cx, e.cy);
    }
};

/// The solid whose front and side are the two silhouettes: a place is inside where both are (step 1).
Mesh model_of(const Small& front, const Small& side, double side_sign) {
    // Heights of both run from the upper to the lower end of their own boxes.
    const Silhouettes::Extent front_box = Silhouettes::extent_of(front.grey.view()), side_box = Silhouettes::extent_of(side.grey.view());
    const double voxel = 1.0 / kModel_vox;
    openvdb::initialize();
    const openvdb::MaskGrid::Ptr grid = openvdb::MaskGrid::create();
    grid->setTransform(openvdb::math::Transform::createLinearTransform(voxel));
    auto access = grid->getAccessor();
    const int reach = kModel_vox;  // voxels from the axis
    const double front_px = front_box.y1 - front_box.y0, side_px = side_box.y1 - side_box.y0;
    const auto inside = [](const Small& s, double x, double y) {
        const int u = static_cast<int>(std::floor(x)), v = static_cast<int>(std::floor(y));
        return u >= 0 && v >= 0 && u < kSide_px && v < kSide_px && s.grey.at(u, v) >= 128;
    };
    for (int k = 0; k < kModel_vox; ++k) {
        const double down = (kModel_vox - k - 0.5) * voxel;  // 0 at the top, 1 at the foot
        std::vector<int> columns, depths;
        for (int a = -reach; a < reach; ++a) {
            // The camera at azimuth 0 stands on +x and has +y to its right; the one a quarter on, in the direction of `side_sign`, has -+x to its right.
            if (inside(front, 0.5 * kSide_px + (a + 0.5) * voxel * front_px, front_box.y0 + down * front_px)) columns.push_back(a);
            if (inside(side, 0.5 * kSide_px - side_sign * (a + 0.5) * voxel * side_px, side_box.y0 + down * side_px)) depths.push_back(a);
        }
        for (int x : depths)
            for (int y : columns) access.setValueOn(openvdb::Coord(x, y, k - kModel_vox / 2));
    }
    if (grid->activeVoxelCount() == 0)
        throw InputError("--method paper: the two views have nothing in common. Remedy: --paper-views A,B, of the front and of a quarter turn on");
    Progress quiet;
    return extract_mesh(*level_set_of_occupancy(*grid, {}, quiet), {.mesher = Mesher::MarchingCubes}, quiet);
}

/// Distance, field of view, pitch, yaw and roll for which the model looks like the two views it was made of (step 2), by Nelder and Mead's simplex.
struct FitTwo : cv::MinProblemSolver::Function {
    const Mesh& model;
    const Small &front, &side;
    double quarter;  ///< azimuth from front to side, rad

    FitTwo(const Mesh& m, const Small& f, const Small& s, double q) : model(m), front(f), side(s), quarter(q) {}
    int getDims() const override { return 5; }
    static Virtual at(const double* x) { return {x[0], x[1], x[2], x[3], x[4]}; }
    double calc(const double* x) const override {
        const Virtual v = at(x);
        if (v.ln_distance < 0.2 || v.ln_distance > 4 || std::fabs(v.elevation) > 1.2) return 2;
        const auto a = v.look(model, 0), b = v.look(model, quarter);
        return a && b ? 1 - 0.5 * (iou_of(*a, front) + iou_of(*b, side)) : 2;
    }
};

/// A silhouette's energies, and the best moves.
struct Match {
    double energy = 1;
    int dx = 0, dy = 0, roll = 0;
};
constexpr double kRollStep_rad = 2 * kRadians;
constexpr int kRolls = 2, kShift_px = 2;

/// Monotone path of least energy through the map (step 4): from view to view it advances by kLeastStep to kMostStep of the mean; a closed one comes back to its
/// start after a whole turn. Columns by view, unwrapped.
std::vector<int> path_through(const std::vector<std::vector<Match>>& energy, double mean_step, bool closed, double& cost) {
    const int n = static_cast<int>(energy.size()), least = std::max(1, static_cast<int>(std::floor(kLeastStep * mean_step))),
              most = std::max(least + 1, static_cast<int>(std::ceil(kMostStep * mean_step)));
    const int length = (n - 1) * most + 1;
    const auto at = [&](int view, int column) { return energy[static_cast<size_t>(view)][static_cast<size_t>(column % kTurns)].energy; };
    cost = std::numeric_limits<double>::infinity();
    std::vector<int> best;
    std::vector<double> before(static_cast<size_t>(length)), now(static_cast<size_t>(length));
    std::vector<std::vector<int>> step(static_cast<size_t>(n), std::vector<int>(static_cast<size_t>(length), 0));
    for (int start = 0; start < kTurns; ++start) {
        std::fill(before.begin(), before.end(), std::numeric_limits<double>::infinity());
        before[0] = at(0, start);
        for (int i = 1; i < n; ++i) {
            std::fill(now.begin(), now.end(), std::numeric_limits<double>::infinity());
            for (int k = i * least; k <= std::min(i * most, length - 1); ++k) {
                int from = -1;
                for (int s = least; s <= most && s <= k; ++s)
                    if (before[static_cast<size_t>(k - s)] < now[static_cast<size_t>(k)])
                        now[static_cast<size_t>(k)] = before[static_cast<size_t>(k - s)], from = s;
                if (from < 0) continue;
                now[static_cast<size_t>(k)] += at(i, start + k);
                step[static_cast<size_t>(i)][static_cast<size_t>(k)] = from;
            }
            std::swap(before, now);
        }
        for (int k = 0; k < length; ++k) {
            if (closed && (kTurns - k < least || kTurns - k > most)) continue;
            if (!(before[static_cast<size_t>(k)] < cost)) continue;
            cost = before[static_cast<size_t>(k)];
            best.assign(static_cast<size_t>(n), 0);
            for (int i = n - 1, c = k; i >= 0; --i) {
                best[static_cast<size_t>(i)] = start + c;
                c -= step[static_cast<size_t>(i)][static_cast<size_t>(c)];
            }
        }
    }
    cost /= n;
    return best;
}

/// Moves `a` onto `b`: shift and roll of least squared difference of the blurred pictures (Lucas and Kanade 1981), from a start (step 5).
void register_onto(const Small& a, const Small& b, double& dx, double& dy, double& roll) {
    cv::Mat from, onto;
    cv::GaussianBlur(io::wrap(a.grey.view()), from, {}, 2);
    cv::GaussianBlur(io::wrap(b.grey.view()), onto, {}, 2);
    const double middle = 0.5 * kSide_px - 0.5;
    for (int iteration = 0; iteration < 12; ++iteration) {
        const double c = std::cos(roll), s = std::sin(roll);
        // moved(x) = from(R' (x - middle - shift) + middle)
        const cv::Mat back =
            (cv::Mat_<double>(2, 3) << c, s, middle - c * (middle + dx) - s * (middle + dy), -s, c, middle + s * (middle + dx) - c * (middle + dy));
        cv::Mat moved, gx, gy;
        cv::warpAffine(from, moved, back, from.size(), cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
        moved.convertTo(moved, CV_32F);
        cv::Sobel(moved, gx, CV_32F, 1, 0, 3, 1 / 8.0);
        cv::Sobel(moved, gy, CV_32F, 0, 1, 3, 1 / 8.0);
        Mat3d h = Mat3d::Identity() * 1e-3;
        Vec3d g = Vec3d::Zero();
        for (int y = 0; y < kSide_px; ++y)
            for (int x = 0; x < kSide_px; ++x) {
                const double u = gx.at<float>(y, x), v = gy.at<float>(y, x);
                if (u == 0 && v == 0) continue;
                const double px = x - middle - dx, py = y - middle - dy;
                const Vec3d j(-u, -v, u * py - v * px);  // by dx, dy, roll
                h += j * j.transpose();
                g += j * (moved.at<float>(y, x) - onto.at<uint8_t>(y, x));
            }
        const Vec3d step = h.ldlt().solve(g);
        dx -= step[0], dy -= step[1], roll -= step[2];
        if (step.head<2>().norm() < 0.01 && std::fabs(step[2]) < 1e-4) break;
    }
}

Image8 picture_of(const std::vector<std::vector<Match>>& energy, const std::vector<int>& path) {
    const int n = static_cast<int>(energy.size()), row = std::clamp(480 / n, 2, 16), column = 2;
    Image8 out(kTurns * column, n * row, 3);
    double least = 1, most = 0;
    for (const auto& line : energy)
        for (const Match& m : line) least = std::min(least, m.energy), most = std::max(most, m.energy);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            const double e = energy[static_cast<size_t>(y / row)][static_cast<size_t>(x / column)].energy;
            const auto grey = static_cast<uint8_t>(std::lround(255 * std::clamp((e - least) / std::max(most - least, 1e-9), 0.0, 1.0)));
            const int at = ((path[static_cast<size_t>(y / row)]) % kTurns + kTurns) % kTurns;
            const bool on = x / column == at;
            out.at(x, y, 0) = on ? 255 : grey, out.at(x, y, 1) = out.at(x, y, 2) = on ? 0 : grey;
        }
    return out;
}

}  // namespace

std::array<size_t, 2> paper_views(const Views& views, const Silhouettes& silhouettes, const std::vector<OrbitView>& nominal,
                                  const std::array<std::string, 2>& wanted) {
    std::array<size_t, 2> out{silhouettes.seen().front(), 0};
    for (size_t w = 0; w < 2; ++w) {
        if (wanted[w].empty()) continue;
        out[w] = view_called(views, wanted[w], "--paper-views");
        if (!std::count(silhouettes.seen().begin(), silhouettes.seen().end(), out[w])) throw UsageError("--paper-views: " + wanted[w] + " has no silhouette");
    }
    if (!wanted[1].empty()) {
        if (out[0] == out[1]) throw UsageError("--paper-views: " + wanted[1] + " is both front and side");
        return out;
    }
    const double from = nominal[out[0]].azimuth_rad;
    out[1] = *std::min_element(silhouettes.seen().begin(), silhouettes.seen().end(), [&](size_t a, size_t b) {
        const auto off = [&](size_t i) { return std::fabs(std::fabs(nominal[i].azimuth_rad - from) - 90 * kRadians); };
        return off(a) < off(b);
    });
    return out;
}

PaperFit fit_like_the_paper(const std::vector<MaskView>& masks, const Silhouettes& silhouettes, const std::vector<OrbitView>& nominal,
                            std::array<size_t, 2> two, Progress& progress) {
    // Reads better whole: one step after the other, numbered as in the paper, each with what the ones before it made.
    const std::vector<size_t>& seen = silhouettes.seen();
    const double shrink = kObject_px / silhouettes.size_px();
    // Silhouettes in small pictures, each around its own middle.
    std::vector<cv::Mat> pictures(masks.size());
    std::vector<Small> views(masks.size());
    tbb::parallel_for(size_t{0}, seen.size(), [&](size_t s) {
        const size_t i = seen[s];
        cv::resize(io::wrap(masks[i].coverage), pictures[i], {}, shrink, shrink, cv::INTER_AREA);
        const Silhouettes::Extent e = Silhouettes::extent_of(io::unwrap(pictures[i]).view());
        if (e.size() > 0) views[i] = small_of(pictures[i], e.cx, e.cy);
    });
    const double first_azimuth = nominal[two[0]].azimuth_rad, quarter_sign = nominal[two[1]].azimuth_rad >= first_azimuth ? 1 : -1;
    const Mesh model = model_of(views[two[0]], views[two[1]], quarter_sign);
    progress.check();
    PaperFit out;
    // Step 2.
    Virtual eye;
    {
        const auto solver = cv::DownhillSolver::create(cv::makePtr<FitTwo>(model, views[two[0]], views[two[1]], quarter_sign * 90 * kRadians));
        cv::Mat x = (cv::Mat_<double>(1, 5) << std::log(kObject_px), 1.2, 0.1, 0, 0);
        solver->setInitStep(cv::Mat((cv::Mat_<double>(1, 5) << 0.1, 0.4, 0.15, 0.1, 0.05)));
        solver->setTermCriteria({cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 160, 1e-4});
        const double cost = solver->minimize(x);
        out.model_iou = 1 - cost;
        eye = FitTwo::at(x.ptr<double>());
    }
    progress.check();
    progress.detail(text_of("paper: model of two views agrees with them by IoU %.3f; distance %.2f heights, elevation %.1f, yaw %.1f, roll %.1f degrees",
                            out.model_iou, std::exp(eye.ln_distance), eye.elevation / kRadians, eye.yaw / kRadians, eye.roll / kRadians));
    // Step 3: the simulated sequence, turning as the object did, and its likeness to every view.
    const double sign = nominal.back().azimuth_rad >= nominal.front().azimuth_rad ? 1 : -1;
    std::vector<std::optional<Small>> simulated(kTurns);
    tbb::parallel_for(size_t{0}, simulated.size(),
                      [&](size_t k) { simulated[k] = eye.look(model, sign * static_cast<double>(k) * 2 * std::numbers::pi / kTurns); });
    std::vector<std::vector<Match>> energy(seen.size(), std::vector<Match>(kTurns));
    tbb::parallel_for(size_t{0}, seen.size(), [&](size_t s) {
        const size_t i = seen[s];
        for (int roll = -kRolls; roll <= kRolls; ++roll) {
            const Small turned = small_of(pictures[i], views[i].x_px, views[i].y_px, -roll * kRollStep_rad);
            for (size_t k = 0; k < kTurns; ++k) {
                if (!simulated[k]) continue;
                Match& m = energy[s][k];
                for (int dy = -kShift_px; dy <= kShift_px; ++dy)
                    for (int dx = -kShift_px; dx <= kShift_px; ++dx) {
                        const double e = 1 - iou_of(turned, *simulated[k], dx, dy);
                        if (e < m.energy) m = {e, dx, dy, roll};
                    }
            }
        }
    });
    progress.check();
    // Step 4.
    const double span = std::fabs(nominal[seen.back()].azimuth_rad - nominal[seen.front()].azimuth_rad) / kRadians,
                 mean_step = span / static_cast<double>(seen.size() - 1);
    const bool closed = std::fabs(span + mean_step - 360) < 1e-6;
    const std::vector<int> path = path_through(energy, mean_step * kTurns / 360, closed, out.path_energy);
    if (path.empty())
        throw UndeterminedError(
            text_of("--method paper: no path of steps of %.1f to %.1f degrees leads once around through %zu views. Remedy: --arc, or --method coherence",
                    kLeastStep * mean_step, kMostStep * mean_step, seen.size()));
    out.energy_map = picture_of(energy, path);
    // Step 5, and cameras: what moved the picture turns the camera.
    std::vector<OrbitView> places = nominal;
    const double focal = eye.focal_px() / shrink;
    for (OrbitView& v : places) v.focal_px = focal, v.azimuth_rad = 0;
    OrbitModel& m = out.model = OrbitModel(places, 1);
    m.ring(0, OrbitModel::Elevation).value = eye.elevation;
    for (size_t s = 0; s < seen.size(); ++s) {
        const size_t i = seen[s];
        const auto k = static_cast<size_t>(path[s] % kTurns);
        const Match& match = energy[s][k];
        // Between the columns: the parabola through three energies.
        const double left = energy[s][(k + kTurns - 1) % kTurns].energy, right = energy[s][(k + 1) % kTurns].energy, bend = left + right - 2 * match.energy;
        const double between = bend > 1e-9 ? std::clamp(0.5 * (left - right) / bend, -0.5, 0.5) : 0;
        m.of(i, OrbitModel::Azimuth).value = sign * (path[s] + between) * 2 * std::numbers::pi / kTurns + eye.yaw;
        double dx = match.dx, dy = match.dy, roll = match.roll * kRollStep_rad;
        if (!simulated[k]) continue;
        register_onto(views[i], *simulated[k], dx, dy, roll);
        // The view is the simulated picture turned back by `roll` and moved back; the origin's image moves with it.
        const double half = 0.5 * Virtual::kPicture_px;
        const Vec2d origin = Vec2d(half, half) - Vec2d(simulated[k]->x_px, simulated[k]->y_px);  // from the simulated silhouette's middle
        const double c = std::cos(-roll), t = std::sin(-roll);
        const Vec2d moved = origin - Vec2d(dx, dy);
        const Vec2d here = Vec2d(views[i].x_px, views[i].y_px) + Vec2d(c * moved.x() - t * moved.y(), t * moved.x() + c * moved.y());
        const double lean = eye.roll - roll;
        const Vec2d at = here / shrink - Vec2d(places[i].cx, places[i].cy);
        const Vec2d upright(std::cos(lean) * at.x() + std::sin(lean) * at.y(), -std::sin(lean) * at.x() + std::cos(lean) * at.y());
        m.of(i, OrbitModel::Pan).value = std::atan2(upright.x(), focal);
        m.of(i, OrbitModel::Tilt).value = -std::atan2(upright.y(), focal);
        m.of(i, OrbitModel::Roll).value = lean;
    }
    return out;
}

}  // namespace vdbcarve
