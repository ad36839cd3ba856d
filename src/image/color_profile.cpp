// SPDX-License-Identifier: Apache-2.0
#include <lcms2.h>
#include <tiffio.h>
#include <zlib.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "image/codecs.h"

namespace vdbcarve::io {
namespace {

struct Close {
    void operator()(void* profile) const { cmsCloseProfile(profile); }
};
using Profile = std::unique_ptr<void, Close>;

struct Delete {
    void operator()(void* transform) const { cmsDeleteTransform(transform); }
};
using Transform = std::unique_ptr<void, Delete>;

Transform to_srgb(cmsHPROFILE from, cmsUInt32Number format) {
    const Profile srgb(cmsCreate_sRGBProfile());
    return Transform(cmsCreateTransform(from, format, srgb.get(), format, INTENT_RELATIVE_COLORIMETRIC,
                                        cmsFLAGS_BLACKPOINTCOMPENSATION | cmsFLAGS_COPY_ALPHA | cmsFLAGS_NOCACHE));
}

/// Many files carry the profile of what they are anyway; their pixels are to stay to the bit.
bool changes_nothing(cmsHPROFILE profile) {
    const Transform t = to_srgb(profile, TYPE_RGB_8);
    if (!t) return true;
    std::vector<uint8_t> in, out;
    for (int r = 0; r <= 255; r += 51)
        for (int g = 0; g <= 255; g += 51)
            for (int b = 0; b <= 255; b += 51)
                for (const int v : {r, g, b}) in.push_back(static_cast<uint8_t>(v));
    out.resize(in.size());
    cmsDoTransform(t.get(), in.data(), out.data(), static_cast<cmsUInt32Number>(in.size() / 3));
    return std::equal(in.begin(), in.end(), out.begin(), [](uint8_t a, uint8_t b) { return std::abs(a - b) <= 1; });
}

uint32_t big_endian(const uint8_t* p) {
    return static_cast<uint32_t>(p[0]) << 24 | static_cast<uint32_t>(p[1]) << 16 | static_cast<uint32_t>(p[2]) << 8 | p[3];
}
uint32_t little_endian(const uint8_t* p) {
    return static_cast<uint32_t>(p[3]) << 24 | static_cast<uint32_t>(p[2]) << 16 | static_cast<uint32_t>(p[1]) << 8 | p[0];
}

/// Chunk iCCP (PNG 1.2, 11.3.3.3): a name, a zero, the method (0), the profile deflated.
std::vector<uint8_t> png_profile(const std::vector<uint8_t>& bytes) {
    for (size_t at = 8; at + 12 <= bytes.size();) {
        const size_t length = big_endian(&bytes[at]);
        if (length > bytes.size() - at - 12 || std::memcmp(&bytes[at + 4], "IDAT", 4) == 0) break;
        if (std::memcmp(&bytes[at + 4], "iCCP", 4) == 0) {
            const auto first = bytes.begin() + static_cast<long>(at) + 8, last = first + static_cast<long>(length);
            const auto zero = std::find(first, std::min(last, first + 80), 0);
            if (last - zero < 3) break;
            std::vector<uint8_t> out;
            for (size_t room = 1 << 16; room <= 1 << 24; room *= 4) {
                out.resize(room);
                auto size = static_cast<uLongf>(room);
                const int rc = uncompress(out.data(), &size, &*(zero + 2), static_cast<uLong>(last - zero - 2));
                if (rc == Z_BUF_ERROR) continue;
                out.resize(rc == Z_OK ? size : 0);
                return out;
            }
            return {};
        }
        at += 12 + length;
    }
    return {};
}

/// Chunk ICCP of the extended format (RFC 9649, 2.7.1.4).
std::vector<uint8_t> webp_profile(const std::vector<uint8_t>& bytes) {
    for (size_t at = 12; at + 8 <= bytes.size();) {
        const size_t length = little_endian(&bytes[at + 4]);
        if (length > bytes.size() - at - 8) break;
        if (std::memcmp(&bytes[at], "ICCP", 4) == 0) return {bytes.begin() + static_cast<long>(at) + 8, bytes.begin() + static_cast<long>(at + 8 + length)};
        at += 8 + length + (length & 1);
    }
    return {};
}

std::vector<uint8_t> tiff_profile(const std::filesystem::path& file) {
    const TIFFErrorHandler warnings = TIFFSetWarningHandler(nullptr);
    std::unique_ptr<TIFF, decltype(&TIFFClose)> tiff(TIFFOpen(file.c_str(), "r"), TIFFClose);
    TIFFSetWarningHandler(warnings);
    uint32_t length = 0;
    void* data = nullptr;
    if (!tiff || !TIFFGetField(tiff.get(), TIFFTAG_ICCPROFILE, &length, &data) || !data) return {};
    const auto* first = static_cast<const uint8_t*>(data);
    return {first, first + length};
}

}  // namespace

std::vector<uint8_t> embedded_profile(const std::vector<uint8_t>& bytes, const std::filesystem::path& file) {
    const auto starts = [&](const char* with, size_t length, size_t at = 0) {
        return bytes.size() >= at + length && std::memcmp(bytes.data() + at, with, length) == 0;
    };
    if (starts("\x89PNG", 4)) return png_profile(bytes);
    if (starts("RIFF", 4) && starts("WEBP", 4, 8)) return webp_profile(bytes);
    if (starts("II*\0", 4) || starts("MM\0*", 4)) return tiff_profile(file);
    return {};
}

void convert_to_srgb(Decoded& picture) {
    Photo& photo = picture.photo;
    const int channels = view_of(photo).channels();
    if (picture.icc_profile.empty() || channels < 3) return;
    const Profile profile(cmsOpenProfileFromMem(picture.icc_profile.data(), static_cast<cmsUInt32Number>(picture.icc_profile.size())));
    if (!profile || cmsGetColorSpace(profile.get()) != cmsSigRgbData || changes_nothing(profile.get())) return;
    if (!photo.pixels8.empty()) {
        const Transform t = to_srgb(profile.get(), channels == 4 ? TYPE_RGBA_8 : TYPE_RGB_8);
        cmsDoTransform(t.get(), photo.pixels8.data.data(), photo.pixels8.data.data(), static_cast<cmsUInt32Number>(photo.pixels8.pixels()));
    } else {
        const Transform t = to_srgb(profile.get(), channels == 4 ? TYPE_RGBA_16 : TYPE_RGB_16);
        cmsDoTransform(t.get(), photo.pixels16.data.data(), photo.pixels16.data.data(), static_cast<cmsUInt32Number>(photo.pixels16.pixels()));
    }
}

}  // namespace vdbcarve::io
