// SPDX-License-Identifier: Apache-2.0
// Between our images and OpenCV's.
#pragma once

#include <opencv2/core.hpp>

#include "io_image.h"

namespace vdbcarve::io {

/// Borrows the pixels.
inline cv::Mat wrap(ImageView<uint8_t> image) {
    return {image.height, image.width, CV_8UC(image.channels), const_cast<uint8_t*>(image.data)};
}

inline Image8 unwrap(const cv::Mat& m) {
    Image8 out(m.cols, m.rows, m.channels());
    for (int y = 0; y < m.rows; ++y)
        std::copy_n(m.ptr<uint8_t>(y), static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()),
                    out.data.data() + static_cast<size_t>(y) * static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()));
    return out;
}

}  // namespace vdbcarve::io
