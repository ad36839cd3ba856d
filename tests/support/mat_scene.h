// SPDX-License-Identifier: Apache-2.0
// Photographs of a marker mat with a ball on it, by casting rays.
#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "vdbcarve/board.h"
#include "vdbcarve/image.h"
#include "vdbcarve/views.h"

namespace vdbcarve::test {

struct MatShoot {
    MatLayout mat = read_mat("grid:5x7:0.03:0.008:6X6_250");
    int views = 12;
    double k1 = 0;  ///< of the lens
    double focal_px = 1000;
    int width_px = 960, height_px = 720;
    double ball_radius_m = 0;  ///< 0: no ball
    double ball_height_m = 0;  ///< of its middle above the mat
    int samples = 3;           ///< a side of a pixel
    /// Height of the paper above the plane at a place of the mat's world; none: flat.
    std::function<double(double x_m, double y_m)> curl;
};

struct MatPhotos {
    Views views;                 ///< with the true cameras (of the undistorted pictures) and lens; world: middle of the mat, z up, metres
    std::vector<Image8> photos;  ///< grey, as taken
    std::vector<Image8> masks;   ///< of the ball
};

MatPhotos photograph(const MatShoot& shoot);

/// Writes images/ and, where there is a ball, masks/; returns the views as they are found without a camera file.
Views write_photos(const MatPhotos& photos, const std::filesystem::path& folder);

}  // namespace vdbcarve::test
