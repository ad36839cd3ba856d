// SPDX-License-Identifier: Apache-2.0
// Files of pictures; what needs no codec is in image_geometry.cpp and skeleton.cpp, so that programs that read none do without them.
#include <algorithm>
#include <cctype>
#include <fstream>
#include <iterator>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "base/atomic_file.h"
#include "image/codecs.h"
#include "image/opencv_image.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {

const std::vector<std::string> kPictureExtensions{".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm", ".pgm", ".bmp", ".webp", ".heic", ".heif", ".avif"};

bool is_picture(const std::filesystem::path& file) {
    std::string extension = file.extension().string();
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return std::find(kPictureExtensions.begin(), kPictureExtensions.end(), extension) != kPictureExtensions.end();
}

namespace {

/// A file's pixels through the library for its kind.
Decoded decode(const std::filesystem::path& file) {
    const std::vector<uint8_t> bytes = file_bytes(file);
    if (is_jpeg(bytes)) return decode_jpeg(bytes, file);
    if (is_heif(bytes)) return decode_heif(bytes, file);
    cv::Mat m;
    try {
        if (!bytes.empty()) m = cv::imdecode(bytes, cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
    } catch (const cv::Exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
    if (m.empty()) throw InputError(file.string() + ": is not a picture that can be decoded, or is damaged");
    if (m.depth() != CV_8U && m.depth() != CV_16U) throw InputError(file.string() + ": has neither 8 nor 16 bits a channel");
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_BGR2RGB);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_BGRA2RGBA);
    if (m.channels() == 2) throw InputError(file.string() + ": has two channels; grey, RGB and RGBA are read");
    Decoded out;
    if (m.depth() == CV_8U) out.photo.pixels8 = unwrap(m);
    else out.photo.pixels16 = unwrap<uint16_t>(m);
    out.icc_profile = embedded_profile(bytes, file);
    return out;
}

Image8 rounded(Photo photo) {
    if (photo.pixels16.empty()) return std::move(photo.pixels8);
    // (v * 255 + 32767) / 65535, rounded: 32767 -> 127, 32768 -> 128.
    const Image16& wide = photo.pixels16;
    Image8 out(wide.width, wide.height, wide.channels);
    for (size_t i = 0; i < wide.data.size(); ++i) out.data[i] = static_cast<uint8_t>((wide.data[i] * 255u + 32767u) / 65535u);
    return out;
}

template <class T>
Image<T> turn(Image<T> image, int orientation) {
    if (orientation < 2 || orientation > 8 || image.empty()) return image;
    const int w = image.width, h = image.height;
    Image<T> out(orientation < 5 ? w : h, orientation < 5 ? h : w, image.channels);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            int sx = x, sy = y;
            switch (orientation) {  // which corner of the stored picture is shown at the upper left (TIFF 6.0, Orientation)
                case 2:
                    sx = w - 1 - x;
                    break;
                case 3:
                    sx = w - 1 - x, sy = h - 1 - y;
                    break;
                case 4:
                    sy = h - 1 - y;
                    break;
                case 5:
                    sx = y, sy = x;
                    break;
                case 6:
                    sx = y, sy = h - 1 - x;
                    break;
                case 7:
                    sx = w - 1 - y, sy = h - 1 - x;
                    break;
                default:
                    sx = w - 1 - y, sy = x;
            }
            for (int c = 0; c < image.channels; ++c) out.at(x, y, c) = image.at(sx, sy, c);
        }
    return out;
}

}  // namespace

std::vector<uint8_t> file_bytes(const std::filesystem::path& file, size_t limit) {
    if (!std::filesystem::is_regular_file(file)) throw InputError(file.string() + ": no such file");
    std::ifstream in(file, std::ios::binary);
    std::vector<uint8_t> bytes(std::min<size_t>(limit, std::filesystem::file_size(file)));
    in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!in) throw InputError(file.string() + ": cannot be read");
    return bytes;
}

Image8 turned(Image8 image, int orientation) { return turn(std::move(image), orientation); }

Image8 read_image8(const std::filesystem::path& file) { return rounded(decode(file).photo); }

Photo read_photo(const std::filesystem::path& file, int orientation) {
    Decoded picture = decode(file);
    convert_to_srgb(picture);
    return {turn(std::move(picture.photo.pixels8), orientation), turn(std::move(picture.photo.pixels16), orientation)};
}

Image8 read_photo8(const std::filesystem::path& file, int orientation) { return rounded(read_photo(file, orientation)); }

std::pair<int, int> stored_size(const std::filesystem::path& file) {
    const std::vector<uint8_t> bytes = file_bytes(file, 4 << 20);  // a JPEG's header may hold a preview
    if (bytes.size() >= 24 && bytes[0] == 0x89 && bytes[1] == 'P' && bytes[2] == 'N' && bytes[3] == 'G') {
        const auto big = [&](size_t at) { return (bytes[at] << 24) | (bytes[at + 1] << 16) | (bytes[at + 2] << 8) | bytes[at + 3]; };
        return {big(16), big(20)};
    }
    if (is_jpeg(bytes)) return jpeg_size(bytes, file);
    const Image8 image = read_image8(file);
    return {image.width, image.height};
}

std::vector<uint8_t> encode_png(ImageView<uint8_t> image) {
    cv::Mat m = wrap(image).clone();
    if (m.channels() == 3) cv::cvtColor(m, m, cv::COLOR_RGB2BGR);
    if (m.channels() == 4) cv::cvtColor(m, m, cv::COLOR_RGBA2BGRA);
    std::vector<uint8_t> bytes;
    if (!cv::imencode(".png", m, bytes, {cv::IMWRITE_PNG_COMPRESSION, 3})) throw OutputError("a PNG could not be encoded");
    return bytes;
}

void write_png(const std::filesystem::path& file, ImageView<uint8_t> image) {
    const std::vector<uint8_t> png = encode_png(image);
    write_file(file, png.data(), png.size());
}

std::vector<uint8_t> encode_tiff(const ImageF& image) {
    const cv::Mat m(image.height, image.width, CV_32FC1, const_cast<float*>(image.data.data()));
    std::vector<uint8_t> bytes;
    if (!cv::imencode(".tiff", m, bytes)) throw OutputError("a TIFF could not be encoded");
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
    put(42, 2), put(8, 4);                                                   // the first directory starts at 8
    put(1, 2), put(0x8769, 2), put(4, 2), put(1, 4), put(26, 4), put(0, 4);  // one entry: the EXIF directory is at 26
    put(2, 2);
    put(0x920A, 2), put(5, 2), put(1, 4), put(56, 4);  // its rational is at 56
    put(0xA405, 2), put(3, 2), put(1, 4), put(static_cast<uint64_t>(focal_35mm + 0.5), 4);
    put(0, 4);
    put(static_cast<uint64_t>(focal_35mm * 1000 + 0.5), 4), put(1000, 4);
    std::vector<uint8_t> segment{0xFF, 0xE1, static_cast<uint8_t>((exif.size() + 2) >> 8), static_cast<uint8_t>(exif.size() + 2)};
    segment.insert(segment.end(), exif.begin(), exif.end());
    bytes.insert(bytes.begin() + 2, segment.begin(), segment.end());
    return bytes;
}

Image8 read_grey(const std::filesystem::path& file, int orientation, const Intrinsics& intrinsics, const Lens& lens) {
    Image8 photo = read_photo8(file, orientation);
    if (lens.distorts()) photo = undistort(photo.view(), intrinsics, lens, nullptr);
    if (photo.channels == 1) return photo;
    cv::Mat grey;
    cv::cvtColor(wrap(photo.view()), grey, photo.channels == 4 ? cv::COLOR_RGBA2GRAY : cv::COLOR_RGB2GRAY);
    return unwrap(grey);
}

}  // namespace vdbcarve::io
