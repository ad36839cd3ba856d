// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "mask/mask_clean_up.h"
#include "image/opencv_image.h"
#include "mask/otsu.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/error.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {
namespace {

/// Logarithm of what one channel of the photograph is of the plate's, as a plane over the frame: lamps drift in strength, colour and side.
struct Drift {
    Vec3d plane = Vec3d::Zero();  ///< of 1, x and y, the frame from -1 to 1
    double at(double x, double y) const { return std::exp(plane.dot(Vec3d(1, x, y))); }
};

/// Robust, for the object stands in the way: medians of blocks, weighed by Tukey's function of how far they are off.
Drift find_drift(ImageView<uint8_t> photo, ImageView<uint8_t> plate, int channel) {
    constexpr int kBlocks = 24;
    std::vector<Vec3d> places;
    std::vector<double> ratios;
    for (int v = 0; v < kBlocks; ++v)
        for (int u = 0; u < kBlocks; ++u) {
            std::vector<double> block;
            const int x0 = u * photo.width / kBlocks, x1 = (u + 1) * photo.width / kBlocks, y0 = v * photo.height / kBlocks,
                      y1 = (v + 1) * photo.height / kBlocks;
            const int step = std::max(1, (x1 - x0) / 12);
            for (int y = y0; y < y1; y += step)
                for (int x = x0; x < x1; x += step) {
                    const int c = photo.at(x, y, channel), p = plate.at(x, y, channel);
                    if (p > 5 && p < 250 && c > 5 && c < 250) block.push_back(std::log(static_cast<double>(c) / p));  // neither black nor burnt out
                }
            if (block.size() < 6) continue;
            ratios.push_back(median(block));
            places.emplace_back(1, 2 * (u + 0.5) / kBlocks - 1, 2 * (v + 0.5) / kBlocks - 1);
        }
    Drift out;
    if (ratios.size() < 12) return out;
    out.plane[0] = median(ratios);
    for (int round = 0; round < 30; ++round) {
        std::vector<double> off;
        for (size_t k = 0; k < ratios.size(); ++k) off.push_back(std::fabs(ratios[k] - out.plane.dot(places[k])));
        const double reach = 4.7 * std::max(0.005, 1.48 * median(off));
        Mat3d h = 1e-3 * Mat3d::Identity();
        Vec3d g = Vec3d::Zero();
        for (size_t k = 0; k < ratios.size(); ++k) {
            const double t = off[k] / reach, w = t < 1 ? (1 - t * t) * (1 - t * t) : 0;
            h += w * places[k] * places[k].transpose();
            g += w * places[k] * ratios[k];
        }
        const Vec3d plane = h.ldlt().solve(g);
        const bool settled = (plane - out.plane).norm() < 1e-6;
        out.plane = plane;
        if (settled) break;
    }
    return out;
}

Image8 without_alpha(ImageView<uint8_t> photo) {
    Image8 out(photo.width, photo.height, 3);
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x)
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = photo.at(x, y, c);
    return out;
}

constexpr uint8_t kPerhaps = 128, kShadow = 255;

/// All of 0 and 255.
cv::Mat grown_within(cv::Mat seed, const cv::Mat& within, int steps) {
    cv::Mat grown;
    for (int step = 0; step < steps; ++step) {
        cv::dilate(seed, grown, cv::getStructuringElement(cv::MORPH_RECT, {3, 3}));
        cv::bitwise_and(grown, within, seed);
    }
    return seed;
}

/// What is a shadow becomes background: with its edge, as far as that may be one; but not where most of what lies around it is object, for then it is a part of
/// the object that happens to look like one. An object of the table's colour touches its shadow; where they meet, brightness jumps, so pieces are judged as
/// they are without their edges.
void remove_shadows(cv::Mat& binary, const cv::Mat& shadow) {
    constexpr int kEdge_px = 6;
    cv::Mat found = shadow == kShadow;
    cv::morphologyEx(found, found, cv::MORPH_OPEN, cv::getStructuringElement(cv::MORPH_ELLIPSE, {3, 3}));
    cv::Mat labels;
    const int n = cv::connectedComponents(found, labels, 4, CV_32S);
    std::vector<size_t> beside_object(static_cast<size_t>(n), 0), beside_background(static_cast<size_t>(n), 0);
    const auto label_at = [&](int x, int y) { return x >= 0 && y >= 0 && x < binary.cols && y < binary.rows ? labels.at<int>(y, x) : -1; };
    for (int y = 0; y < binary.rows; ++y)
        for (int x = 0; x < binary.cols; ++x) {
            const int label = labels.at<int>(y, x);
            if (!label) continue;
            for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
                if (label_at(x + dx, y + dy) == label) continue;
                const int u = x + (kEdge_px + 1) * dx, v = y + (kEdge_px + 1) * dy, beyond = label_at(u, v);
                if (beyond >= 0 && beyond != label) ++(binary.at<uint8_t>(v, u) ? beside_object : beside_background)[static_cast<size_t>(label)];
            }
        }
    cv::Mat gone = cv::Mat::zeros(binary.size(), CV_8U), within = shadow > 0;
    for (int y = 0; y < binary.rows; ++y)
        for (int x = 0; x < binary.cols; ++x) {
            const auto label = static_cast<size_t>(labels.at<int>(y, x));
            if (!label) continue;
            const bool is_shadow = 3 * beside_background[label] > beside_object[label];
            (is_shadow ? gone : within).at<uint8_t>(y, x) = is_shadow ? 255 : 0;
        }
    binary.setTo(0, grown_within(gone, within, kEdge_px));
}

}  // namespace

Mask plate_mask(ImageView<uint8_t> photo, ImageView<uint8_t> plate, const PlateOptions& options, const MaskCleanUp& cleaning) {
    if (photo.width != plate.width || photo.height != plate.height || photo.channels < 3 || plate.channels < 3)
        throw InputError(text_of("plate_mask: a photograph of %d x %d pixels and a plate of %d x %d; colour and one size are needed", photo.width, photo.height,
                                 plate.width, plate.height));
    std::array<Drift, 3> drift;
    for (int c = 0; c < 3; ++c) drift[static_cast<size_t>(c)] = find_drift(photo, plate, c);
    Image8 expected(photo.width, photo.height, 3);
    std::array<Histogram, 3> off{};
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x)
            for (int c = 0; c < 3; ++c) {
                const double gain = drift[static_cast<size_t>(c)].at(2 * (x + 0.5) / photo.width - 1, 2 * (y + 0.5) / photo.height - 1);
                const auto value = static_cast<uint8_t>(std::clamp(std::lround(gain * plate.at(x, y, c)), 0L, 255L));
                expected.at(x, y, c) = value;
                ++off[static_cast<size_t>(c)][static_cast<size_t>(std::abs(photo.at(x, y, c) - value))];
            }
    // Noise from the median difference (half of the picture or more is background), and what a plate of a textured wall is off by.
    std::array<double, 3> noise{};
    for (size_t c = 0; c < 3; ++c) {
        uint64_t seen = 0;
        size_t v = 0;
        for (; v < 255 && 2 * (seen + off[c][v]) < photo.pixels(); ++v) seen += off[c][v];
        const double within = (0.5 * static_cast<double>(photo.pixels()) - static_cast<double>(seen)) / std::max(1.0, static_cast<double>(off[c][v]));
        noise[c] = std::max(1.0, 1.48 * (static_cast<double>(v) - 0.5 + within));
    }
    // Differences are taken smoothed: noise is a third of a pixel's then, and single pixels of it are neither; the edge is found again below.
    constexpr double kSmooth_px = 0.8;
    cv::Mat seen, meant, ratio(photo.height, photo.width, CV_32F);
    cv::GaussianBlur(io::wrap(without_alpha(photo).view()), seen, {}, kSmooth_px);
    cv::GaussianBlur(io::wrap(expected.view()), meant, {}, kSmooth_px);
    const auto at = [](const cv::Mat& m, int x, int y) {
        const auto& v = m.at<cv::Vec3b>(y, x);
        return Vec3d(v[0], v[1], v[2]);
    };
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x) ratio.at<float>(y, x) = static_cast<float>(at(seen, x, y).sum() / std::max(3.0, at(meant, x, y).sum()));
    cv::Mat mean, squares;
    cv::boxFilter(ratio, mean, CV_32F, {7, 7});
    cv::boxFilter(ratio.mul(ratio), squares, CV_32F, {7, 7});
    cv::Mat binary(photo.height, photo.width, CV_8U), perhaps(photo.height, photo.width, CV_8U), shadow = cv::Mat::zeros(photo.height, photo.width, CV_8U);
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x) {
            const Vec3d s = at(seen, x, y), m = at(meant, x, y);
            Vec3d sigma;
            for (int c = 0; c < 3; ++c) sigma[c] = std::hypot(noise[static_cast<size_t>(c)], 0.02 * m[c]);
            const auto far = [&](const Vec3d& difference) { return difference.cwiseQuotient(sigma).norm() / std::sqrt(3.0); };
            const double distance = far(s - m);
            binary.at<uint8_t>(y, x) = distance > options.level ? 255 : 0;
            perhaps.at<uint8_t>(y, x) = distance > 0.5 * options.level ? 255 : 0;
            if (distance < 0.5 * options.level || !options.shadows) continue;
            // A shadow is the same colour, darker (Horprasert, Harwood and Davis, "A statistical approach for real-time robust background subtraction and
            // shadow detection", 1999), by a share that changes slowly but at its edge, so that the plate's own texture shows through.
            const double share = s.dot(m) / std::max(1.0, m.squaredNorm()), level = mean.at<float>(y, x);
            if (share < 0.3 || share > 0.98 || 1.5 * far(s - share * m) > options.level) continue;
            const double varies = std::sqrt(std::max(0.0, squares.at<float>(y, x) - level * level)), by_noise = sigma.sum() / std::max(3.0, m.sum());
            shadow.at<uint8_t>(y, x) = varies < 1.5 * by_noise + 0.02 ? kShadow : kPerhaps;
        }
    binary = grown_within(binary, perhaps,
                          std::max(8, photo.height / 40));  // where the object's colour comes near the plate's, less is enough beside what is certain
    if (options.shadows) remove_shadows(binary, shadow);
    clean_up(binary, cleaning);
    return {soft_edge(photo, binary, expected), {}};
}

}  // namespace vdbcarve
