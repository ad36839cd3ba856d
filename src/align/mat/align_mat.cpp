// SPDX-License-Identifier: Apache-2.0
#include "align/mat/align_mat.h"

#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <numeric>
#include <optional>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "align/mat/aruco.h"
#include "align/mat/calibration.h"
#include "image/opencv_image.h"
#include "align/orbit_model.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"

namespace vdbcarve {

using namespace mat;

namespace {

constexpr size_t kLeastCorners = 8;
constexpr double kMostStretch = 0.05;  ///< of a marker: more than printers and curled paper do within the sheet

double share_within_half_pixel(const std::vector<double>& errors_px) {
    return static_cast<double>(std::count_if(errors_px.begin(), errors_px.end(), [](double x) { return x < 0.5; })) / static_cast<double>(errors_px.size());
}

Image8 grey_of(const View& view) { return io::read_grey(view.image_path, view.orientation, view.camera.intrinsics, view.lens); }

/// The views that fit worst, with the corners found (green) and where the cameras put all of the mat's corners (red).
Image8 picture_of(const Views& views, const std::vector<Seen>& seen, const Calibration& c, const std::vector<double>& errors_px) {
    std::vector<size_t> order(seen.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return errors_px[a] > errors_px[b]; });
    order.resize(std::min<size_t>(order.size(), 6));
    constexpr int kWidth = 640;
    std::vector<cv::Mat> tiles;
    for (const size_t i : order) {
        const Image8 grey = grey_of(views.views[seen[i].view]);
        cv::Mat tile;
        const double scale = static_cast<double>(kWidth) / grey.width;
        cv::resize(io::wrap(grey.view()), tile, {}, scale, scale, cv::INTER_AREA);
        cv::cvtColor(tile, tile, cv::COLOR_GRAY2RGB);
        std::vector<cv::Point2f> projected;
        cv::projectPoints(seen[i].world_m, c.rvecs[i], c.tvecs[i], c.k, c.distortion, projected);
        constexpr int kShift = 4;  // fractions of a pixel
        const auto at = [&](const cv::Point2f& p) {
            return cv::Point(static_cast<int>(std::lround((p.x * scale - 0.5) * (1 << kShift))),
                             static_cast<int>(std::lround((p.y * scale - 0.5) * (1 << kShift))));
        };
        for (size_t k = 0; k < projected.size(); ++k) {
            cv::circle(tile, at(seen[i].image_px[k]), 3 << kShift, {0, 200, 0}, 1, cv::LINE_AA, kShift);
            cv::line(tile, at(seen[i].image_px[k]), at(projected[k]), {255, 0, 0}, 1, cv::LINE_AA, kShift);
        }
        std::vector<cv::Point2f> axes;
        const auto length = static_cast<float>(0.05);
        cv::projectPoints(std::vector<cv::Point3f>{{0, 0, 0}, {length, 0, 0}, {0, length, 0}, {0, 0, length}}, c.rvecs[i], c.tvecs[i], c.k, c.distortion, axes);
        const cv::Scalar colours[] = {{255, 0, 0}, {0, 200, 0}, {60, 60, 255}};
        for (int a = 0; a < 3; ++a) cv::line(tile, at(axes[0]), at(axes[static_cast<size_t>(a) + 1]), colours[a], 2, cv::LINE_AA, kShift);
        cv::putText(tile, views.views[seen[i].view].name + text_of("  %.2f px", errors_px[i]), {8, 20}, cv::FONT_HERSHEY_SIMPLEX, 0.5, {255, 255, 0}, 1,
                    cv::LINE_AA);
        tiles.push_back(tile);
    }
    int rows = 0, height = 0;
    for (const cv::Mat& t : tiles) height = std::max(height, t.rows);
    rows = (static_cast<int>(tiles.size()) + 1) / 2;
    cv::Mat sheet(rows * height, 2 * kWidth, CV_8UC3, cv::Scalar(0, 0, 0));
    for (size_t t = 0; t < tiles.size(); ++t)
        tiles[t].copyTo(sheet({static_cast<int>(t % 2) * kWidth, static_cast<int>(t / 2) * height, tiles[t].cols, tiles[t].rows}));
    return io::unwrap(sheet);
}

/// Corners for a pose: several, and not all on a line, or nearly so.
bool enough(const Seen& s) {
    if (s.groups.size() < kLeastCorners) return false;
    cv::Mat points(static_cast<int>(s.world_m.size()), 2, CV_32F);
    for (size_t k = 0; k < s.world_m.size(); ++k)
        points.at<float>(static_cast<int>(k), 0) = s.world_m[k].x, points.at<float>(static_cast<int>(k), 1) = s.world_m[k].y;
    const cv::PCA axes(points, cv::noArray(), cv::PCA::DATA_AS_ROW);
    return axes.eigenvalues.at<float>(1) > 0.003F * axes.eigenvalues.at<float>(0);
}

/// From photographs of a mat to their cameras, step by step.
class MatAlignment {
  public:
    MatAlignment(const Views& given_views, const AlignOptions& options, Progress& context)
        : given_(given_views), o_(options), progress_(context), mat_(*options.mat) {}

    AlignResult run() {
        metres_ = o_.units.empty() ? 1 : metres_per(o_.units).value_or(0);
        if (metres_ == 0)
            throw UsageError("--units " + o_.units + ": a mat is measured in metres; what those are in this unit is not known. Remedy: m, cm, mm, inch");
        progress_.begin("align", static_cast<int>(given_.views.size()) + 3);
        check_views();
        out_.method = o_.method;
        out_.orbit = Orbit::HandHeld;
        find_corners();
        calibrator_.emplace(given_, o_);
        if (calibrator_->calibrated() && (o_.fov_deg > 0 || o_.principal_point_px))
            throw UsageError(
                "--method mat: the cameras given say lens and principal point: --fov and --principal-point would say it again. Remedy: --cameras none, or "
                "without them");
        choose_lens();
        progress_.step(1);
        place_views();
        learn_print();
        progress_.step(1);
        add_cameras();
        summarise();
        judge();
        progress_.step(1);
        return std::move(out_);
    }

  private:
    /// One camera at one focus is wanted.
    void check_views() const {
        for (const View& v : given_.views) {
            if (v.image_path.empty()) throw InputError("--method mat: view " + v.name + " has no photograph to find the mat in");
            const Intrinsics &k = v.camera.intrinsics, &first = given_.views.front().camera.intrinsics;
            if (given_.posed && (k.orthographic || k.skew != 0 || std::fabs(k.fx - first.fx) > 1e-6 * first.fx ||
                                 std::fabs(k.fy - first.fy) > 1e-6 * first.fy || std::fabs(k.cx - first.cx) > 1e-3 || std::fabs(k.cy - first.cy) > 1e-3))
                throw InputError("--method mat: the camera file's lens of view " + v.name + " is not that of " + given_.views.front().name +
                                 ", or is skewed or parallel: one camera at one focus is wanted. Remedy: --cameras none, the lens is then found");
            if (!given_.posed && (k.width_px != first.width_px || k.height_px != first.height_px))
                throw InputError(
                    text_of("--method mat: %s has %d x %d pixels and %s %d x %d: one camera at one focus, held one way, is calibrated. Remedy: sort them into "
                            "one run each",
                            v.name.c_str(), k.width_px, k.height_px, given_.views.front().name.c_str(), first.width_px, first.height_px));
        }
    }

    void find_corners() {
        std::vector<Seen> all(given_.views.size());
        tbb::parallel_for(size_t{0}, given_.views.size(), [&](size_t i) {
            progress_.check();
            all[i].view = i;
            std::vector<MatCorner> corners;
            try {
                corners = find_mat(mat_, grey_of(given_.views[i]).view());
            } catch (const cv::Exception& e) {
                throw InputError(given_.views[i].image_path.string() + ": markers cannot be looked for in it: " + e.what());
            }
            for (const MatCorner& corner : corners) {
                all[i].groups.push_back(corner.group);
                all[i].layout_m.emplace_back(static_cast<float>(corner.mat_m.x() - 0.5 * mat_.width_m()),
                                             static_cast<float>(0.5 * mat_.height_m() - corner.mat_m.y()), 0.f);
                all[i].image_px.emplace_back(static_cast<float>(corner.image_px.x()), static_cast<float>(corner.image_px.y()));
            }
            all[i].world_m = all[i].layout_m;
            progress_.step(1);
        });
        for (const Seen& s : all)
            if (enough(s)) seen_.push_back(s);
        if (seen_.size() < 4)
            throw InputError(text_of(
                "--method mat: the mat (%d x %d, %s) is seen in %zu of %zu views; at least 4 are needed. Remedy: check --mat against the print (the layout "
                "file beside it says it): dictionary, columns, rows; sharper photographs, more of the mat in frame",
                mat_.columns, mat_.rows, mat_.dictionary.c_str(), seen_.size(), given_.views.size()));
    }

    /// Each rung of lenses is fitted to half of the markers and judged by the others.
    void choose_lens() {
        if (calibrator_->calibrated()) return;
        std::vector<Seen> fitted, held;
        for (const Seen& s : seen_) {
            const auto half = [&](int which) { return s.only([&](size_t k) { return s.groups[k] % 2 == which; }); };
            if (enough(half(0)) && !half(1).groups.empty()) fitted.push_back(half(0)), held.push_back(half(1));
        }
        double least = std::numeric_limits<double>::infinity();
        for (const LensRung& r : kLensRungs) {
            if (fitted.size() < 4) break;
            const Calibration fit = calibrator_->fit(fitted, r);
            std::vector<double> errors;
            for (size_t i = 0; i < held.size(); ++i)
                for (double e : errors_of(fit, i, held[i])) errors.push_back(e);
            const double found = percentile(errors, 0.8);
            progress_.detail(text_of("lens: %s: held-out corners within %.3f px (80 %%), f %.1f +- %.1f, centre %.1f %.1f, k1 %.4f k2 %.4f", r.name, found,
                                     fit.k.at<double>(0, 0), fit.focal_sd_px, fit.k.at<double>(0, 2), fit.k.at<double>(1, 2), fit.distortion.at<double>(0),
                                     fit.distortion.at<double>(1)));
            if (found < 0.95 * least - 0.002) least = found, rung_ = &r;
        }
    }

    /// Poses, without corners and views that are far off.
    void place_views() {
        for (int round = 0; round < 4; ++round) {
            c_ = calibrator_->fit(seen_, *rung_);
            std::vector<double> all_errors;
            errors_px_.clear();
            for (size_t i = 0; i < seen_.size(); ++i) {
                const std::vector<double> e = errors_of(c_, i, seen_[i]);
                all_errors.insert(all_errors.end(), e.begin(), e.end());
                errors_px_.push_back(rms(e));
            }
            // A corner that is far off is not the corner; a view that is, not sharp.
            const double corner_limit = std::max(1.0, 5 * median(all_errors)), view_limit = std::max(1.5, 4 * median(errors_px_));
            std::vector<Seen> kept;
            bool changed = false;
            for (size_t i = 0; i < seen_.size(); ++i) {
                const std::vector<double> e = errors_of(c_, i, seen_[i]);
                const Seen s = seen_[i].only([&](size_t k) { return e[k] <= corner_limit; });
                const bool stays = errors_px_[i] <= view_limit && enough(s);
                changed |= !stays || s.groups.size() != seen_[i].groups.size();
                if (stays) kept.push_back(s);
            }
            if (!changed || kept.size() < 4 || round == 3) break;
            seen_ = std::move(kept);
        }
    }

    /// How the print differs from the layout, where it does: learnt from every other view, does it hold for the rest?
    void learn_print() {
        if (seen_.size() < 10 || !(median(errors_px_) > 0.3)) return;
        // Whose lens was chosen while the print was thought perfect: all of it is asked again.
        const std::optional<int> lens_flags = calibrator_->calibrated() ? std::nullopt : std::optional(calibrator_->flags_of(kLensRungs[3]));
        std::array<std::vector<Seen>, 2> half;
        std::array<Calibration, 2> calibrated;
        for (size_t i = 0; i < seen_.size(); ++i) {
            half[i % 2].push_back(seen_[i]);
            calibrated[i % 2].rvecs.push_back(c_.rvecs[i].clone()), calibrated[i % 2].tvecs.push_back(c_.tvecs[i].clone());
        }
        for (Calibration& x : calibrated) x.k = c_.k.clone(), x.distortion = c_.distortion.clone();
        const auto rms_after_fit = [&](const Calibration& start) {
            Calibration from = start.copy();
            bundle(from, half[1], lens_flags, nullptr);
            std::vector<double> errors;
            for (size_t i = 0; i < half[1].size(); ++i)
                for (double e : errors_of(from, i, half[1][i])) errors.push_back(e);
            return rms(errors);
        };
        const double as_meant = rms_after_fit(calibrated[1]);
        Print print;
        bundle(calibrated[0], half[0], lens_flags, &print);
        set_print(half[1], print);
        const double as_printed = rms_after_fit(calibrated[1]);
        progress_.detail(text_of("print: %.3f px as the layout says, %.3f px as the other views saw it", as_meant, as_printed));
        if (as_printed < 0.7 * as_meant) {
            Print whole;
            bundle(c_, seen_, lens_flags, &whole);
            std::vector<double> off, in_plane;
            for (const auto& [key, at] : whole) {
                const cv::Point3f by = at - cv::Point3f(key.first, key.second, 0);
                off.push_back(cv::norm(by)), in_plane.push_back(std::hypot(by.x, by.y));
            }
            print_off_m_ = rms(off), print_stretched_m_ = rms(in_plane);
            progress_.detail(text_of("print: corners %.2f mm (rms) off, %.2f mm of it within the sheet", 1e3 * print_off_m_, 1e3 * print_stretched_m_));
            for (size_t i = 0; i < seen_.size(); ++i) errors_px_[i] = rms(errors_of(c_, i, seen_[i]));
        }
    }

    void add_cameras() {
        out_.views = given_;
        out_.views.views.clear();
        for (size_t i = 0; i < seen_.size(); ++i) {
            View v = given_.views[seen_[i].view];
            Intrinsics& k = v.camera.intrinsics;
            if (!calibrator_->calibrated()) {
                k.fx = c_.k.at<double>(0, 0), k.fy = c_.k.at<double>(1, 1), k.cx = c_.k.at<double>(0, 2), k.cy = c_.k.at<double>(1, 2);
                const double k1 = c_.distortion.at<double>(0), k2 = c_.distortion.at<double>(1);
                if (k2 != 0) v.lens = {Lens::Model::Radial, {k1, k2}};
                else if (k1 != 0) v.lens = {Lens::Model::SimpleRadial, {k1}};
            }
            cv::Mat r;
            cv::Rodrigues(c_.rvecs[i], r);
            Rigid3& pose = v.camera.camera_from_world;
            for (int a = 0; a < 3; ++a) {
                for (int b = 0; b < 3; ++b) pose.rotation(a, b) = r.at<double>(a, b);
                pose.translation[a] = c_.tvecs[i].at<double>(a) / metres_;
            }
            pose.rotation = nearest_rotation(pose.rotation);
            v.sitting = "0";
            v.unused.clear();
            const Vec3d centre = v.camera.centre_world();
            elevations_.push_back(std::asin(centre.z() / centre.norm()) / kRadians);
            AlignedView a;
            a.name = v.name;
            a.residual_px = errors_px_[i];
            const std::vector<double> e = errors_of(c_, i, seen_[i]);
            a.residual_p95_px = percentile(e, 0.95);
            a.coherent = share_within_half_pixel(e);
            every_.insert(every_.end(), e.begin(), e.end());
            out_.aligned.push_back(a);
            out_.views.views.push_back(v);
        }
    }

    void summarise() {
        const std::vector<double> azimuths = azimuths_rad(out_.views.cameras(), Vec3d::Zero(), Vec3d::UnitZ());
        for (size_t i = 0; i < azimuths.size(); ++i) out_.aligned[i].azimuth_deg = azimuths[i] / kRadians;
        for (const View& v : given_.views)
            if (std::none_of(out_.aligned.begin(), out_.aligned.end(), [&](const AlignedView& a) { return a.name == v.name; })) out_.left_out.push_back(v.name);
        out_.views.sittings = {Sitting{}};
        out_.views.up = "z";
        out_.views.units = o_.units.empty() ? "m" : o_.units;
        out_.views.floor = 0;
        out_.views.format = "mat";
        out_.views.metric = out_.views.posed = true;
        out_.direction = turned_rad(azimuths) > 0 ? Turn::Clockwise : Turn::Counterclockwise;  // the object's, before a camera that walks the other way
        out_.rms_px = rms(every_);
        out_.coherent = share_within_half_pixel(every_);
        const Intrinsics& k = out_.views.views.front().camera.intrinsics;
        out_.focal_px = k.fx;
        out_.focal_start_px = given_.views.front().camera.intrinsics.fx;
        out_.focal_sd_px = c_.focal_sd_px;
        out_.elevation_deg = median(elevations_);
        out_.principal_x_px = k.cx, out_.principal_y_px = k.cy;
        out_.picture_name = "mat";
        out_.picture = picture_of(given_, seen_, c_, errors_px_);
    }

    void judge() {
        const Intrinsics& k = out_.views.views.front().camera.intrinsics;
        if (!out_.left_out.empty())
            out_.warnings.push_back(
                text_of("%s left out, the mat is not seen well enough: %s", counted(out_.left_out.size(), "view").c_str(), some_of(out_.left_out).c_str()));
        const bool another_mat = print_stretched_m_ > kMostStretch * mat_.marker_m;
        if (print_off_m_ > 0 && !another_mat)
            out_.warnings.push_back(
                text_of("the print is not quite the mat that --mat says: its corners are %.2f mm (rms) from where they should be, all views agree. That was "
                        "allowed for, and the scale is that of the layout as a whole. Remedy: measure the print "
                        "(and print at 100 %%, on stiff paper)",
                        1e3 * print_off_m_));
        const double allowed = std::max(2.0, k.width_px / 500.0);
        if (another_mat)
            out_.failures.push_back(text_of(
                "the corners of the print lie %.2f mm (rms) from where --mat says, within the sheet: no printer does that to markers of %.1f mm. Remedy: "
                "measure a marker and a gap (or square), and give --mat what you measured",
                1e3 * print_stretched_m_, 1e3 * mat_.marker_m));
        else if (out_.rms_px > allowed)
            out_.failures.push_back(text_of(
                "the mat's corners are %.2f px (rms) from where the cameras put them, at most %.2f px may be: another mat than --mat says (the sizes of "
                "markers and gaps, columns, rows), a mat that is not flat, or a zoom or focus that changed. Remedy: check --mat; mat.png shows what was found "
                "where",
                out_.rms_px, allowed));
        if (c_.focal_sd_px > 0.02 * k.fx)
            out_.warnings.push_back(text_of(
                "the focal length is uncertain by %.0f %% (%.0f +- %.0f px); the mat was seen from %.0f to %.0f degrees of elevation. Remedy: a few views "
                "from higher and lower",
                100 * c_.focal_sd_px / k.fx, k.fx, c_.focal_sd_px, *std::min_element(elevations_.begin(), elevations_.end()),
                *std::max_element(elevations_.begin(), elevations_.end())));
        if (c_.focal_sd_px > 0.15 * k.fx)
            out_.failures.push_back(
                text_of("the mat does not say what the focal length is (%.0f +- %.0f px). Remedy: views from higher and lower", k.fx, c_.focal_sd_px));
    }

    const Views& given_;
    const AlignOptions& o_;
    Progress& progress_;
    const MatLayout& mat_;
    std::optional<Calibrator> calibrator_;
    double metres_ = 1;                               ///< to the unit of the result
    std::vector<Seen> seen_;                          ///< views that show enough of the mat
    const LensRung* rung_ = &kLensRungs[0];           ///< the lens that is taken
    Calibration c_;                                   ///< of `seen`
    std::vector<double> errors_px_;                   ///< rms, of `seen`
    std::vector<double> every_, elevations_;          ///< corners' errors in pixels; radians
    double print_off_m_ = 0, print_stretched_m_ = 0;  ///< rms of what is wrong with the print; of it, within the sheet
    AlignResult out_;
};

}  // namespace

AlignResult align_to_mat(const Views& given, const AlignOptions& o, Progress& progress) {
    try {
        return MatAlignment(given, o, progress).run();
    } catch (const cv::Exception& e) {
        throw UndeterminedError(std::string("--method mat: the views of the mat do not determine a camera: ") + e.what() +
                                ". Remedy: more views, from several heights");
    }
}

}  // namespace vdbcarve
