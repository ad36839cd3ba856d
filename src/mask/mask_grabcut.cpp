// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "mask/mask_clean_up.h"
#include "image/opencv_image.h"
#include "base/text.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

Image8 seed_of_box(int width, int height, const std::optional<std::array<int, 4>>& box_px) {
    const int margin = std::max(2, std::min(width, height) / 20);
    const std::array<int, 4> box = box_px.value_or(std::array<int, 4>{margin, margin, width - margin, height - margin});
    if (box[0] < 0 || box[1] < 0 || box[2] > width || box[3] > height)
        throw InputError(
            text_of("--grabcut-box %d,%d,%d,%d reaches outside the photograph, which has %d x %d pixels", box[0], box[1], box[2], box[3], width, height));
    Image8 out(width, height);
    for (int y = std::max(0, box[1]); y < std::min(height, box[3]); ++y)
        for (int x = std::max(0, box[0]); x < std::min(width, box[2]); ++x) out.at(x, y) = 128;
    return out;
}

Image8 seed_of_mask(ImageView<uint8_t> coverage, double uncertain_px) {
    const cv::Mat object = io::wrap(coverage) >= 128, background = object == 0;
    cv::Mat inside, outside;
    cv::distanceTransform(object, inside, cv::DIST_L2, cv::DIST_MASK_PRECISE);
    cv::distanceTransform(background, outside, cv::DIST_L2, cv::DIST_MASK_PRECISE);
    Image8 out(coverage.width, coverage.height);
    for (int y = 0; y < coverage.height; ++y)
        for (int x = 0; x < coverage.width; ++x) {
            const bool in = object.at<uint8_t>(y, x) != 0;
            const bool certain = (in ? inside : outside).at<float>(y, x) > static_cast<float>(uncertain_px);
            out.at(x, y) = certain ? (in ? 255 : 0) : in ? 160 : 96;
        }
    return out;
}

Mask grabcut_mask(ImageView<uint8_t> photo, ImageView<uint8_t> seed, const GrabCutOptions& options, const MaskCleanUp& cleaning) {
    if (photo.channels < 3 || seed.width != photo.width || seed.height != photo.height)
        throw InputError("grabcut_mask: a colour photograph and a seed of its size are needed");
    // Its time grows faster than the pixels; the edge is found again in the photograph itself.
    const double factor = std::min(1.0, std::sqrt(4e5 / (static_cast<double>(photo.width) * photo.height)));
    cv::Mat colour, small_photo, small_seed;
    cv::cvtColor(io::wrap(photo), colour, photo.channels == 4 ? cv::COLOR_RGBA2BGR : cv::COLOR_RGB2BGR);
    cv::resize(colour, small_photo, {}, factor, factor, cv::INTER_AREA);
    cv::resize(io::wrap(seed), small_seed, small_photo.size(), 0, 0, cv::INTER_NEAREST);
    cv::Mat labels(small_photo.size(), CV_8U);
    size_t maybe = 0, background = 0;
    for (int y = 0; y < labels.rows; ++y)
        for (int x = 0; x < labels.cols; ++x) {
            const uint8_t s = small_seed.at<uint8_t>(y, x);
            labels.at<uint8_t>(y, x) = s == 0 ? cv::GC_BGD : s == 255 ? cv::GC_FGD : s >= 128 ? cv::GC_PR_FGD : cv::GC_PR_BGD;
            maybe += s >= 128, background += s < 128;
        }
    if (maybe < 20 || background < 20)
        throw InputError(
            text_of("grabcut: the seed has %zu pixels of object and %zu of background: there is nothing to learn colours from. Remedy: a --grabcut-box that "
                    "holds the object and leaves background around it",
                    maybe, background));
    cv::setRNGSeed(1);  // its own clustering throws dice; the same ones every time and on every thread
    cv::Mat behind, front;
    cv::grabCut(small_photo, labels, {}, behind, front, options.iterations, cv::GC_INIT_WITH_MASK);
    const cv::Mat small_object = (labels & 1) * 255;
    cv::Mat smooth, binary;
    cv::resize(small_object, smooth, {photo.width, photo.height}, 0, 0, cv::INTER_LINEAR);
    binary = smooth >= 128;
    clean_up(binary, cleaning);
    return {soft_edge(photo, binary), {}};
}

}  // namespace vdbcarve
