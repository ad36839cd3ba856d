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

Image8 blurred(ImageView<uint8_t> image, double sigma_px) {
    cv::Mat out;
    cv::GaussianBlur(wrap(image), out, cv::Size(), sigma_px, sigma_px, cv::BORDER_REPLICATE);
    return unwrap(out);
}

std::vector<uint8_t> encode_jpeg(ImageView<uint8_t> image, int quality, double focal_35mm) {
    cv::Mat m = wrap(image).clone();
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_RGB2BGR);
    std::vector<uint8_t> bytes;
    if (!cv::imencode(".jpg", m, bytes, {cv::IMWRITE_JPEG_QUALITY, quality})) throw OutputError("a JPEG could not be encoded");
    if (!(focal_35mm > 0)) return bytes;
    // An APP1 segment after the start marker: TIFF, little-endian, one directory that points to the EXIF one, which says
    // FocalLength (0x920A, rational, mm) and FocalLengthIn35mmFilm (0xA405, short, mm).
    std::vector<uint8_t> exif;
    const auto put = [&](uint64_t value, int count) {
        for (int i = 0; i < count; ++i) exif.push_back(static_cast<uint8_t>(value >> (8 * i)));
    };
    for (const char c : {'E', 'x', 'i', 'f', '\0', '\0', 'I', 'I'}) exif.push_back(static_cast<uint8_t>(c));
    put(42, 2), put(8, 4);                                            // the first directory starts at 8
    put(1, 2), put(0x8769, 2), put(4, 2), put(1, 4), put(26, 4), put(0, 4);  // one entry: the EXIF directory is at 26
    put(2, 2);
    put(0x920A, 2), put(5, 2), put(1, 4), put(56, 4);                 // its rational is at 56
    put(0xA405, 2), put(3, 2), put(1, 4), put(static_cast<uint64_t>(focal_35mm + 0.5), 4);
    put(0, 4);
    put(static_cast<uint64_t>(focal_35mm * 1000 + 0.5), 4), put(1000, 4);
    std::vector<uint8_t> segment{0xFF, 0xE1, static_cast<uint8_t>((exif.size() + 2) >> 8), static_cast<uint8_t>(exif.size() + 2)};
    segment.insert(segment.end(), exif.begin(), exif.end());
    bytes.insert(bytes.begin() + 2, segment.begin(), segment.end());
    return bytes;
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
    // Thinning looks at every pixel again and again: only around each piece of what is marked, with room for the shape to be told.
    const cv::Rect all(0, 0, coverage.width, coverage.height);
    cv::Mat labels, statistics, centres, half_width;
    cv::distanceTransform(object, half_width, cv::DIST_L2, 3);
    const int pieces = cv::connectedComponentsWithStats(wrap(marked), labels, statistics, centres, 8, CV_32S);
    std::vector<std::array<int, 2>> out;
    for (int n = 1; n < pieces; ++n) {
        constexpr int kRoom = 2 * kThinHalfWidth_px, kSpeck = 3;
        if (statistics.at<int>(n, cv::CC_STAT_AREA) < kSpeck) continue;
        const cv::Rect part = cv::Rect(statistics.at<int>(n, cv::CC_STAT_LEFT) - kRoom, statistics.at<int>(n, cv::CC_STAT_TOP) - kRoom,
                                       statistics.at<int>(n, cv::CC_STAT_WIDTH) + 2 * kRoom, statistics.at<int>(n, cv::CC_STAT_HEIGHT) + 2 * kRoom) & all;
        cv::Mat thin;
        cv::ximgproc::thinning(object(part), thin, cv::ximgproc::THINNING_ZHANGSUEN);
        for (int y = 0; y < part.height; ++y)
            for (int x = 0; x < part.width; ++x)
                if (thin.at<uint8_t>(y, x) && half_width.at<float>(y + part.y, x + part.x) <= kThinHalfWidth_px && labels.at<int>(y + part.y, x + part.x) == n) out.push_back({x + part.x, y + part.y});
    }
    return out;
}

Image8 downscale(ImageView<uint8_t> image, int width, int height) {
    cv::Mat out;
    cv::resize(wrap(image), out, cv::Size(width, height), 0, 0, cv::INTER_AREA);
    return unwrap(out);
}

}  // namespace vdbcarve::io
