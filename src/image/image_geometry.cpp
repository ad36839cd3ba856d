// SPDX-License-Identifier: Apache-2.0
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "image/opencv_image.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {

namespace {

cv::Mat undistorted(const cv::Mat& image, const Intrinsics& k, const Lens& lens, Image8* outside) {
    // OpenCV counts the first pixel's centre as (0, 0), we as (0.5, 0.5).
    const cv::Matx33d matrix(k.fx, 0, k.cx - 0.5, 0, k.fy, k.cy - 0.5, 0, 0, 1);
    const auto c = [&](size_t i) { return i < lens.coefficients.size() ? lens.coefficients[i] : 0.0; };
    const cv::Size size(k.width_px, k.height_px);
    cv::Mat map_x, map_y;
    if (lens.model == Lens::Model::OpenCVFisheye) {
        cv::fisheye::initUndistortRectifyMap(matrix, cv::Vec4d(c(0), c(1), c(2), c(3)), cv::Matx33d::eye(), matrix, size, CV_32FC1, map_x, map_y);
    } else {
        std::vector<double> d(8, 0.0);
        switch (lens.model) {
            case Lens::Model::SimpleRadial:
                d[0] = c(0);
                break;
            case Lens::Model::Radial:
                d[0] = c(0);
                d[1] = c(1);
                break;
            default:
                for (size_t i = 0; i < 8; ++i) d[i] = c(i);
        }
        cv::initUndistortRectifyMap(matrix, d, cv::noArray(), matrix, size, CV_32FC1, map_x, map_y);
    }
    cv::Mat result;
    cv::remap(image, result, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    if (outside) {
        *outside = Image8(k.width_px, k.height_px);
        for (int y = 0; y < k.height_px; ++y)
            for (int x = 0; x < k.width_px; ++x) {
                const float u = map_x.at<float>(y, x), v = map_y.at<float>(y, x);
                const bool in = u >= -0.5f && v >= -0.5f && u <= static_cast<float>(image.cols) - 0.5f && v <= static_cast<float>(image.rows) - 0.5f;
                if (!in) outside->at(x, y) = 255;
            }
    }
    return result;
}

}  // namespace

Image8 undistort(ImageView<uint8_t> image, const Intrinsics& k, const Lens& lens, Image8* outside) {
    return unwrap(undistorted(wrap(image), k, lens, outside));
}

Photo undistort(const Photo& photo, const Intrinsics& k, const Lens& lens) {
    if (photo.pixels8.empty()) return {{}, unwrap<uint16_t>(undistorted(wrap(photo.pixels16.view()), k, lens, nullptr))};
    return {unwrap(undistorted(wrap(photo.pixels8.view()), k, lens, nullptr)), {}};
}

Image8 distort(ImageView<uint8_t> image, int margin, const Intrinsics& k, const Lens& lens) {
    const cv::Matx33d matrix(k.fx, 0, k.cx - 0.5, 0, k.fy, k.cy - 0.5, 0, 0, 1);
    const auto c = [&](size_t i) { return i < lens.coefficients.size() ? lens.coefficients[i] : 0.0; };
    std::vector<cv::Point2d> from, to;
    for (int y = 0; y < k.height_px; ++y)
        for (int x = 0; x < k.width_px; ++x) from.emplace_back(x, y);
    if (lens.model == Lens::Model::OpenCVFisheye) {
        cv::fisheye::undistortPoints(from, to, matrix, cv::Vec4d(c(0), c(1), c(2), c(3)), cv::noArray(), matrix);
    } else {
        std::vector<double> d(8, 0.0);
        const size_t used = lens.model == Lens::Model::SimpleRadial ? 1 : lens.model == Lens::Model::Radial ? 2 : 8;
        for (size_t i = 0; i < used; ++i) d[i] = c(i);
        cv::undistortPoints(from, to, matrix, d, cv::noArray(), matrix, cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 60, 1e-9));
    }
    cv::Mat map(k.height_px, k.width_px, CV_32FC2);
    for (int y = 0; y < k.height_px; ++y)
        for (int x = 0; x < k.width_px; ++x) {
            const cv::Point2d& p = to[static_cast<size_t>(y) * static_cast<size_t>(k.width_px) + static_cast<size_t>(x)];
            map.at<cv::Vec2f>(y, x) = cv::Vec2f(static_cast<float>(p.x + margin), static_cast<float>(p.y + margin));
        }
    cv::Mat out;
    cv::remap(wrap(image), out, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    return unwrap(out);
}

double sharpness_of(const cv::Mat& grey) {
    cv::Mat laplacian;
    cv::Laplacian(grey, laplacian, CV_32F);
    return laplacian.dot(laplacian) / static_cast<double>(laplacian.total());
}

double sharpness(ImageView<uint8_t> image) {
    cv::Mat grey = wrap(image);
    if (image.channels > 1) cv::cvtColor(wrap(image), grey, image.channels == 4 ? cv::COLOR_RGBA2GRAY : cv::COLOR_RGB2GRAY);
    cv::Mat small;
    const double factor = std::min(1.0, static_cast<double>(kSharpWidth_px) / grey.cols);
    cv::resize(grey, small, cv::Size(), factor, factor, cv::INTER_AREA);
    return sharpness_of(small);
}

Image8 blurred(ImageView<uint8_t> image, double sigma_px) {
    cv::Mat out;
    cv::GaussianBlur(wrap(image), out, cv::Size(), sigma_px, sigma_px, cv::BORDER_REPLICATE);
    return unwrap(out);
}

Component largest_component(ImageView<uint8_t> image) {
    cv::Mat labels, statistics, centres;
    const int count = cv::connectedComponentsWithStats(wrap(image), labels, statistics, centres, 8, CV_32S);
    Component out;
    for (int n = 1; n < count; ++n) {
        const auto pixels = static_cast<size_t>(statistics.at<int>(n, cv::CC_STAT_AREA));
        if (pixels <= out.pixels) continue;
        const int x = statistics.at<int>(n, cv::CC_STAT_LEFT), y = statistics.at<int>(n, cv::CC_STAT_TOP);
        out = {pixels, {x, y, x + statistics.at<int>(n, cv::CC_STAT_WIDTH), y + statistics.at<int>(n, cv::CC_STAT_HEIGHT)}};
    }
    return out;
}

void stamp(Image8& image, const std::string& word) {
    cv::Mat m(image.height, image.width, CV_8UC(image.channels), image.data.data());
    int below = 0;
    const double scale = 0.8 * image.width / cv::getTextSize(word, cv::FONT_HERSHEY_SIMPLEX, 1, 3, &below).width;
    const int thickness = std::max(2, static_cast<int>(2 * scale));
    const cv::Size size = cv::getTextSize(word, cv::FONT_HERSHEY_SIMPLEX, scale, thickness, &below);
    cv::putText(m, word, {(image.width - size.width) / 2, (image.height + size.height) / 2}, cv::FONT_HERSHEY_SIMPLEX, scale, cv::Scalar(230, 40, 40, 255),
                thickness, cv::LINE_AA);
}

void write_text(Image8& image, int x, int y, int width, const std::string& text) {
    cv::Mat m(image.height, image.width, CV_8UC(image.channels), image.data.data());
    constexpr double kScale = 0.45;
    std::string shown = text;
    int below = 0;
    while (!shown.empty() && cv::getTextSize(shown, cv::FONT_HERSHEY_SIMPLEX, kScale, 1, &below).width > width) shown.pop_back();
    cv::putText(m, shown, {x, y}, cv::FONT_HERSHEY_SIMPLEX, kScale, cv::Scalar(40, 40, 40, 255), 1, cv::LINE_AA);
}

Image8 downscale(ImageView<uint8_t> image, int width, int height) {
    cv::Mat out;
    cv::resize(wrap(image), out, cv::Size(width, height), 0, 0, cv::INTER_AREA);
    return unwrap(out);
}

}  // namespace vdbcarve::io
