// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "vdbcarve/error.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {

PhotoAgreement compare_photo(ImageView<uint8_t> rendered, const PhotoView& photo, const MaskView& mask) {
    const int width = rendered.width, height = rendered.height;
    if (rendered.channels != 4 || photo.width() != width || photo.height() != height) throw UsageError("compare_photo: the pictures differ in size");
    const int channels = photo.channels();
    const auto value = [&](int x, int y, int c) {
        const int from = channels < 3 ? 0 : c;
        return photo.pixels8.empty() ? photo.pixels16.at(x, y, from) / 257.0 : static_cast<double>(photo.pixels8.at(x, y, from));
    };
    cv::Mat1d inside(height, width, 0.0), a(height, width, 0.0), b(height, width, 0.0);
    PhotoAgreement out;
    double squares = 0;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            if (!rendered.at(x, y, 3)) continue;
            if (!mask.coverage.empty() && mask.coverage.at(x, y) < 128) continue;
            if (!mask.ignore.empty() && mask.ignore.at(x, y)) continue;
            const double weights[3] = {0.299, 0.587, 0.114};
            for (int c = 0; c < 3; ++c) {
                const double p = rendered.at(x, y, c), q = value(x, y, c);
                squares += (p - q) * (p - q);
                a(y, x) += weights[c] * p;
                b(y, x) += weights[c] * q;
            }
            inside(y, x) = 1;
            ++out.pixels;
        }
    if (out.pixels == 0) return out;
    const double mse = squares / (3.0 * static_cast<double>(out.pixels));
    out.psnr_db = mse > 0 ? 10 * std::log10(255.0 * 255.0 / mse) : INFINITY;
    const auto blurred = [](const cv::Mat1d& m) {
        cv::Mat1d blur;
        cv::GaussianBlur(m, blur, cv::Size(11, 11), 1.5, 1.5, cv::BORDER_CONSTANT);
        return blur;
    };
    const cv::Mat1d weight = blurred(inside), sa = blurred(a), sb = blurred(b), saa = blurred(a.mul(a)), sbb = blurred(b.mul(b)), sab = blurred(a.mul(b));
    const double c1 = std::pow(0.01 * 255, 2), c2 = std::pow(0.03 * 255, 2);
    double sum = 0;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            if (inside(y, x) == 0) continue;
            const double w = weight(y, x), ma = sa(y, x) / w, mb = sb(y, x) / w;
            const double va = saa(y, x) / w - ma * ma, vb = sbb(y, x) / w - mb * mb, cov = sab(y, x) / w - ma * mb;
            sum += (2 * ma * mb + c1) * (2 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
        }
    out.ssim = sum / static_cast<double>(out.pixels);
    return out;
}

}  // namespace vdbcarve
