// SPDX-License-Identifier: Apache-2.0
#include <libheif/heif.h>

#include <cstring>
#include <memory>
#include <string>

#include "image/codecs.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {
namespace {

template <auto release>
struct Release {
    template <class T>
    void operator()(T* t) const {
        release(t);
    }
};

/// Colours described by number (ITU-T H.273) instead of a profile; only those that photographs have.
void refuse_unknown_colors(heif_image_handle* handle, const std::filesystem::path& file) {
    heif_color_profile_nclx* nclx = nullptr;
    if (heif_image_handle_get_nclx_color_profile(handle, &nclx).code != heif_error_Ok || !nclx) return;
    const auto primaries = nclx->color_primaries;
    const auto transfer = nclx->transfer_characteristics;
    heif_nclx_color_profile_free(nclx);
    const bool known_primaries = primaries == heif_color_primaries_ITU_R_BT_709_5 || primaries == heif_color_primaries_unspecified;
    const bool known_transfer = transfer == heif_transfer_characteristic_IEC_61966_2_1 || transfer == heif_transfer_characteristic_ITU_R_BT_709_5 ||
                                transfer == heif_transfer_characteristic_unspecified;
    if (!known_primaries || !known_transfer)
        throw InputError(file.string() + ": has colours of a wide or high dynamic range (H.273 primaries " + std::to_string(primaries) + ", transfer " +
                         std::to_string(transfer) + ") without a colour profile. Remedy: save it as an sRGB JPEG or PNG");
}

}  // namespace

bool is_heif(const std::vector<uint8_t>& bytes) {
    if (bytes.size() < 12 || std::memcmp(bytes.data() + 4, "ftyp", 4) != 0) return false;
    const std::string brand(reinterpret_cast<const char*>(bytes.data()) + 8, 4);
    for (const char* known : {"heic", "heix", "heim", "heis", "mif1", "avif"})
        if (brand == known) return true;
    return false;
}

Decoded decode_heif(const std::vector<uint8_t>& bytes, const std::filesystem::path& file) {
    const auto need = [&](const heif_error& e) {
        if (e.code != heif_error_Ok)
            throw InputError(file.string() + ": is a HEIF picture that cannot be decoded: " + e.message +
                             ". Remedy: save it as JPEG or PNG, or let the camera do so");
    };
    const std::unique_ptr<heif_context, Release<heif_context_free>> context(heif_context_alloc());
    need(heif_context_read_from_memory_without_copy(context.get(), bytes.data(), bytes.size(), nullptr));
    heif_image_handle* first = nullptr;
    need(heif_context_get_primary_image_handle(context.get(), &first));
    const std::unique_ptr<heif_image_handle, Release<heif_image_handle_release>> handle(first);

    Decoded out;
    const heif_color_profile_type profile = heif_image_handle_get_color_profile_type(handle.get());
    if (profile == heif_color_profile_type_rICC || profile == heif_color_profile_type_prof) {
        out.icc_profile.resize(heif_image_handle_get_raw_color_profile_size(handle.get()));
        need(heif_image_handle_get_raw_color_profile(handle.get(), out.icc_profile.data()));
    } else {
        refuse_unknown_colors(handle.get(), file);
    }
    const int bits = heif_image_handle_get_luma_bits_per_pixel(handle.get());
    const int channels = heif_image_handle_has_alpha_channel(handle.get()) ? 4 : 3;
    const heif_chroma chroma = bits <= 8 ? (channels == 4 ? heif_chroma_interleaved_RGBA : heif_chroma_interleaved_RGB)
                                         : (channels == 4 ? heif_chroma_interleaved_RRGGBBAA_LE : heif_chroma_interleaved_RRGGBB_LE);
    heif_image* decoded = nullptr;
    need(heif_decode_image(handle.get(), &decoded, heif_colorspace_RGB, chroma, nullptr));
    const std::unique_ptr<heif_image, Release<heif_image_release>> image(decoded);
    int stride = 0;
    const uint8_t* plane = heif_image_get_plane_readonly(image.get(), heif_channel_interleaved, &stride);
    const int width = heif_image_get_width(image.get(), heif_channel_interleaved), height = heif_image_get_height(image.get(), heif_channel_interleaved);
    if (!plane || width < 1 || height < 1) throw InputError(file.string() + ": is a HEIF picture without pixels");
    const size_t row = static_cast<size_t>(width) * static_cast<size_t>(channels);
    if (bits <= 8) {
        out.photo.pixels8 = Image8(width, height, channels);
        for (int y = 0; y < height; ++y)
            std::memcpy(out.photo.pixels8.data.data() + row * static_cast<size_t>(y), plane + static_cast<ptrdiff_t>(stride) * y, row);
        return out;
    }
    out.photo.pixels16 = Image16(width, height, channels);
    const uint32_t largest = (1u << bits) - 1;
    for (int y = 0; y < height; ++y) {
        const uint8_t* from = plane + static_cast<ptrdiff_t>(stride) * y;
        uint16_t* to = out.photo.pixels16.data.data() + row * static_cast<size_t>(y);
        for (size_t i = 0; i < row; ++i) to[i] = static_cast<uint16_t>(((from[2 * i] | from[2 * i + 1] << 8) * 65535u + largest / 2) / largest);
    }
    return out;
}

}  // namespace vdbcarve::io
