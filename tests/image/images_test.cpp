// SPDX-License-Identifier: Apache-2.0
// Files of photographs as cameras, phones and other programs write them.
#include <csetjmp>
#include <cstdio>

#include <jpeglib.h>
#include <lcms2.h>
#include <libheif/heif.h>
#include <zlib.h>

#include <cmath>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "image/exif.h"
#include "image/image_io.h"
#include "image/opencv_image.h"
#include "support/scenes.h"
#include "vdbcarve/mask.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

/// Smooth, with a dark object off the middle, so that no turn of it is itself.
Image8 picture(int width = 64, int height = 48) {
    Image8 out(width, height, 3);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const bool object = x > 10 && x < 25 && y > 5 && y < 30;
            out.at(x, y, 0) = static_cast<uint8_t>(object ? 30 : 100 + x);
            out.at(x, y, 1) = static_cast<uint8_t>(object ? 60 : 90 + 2 * y);
            out.at(x, y, 2) = static_cast<uint8_t>(object ? 20 : 160 - x);
        }
    return out;
}

void write_bytes(const fs::path& file, const std::vector<uint8_t>& bytes) { write_text(file, {bytes.begin(), bytes.end()}); }

std::vector<uint8_t> with_segment(std::vector<uint8_t> jpeg, uint8_t marker, const std::vector<uint8_t>& content) {
    std::vector<uint8_t> segment{0xFF, marker, static_cast<uint8_t>((content.size() + 2) >> 8), static_cast<uint8_t>(content.size() + 2)};
    segment.insert(segment.end(), content.begin(), content.end());
    jpeg.insert(jpeg.begin() + 2, segment.begin(), segment.end());
    return jpeg;
}

/// Exif 2.3: a little-endian TIFF with one directory of one entry, Orientation (0x0112).
std::vector<uint8_t> exif_with_orientation(int orientation) {
    std::vector<uint8_t> out{'E', 'x', 'i', 'f', 0, 0, 'I', 'I', 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 0x01, 3, 0, 1, 0, 0, 0, static_cast<uint8_t>(orientation),
                             0,   0,   0,   0,   0, 0, 0};
    return out;
}

/// ICC.1, annex B.4: the profile in one APP2 segment.
std::vector<uint8_t> icc_segment(const std::vector<uint8_t>& profile) {
    std::vector<uint8_t> out{'I', 'C', 'C', '_', 'P', 'R', 'O', 'F', 'I', 'L', 'E', 0, 1, 1};
    out.insert(out.end(), profile.begin(), profile.end());
    return out;
}

std::vector<uint8_t> profile_of(cmsHPROFILE p) {
    cmsUInt32Number size = 0;
    cmsSaveProfileToMem(p, nullptr, &size);
    std::vector<uint8_t> out(size);
    cmsSaveProfileToMem(p, out.data(), &size);
    cmsCloseProfile(p);
    return out;
}

/// Primaries of DCI-P3 with sRGB's white and curve.
std::vector<uint8_t> display_p3() {
    const cmsCIExyY white{0.3127, 0.3290, 1};
    const cmsCIExyYTRIPLE primaries{{0.680, 0.320, 1}, {0.265, 0.690, 1}, {0.150, 0.060, 1}};
    const cmsFloat64Number srgb[5] = {2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045};
    cmsToneCurve* curve = cmsBuildParametricToneCurve(nullptr, 4, srgb);
    cmsToneCurve* curves[3] = {curve, curve, curve};
    const auto out = profile_of(cmsCreateRGBProfile(&white, &primaries, curves));
    cmsFreeToneCurve(curve);
    return out;
}

/// By the definition of both spaces: linear light through XYZ.
std::array<int, 3> srgb_of_p3(const std::array<int, 3>& p3) {
    // Columns solved from the primaries' chromaticities and D65 (IEC 61966-2-1, SMPTE EG 432-1).
    const Mat3d xyz_of_p3 = (Mat3d() << 0.48657095, 0.26566769, 0.19821729, 0.22897456, 0.69173852, 0.07928691, 0, 0.04511338, 1.04394437).finished();
    const Mat3d srgb_of_xyz =
        (Mat3d() << 3.24096994, -1.53738318, -0.49861076, -0.96924364, 1.8759675, 0.04155506, 0.05563008, -0.20397696, 1.05697151).finished();
    const auto linear = [](double v) { return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4); };
    const Vec3d light = srgb_of_xyz * xyz_of_p3 * Vec3d(linear(p3[0] / 255.0), linear(p3[1] / 255.0), linear(p3[2] / 255.0));
    std::array<int, 3> out;
    for (int c = 0; c < 3; ++c) {
        const double l = std::clamp(light[c], 0.0, 1.0);
        out[static_cast<size_t>(c)] = static_cast<int>(std::lround(255 * (l <= 0.0031308 ? 12.92 * l : 1.055 * std::pow(l, 1 / 2.4) - 0.055)));
    }
    return out;
}

TEST(Images, JpegsAreReadAsOpenCVReadsThem) {
    TemporaryFolder folder;
    write_bytes(folder / "a.jpg", io::encode_jpeg(picture(), 90, 0));
    cv::Mat opencv = cv::imread((folder / "a.jpg").string(), cv::IMREAD_COLOR);
    cv::cvtColor(opencv, opencv, cv::COLOR_BGR2RGB);
    EXPECT_EQ(io::read_image8(folder / "a.jpg").data, io::unwrap(opencv).data);
    EXPECT_EQ(io::stored_size(folder / "a.jpg"), std::pair(64, 48));
    Image8 grey(40, 30);
    for (size_t i = 0; i < grey.data.size(); ++i) grey.data[i] = static_cast<uint8_t>(i / 5);
    write_bytes(folder / "g.jpg", io::encode_jpeg(grey, 95, 0));
    EXPECT_EQ(io::read_image8(folder / "g.jpg").channels, 1);
}

TEST(Images, HalfAPictureIsRefused) {
    TemporaryFolder folder;
    std::vector<uint8_t> jpeg = io::encode_jpeg(picture(400, 300), 90, 0), cut = jpeg, hurt = jpeg;
    cut.resize(cut.size() * 2 / 3);
    write_bytes(folder / "cut.jpg", cut);
    const std::string text = error_of(ExitCode::Input, [&] { io::read_photo(folder / "cut.jpg"); });
    EXPECT_NE(text.find("cut.jpg"), std::string::npos);
    EXPECT_NE(text.find("a part of the picture is missing"), std::string::npos) << text;
    for (size_t i = hurt.size() / 2; i < hurt.size() / 2 + 20; ++i) hurt[i] = 0xFF;
    write_bytes(folder / "hurt.jpg", hurt);
    EXPECT_THROW(io::read_photo(folder / "hurt.jpg"), InputError);
    // Stray bytes after the end lose nothing: panoramas and motion photographs have megabytes of them.
    jpeg.insert(jpeg.end(), 1000, 7);
    write_bytes(folder / "longer.jpg", jpeg);
    EXPECT_NO_THROW(io::read_photo(folder / "longer.jpg"));
    std::vector<uint8_t> png = io::encode_png(picture(400, 300));
    png.resize(png.size() / 2);
    write_bytes(folder / "cut.png", png);
    EXPECT_NE(error_of(ExitCode::Input, [&] { io::read_photo(folder / "cut.png"); }).find("cut.png"), std::string::npos);
    write_text(folder / "empty.jpg", "");
    EXPECT_THROW(io::read_photo(folder / "empty.jpg"), InputError);
    write_text(folder / "words.png", "no picture at all");
    EXPECT_THROW(io::read_photo(folder / "words.png"), InputError);
}

TEST(Images, InksAreRefusedWithTheRemedy) {
    TemporaryFolder folder;
    jpeg_compress_struct info;
    jpeg_error_mgr errors;
    info.err = jpeg_std_error(&errors);
    jpeg_create_compress(&info);
    unsigned char* bytes = nullptr;
    unsigned long size = 0;
    jpeg_mem_dest(&info, &bytes, &size);
    info.image_width = 16;
    info.image_height = 16;
    info.input_components = 4;
    info.in_color_space = JCS_CMYK;
    jpeg_set_defaults(&info);
    jpeg_start_compress(&info, TRUE);
    std::vector<uint8_t> row(16 * 4, 90);
    while (info.next_scanline < info.image_height) {
        JSAMPROW p = row.data();
        jpeg_write_scanlines(&info, &p, 1);
    }
    jpeg_finish_compress(&info);
    write_bytes(folder / "print.jpg", {bytes, bytes + size});
    jpeg_destroy_compress(&info);
    free(bytes);
    const std::string text = error_of(ExitCode::Input, [&] { io::read_photo(folder / "print.jpg"); });
    EXPECT_NE(text.find("CMYK"), std::string::npos);
    EXPECT_NE(text.find("sRGB"), std::string::npos);
}

TEST(Images, ColoursOfAProfileBecomeSrgb) {
    TemporaryFolder folder;
    const std::array<std::array<int, 3>, 4> colors{{{200, 100, 100}, {60, 150, 80}, {90, 90, 90}, {40, 60, 200}}};
    Image8 stored(64, 16, 3);
    for (int y = 0; y < 16; ++y)
        for (int x = 0; x < 64; ++x)
            for (int c = 0; c < 3; ++c) stored.at(x, y, c) = static_cast<uint8_t>(colors[static_cast<size_t>(x / 16)][static_cast<size_t>(c)]);
    const std::vector<uint8_t> profile = display_p3();
    const auto expect_converted = [&](const fs::path& file, int tolerance) {
        const Image8 read = io::read_photo8(file);
        for (size_t i = 0; i < colors.size(); ++i) {
            const auto expected = srgb_of_p3(colors[i]);
            for (int c = 0; c < 3; ++c)
                EXPECT_NEAR(read.at(static_cast<int>(16 * i + 8), 8, c), expected[static_cast<size_t>(c)], tolerance) << file << " colour " << i;
        }
        EXPECT_NEAR(io::read_image8(file).at(8, 8, 0), 200, tolerance);  // a mask's numbers are no colours
    };
    write_bytes(folder / "p3.jpg", with_segment(io::encode_jpeg(stored, 100, 0), 0xE2, icc_segment(profile)));
    expect_converted(folder / "p3.jpg", 3);

    // PNG: the chunk goes after IHDR, which ends at byte 33.
    std::vector<uint8_t> png = io::encode_png(stored), chunk{0, 0, 0, 0, 'i', 'C', 'C', 'P', 'P', '3', 0, 0};
    std::vector<uint8_t> deflated(compressBound(profile.size()));
    uLongf length = deflated.size();
    compress(deflated.data(), &length, profile.data(), profile.size());
    chunk.insert(chunk.end(), deflated.begin(), deflated.begin() + static_cast<long>(length));
    const auto put = [](uint8_t* at, uint32_t v) {
        for (int i = 0; i < 4; ++i) at[i] = static_cast<uint8_t>(v >> (24 - 8 * i));
    };
    put(chunk.data(), static_cast<uint32_t>(chunk.size() - 8));
    const auto sum = static_cast<uint32_t>(crc32(0, chunk.data() + 4, static_cast<uInt>(chunk.size() - 4)));
    chunk.resize(chunk.size() + 4);
    put(chunk.data() + chunk.size() - 4, sum);
    png.insert(png.begin() + 33, chunk.begin(), chunk.end());
    write_bytes(folder / "p3.png", png);
    expect_converted(folder / "p3.png", 2);

    // What is sRGB already stays to the bit; what is no profile at all is as good as none.
    write_bytes(folder / "srgb.jpg", with_segment(io::encode_jpeg(picture(), 90, 0), 0xE2, icc_segment(profile_of(cmsCreate_sRGBProfile()))));
    EXPECT_EQ(io::read_photo8(folder / "srgb.jpg").data, io::read_image8(folder / "srgb.jpg").data);
    write_bytes(folder / "junk.jpg", with_segment(io::encode_jpeg(picture(), 90, 0), 0xE2, icc_segment({1, 2, 3, 4})));
    EXPECT_EQ(io::read_photo8(folder / "junk.jpg").data, io::read_image8(folder / "junk.jpg").data);
}

TEST(Images, ExifTurnsAsOpenCVTurns) {
    TemporaryFolder folder;
    for (int orientation = 1; orientation <= 8; ++orientation) {
        const fs::path file = folder / ("turned" + std::to_string(orientation) + ".jpg");
        write_bytes(file, with_segment(io::encode_jpeg(picture(), 95, 0), 0xE1, exif_with_orientation(orientation)));
        EXPECT_EQ(io::exif_orientation(file), orientation);
        cv::Mat opencv = cv::imread(file.string(), cv::IMREAD_COLOR);  // heeds EXIF
        cv::cvtColor(opencv, opencv, cv::COLOR_BGR2RGB);
        const Image8 ours = io::read_photo8(file, orientation);
        EXPECT_EQ(ours.width, opencv.cols);
        EXPECT_EQ(ours.data, io::unwrap(opencv).data) << "orientation " << orientation;
    }
    EXPECT_EQ(io::exif_orientation(folder / "nothing.jpg"), 1);
}

TEST(Images, PhonesHeldUprightGiveUprightViews) {
    TemporaryFolder folder;
    fs::create_directories(folder / "images");
    for (int i = 0; i < 3; ++i)
        write_bytes(folder / ("images/" + std::to_string(i) + ".jpg"), with_segment(io::encode_jpeg(picture(), 95, 0), 0xE1, exif_with_orientation(6)));
    ViewsOptions o;
    o.scene = folder.path();
    o.allow_unposed = true;
    Progress quiet;
    Views views = load_views(o, quiet);
    EXPECT_EQ(views.views[0].orientation, 6);
    EXPECT_EQ(views.views[0].camera.intrinsics.width_px, 48);
    EXPECT_EQ(load_photo8(views.views[0]).height, 64);
    // Masks by another program may be of either shape; both become the camera's.
    const Image8 stored = picture();
    Image8 object(64, 48);
    for (size_t i = 0; i < object.data.size(); ++i) object.data[i] = stored.data[3 * i] == 30 ? 255 : 0;
    const Image8 upright = io::turned(object, 6);
    for (const Image8* mask : std::initializer_list<const Image8*>{&object, &upright}) {
        fs::create_directories(folder / "masks");
        for (int i = 0; i < 3; ++i) write_bytes(folder / ("masks/" + std::to_string(i) + ".png"), io::encode_png(*mask));
        const Masks made = make_masks(views, folder.path(), {}, {{}, {}, {}}, quiet);
        EXPECT_EQ(made.masks[0].coverage.data, upright.data);
    }
    // A camera file's size says which pixels it means; ours says so itself.
    for (View& v : views.views) v.camera.intrinsics.fx = v.camera.intrinsics.fy = 80;
    write_text(folder / "cameras.json", cameras_json(views));
    EXPECT_EQ(load_views(o, quiet).views[0].orientation, 6);
    std::string text = cameras_json(views);
    for (const auto& [from, to] :
         {std::pair<std::string, std::string>{"\"w\": 48", "\"w\": 64"}, {"\"h\": 64", "\"h\": 48"}, {"\"orientation\": 6", "\"orientation\": 1"}})
        for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) text.replace(at, from.size(), to);
    write_text(folder / "cameras.json", text);
    EXPECT_EQ(load_views(o, quiet).views[0].orientation, 1);
    EXPECT_EQ(load_photo8(load_views(o, quiet).views[0]).width, 64);
}

TEST(Images, ZoomAndSizesAreNoticed) {
    TemporaryFolder folder;
    for (int i = 0; i < 6; ++i)
        write_bytes(folder / ("p" + std::to_string(i) + ".jpg"), io::encode_jpeg(i == 5 ? picture(128, 96) : picture(), 95, i == 2 ? 50 : 35));
    ViewsOptions o;
    o.scene = folder.path();
    o.allow_unposed = true;
    Progress progress;
    load_views(o, progress);
    ASSERT_EQ(progress.warnings().size(), 2u);
    EXPECT_NE(progress.warnings()[0].find("p2.jpg (50 mm)"), std::string::npos) << progress.warnings()[0];
    EXPECT_NE(progress.warnings()[1].find("128 x 96: p5.jpg"), std::string::npos) << progress.warnings()[1];
}

TEST(Images, Heic) {
    TemporaryFolder folder;
    const Image8 p = picture(96, 64);
    heif_context* context = heif_context_alloc();
    heif_encoder* encoder = nullptr;
    if (heif_context_get_encoder_for_format(context, heif_compression_HEVC, &encoder).code != heif_error_Ok) {
        heif_context_free(context);
        GTEST_SKIP() << "this libheif writes no HEIC";
    }
    heif_encoder_set_lossy_quality(encoder, 95);
    heif_image* image = nullptr;
    heif_image_create(p.width, p.height, heif_colorspace_RGB, heif_chroma_interleaved_RGB, &image);
    heif_image_add_plane(image, heif_channel_interleaved, p.width, p.height, 8);
    int stride = 0;
    uint8_t* plane = heif_image_get_plane(image, heif_channel_interleaved, &stride);
    for (int y = 0; y < p.height; ++y) std::copy_n(p.data.data() + static_cast<size_t>(y) * 3 * 96, 3 * 96, plane + static_cast<ptrdiff_t>(y) * stride);
    heif_context_encode_image(context, image, encoder, nullptr, nullptr);
    heif_context_write_to_file(context, (folder / "IMG_1.HEIC").c_str());
    heif_image_release(image);
    heif_encoder_release(encoder);
    heif_context_free(context);

    const Image8 read = io::read_photo8(folder / "IMG_1.HEIC");
    ASSERT_EQ(read.width, 96);
    ASSERT_EQ(read.channels, 3);
    double worst = 0, sum = 0;
    for (size_t i = 0; i < read.data.size(); ++i) {
        worst = std::max(worst, std::abs(static_cast<double>(read.data[i]) - p.data[i]));
        sum += std::abs(static_cast<double>(read.data[i]) - p.data[i]);
    }
    EXPECT_LT(sum / static_cast<double>(read.data.size()), 4);  // 4:2:0 smears the object's edge
    ViewsOptions o;
    o.scene = folder.path();
    o.allow_unposed = true;
    Progress quiet;
    EXPECT_EQ(load_views(o, quiet).views.at(0).name, "IMG_1.HEIC");
    std::string bytes = read_text(folder / "IMG_1.HEIC");
    write_text(folder / "IMG_1.HEIC", bytes.substr(0, bytes.size() / 2));
    EXPECT_NE(error_of(ExitCode::Input, [&] { io::read_photo(folder / "IMG_1.HEIC"); }).find("HEIF"), std::string::npos);
}

TEST(Images, SpacesAndUnicode) {
    TemporaryFolder folder;
    const fs::path place = folder / "Käthe's Schüssel 茶碗";
    fs::create_directories(place / "images");
    for (int i = 0; i < 4; ++i) write_bytes(place / "images" / ("Bild é " + std::to_string(i) + ".jpg"), io::encode_jpeg(picture(), 95, 35));
    ViewsOptions o;
    o.scene = place;
    o.allow_unposed = true;
    Progress quiet;
    Views views = load_views(o, quiet);
    ASSERT_EQ(views.views.size(), 4u);
    write_text(place / "cameras.json", cameras_json(views));
    EXPECT_EQ(load_views(o, quiet).views[3].name, "Bild é 3.jpg");
}

}  // namespace
}  // namespace vdbcarve::test
