// SPDX-License-Identifier: Apache-2.0
// Reading, writing and undistorting pictures through OpenCV. Private: OpenCV appears in no header.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"

namespace vdbcarve::io {

/// Of pictures that are read, in lower case.
extern const std::vector<std::string> kPictureExtensions;
/// By its name.
bool is_picture(const std::filesystem::path& file);

/// 8-bit pixels as stored, with 1 (grey), 3 (RGB) or 4 (RGBA) channels; 16-bit files are rounded to 8 bits in a way
/// that keeps every pixel on its side of 1/2. For masks: neither EXIF orientation nor a colour profile is heeded. Throws InputError
/// naming the file.
Image8 read_image8(const std::filesystem::path& file);

/// A photograph with the file's own 8 or 16 bits: colours of an embedded profile become sRGB, and the picture is turned by an EXIF
/// orientation (View::orientation; 1: left as stored). Throws InputError naming the file.
Photo read_photo(const std::filesystem::path& file, int orientation = 1);

/// The same in 8 bits, rounded like masks.
Image8 read_photo8(const std::filesystem::path& file, int orientation = 1);

/// A stored picture as its EXIF orientation (1..8) says that it is to be shown.
Image8 turned(Image8 image, int orientation);

/// Width and height as stored, from the header where that is simple. Throws InputError.
std::pair<int, int> stored_size(const std::filesystem::path& file);

/// PNG bytes of a grey, RGB or RGBA picture. Deterministic.
std::vector<uint8_t> encode_png(ImageView<uint8_t> image);

/// The same as a file, which appears by rename. Throws OutputError.
void write_png(const std::filesystem::path& file, ImageView<uint8_t> image);

/// TIFF bytes, 32-bit floats.
std::vector<uint8_t> encode_tiff(const ImageF& image);

/// The picture that a camera with the same intrinsics and no lens distortion would have taken, linear
/// interpolation. `outside` (optional) becomes 255 where the source picture has no pixel.
Image8 undistort(ImageView<uint8_t> image, const Intrinsics& intrinsics, const Lens& lens, Image8* outside);

Photo undistort(const Photo& photo, const Intrinsics& intrinsics, const Lens& lens);

/// Grey values of a photograph as a camera without distortion would have taken it, 8 bits.
Image8 read_grey(const std::filesystem::path& file, int orientation, const Intrinsics& intrinsics, const Lens& lens);

/// What a camera with this lens sees of `image`, taken by the same camera without distortion but with `margin` more pixels on
/// every side; the reverse of undistort. Linear interpolation.
Image8 distort(ImageView<uint8_t> image, int margin, const Intrinsics& intrinsics, const Lens& lens);

/// Mean square of the Laplacian of the grey picture, made 640 px wide: only pictures of the same thing compare.
double sharpness(ImageView<uint8_t> image);

/// Gaussian blur.
Image8 blurred(ImageView<uint8_t> image, double sigma_px);

/// JPEG bytes of a grey or RGB picture. focal_35mm > 0: with an EXIF block that says the focal length as on 36 mm wide film.
std::vector<uint8_t> encode_jpeg(ImageView<uint8_t> image, int quality, double focal_35mm);

/// The largest 8-connected piece of what is not 0.
struct Component {
    size_t pixels = 0;
    std::array<int, 4> box{};  ///< x0, y0, x1, y1, the last ones outside
};
Component largest_component(ImageView<uint8_t> image);

/// Pixels of the skeleton (Zhang and Suen 1984) of the object (coverage >= 1/2) that are marked and where the object is
/// thin, at most kThinHalfWidth_px to its border: one pixel wide lines.
inline constexpr int kThinHalfWidth_px = 10;
std::vector<std::array<int, 2>> skeleton_near(ImageView<uint8_t> coverage, ImageView<uint8_t> marked);

/// Writes a word across the picture, red, so that nobody takes it for something else.
void stamp(Image8& image, const std::string& word);

/// A line of dark text in small letters, its baseline at y, cut where it would be wider than `width`.
void write_text(Image8& image, int x, int y, int width, const std::string& text);

/// Smaller copy by area averaging.
Image8 downscale(ImageView<uint8_t> image, int width, int height);

}  // namespace vdbcarve::io
