// SPDX-License-Identifier: Apache-2.0
// Between our images and OpenCV's.
#pragma once

#include <opencv2/core.hpp>

#include "image/image_io.h"

namespace vdbcarve::io {

/// Borrows the pixels.
template <class T>
cv::Mat wrap(ImageView<T> image) {
    return {image.height, image.width, CV_MAKETYPE(cv::DataType<T>::depth, image.channels), const_cast<T*>(image.data)};
}

template <class T = uint8_t>
Image<T> unwrap(const cv::Mat& m) {
    Image<T> out(m.cols, m.rows, m.channels());
    for (int y = 0; y < m.rows; ++y)
        std::copy_n(m.ptr<T>(y), static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()),
                    out.data.data() + static_cast<size_t>(y) * static_cast<size_t>(m.cols) * static_cast<size_t>(m.channels()));
    return out;
}

/// sharpness() of a picture that is grey and small already.
double sharpness_of(const cv::Mat& grey);
inline constexpr int kSharpWidth_px = 640;

}  // namespace vdbcarve::io
