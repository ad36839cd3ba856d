// SPDX-License-Identifier: Apache-2.0
#include "align/mat/aruco.h"

#include <opencv2/core/version.hpp>
#if CV_VERSION_MAJOR > 4 || (CV_VERSION_MAJOR == 4 && CV_VERSION_MINOR >= 7)
#define VDBCARVE_ARUCO_IN_OBJDETECT 1
#include <opencv2/objdetect/aruco_detector.hpp>
#include <opencv2/objdetect/charuco_detector.hpp>
#else
#define VDBCARVE_ARUCO_IN_OBJDETECT 0
#include <opencv2/aruco.hpp>
#include <opencv2/aruco/charuco.hpp>
#endif

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "image/opencv_image.h"

namespace vdbcarve {
namespace {

struct Named {
    int number, size, bits;
};
const Named* named(const std::string& name) {
    static const std::map<std::string, Named> all = [] {
        // OpenCV numbers them in this order, from 0.
        std::map<std::string, Named> out;
        int number = 0;
        for (const int bits : {4, 5, 6, 7})
            for (const int size : {50, 100, 250, 1000})
                out[std::to_string(bits) + "X" + std::to_string(bits) + "_" + std::to_string(size)] = {number++, size, bits};
        return out;
    }();
    const auto found = all.find(name);
    return found == all.end() ? nullptr : &found->second;
}

/// Brightness at a place, first pixel's centre at (0.5, 0.5).
double sample(ImageView<uint8_t> grey, const Vec2d& at) {
    const double x = std::clamp(at.x() - 0.5, 0.0, grey.width - 1.001), y = std::clamp(at.y() - 0.5, 0.0, grey.height - 1.001);
    const int i = static_cast<int>(x), j = static_cast<int>(y);
    const double u = x - i, v = y - j;
    return (1 - v) * ((1 - u) * grey.at(i, j) + u * grey.at(i + 1, j)) + v * ((1 - u) * grey.at(i, j + 1) + u * grey.at(i + 1, j + 1));
}

/// Corners of a marker's black square where lines through its sides meet. (Refinement by gradients is drawn inwards at such corners by 0.2 px, and
/// takes a neighbour's corner where the gap is narrow; OpenCV's AprilTag refinement is off by 0.1 px.) `reach`: how far from the sides nothing but their edge
/// is, in sides.
std::array<Vec2d, 4> refined(ImageView<uint8_t> grey, const std::array<Vec2d, 4>& corners, double reach) {
    struct Line {
        Vec2d point = Vec2d::Zero(), normal = Vec2d::Zero();
    };
    std::array<Line, 4> lines;
    const Vec2d middle = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
    for (size_t side = 0; side < 4; ++side) {
        const Vec2d a = corners[side], along = corners[(side + 1) % 4] - a;
        const double length = along.norm();
        Vec2d out = Vec2d(along.y(), -along.x()) / length;
        if (out.dot(a - middle) < 0) out = -out;
        // As far outwards as the other sides are, foreshortened like the marker itself.
        const double far = std::clamp(reach * std::fabs(out.dot(0.5 * (corners[(side + 2) % 4] + corners[(side + 3) % 4]) - a - 0.5 * along)), 1.0, 8.0);
        std::vector<Vec2d> edge;
        const int count = std::clamp(static_cast<int>(length), 8, 60);
        for (int k = 0; k < count; ++k) {
            const Vec2d at = a + along * (0.1 + 0.8 * (k + 0.5) / count);
            const double dark = sample(grey, at - far * out), bright = sample(grey, at + far * out);
            if (bright < dark + 25) continue;
            const double half = 0.5 * (dark + bright);
            double before = dark;
            for (double t = -far; t < far; t += 0.25) {
                const double now = sample(grey, at + (t + 0.25) * out);
                if (before < half && now >= half) {
                    edge.push_back(at + (t + 0.25 * (half - before) / (now - before)) * out);
                    break;
                }
                before = now;
            }
        }
        for (int round = 0; round < 3 && edge.size() >= 5; ++round) {
            Vec2d mean = Vec2d::Zero();
            for (const Vec2d& p : edge) mean += p / static_cast<double>(edge.size());
            Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
            for (const Vec2d& p : edge) spread += (p - mean) * (p - mean).transpose();
            const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(spread);
            lines[side] = {mean, axes.eigenvectors().col(0)};
            const double limit = 2.5 * std::sqrt(axes.eigenvalues()[0] / static_cast<double>(edge.size())) + 0.02;
            if (std::erase_if(edge, [&](const Vec2d& p) { return std::fabs(lines[side].normal.dot(p - mean)) > limit; }) == 0) break;
        }
    }
    std::array<Vec2d, 4> result = corners;
    for (size_t c = 0; c < 4; ++c) {
        const Line &p = lines[(c + 3) % 4], &q = lines[c];
        Eigen::Matrix2d both;
        both << p.normal.transpose(), q.normal.transpose();
        if (std::fabs(both.determinant()) < 0.1) continue;  // a side was not found
        const Vec2d meet = both.inverse() * Vec2d(p.normal.dot(p.point), q.normal.dot(q.point));
        if ((meet - corners[c]).norm() < 3) result[c] = meet;
    }
    return result;
}

/// From the detectors' pixels to ours: quadrilaterals are counted from the first pixel's centre, the chessboard's corners from its corner. Measured on drawn
/// mats (Board.CornersAreFoundWhereTheyAre).
constexpr double kQuadShift_px = 0.5, kCharucoShift_px = 0;

}  // namespace

int dictionary_size(const std::string& name) {
    const Named* n = named(name);
    return n ? n->size : 0;
}

int marker_bits(const std::string& name) { return named(name)->bits; }

Image8 marker_image(const std::string& dictionary, int id, int side) {
    cv::Mat out;
#if VDBCARVE_ARUCO_IN_OBJDETECT
    cv::aruco::generateImageMarker(cv::aruco::getPredefinedDictionary(named(dictionary)->number), id, side, out, 1);
#else
    cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(named(dictionary)->number), id, side, out, 1);
#endif
    return io::unwrap(out);
}

std::vector<MatCorner> find_mat(const MatLayout& mat, ImageView<uint8_t> grey) {
    const cv::Mat image = io::wrap(grey);
    const bool grid = mat.kind == MatLayout::Kind::Grid;
    const auto dictionary = cv::aruco::getPredefinedDictionary(named(mat.dictionary)->number);
    std::vector<std::vector<cv::Point2f>> markers;
    std::vector<int> ids;
#if VDBCARVE_ARUCO_IN_OBJDETECT
    cv::aruco::ArucoDetector(dictionary).detectMarkers(image, markers, ids);
#else
    cv::aruco::detectMarkers(image, dictionary, markers, ids);
#endif
    std::vector<MatCorner> out;
    if (grid) {
        for (size_t k = 0; k < ids.size(); ++k) {
            if (ids[k] >= mat.columns * mat.rows) continue;  // another print's
            const Vec2d at(ids[k] % mat.columns * mat.step_m, ids[k] / mat.columns * mat.step_m);
            const Vec2d clockwise[4] = {{0, 0}, {mat.marker_m, 0}, {mat.marker_m, mat.marker_m}, {0, mat.marker_m}};
            std::array<Vec2d, 4> quad;
            for (size_t c = 0; c < 4; ++c) quad[c] = Vec2d(markers[k][c].x + kQuadShift_px, markers[k][c].y + kQuadShift_px);
            const double module_m = mat.marker_m / (marker_bits(mat.dictionary) + 2);
            quad = refined(grey, quad, 0.7 * std::min(module_m, mat.step_m - mat.marker_m) / mat.marker_m);
            for (size_t c = 0; c < 4; ++c) out.push_back({ids[k], at + clockwise[c], quad[c]});
        }
        return out;
    }
    if (ids.empty()) return out;
    cv::Mat corners, numbers;
#if VDBCARVE_ARUCO_IN_OBJDETECT
    const cv::aruco::CharucoBoard board({mat.columns, mat.rows}, static_cast<float>(mat.step_m), static_cast<float>(mat.marker_m), dictionary);
    cv::aruco::CharucoDetector(board).detectBoard(image, corners, numbers, markers, ids);
#else
    const auto board = cv::aruco::CharucoBoard::create(mat.columns, mat.rows, static_cast<float>(mat.step_m), static_cast<float>(mat.marker_m), dictionary);
    cv::aruco::interpolateCornersCharuco(markers, ids, image, board, corners, numbers);
#endif
    for (int k = 0; k < static_cast<int>(numbers.total()); ++k) {
        const int id = numbers.at<int>(k);
        const cv::Point2f at = corners.at<cv::Point2f>(k);
        out.push_back(
            {id, mat.step_m * Vec2d(id % (mat.columns - 1) + 1, id / (mat.columns - 1) + 1), Vec2d(at.x + kCharucoShift_px, at.y + kCharucoShift_px)});
    }
    return out;
}

}  // namespace vdbcarve
