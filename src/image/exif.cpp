// SPDX-License-Identifier: Apache-2.0
#include "image/exif.h"

#include <libexif/exif-data.h>

#include <algorithm>
#include <memory>

namespace vdbcarve::io {
namespace {

double number_of(ExifData* data, ExifTag tag, ExifIfd directory = EXIF_IFD_EXIF) {
    const ExifEntry* e = exif_content_get_entry(data->ifd[directory], tag);
    if (!e || !e->data || e->components < 1) return 0;
    const ExifByteOrder order = exif_data_get_byte_order(data);
    if (e->format == EXIF_FORMAT_SHORT && e->size >= 2) return exif_get_short(e->data, order);
    if (e->format == EXIF_FORMAT_LONG && e->size >= 4) return exif_get_long(e->data, order);
    if (e->format != EXIF_FORMAT_RATIONAL || e->size < 8) return 0;
    const ExifRational r = exif_get_rational(e->data, order);
    return r.denominator ? static_cast<double>(r.numerator) / r.denominator : 0;
}

using Exif = std::unique_ptr<ExifData, decltype(&exif_data_unref)>;

Exif exif_of(const std::filesystem::path& file) { return {exif_data_new_from_file(file.c_str()), exif_data_unref}; }

}  // namespace

int exif_orientation(const std::filesystem::path& file) {
    const Exif data = exif_of(file);
    const double said = data ? number_of(data.get(), EXIF_TAG_ORIENTATION, EXIF_IFD_0) : 1;
    return said >= 1 && said <= 8 ? static_cast<int>(said) : 1;
}

double exif_focal_px(const std::filesystem::path& file, int width_px, int height_px) {
    const Exif data = exif_of(file);
    if (!data) return 0;
    const double longer = std::max(width_px, height_px);
    if (const double film = number_of(data.get(), EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM); film > 0) return film / 36 * longer;
    const double focal_mm = number_of(data.get(), EXIF_TAG_FOCAL_LENGTH), per_unit = number_of(data.get(), EXIF_TAG_FOCAL_PLANE_X_RESOLUTION);
    const double unit = number_of(data.get(), EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT);
    const double taken_px = std::max(number_of(data.get(), EXIF_TAG_PIXEL_X_DIMENSION), number_of(data.get(), EXIF_TAG_PIXEL_Y_DIMENSION));
    if (focal_mm <= 0 || per_unit <= 0) return 0;
    const double per_mm = per_unit / (unit == 3 ? 10 : 25.4);
    return focal_mm * per_mm * (taken_px > 0 ? longer / taken_px : 1);  // the picture may have been made smaller since
}

}  // namespace vdbcarve::io
