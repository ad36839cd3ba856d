// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "image/image_io.h"
#include "mask/mask_clean_up.h"
#include "mask/mask_methods.h"
#include "mask/otsu.h"
#include "vdbcarve/error.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {
namespace {

/// Blue and red difference (ITU-R BT.601) by brightness: what a cloth's colour has alike in light and shade. The addend keeps the noise of black out.
Vec2d chroma_of(const uint8_t* rgb) {
    const double luma = 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2];
    return Vec2d(0.564 * (rgb[2] - luma), 0.713 * (rgb[0] - luma)) / (luma + 16);
}

/// How much of the key a colour has: 1 the cloth, 0 grey; what leans to another hue loses by that.
double share_of_key(const uint8_t* rgb, const Vec2d& key) {
    const Vec2d c = chroma_of(rgb) / key.squaredNorm();
    return c.dot(key) - 0.8 * std::fabs(c.x() * key.y() - c.y() * key.x());
}

constexpr double kMostShare = 1.5, kLeastShare = -0.5;
uint8_t quantised(double share) { return static_cast<uint8_t>(std::lround(255 * std::clamp((share - kLeastShare) / (kMostShare - kLeastShare), 0.0, 1.0))); }

Vec2d key_of(const ChromaOptions& options) { return chroma_of(options.key_rgb->data()); }

}  // namespace

void find_chroma_key(const std::vector<std::filesystem::path>& photos, ChromaOptions& options) {
    constexpr int kBins = 150;
    constexpr double kBin = 0.04;  // of chroma_of(), -3 to 3
    constexpr double kLeastChroma = 0.12;
    if (!options.key_rgb) {
        struct Bin {
            double count = 0;
            std::array<double, 3> rgb{};
        };
        std::vector<std::vector<Bin>> each(photos.size(), std::vector<Bin>(kBins * kBins));
        tbb::parallel_for(size_t{0}, photos.size(), [&](size_t i) {
            const Image8 photo = io::read_photo8(photos[i]);
            if (photo.channels < 3) throw InputError(photos[i].string() + ": is grey: there is no colour to key. Remedy: --mask threshold");
            const int band = std::max(4, std::min(photo.width, photo.height) / 40);
            for (int y = 0; y < photo.height; ++y)
                for (int x = 0; x < photo.width; ++x) {
                    if (x >= band && y >= band && x < photo.width - band && y < photo.height - band) {
                        x = photo.width - band - 1;
                        continue;
                    }
                    const uint8_t* p = &photo.at(x, y);
                    const Vec2d c = chroma_of(p);
                    const auto at = [&](double v) { return std::clamp(static_cast<int>(v / kBin) + kBins / 2, 0, kBins - 1); };
                    Bin& bin = each[i][static_cast<size_t>(at(c.y()) * kBins + at(c.x()))];
                    bin.count += 1;
                    for (size_t k = 0; k < 3; ++k) bin.rgb[k] += p[k];
                }
        });
        // Three by three bins together, so that a colour between two is not halved.
        Bin best;
        for (int v = 1; v + 1 < kBins; ++v)
            for (int u = 1; u + 1 < kBins; ++u) {
                Bin sum;
                for (const auto& bins : each)
                    for (int dv = -1; dv <= 1; ++dv)
                        for (int du = -1; du <= 1; ++du) {
                            const Bin& b = bins[static_cast<size_t>((v + dv) * kBins + u + du)];
                            sum.count += b.count;
                            for (size_t k = 0; k < 3; ++k) sum.rgb[k] += b.rgb[k];
                        }
                if (sum.count > best.count) best = sum;
            }
        std::array<uint8_t, 3> key{};
        for (size_t k = 0; k < 3; ++k) key[k] = static_cast<uint8_t>(std::lround(best.rgb[k] / best.count));
        options.key_rgb = key;
    }
    if (key_of(options).norm() < kLeastChroma) {
        const auto& k = *options.key_rgb;
        throw InputError("--mask chroma: the backdrop, " + std::to_string(k[0]) + "," + std::to_string(k[1]) + "," + std::to_string(k[2]) +
                         ", is nearly grey. Remedy: --chroma-key R,G,B, if another colour was meant; --mask threshold, clean-plate or grabcut");
    }
    if (options.level > 0) return;
    std::vector<Histogram> histograms(photos.size());
    const Vec2d key = key_of(options);
    tbb::parallel_for(size_t{0}, photos.size(), [&](size_t i) {
        const Image8 photo = io::read_photo8(photos[i]);
        if (photo.channels < 3) throw InputError(photos[i].string() + ": is grey: there is no colour to key. Remedy: --mask threshold");
        for (size_t p = 0; p < photo.pixels(); ++p) ++histograms[i][quantised(share_of_key(&photo.data[p * static_cast<size_t>(photo.channels)], key))];
    });
    Histogram sum{};
    for (const Histogram& h : histograms)
        for (size_t v = 0; v < h.size(); ++v) sum[v] += h[v];
    // Half of the key is where it should be; spill and folds move it, but not far.
    options.level = std::clamp(kLeastShare + (kMostShare - kLeastShare) * otsu_level(sum, false) / 255, 0.3, 0.7);
}

Mask chroma_mask(ImageView<uint8_t> photo, const ChromaOptions& options, const MaskCleanUp& cleaning) {
    if (photo.channels < 3) throw InputError("chroma_mask: a grey photograph has no colour to key");
    if (!options.key_rgb || !(options.level > 0)) throw InputError("chroma_mask: neither a key nor a level");
    const Vec2d key = key_of(options);
    cv::Mat binary(photo.height, photo.width, CV_8U);
    for (int y = 0; y < photo.height; ++y)
        for (int x = 0; x < photo.width; ++x) binary.at<uint8_t>(y, x) = share_of_key(&photo.at(x, y), key) < options.level ? 255 : 0;
    clean_up(binary, cleaning);
    return {soft_edge(photo, binary), {}};
}

}  // namespace vdbcarve
