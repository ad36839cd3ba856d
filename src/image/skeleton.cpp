// SPDX-License-Identifier: Apache-2.0
#include <opencv2/imgproc.hpp>
#include <opencv2/ximgproc.hpp>

#include "image/opencv_image.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {

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
                                       statistics.at<int>(n, cv::CC_STAT_WIDTH) + 2 * kRoom, statistics.at<int>(n, cv::CC_STAT_HEIGHT) + 2 * kRoom) &
                              all;
        cv::Mat thin;
        cv::ximgproc::thinning(object(part), thin, cv::ximgproc::THINNING_ZHANGSUEN);
        for (int y = 0; y < part.height; ++y)
            for (int x = 0; x < part.width; ++x)
                if (thin.at<uint8_t>(y, x) && half_width.at<float>(y + part.y, x + part.x) <= kThinHalfWidth_px && labels.at<int>(y + part.y, x + part.x) == n)
                    out.push_back({x + part.x, y + part.y});
    }
    return out;
}

}  // namespace vdbcarve::io
