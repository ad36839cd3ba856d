// SPDX-License-Identifier: Apache-2.0
#include "mask/mask_clean_up.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "vdbcarve/color_space.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {
namespace {

cv::Mat disc(int radius_px) { return cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * radius_px + 1, 2 * radius_px + 1}); }

void keep_largest(cv::Mat& binary) {
    cv::Mat labels, stats, centroids;
    const int n = cv::connectedComponentsWithStats(binary, labels, stats, centroids, 8, CV_32S);
    int best = 0;
    for (int i = 1; i < n; ++i)
        if (best == 0 || stats.at<int>(i, cv::CC_STAT_AREA) > stats.at<int>(best, cv::CC_STAT_AREA)) best = i;
    if (best) binary.setTo(0, labels != best);
}

void fill_small_holes(cv::Mat& binary, double share) {
    const double area = cv::countNonZero(binary);
    const cv::Mat background = binary == 0;
    cv::Mat labels, stats, centroids;
    const int n = cv::connectedComponentsWithStats(background, labels, stats, centroids, 4, CV_32S);
    std::vector<uint8_t> fill(static_cast<size_t>(n), 0);
    for (int i = 1; i < n; ++i) {
        const int x = stats.at<int>(i, cv::CC_STAT_LEFT), y = stats.at<int>(i, cv::CC_STAT_TOP);
        const int w = stats.at<int>(i, cv::CC_STAT_WIDTH), h = stats.at<int>(i, cv::CC_STAT_HEIGHT);
        const bool at_border = x == 0 || y == 0 || x + w == binary.cols || y + h == binary.rows;
        if (!at_border && (share >= 1 || stats.at<int>(i, cv::CC_STAT_AREA) <= share * area)) fill[static_cast<size_t>(i)] = 1;
    }
    for (int y = 0; y < binary.rows; ++y)
        for (int x = 0; x < binary.cols; ++x)
            if (fill[static_cast<size_t>(labels.at<int>(y, x))]) binary.at<uint8_t>(y, x) = 255;
}

}  // namespace

void clean_up(cv::Mat& binary, const MaskCleanUp& options) {
    if (options.open_px > 0) cv::morphologyEx(binary, binary, cv::MORPH_OPEN, disc(options.open_px));
    if (options.close_px > 0) cv::morphologyEx(binary, binary, cv::MORPH_CLOSE, disc(options.close_px));
    if (options.largest_component) keep_largest(binary);
    if (options.fill_holes > 0) fill_small_holes(binary, options.fill_holes);
}

Image8 soft_edge(ImageView<uint8_t> photo, const cv::Mat& binary, ImageView<uint8_t> plate) {
    constexpr int kEdge_px = 2, kLook_px = 6;
    constexpr double kLeastContrast = 0.03;  // of linear light: what mixes alike says nothing
    // 0: outside for certain, 255: inside for certain, 128: along the edge.
    cv::Mat inside, outside;
    cv::erode(binary, inside, disc(kEdge_px), {-1, -1}, 1, cv::BORDER_REPLICATE);
    cv::dilate(binary, outside, disc(kEdge_px), {-1, -1}, 1, cv::BORDER_REPLICATE);
    Image8 out(photo.width, photo.height);
    std::array<double, 256> linear;
    for (size_t v = 0; v < linear.size(); ++v) linear[v] = linear_from_srgb(static_cast<double>(v) / 255);
    const auto light = [&](ImageView<uint8_t> image, int x, int y) {
        Vec3d v;
        for (int c = 0; c < 3; ++c) v[c] = linear[image.at(x, y, image.channels >= 3 ? c : 0)];
        return v;
    };
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x) {
            const bool in = binary.at<uint8_t>(y, x) != 0;
            out.at(x, y) = in ? 255 : 0;
            if (inside.at<uint8_t>(y, x) || !outside.at<uint8_t>(y, x)) continue;
            std::array<Vec3d, 2> sum{Vec3d::Zero(), Vec3d::Zero()};
            std::array<double, 2> weight{0, 0};
            for (int v = std::max(0, y - kLook_px); v <= std::min(photo.height - 1, y + kLook_px); ++v)
                for (int u = std::max(0, x - kLook_px); u <= std::min(photo.width - 1, x + kLook_px); ++u) {
                    const bool object = inside.at<uint8_t>(v, u) != 0;
                    if ((!object && outside.at<uint8_t>(v, u)) || (!object && !plate.empty())) continue;
                    const double w = 1.0 / ((u - x) * (u - x) + (v - y) * (v - y));
                    sum[object] += w * light(photo, u, v);
                    weight[object] += w;
                }
            if (!plate.empty()) sum[0] = light(plate, x, y), weight[0] = 1;
            if (weight[0] == 0 || weight[1] == 0) continue;  // thin: nothing near is object (or background) for certain
            const Vec3d background = sum[0] / weight[0], along = sum[1] / weight[1] - background;
            if (along.norm() < kLeastContrast) continue;
            const double share = (light(photo, x, y) - background).dot(along) / along.squaredNorm();
            out.at(x, y) = static_cast<uint8_t>(std::lround(255 * std::clamp(share, 0.0, 1.0)));
        }
    return out;
}

double contour_softness(ImageView<uint8_t> m) {
    size_t soft = 0, crossings = 0;
    for (int y = 0; y + 1 < m.height; ++y)
        for (int x = 0; x + 1 < m.width; ++x) {
            const int here = m.at(x, y);
            soft += here > 8 && here < 247;
            crossings += ((here < 128) != (m.at(x + 1, y) < 128)) || ((here < 128) != (m.at(x, y + 1) < 128));
        }
    return crossings ? std::min(1.0, static_cast<double>(soft) / static_cast<double>(crossings)) : 0;
}

}  // namespace vdbcarve
