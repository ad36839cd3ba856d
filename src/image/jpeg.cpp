// SPDX-License-Identifier: Apache-2.0
#include <csetjmp>
#include <cstdio>
#include <cstdlib>

#include <jpeglib.h>
#include <jerror.h>

#include "image/codecs.h"
#include "vdbcarve/error.h"

namespace vdbcarve::io {
namespace {

/// libjpeg's errors as a jump (it is C), and its first warning of lost data.
struct Listener {
    jpeg_error_mgr base;
    jmp_buf on_error;
    char error[JMSG_LENGTH_MAX] = "";
    char lost[JMSG_LENGTH_MAX] = "";
};

void stop(j_common_ptr info) {
    auto* listener = reinterpret_cast<Listener*>(info->err);
    info->err->format_message(info, listener->error);
    longjmp(listener->on_error, 1);
}

void listen(j_common_ptr info, int level) {
    auto* listener = reinterpret_cast<Listener*>(info->err);
    if (level >= 0 || listener->lost[0]) return;
    switch (info->err->msg_code) {  // of the others nothing is lost: stray bytes between segments, odd headers, a profile that is none
        case JWRN_JPEG_EOF:
        case JWRN_HIT_MARKER:
        case JWRN_HUFF_BAD_CODE:
        case JWRN_MUST_RESYNC:
        case JWRN_NOT_SEQUENTIAL:
        case JWRN_BOGUS_PROGRESSION:
            info->err->format_message(info, listener->lost);
    }
}

void quiet(j_common_ptr) {}

/// Everything that a jump may pass over lives here, outside of the function that is jumped out of.
struct Reader {
    jpeg_decompress_struct info{};
    Listener listener{};
    Image8 pixels;
    std::vector<uint8_t> profile;
    JOCTET* profile_data = nullptr;
    unsigned int profile_length = 0;
    bool inks = false;

    Reader() {
        info.err = jpeg_std_error(&listener.base);
        listener.base.error_exit = stop;
        listener.base.emit_message = listen;
        listener.base.output_message = quiet;
    }
    ~Reader() { jpeg_destroy_decompress(&info); }
    Reader(const Reader&) = delete;
    Reader& operator=(const Reader&) = delete;

    /// False where libjpeg gave up.
    bool header(const std::vector<uint8_t>& bytes) {
        if (setjmp(listener.on_error)) return false;
        jpeg_create_decompress(&info);
        jpeg_mem_src(&info, bytes.data(), static_cast<unsigned long>(bytes.size()));
        jpeg_save_markers(&info, JPEG_APP0 + 2, 0xFFFF);  // the colour profile
        jpeg_read_header(&info, TRUE);
        inks = info.jpeg_color_space == JCS_CMYK || info.jpeg_color_space == JCS_YCCK;
        return true;
    }

    bool picture() {
        if (setjmp(listener.on_error)) return false;
        if (jpeg_read_icc_profile(&info, &profile_data, &profile_length)) {
            profile.assign(profile_data, profile_data + profile_length);
            std::free(profile_data);
        }
        info.out_color_space = info.jpeg_color_space == JCS_GRAYSCALE ? JCS_GRAYSCALE : JCS_RGB;
        pixels = Image8(static_cast<int>(info.image_width), static_cast<int>(info.image_height), info.out_color_space == JCS_GRAYSCALE ? 1 : 3);
        jpeg_start_decompress(&info);
        const size_t row = static_cast<size_t>(pixels.width) * static_cast<size_t>(pixels.channels);
        while (info.output_scanline < info.output_height) {
            JSAMPROW to = pixels.data.data() + row * info.output_scanline;
            jpeg_read_scanlines(&info, &to, 1);
        }
        jpeg_finish_decompress(&info);
        return true;
    }
};

}  // namespace

bool is_jpeg(const std::vector<uint8_t>& bytes) { return bytes.size() > 3 && bytes[0] == 0xFF && bytes[1] == 0xD8 && bytes[2] == 0xFF; }

std::pair<int, int> jpeg_size(const std::vector<uint8_t>& bytes, const std::filesystem::path& file) {
    Reader reader;
    if (!reader.header(bytes)) throw InputError(file.string() + ": is a JPEG that cannot be read: " + reader.listener.error);
    return {static_cast<int>(reader.info.image_width), static_cast<int>(reader.info.image_height)};
}

Decoded decode_jpeg(const std::vector<uint8_t>& bytes, const std::filesystem::path& file) {
    Reader reader;
    if (!reader.header(bytes)) throw InputError(file.string() + ": is a JPEG that cannot be read: " + reader.listener.error);
    if (reader.inks) throw InputError(file.string() + ": is a CMYK picture, made for print. Remedy: save it as sRGB");
    if (!reader.picture()) throw InputError(file.string() + ": is a JPEG that cannot be read: " + reader.listener.error);
    if (reader.listener.lost[0])
        throw InputError(file.string() + ": is damaged, a part of the picture is missing: " + reader.listener.lost +
                         ". Remedy: copy it again from the camera, or take it away");
    return {{std::move(reader.pixels), {}}, std::move(reader.profile)};
}

}  // namespace vdbcarve::io
