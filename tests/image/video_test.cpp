// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/video.h"

#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>
#include <set>

#include "image/image_io.h"
#include "image/opencv_image.h"
#include "support/scenes.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

/// A patterned disc before grey; `turn` in degrees.
Image8 disc(double turn_deg, double blur_px = 0) {
    Image8 out(160, 120, 3, 70);
    for (int y = 0; y < 120; ++y)
        for (int x = 0; x < 160; ++x) {
            const double dx = x - 80, dy = y - 60, r = std::hypot(dx, dy);
            if (r > 48) continue;
            const double a = std::atan2(dy, dx) + turn_deg * M_PI / 180;
            const double pattern = 0.5 + 0.25 * std::sin(5 * a + 0.2 * r) + 0.25 * std::sin(0.35 * (std::cos(a) * r) + 0.5 * (std::sin(a) * r));
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = static_cast<uint8_t>(40 + 190 * pattern * (c == 1 ? 1 : 0.8));
        }
    return blur_px > 0 ? io::blurred(out, blur_px) : out;
}

VideoFrames extract(const fs::path& film, const fs::path& folder, int frames, double from = 0, double to = 0) {
    Progress quiet;
    return extract_frames(film, folder, {frames, from, to}, quiet);
}

TEST(Video, FramesAreEvenInMotionNotInTime) {
    TemporaryFolder folder;
    // Turns for a second, stands for a second, turns on twice as fast.
    std::vector<Image8> pictures;
    std::vector<double> turned;
    double turn = 0;
    for (int i = 0; i < 75; ++i) {
        pictures.push_back(disc(turn));
        turned.push_back(turn);
        turn += i < 25 ? 1.5 : i < 50 ? 0 : 3;
    }
    write_film(pictures, 25, folder / "film.mp4");
    ASSERT_TRUE(is_video(folder / "film.mp4"));
    const VideoFrames v = extract(folder / "film.mp4", folder / "frames", 12);
    ASSERT_EQ(v.frames.size(), 12u);
    EXPECT_EQ(v.looked_at, 75u);
    EXPECT_EQ(v.width_px, 160);
    size_t standing = 0;
    const double step = turn / 12;
    for (size_t k = 0; k < 12; ++k) {
        const VideoFrame& f = v.frames[k];
        EXPECT_NEAR(f.time_s, static_cast<double>(f.index) / 25, 0.011);
        EXPECT_NEAR(turned[f.index], step * static_cast<double>(k), 0.8 * step) << "frame " << f.index;
        standing += f.index > 27 && f.index < 48;
        const Image8 picture = io::read_photo8(folder / ("frames/" + f.name));
        EXPECT_EQ(picture.width, 160);
        if (k) {
            EXPECT_GT(f.index, v.frames[k - 1].index);
        }
    }
    EXPECT_LE(standing, 1u);
    // What is written beside them is what was returned; the same again gives the same bytes.
    const VideoFrames read = read_video_json(folder / "frames/frames.json");
    EXPECT_EQ(video_json(read), video_json(v));
    extract(folder / "film.mp4", folder / "again", 12);
    for (const VideoFrame& f : v.frames) EXPECT_EQ(read_text(folder / ("frames/" + f.name)), read_text(folder / ("again/" + f.name)));
}

TEST(Video, TheSharpestFrameNearAPlaceIsTaken) {
    TemporaryFolder folder;
    std::vector<Image8> pictures;
    for (int i = 0; i < 60; ++i) pictures.push_back(disc(2 * i, i % 4 == 1 ? 0 : 2.5));
    write_film(pictures, 30, folder / "film.avi");
    const VideoFrames v = extract(folder / "film.avi", folder / "frames", 8);
    ASSERT_EQ(v.frames.size(), 8u);
    size_t sharp = 0;
    for (const VideoFrame& f : v.frames) sharp += f.index % 4 == 1;
    EXPECT_GE(sharp, 7u);  // before the film's first frame there is nothing to choose from
}

TEST(Video, APartOfTheFilm) {
    TemporaryFolder folder;
    std::vector<Image8> pictures;
    for (int i = 0; i < 80; ++i) pictures.push_back(disc(3 * i));
    write_film(pictures, 20, folder / "film.mp4");
    const VideoFrames v = extract(folder / "film.mp4", folder / "frames", 10, 1, 3);
    for (const VideoFrame& f : v.frames) {
        EXPECT_GE(f.time_s, 0.99);
        EXPECT_LE(f.time_s, 3.01);
    }
    EXPECT_NEAR(static_cast<double>(v.looked_at), 41, 1);
    EXPECT_THROW(extract(folder / "film.mp4", folder / "frames", 10, 3, 1), UsageError);
    EXPECT_THROW(extract(folder / "film.mp4", folder / "frames", 10, 30, 40), InputError);
}

TEST(Video, NoFrameIsTakenFromWhatIsDamaged) {
    TemporaryFolder folder;
    std::vector<Image8> pictures;
    for (int i = 0; i < 200; ++i) pictures.push_back(disc(1.8 * i));
    write_film(pictures, 25, folder / "film.avi");
    const VideoFrames whole = extract(folder / "film.avi", folder / "whole", 40);
    EXPECT_TRUE(whole.warnings.empty());
    std::string bytes = read_text(folder / "film.avi");
    for (size_t i = bytes.size() / 2; i < bytes.size() / 2 + 400; ++i) bytes[i] = static_cast<char>(bytes[i] * 7 + 13);
    write_text(folder / "hurt.avi", bytes);
    const VideoFrames hurt = extract(folder / "hurt.avi", folder / "hurt", 40);
    ASSERT_FALSE(hurt.warnings.empty());
    EXPECT_NE(hurt.warnings[0].find("is damaged; no frame is taken from 0:0"), std::string::npos) << hurt.warnings[0];
    EXPECT_LT(hurt.frames.size(), 40u);
    EXPECT_GT(hurt.frames.size(), 15u);
    // Every frame that was taken looks like the one that was filmed.
    for (const VideoFrame& f : hurt.frames) {
        const Image8 read = io::read_photo8(folder / ("hurt/" + f.name));
        double sum = 0;
        for (size_t i = 0; i < read.data.size(); ++i) sum += std::abs(static_cast<double>(read.data[i]) - pictures[f.index].data[i]);
        EXPECT_LT(sum / static_cast<double>(read.data.size()), 12) << f.name;
    }
    write_text(folder / "short.avi", read_text(folder / "film.avi").substr(0, bytes.size() / 3));
    const VideoFrames cut = extract(folder / "short.avi", folder / "short", 20);
    for (const VideoFrame& f : cut.frames) EXPECT_LT(f.index, 90u);
}

TEST(Video, RotationMetadataTurnsFrames) {
    TemporaryFolder folder;
    std::vector<Image8> pictures;
    for (int i = 0; i < 40; ++i) pictures.push_back(disc(4 * i));
    write_film(pictures, 25, folder / "film.mp4");
    // ISO 14496-12, 8.3.2: the track header's matrix; here the turn of a telephone held upright.
    std::string bytes = read_text(folder / "film.mp4");
    const size_t box = bytes.find("tkhd");
    ASSERT_NE(box, std::string::npos);
    const uint32_t matrix[9] = {0, 0x00010000, 0, 0xFFFF0000, 0, 0, 0x00780000, 0, 0x40000000};
    for (size_t i = 0; i < 9; ++i)
        for (size_t b = 0; b < 4; ++b) bytes[box + 4 + 40 + 4 * i + b] = static_cast<char>(matrix[i] >> (24 - 8 * b));
    write_text(folder / "upright.mp4", bytes);
    const VideoFrames v = extract(folder / "upright.mp4", folder / "frames", 6);
    EXPECT_EQ(v.width_px, 120);
    EXPECT_EQ(v.height_px, 160);
    EXPECT_EQ(io::read_photo8(folder / ("frames/" + v.frames[0].name)).width, 120);
}

TEST(Video, WhatIsNoFilmIsRefused) {
    TemporaryFolder folder;
    write_text(folder / "words.mp4", "no film at all");
    EXPECT_NE(error_of(ExitCode::Input, [&] { extract(folder / "words.mp4", folder / "frames", 10); }).find("not a film that can be opened"),
              std::string::npos);
    write_film(std::vector<Image8>(30, disc(0)), 25, folder / "still.mp4");
    EXPECT_NE(error_of(ExitCode::Input, [&] { extract(folder / "still.mp4", folder / "frames", 10); }).find("nothing moves"), std::string::npos);
    EXPECT_FALSE(is_video(folder.path()));
    EXPECT_FALSE(is_video(folder / "missing.mp4"));
}

}  // namespace
}  // namespace vdbcarve::test
