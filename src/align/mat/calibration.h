// SPDX-License-Identifier: Apache-2.0
// Calibration from corners of a mat: all photographs' poses, one lens, and the print. Private.
#pragma once

#include <map>
#include <optional>
#include <opencv2/calib3d.hpp>
#include <utility>
#include <vector>

#include "vdbcarve/align.h"

namespace vdbcarve::mat {

/// What one photograph shows of the mat.
struct Seen {
    size_t view = 0;
    std::vector<int> groups;
    std::vector<cv::Point3f> layout_m;  ///< where the layout has the corners
    std::vector<cv::Point3f> world_m;   ///< where the print has them, as far as is known
    std::vector<cv::Point2f> image_px;

    template <class Keep>
    Seen only(const Keep& keep) const {
        Seen out;
        out.view = view;
        for (size_t k = 0; k < groups.size(); ++k)
            if (keep(k))
                out.groups.push_back(groups[k]), out.layout_m.push_back(layout_m[k]), out.world_m.push_back(world_m[k]), out.image_px.push_back(image_px[k]);
        return out;
    }
};

struct Calibration {
    cv::Mat k, distortion;
    std::vector<cv::Mat> rvecs, tvecs;
    double focal_sd_px = 0;

    /// (OpenCV's matrices are references.)
    Calibration copy() const {
        Calibration out{k.clone(), distortion.clone(), {}, {}, focal_sd_px};
        for (const cv::Mat& m : rvecs) out.rvecs.push_back(m.clone());
        for (const cv::Mat& m : tvecs) out.tvecs.push_back(m.clone());
        return out;
    }
};

/// Distances between corners seen and corners as the calibration puts them, pixels.
std::vector<double> errors_of(const Calibration& c, size_t index, const Seen& s);

/// A lens by how many of its quantities are free; each has those of the one before.
struct LensRung {
    const char* name;
    int fixed;
};
inline constexpr int kPinhole = cv::CALIB_FIX_ASPECT_RATIO | cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K3;
inline const LensRung kLensRungs[] = {{"focal length", kPinhole | cv::CALIB_FIX_PRINCIPAL_POINT | cv::CALIB_FIX_K1 | cv::CALIB_FIX_K2},
                                      {"and k1", kPinhole | cv::CALIB_FIX_PRINCIPAL_POINT | cv::CALIB_FIX_K2},
                                      {"and principal point", kPinhole | cv::CALIB_FIX_K2},
                                      {"and k2", kPinhole}};

class Calibrator {
  public:
    Calibrator(const Views& views, const AlignOptions& o);
    bool calibrated() const { return calibrated_; }
    int flags_of(const LensRung& rung) const;

    /// All views together.
    Calibration fit(const std::vector<Seen>& seen, const LensRung& rung) const;

  private:
    Intrinsics intrinsics_;
    cv::Size size_;
    double focal_px_ = 0;
    Vec2d centre_;
    bool centre_known_ = false, calibrated_ = false;
};

/// A print as it came out of the printer.
using Print = std::map<std::pair<float, float>, cv::Point3f>;  // by place in the layout

void set_print(std::vector<Seen>& seen, const Print& print);

/// Calibration by Gauss and Newton's method on everything together, poses and lens, and, where `print` is given, on where the corners really are: printers
/// stretch paper, and paper is not flat (Strobl and Hirzinger, "More accurate pinhole camera calibration with imperfect planar target", ICCV workshops 2011).
/// Corners are held near the layout by priors, which keep the world's place and size.
void bundle(Calibration& c, std::vector<Seen>& seen, std::optional<int> lens_flags, Print* print);

}  // namespace vdbcarve::mat
