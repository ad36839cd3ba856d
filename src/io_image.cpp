// SPDX-License-Identifier: Apache-2.0
#include "io_image.h"

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/ximgproc.hpp>

#include "vdbcarve/error.h"

namespace vdbcarve::io {
namespace {

cv::Mat wrap(ImageView<uint8_t> image) {
    return {image.height, image.width, CV_8UC(image.channels), const_cast<uint8_t*>(image.data)};
}

Image8 unwrap(const cv::Mat& m) {
    Image8 out(m.cols, m.rows, m.channels());
    for (int y = 0; y < m.rows; ++y)
        std::copy_n(m.ptr<uint8_t>(y), static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()),
                    out.data.data() + static_cast<size_t>(y) * static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()));
    return out;
}

}  // namespace

Image8 read_image8(const std::filesystem::path& file) {
    cv::Mat m;
    try {
        m = cv::imread(file.string(), cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
    } catch (const cv::Exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
    if (m.empty()) {
        if (!std::filesystem::exists(file)) throw InputError(file.string() + ": no such file");
        throw InputError(file.string() + ": is not a picture that can be decoded, or is damaged");
    }
    if (m.depth() == CV_16U) {
        // (v * 255 + 32767) / 65535, rounded: 32767 -> 127, 32768 -> 128.
        cv::Mat narrow(m.rows, m.cols, CV_8UC(m.channels()));
        for (int y = 0; y < m.rows; ++y) {
            const auto* from = m.ptr<uint16_t>(y);
            auto* to = narrow.ptr<uint8_t>(y);
            for (int i = 0; i < m.cols * m.channels(); ++i) to[i] = static_cast<uint8_t>((from[i] * 255u + 32767u) / 65535u);
        }
        m = narrow;
    } else if (m.depth() != CV_8U) {
        throw InputError(file.string() + ": has neither 8 nor 16 bits a channel");
    }
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_BGR2RGB);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_BGRA2RGBA);
    if (m.channels() == 2) throw InputError(file.string() + ": has two channels; grey, RGB and RGBA are read");
    return unwrap(m);
}

std::vector<uint8_t> encode_png(ImageView<uint8_t> image) {
    cv::Mat m = wrap(image).clone();
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_RGB2BGR);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_RGBA2BGRA);
    std::vector<uint8_t> bytes;
    if (!cv::imencode(".png", m, bytes, {cv::IMWRITE_PNG_COMPRESSION, 3})) throw OutputError("a PNG could not be encoded");
    return bytes;
}

Image8 undistort(ImageView<uint8_t> image, const Intrinsics& k, const Lens& lens, Image8* outside) {
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
            case Lens::Model::SimpleRadial: d[0] = c(0); break;
            case Lens::Model::Radial: d[0] = c(0); d[1] = c(1); break;
            default: for (size_t i = 0; i < 8; ++i) d[i] = c(i);
        }
        cv::initUndistortRectifyMap(matrix, d, cv::noArray(), matrix, size, CV_32FC1, map_x, map_y);
    }
    cv::Mat result;
    cv::remap(wrap(image), result, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    if (outside) {
        *outside = Image8(k.width_px, k.height_px);
        for (int y = 0; y < k.height_px; ++y)
            for (int x = 0; x < k.width_px; ++x) {
                const float u = map_x.at<float>(y, x), v = map_y.at<float>(y, x);
                const bool in = u >= -0.5f && v >= -0.5f && u <= static_cast<float>(image.width) - 0.5f &&
                                v <= static_cast<float>(image.height) - 0.5f;
                if (!in) outside->at(x, y) = 255;
            }
    }
    return unwrap(result);
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

std::vector<std::array<int, 2>> skeleton_near(ImageView<uint8_t> coverage, ImageView<uint8_t> marked) {
    cv::Mat object = wrap(coverage) >= 128;
    // Thinning looks at every pixel again and again: only around what is marked, with room for the shape to be told.
    const cv::Rect all(0, 0, coverage.width, coverage.height), found = cv::boundingRect(wrap(marked));
    if (found.empty()) return {};
    constexpr int kRoom = 48;
    const cv::Rect part = cv::Rect(found.x - kRoom, found.y - kRoom, found.width + 2 * kRoom, found.height + 2 * kRoom) & all;
    cv::Mat thin;
    cv::ximgproc::thinning(object(part), thin, cv::ximgproc::THINNING_ZHANGSUEN);
    std::vector<std::array<int, 2>> out;
    for (int y = 0; y < part.height; ++y)
        for (int x = 0; x < part.width; ++x)
            if (thin.at<uint8_t>(y, x) && marked.at(x + part.x, y + part.y)) out.push_back({x + part.x, y + part.y});
    return out;
}

Image8 downscale(ImageView<uint8_t> image, int width, int height) {
    cv::Mat out;
    cv::resize(wrap(image), out, cv::Size(width, height), 0, 0, cv::INTER_AREA);
    return unwrap(out);
}

}  // namespace vdbcarve::io
