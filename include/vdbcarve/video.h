// SPDX-License-Identifier: Apache-2.0
// A film around an object becomes a folder of photographs: frames a step of motion apart, the sharpest near each.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct VideoOptions {
    int frames = 72;              ///< so many, or fewer where the film has no more
    double from_s = 0, to_s = 0;  ///< part of the film that is looked at, seconds; to_s 0: to its end
    bool operator==(const VideoOptions&) const = default;
};

struct VideoFrame {
    std::string name;  ///< its file in the folder: frame_000123.png, counted from the film's first as 0
    size_t index = 0;
    double time_s = 0;     ///< when it is shown
    double motion = 0;     ///< share of the film's motion before it, 0..1
    double sharpness = 0;  ///< mean square of the Laplacian, at 640 px; only frames of one film compare
};

struct VideoFrames {
    std::vector<VideoFrame> frames;
    size_t looked_at = 0;   ///< frames decoded
    double duration_s = 0;  ///< of the part looked at
    int width_px = 0, height_px = 0;
    std::vector<std::string> warnings;
};

/// Whether a path is a file that is called like a film (.mp4, .mov, .m4v, .avi, .mkv, .webm, .mts, .m2ts, .mpg, .mpeg, .3gp, .wmv).
bool is_video(const std::filesystem::path& path);

/// Decodes the film twice: to see how much moves from frame to frame (optical flow, less its median, so that a shaking hand
/// counts little) and how sharp each is; then to write the chosen ones as PNG into `folder`, with frames.json beside them. Frames
/// stand where the rotation metadata says. No frame is taken from a group of pictures whose decoding FFmpeg complained of.
/// The last frame lies one step of motion before the film's end: of one turn, none is seen twice. Same film and options, same bytes.
/// Throws InputError for a film that cannot be opened, in which nothing moves, or that has fewer than 4 sound frames.
VideoFrames extract_frames(const std::filesystem::path& film, const std::filesystem::path& folder, const VideoOptions& options, Progress& progress);

/// A film of RGB pictures of one size. Throws OutputError. Codecs: MPEG-4 part 2, which every FFmpeg writes; or what browsers play, H.264 in .mp4
/// (MPEG-4 part 2 where FFmpeg has none, with false returned) and VP8 in .webm, for which sides must be even.
enum class FilmCodec { Plain, Browser };
bool write_film(size_t count, const std::function<Image8(size_t)>& picture, double rate_hz, const std::filesystem::path& file, FilmCodec codec);
void write_film(const std::vector<Image8>& pictures, double rate_hz, const std::filesystem::path& file);

/// What frames.json holds, and back. Throws InputError.
std::string video_json(const VideoFrames& frames);
VideoFrames read_video_json(const std::filesystem::path& file);

}  // namespace vdbcarve
