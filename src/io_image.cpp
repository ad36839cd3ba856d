// SPDX-License-Identifier: Apache-2.0
// Files of pictures; what needs no codec is in image_geometry.cpp and skeleton.cpp, so that programs that read none do without them.
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "opencv_image.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {

namespace {

/// Grey, RGB or RGBA, 8 or 16 bits.
cv::Mat decode(const std::filesystem::path& file) {
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
    if (m.depth() != CV_8U && m.depth() != CV_16U) throw InputError(file.string() + ": has neither 8 nor 16 bits a channel");
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_BGR2RGB);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_BGRA2RGBA);
    if (m.channels() == 2) throw InputError(file.string() + ": has two channels; grey, RGB and RGBA are read");
    return m;
}

}  // namespace

Image8 read_image8(const std::filesystem::path& file) {
    const cv::Mat m = decode(file);
    if (m.depth() == CV_8U) return unwrap(m);
    // (v * 255 + 32767) / 65535, rounded: 32767 -> 127, 32768 -> 128.
    Image8 out(m.cols, m.rows, m.channels());
    const Image16 wide = unwrap<uint16_t>(m);
    for (size_t i = 0; i < wide.data.size(); ++i) out.data[i] = static_cast<uint8_t>((wide.data[i] * 255u + 32767u) / 65535u);
    return out;
}

Photo read_photo(const std::filesystem::path& file) {
    const cv::Mat m = decode(file);
    if (m.depth() == CV_8U) return {unwrap(m), {}};
    return {{}, unwrap<uint16_t>(m)};
}

std::vector<uint8_t> encode_png(ImageView<uint8_t> image) {
    cv::Mat m = wrap(image).clone();
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_RGB2BGR);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_RGBA2BGRA);
    std::vector<uint8_t> bytes;
    if (!cv::imencode(".png", m, bytes, {cv::IMWRITE_PNG_COMPRESSION, 3})) throw OutputError("a PNG could not be encoded");
    return bytes;
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

Image8 read_grey(const std::filesystem::path& file, const Intrinsics& intrinsics, const Lens& lens) {
    Image8 photo = read_image8(file);
    if (lens.distorts()) photo = undistort(photo.view(), intrinsics, lens, nullptr);
    if (photo.channels == 1) return photo;
    cv::Mat grey;
    cv::cvtColor(wrap(photo.view()), grey, photo.channels == 4 ? cv::COLOR_RGBA2GRAY : cv::COLOR_RGB2GRAY);
    return unwrap(grey);
}

}  // namespace vdbcarve::io
