// SPDX-License-Identifier: Apache-2.0
#include "check/camera_doubts.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "surface/coarse_hull.h"
#include "align/coherence.h"
#include "align/coherence_fit.h"
#include "image/image_io.h"
#include "align/orbit_model.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/error.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {
namespace {

constexpr int kSmall_px = 240;  ///< longer side of the silhouettes that readings are judged with
constexpr int kReadingVoxels = 80;
constexpr size_t kPointsPerView = 60;
constexpr double kOutlier_px = 3;
constexpr double kLeastObject_px = 700;

Camera scaled(Camera c, int width, int height) {
    Intrinsics& k = c.intrinsics;
    const double sx = static_cast<double>(width) / k.width_px, sy = static_cast<double>(height) / k.height_px;
    k.fx *= sx, k.cx *= sx, k.skew *= sx;
    k.fy *= sy, k.cy *= sy;
    k.width_px = width;
    k.height_px = height;
    return c;
}

Image8 mirrored(const Image8& image) { return io::turned(image, 2); }

}  // namespace

std::vector<Reading> readings_of(const std::vector<Camera>& cameras) {
    std::vector<size_t> own(cameras.size());
    std::iota(own.begin(), own.end(), size_t{0});
    std::vector<Reading> out{{"", cameras, own, false, 0}};
    const auto poses = [&](const std::string& words, const auto& change) {
        Reading r{words, cameras, own, false, 0};
        for (Camera& c : r.cameras) c.camera_from_world = change(c.camera_from_world);
        out.push_back(std::move(r));
    };
    const Mat3d flip = Vec3d(1, -1, -1).asDiagonal();
    const auto gl = [&](const Rigid3& p) { return Rigid3{flip * p.rotation, flip * p.translation}; };
    const auto inverse = [](const Rigid3& p) { return p.inverse(); };
    const auto transposed = [](const Rigid3& p) { return Rigid3{p.rotation.transpose(), p.translation}; };
    const auto centred = [](const Rigid3& p) { return Rigid3{p.rotation, -(p.rotation * p.translation)}; };
    poses("with the cameras' y and z axes negated (OpenGL's axes for OpenCV's, or the reverse)", gl);
    poses("inverted (camera to world for world to camera, or the reverse)", inverse);
    poses("inverted (camera to world for world to camera), and with the cameras' y and z axes negated (OpenGL's for OpenCV's)",
          [&](const Rigid3& p) { return gl(p.inverse()); });
    poses("with rotations transposed", transposed);
    poses("with rotations transposed, and the cameras' y and z axes negated", [&](const Rigid3& p) { return gl(transposed(p)); });
    poses("with translations as the cameras' places", centred);
    poses("with translations as the cameras' places, and the cameras' y and z axes negated", [&](const Rigid3& p) {
        return Rigid3{flip * p.rotation, -(flip * p.rotation * p.translation)};
    });
    poses("with rotations transposed, the cameras staying where they are", [](const Rigid3& p) {
        return Rigid3{p.rotation.transpose(), p.rotation.transpose() * (p.rotation.transpose() * p.translation)};
    });
    poses("with rotations transposed before axes are turned, the cameras staying where they are", [&](const Rigid3& p) {
        const Mat3d r = flip * p.rotation.transpose() * flip;
        return Rigid3{r, r * (p.rotation.transpose() * p.translation)};
    });
    const auto lengths = [&](const std::string& words, double factor) {
        Reading r{words, cameras, own, false, 0};
        for (Camera& c : r.cameras) c.intrinsics.fx *= factor, c.intrinsics.fy *= factor;
        out.push_back(std::move(r));
    };
    lengths("with half the focal length", 0.5);
    lengths("with twice the focal length", 2);
    Reading mirror{"with the images mirrored left for right", cameras, own, true, 0};
    for (Camera& c : mirror.cameras) c.intrinsics.cx = c.intrinsics.width_px - c.intrinsics.cx;
    out.push_back(std::move(mirror));
    const auto order = [&](const std::string& words, const auto& which) {
        Reading r{words, cameras, own, false, 0};
        for (size_t i = 0; i < own.size(); ++i) r.silhouette[i] = which(i);
        out.push_back(std::move(r));
    };
    const size_t n = cameras.size();
    order("with the images in reverse order", [&](size_t i) { return n - 1 - i; });
    order("with each camera for the image after its own", [&](size_t i) { return (i + 1) % n; });
    order("with each camera for the image before its own", [&](size_t i) { return (i + n - 1) % n; });
    return out;
}

Vec3d mean_up(const std::vector<Camera>& cameras) {
    Vec3d up = Vec3d::Zero();
    for (const Camera& c : cameras) up -= c.camera_from_world.rotation.row(1).transpose();
    return up.norm() < 0.1 * static_cast<double>(cameras.size()) ? Vec3d::Zero() : Vec3d(up.normalized());
}

std::string axis_near(const Vec3d& up_world) {
    int axis = 0;
    if (up_world.cwiseAbs().maxCoeff(&axis) <= std::cos(20 * kRadians)) return "";
    return (up_world[axis] < 0 ? "-" : "") + std::string(1, "xyz"[axis]);
}

std::string doubt_of_up(const std::vector<Camera>& cameras, const std::string& said) {
    const Vec3d up_world = mean_up(cameras);
    if (said.empty() || up_world.isZero()) return "";
    const double cosine = up_direction(said, cameras).dot(up_world);
    if (cosine > std::cos(45 * kRadians)) return "";
    const std::string guessed = axis_near(up_world);
    return "up is said to be " + said + ", but the cameras stand upright " +
           (guessed.empty() ? text_of("%.0f degrees from it", std::acos(std::clamp(cosine, -1.0, 1.0)) / kRadians) : "along " + guessed) +
           ". Remedy: " + (guessed.empty() ? "--up, as it is meant" : "--up " + guessed);
}

void judge(std::vector<Reading>& readings, const std::vector<MaskView>& masks, Progress& progress) {
    std::vector<Image8> small(masks.size()), turned(masks.size());
    tbb::parallel_for(size_t{0}, masks.size(), [&](size_t i) {
        const ImageView<uint8_t>& m = masks[i].coverage;
        if (m.empty()) return;
        const double factor = std::min(1.0, static_cast<double>(kSmall_px) / std::max(m.width, m.height));
        small[i] =
            io::downscale(m, std::max(2, static_cast<int>(std::lround(factor * m.width))), std::max(2, static_cast<int>(std::lround(factor * m.height))));
        turned[i] = mirrored(small[i]);
    });
    progress.begin("readings", readings.size());
    for (Reading& r : readings) {
        progress.step();
        std::vector<std::string> names;
        std::vector<Camera> cameras;
        std::vector<MaskView> seen;
        for (size_t i = 0; i < r.cameras.size(); ++i) {
            const Image8& s = (r.mirrored ? turned : small)[r.silhouette[i]];
            if (s.empty() || masks[i].coverage.empty()) continue;
            names.push_back(std::to_string(i));
            cameras.push_back(scaled(r.cameras[i], s.width, s.height));
            seen.push_back({s.view(), {}});
        }
        try {
            Progress quiet;
            const Mesh mesh = extract_mesh(*coarse_hull(names, cameras, seen, kReadingVoxels, 0.6, quiet), {}, quiet);
            std::vector<double> ious(cameras.size());
            tbb::parallel_for(size_t{0}, cameras.size(), [&](size_t i) { ious[i] = compare_silhouettes(silhouette_of(mesh, cameras[i]), seen[i]).iou; });
            r.overlap = median(ious);
        } catch (const Interrupted&) {
            throw;
        } catch (const Error&) {
            r.overlap = 0;  // no hull
        }
    }
}

namespace {

/// A ball around what the cameras look at that every silhouette, seen from its camera, lies in.
double radius_around(const std::vector<OrbitCamera>& cameras, const Silhouettes& silhouettes) {
    double radius = 0;
    for (const size_t i : silhouettes.seen()) {
        const Silhouettes::Extent& e = silhouettes.extent(i);
        const double reach = std::max(std::hypot(e.x0 - cameras[i].cx, e.y0 - cameras[i].cy), std::hypot(e.x1 - cameras[i].cx, e.y1 - cameras[i].cy));
        radius = std::max(radius, cameras[i].centre.norm() * std::sin(std::atan(1.2 * reach / cameras[i].fx)));
    }
    return radius;
}

double rms_of(const std::vector<Touch>& touches) {
    double sum = 0;
    size_t n = 0;
    for (const Touch& t : touches)
        if (!std::isnan(t.residual_px)) sum += square(std::clamp(t.residual_px, 0.0, kOutlier_px)), ++n;
    return n ? std::sqrt(sum / static_cast<double>(n)) : 0.0;
}

/// Of what a common shift and a common change of focal length do to the residuals.
struct NormalEquations {
    Mat3d normal = Mat3d::Zero();
    Vec3d right = Vec3d::Zero();
};

NormalEquations normal_equations(const std::vector<CoherenceView>& views, const std::vector<OrbitCamera>& now, const std::vector<ContourPoint>& points,
                                 const std::vector<Touch>& touches) {
    NormalEquations out;
    for (size_t p = 0; p < points.size(); ++p) {
        const double residual = touches[p].residual_px;
        if (std::isnan(residual) || residual <= 0 || residual > kOutlier_px) continue;
        const std::vector<Support> supports = supports_of(views, now, points[p], touches[p], 1.0, 8);
        if (supports.empty()) continue;
        std::vector<double> values, slopes;
        double steepest = 0;
        for (const Support& s : supports) {
            values.push_back(s.distance_px);
            slopes.push_back(s.slope);
            steepest = std::max(steepest, std::fabs(s.slope));
        }
        const Minimax held = minimax(values.data(), slopes.data(), values.size(), steepest > 0 ? 2 / steepest : 0);
        Vec3d row = Vec3d::Zero();
        for (const auto& [which, share] : {std::pair{held.first, held.share}, {held.second, 1 - held.share}}) {
            const Support& s = supports[which];
            row += share * Vec3d(s.by_own[kCentreX] + s.by_view[kCentreX], s.by_own[kCentreY] + s.by_view[kCentreY], s.by_own[kLnFocal] + s.by_view[kLnFocal]);
        }
        out.normal += row * row.transpose();
        out.right -= residual * row;
    }
    return out;
}

}  // namespace

std::optional<CommonError> common_error(const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, Progress& progress) {
    const std::optional<Vec3d> middle = look_at_point(cameras);
    if (!middle || std::any_of(cameras.begin(), cameras.end(),
                               [](const Camera& c) { return c.intrinsics.orthographic || std::fabs(c.intrinsics.skew) > 1e-6 * c.intrinsics.fx; }))
        return std::nullopt;
    Silhouettes silhouettes(masks);
    if (silhouettes.seen().size() < 4) return std::nullopt;
    int scale = 1;  // large photographs are looked at more coarsely: their fields would be gigabytes
    while (silhouettes.size_px() / (2 * scale) >= kLeastObject_px) scale *= 2;
    const std::vector<CoherenceView>& views = silhouettes.at_scale(scale);
    const std::vector<ContourPoint> points = silhouettes.contour(scale, kPointsPerView, 1, 0, Silhouettes::Which::All);
    const auto moved = [&](const Vec3d& by) {
        std::vector<OrbitCamera> out;
        for (const Camera& c : cameras) {
            const Intrinsics& k = c.intrinsics;
            out.push_back({c.camera_from_world.rotation, c.centre_world() - *middle, k.fx * std::exp(by[2]), k.fy / k.fx, k.cx + by[0], k.cy + by[1]});
        }
        return out;
    };
    const std::vector<OrbitCamera> given = moved(Vec3d::Zero());
    SearchOptions search;
    search.ball_radius = radius_around(given, silhouettes);
    search.margin_px = 0.5;
    Vec3d at = Vec3d::Zero();
    std::vector<Touch> touches = find_touches(views, given, points, search, {});
    CommonError out;
    out.rms_before_px = out.rms_after_px = rms_of(touches);
    if (out.rms_before_px == 0) return out;
    Mat3d normal = Mat3d::Zero();
    for (int round = 0; round < 5; ++round) {
        progress.check();
        const NormalEquations equations = normal_equations(views, moved(at), points, touches);
        normal = equations.normal;
        // Weak priors (20 px, 30 %) hold what the views leave open: on a level orbit all cones may move up together.
        Mat3d held = normal;
        const double noise = square(out.rms_after_px);
        held.diagonal() += noise * Vec3d(1 / 400.0, 1 / 400.0, 1 / 0.09);
        Vec3d step = held.ldlt().solve(equations.right);
        bool better = false;
        for (int halving = 0; halving < 4 && !better; ++halving, step *= 0.5) {
            const std::vector<Touch> next = find_touches(views, moved(at + step), points, search, touches);
            const double rms_px = rms_of(next);
            if (!(rms_px < out.rms_after_px)) continue;
            better = true;
            at += step;
            touches = next;
            const bool done = rms_px > 0.98 * out.rms_after_px;
            out.rms_after_px = rms_px;
            if (done) better = false;
            break;
        }
        if (!better) break;
    }
    out.shift_x_px = at[0];
    out.shift_y_px = at[1];
    out.focal_factor = std::exp(at[2]);
    const double noise = std::max(out.rms_after_px, 0.02);
    const Mat3d covariance = (normal + 1e-9 * Mat3d::Identity()).inverse() * square(noise);
    for (int i = 0; i < 3; ++i) out.sd[static_cast<size_t>(i)] = std::sqrt(std::max(0.0, covariance(i, i)));
    return out;
}

}  // namespace vdbcarve
