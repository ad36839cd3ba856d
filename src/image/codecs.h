// SPDX-License-Identifier: Apache-2.0
// Decoders behind io_image.h, one a library, and what they share. Private.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "vdbcarve/image.h"

namespace vdbcarve::io {

/// Pixels as a file stores them: grey, RGB or RGBA.
struct Decoded {
    Photo photo;
    std::vector<uint8_t> icc_profile;  ///< of the colours; empty: sRGB
};

/// A file's first `limit` bytes. Throws InputError.
std::vector<uint8_t> file_bytes(const std::filesystem::path& file, size_t limit = SIZE_MAX);

bool is_jpeg(const std::vector<uint8_t>& bytes);
/// libjpeg. Half a picture is no picture: a file that was cut off or damaged, or has inks for colours (CMYK), is an InputError with the remedy.
Decoded decode_jpeg(const std::vector<uint8_t>& bytes, const std::filesystem::path& file);
/// Width and height as stored, from the header.
std::pair<int, int> jpeg_size(const std::vector<uint8_t>& bytes, const std::filesystem::path& file);

bool is_heif(const std::vector<uint8_t>& bytes);
/// libheif: HEIC and AVIF, turned as the file says.
Decoded decode_heif(const std::vector<uint8_t>& bytes, const std::filesystem::path& file);

/// The profile embedded in a PNG, WebP or TIFF file; empty where there is none.
std::vector<uint8_t> embedded_profile(const std::vector<uint8_t>& bytes, const std::filesystem::path& file);

/// Colours of a profile become sRGB (lcms2, relative colorimetric with black point compensation); grey ones, sRGB ones and those of
/// a profile that cannot be read stay as they are.
void convert_to_srgb(Decoded& picture);

}  // namespace vdbcarve::io
