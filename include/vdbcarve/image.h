// SPDX-License-Identifier: Apache-2.0
// Plain images: owners (Image) and non-owning views (ImageView), rows without padding.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdbcarve {

/// Borrowed pixels: row-major, `channels` interleaved values a pixel, no padding.
template <class T>
struct ImageView {
    const T* data = nullptr;
    int width = 0, height = 0, channels = 1;

    bool empty() const { return data == nullptr || width == 0 || height == 0; }
    size_t pixels() const { return static_cast<size_t>(width) * static_cast<size_t>(height); }
    const T& at(int x, int y, int c = 0) const {
        return data[(static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)) * static_cast<size_t>(channels) + static_cast<size_t>(c)];
    }
};

/// Owned pixels of the same layout.
template <class T>
struct Image {
    std::vector<T> data;
    int width = 0, height = 0, channels = 1;

    Image() = default;
    Image(int w, int h, int c = 1, T fill = T())
        : data(static_cast<size_t>(w) * static_cast<size_t>(h) * static_cast<size_t>(c), fill), width(w), height(h), channels(c) {}

    bool empty() const { return data.empty(); }
    size_t pixels() const { return static_cast<size_t>(width) * static_cast<size_t>(height); }
    T& at(int x, int y, int c = 0) { return const_cast<T&>(view().at(x, y, c)); }
    const T& at(int x, int y, int c = 0) const { return view().at(x, y, c); }
    ImageView<T> view() const { return {data.data(), width, height, channels}; }
    operator ImageView<T>() const { return view(); }  // NOLINT(google-explicit-constructor): an owner lends itself
};

using Image8 = Image<uint8_t>;
using Image16 = Image<uint16_t>;
using ImageF = Image<float>;

/// A photograph with the 8 or 16 bits a channel that its file has: sRGB; grey, RGB or RGBA. One of the two is empty.
struct Photo {
    Image8 pixels8;
    Image16 pixels16;
    bool empty() const { return pixels8.empty() && pixels16.empty(); }
};

struct PhotoView {
    ImageView<uint8_t> pixels8;
    ImageView<uint16_t> pixels16;
    bool empty() const { return pixels8.empty() && pixels16.empty(); }
    int width() const { return pixels8.empty() ? pixels16.width : pixels8.width; }
    int height() const { return pixels8.empty() ? pixels16.height : pixels8.height; }
    int channels() const { return pixels8.empty() ? pixels16.channels : pixels8.channels; }
};

inline PhotoView view_of(const Photo& photo) { return {photo.pixels8.view(), photo.pixels16.view()}; }

/// A silhouette in three states. `coverage` is the share of each pixel that the object covers, 0..255; the
/// contour is where it crosses 1/2. `ignore` is empty or non-zero where the view says nothing.
struct Mask {
    Image8 coverage;
    Image8 ignore;
};

struct MaskView {
    ImageView<uint8_t> coverage;
    ImageView<uint8_t> ignore;
};

inline MaskView view_of(const Mask& mask) { return {mask.coverage.view(), mask.ignore.view()}; }

}  // namespace vdbcarve
