// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/video.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <opencv2/videoio.hpp>
#include <set>

extern "C" {
#include <libavutil/log.h>
}

#include "base/atomic_file.h"
#include "image/opencv_image.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

constexpr int kFlowWidth_px = 192;
constexpr double kFlowRate_hz = 10;    ///< flow between frames a tenth of a second apart: of a hand's tremor little is left
constexpr double kWindow = 0.3;        ///< of a step, to both sides of where a frame is wanted: the sharpest there is taken
constexpr double kLeastMotion_px = 1;  ///< of the whole film at kFlowWidth_px
constexpr size_t kDecodedAhead = 32;   ///< frames that FFmpeg's threads and reordering may be ahead of the one that is handed out

/// Complaints of FFmpeg. OpenCV hands out frames of which half was made up, and this is where they are spoken of.
std::atomic<int> complaints{0};

void count_complaint(void*, int level, const char*, va_list) {
    if (level <= AV_LOG_ERROR) ++complaints;
}

class Film {
  public:
    explicit Film(const fs::path& file) : file_(file) {
        av_log_set_callback(count_complaint);
        try {
            capture_.open(file.string(), cv::CAP_FFMPEG);
        } catch (const cv::Exception&) {
        }
        av_log_set_callback(count_complaint);
        complaints = 0;
        if (!capture_.isOpened())
            throw InputError(
                file.string() +
                ": is not a film that can be opened, or its end is missing. Remedy: copy it again from the camera, or save it anew (as .mp4, H.264)");
    }
    ~Film() { av_log_set_callback(av_log_default_callback); }
    Film(const Film&) = delete;
    Film& operator=(const Film&) = delete;

    /// The next frame is there; its time, seconds.
    bool next(double& time_s) {
        const bool there = capture_.grab();
        time_s = capture_.get(cv::CAP_PROP_POS_MSEC) / 1000;
        return there;
    }
    cv::Mat picture() {
        cv::Mat out;
        capture_.retrieve(out);
        if (out.empty() || out.type() != CV_8UC3) throw InputError(file_.string() + ": a frame cannot be decoded");
        return out;
    }
    bool complained() { return complaints.exchange(0) > 0; }
    double rate() const { return capture_.get(cv::CAP_PROP_FPS); }
    double frames_said() const { return capture_.get(cv::CAP_PROP_FRAME_COUNT); }

  private:
    fs::path file_;
    cv::VideoCapture capture_;
};

/// Frames that can be decoded without another, by number.
std::vector<size_t> key_frames(const fs::path& file) {
    std::vector<size_t> out;
    cv::VideoCapture raw(file.string(), cv::CAP_FFMPEG, {cv::CAP_PROP_FORMAT, -1});
    cv::Mat packet;
    for (size_t n = 0; raw.grab(); ++n) {
        if (raw.get(cv::CAP_PROP_LRF_HAS_KEY_FRAME) > 0) out.push_back(n);
        raw.retrieve(packet);
    }
    return out;
}

cv::Mat grey_at(const cv::Mat& bgr, int width) {
    cv::Mat small, grey;
    cv::resize(bgr, small, cv::Size(width, std::max(1, static_cast<int>(std::lround(static_cast<double>(width) * bgr.rows / bgr.cols)))), 0, 0, cv::INTER_AREA);
    cv::cvtColor(small, grey, cv::COLOR_BGR2GRAY);
    return grey;
}

/// How far things moved between two pictures, px: the mean of the flow without what most of the picture does together, and without
/// its lower fifth, which is noise.
double motion_between(const cv::Mat& a, const cv::Mat& b) {
    cv::Mat flow;
    cv::calcOpticalFlowFarneback(a, b, flow, 0.5, 3, 15, 2, 5, 1.1, 0);
    std::vector<float> x, y, length;
    for (int r = 0; r < flow.rows; ++r)
        for (int c = 0; c < flow.cols; ++c) {
            x.push_back(flow.at<cv::Vec2f>(r, c)[0]);
            y.push_back(flow.at<cv::Vec2f>(r, c)[1]);
        }
    const double mx = median(x), my = median(y);
    for (size_t i = 0; i < x.size(); ++i) length.push_back(static_cast<float>(std::hypot(x[i] - mx, y[i] - my)));
    const double noise = percentile(length, 0.2);
    double sum = 0;
    for (const float l : length) sum += std::max(0.0, l - noise);
    return sum / static_cast<double>(length.size());
}

struct Seen {
    size_t index;
    double time_s, sharpness;
    cv::Mat grey;
    bool damaged = false;
};

/// Frames of the groups of pictures in which FFmpeg complained, each told by the frame that was handed out just then.
void mark_damaged(const fs::path& file, const std::vector<size_t>& complained, std::vector<Seen>& seen) {
    const std::vector<size_t> keys = key_frames(file);
    for (const size_t at : complained) {
        const auto after = std::upper_bound(keys.begin(), keys.end(), at);
        const size_t first = after == keys.begin() ? 0 : *std::prev(after);
        const auto sound = std::lower_bound(keys.begin(), keys.end(), at + kDecodedAhead);
        const size_t last = sound == keys.end() ? SIZE_MAX : *sound;
        for (Seen& s : seen) s.damaged |= s.index >= first && s.index < last;
    }
}

std::string minutes(double s) { return text_of("%d:%04.1f", static_cast<int>(s / 60), s - 60 * std::floor(s / 60)); }

std::string frame_name(size_t index) { return text_of("frame_%06zu.png", index); }

}  // namespace

bool is_video(const fs::path& path) {
    std::string extension = path.extension().string();
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    static const std::set<std::string> known{".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".mpg", ".mpeg", ".3gp", ".wmv"};
    return known.count(extension) && fs::is_regular_file(path);
}

namespace {

/// What one look through all frames finds.
struct Look {
    std::vector<Seen> seen;          ///< frames within the range
    std::vector<size_t> complained;  ///< numbers of frames at which the decoder complained
    double rate = 0;
};

Look look_through(const fs::path& file, const VideoOptions& options, VideoFrames& out, Progress& progress) {
    Look look;
    auto& [seen, complained, rate] = look;
    Film film(file);
    rate = film.rate();
    const double said = film.frames_said();
    progress.begin("video", said > 0 && said < 1e7 ? static_cast<size_t>(said) : 1);
    double time_s = 0;
    size_t n = 0;
    bool to_the_end = true;
    for (; film.next(time_s); ++n) {
        progress.step();
        if (film.complained()) complained.push_back(n);
        if (options.to_s > 0 && time_s > options.to_s) {
            to_the_end = false;
            break;
        }
        if (time_s < options.from_s) continue;
        const cv::Mat picture = film.picture();
        out.width_px = picture.cols;
        out.height_px = picture.rows;
        const cv::Mat middle = grey_at(picture, std::min(io::kSharpWidth_px, picture.cols));
        cv::Mat small;
        cv::resize(middle, small, cv::Size(kFlowWidth_px, std::max(1, kFlowWidth_px * middle.rows / middle.cols)), 0, 0, cv::INTER_AREA);
        seen.push_back({n, time_s, io::sharpness_of(middle), small});
    }
    if (film.complained() && n > 0) complained.push_back(n - 1);
    if (to_the_end && said > 0 && static_cast<double>(n) + 2 < said)
        out.warnings.push_back(text_of("%s: ends early, %zu of %.0f frames are there", file.c_str(), n, said));
    return look;
}

/// Marks what is damaged, and says where that is.
void leave_out_damaged(const fs::path& file, const std::vector<size_t>& complained, std::vector<Seen>& seen, VideoFrames& out) {
    mark_damaged(file, complained, seen);
    std::string where;
    size_t count = 0;
    for (size_t i = 0, first = 0; i <= seen.size(); ++i) {
        const bool damaged = i < seen.size() && seen[i].damaged;
        count += damaged;
        if (damaged && (i == 0 || !seen[i - 1].damaged)) first = i;
        if (!damaged && i > 0 && seen[i - 1].damaged) where += (where.empty() ? "" : ", ") + minutes(seen[first].time_s) + "-" + minutes(seen[i - 1].time_s);
    }
    if (count) out.warnings.push_back(file.string() + ": is damaged; no frame is taken from " + where);
}

/// Motion up to each frame. Flow is taken over several frames and shared out among them.
std::vector<double> motion_before(const std::vector<Seen>& seen, double rate) {
    const size_t stride = std::max<size_t>(1, static_cast<size_t>(std::lround((rate > 0 && rate < 1000 ? rate : 30) / kFlowRate_hz)));
    const size_t pairs = (seen.size() - 1) / stride;
    std::vector<double> moved(pairs, 0), before(seen.size(), 0);
    tbb::parallel_for(size_t{0}, pairs, [&](size_t p) { moved[p] = motion_between(seen[p * stride].grey, seen[(p + 1) * stride].grey); });
    for (size_t i = 1; i < seen.size(); ++i)
        before[i] = before[i - 1] + (pairs ? moved[std::min((i - 1) / stride, pairs - 1)] : 0) / static_cast<double>(stride);
    return before;
}

/// One frame for every step of motion; a step that has no sound frame has none.
void choose_frames(const std::vector<Seen>& seen, const std::vector<double>& before, size_t wanted, VideoFrames& out) {
    const double total = before.back();
    const double step = total / static_cast<double>(wanted);
    size_t next = 0;
    for (size_t k = 0; k < wanted; ++k) {
        const double at = step * static_cast<double>(k);
        const Seen* best = nullptr;
        size_t best_at = 0;
        for (size_t i = next; i < seen.size() && before[i] <= at + kWindow * step; ++i)
            if (!seen[i].damaged && before[i] >= at - kWindow * step && (!best || seen[i].sharpness > best->sharpness)) best = &seen[best_at = i];
        if (!best) continue;
        next = best_at + 1;
        out.frames.push_back({frame_name(best->index), best->index, best->time_s, before[best_at] / total, best->sharpness});
    }
}

/// The chosen frames as pictures, and what is known of them.
void write_frames(const fs::path& file, const fs::path& folder, const VideoFrames& out, Progress& progress) {
    std::error_code ignored;
    fs::remove_all(folder, ignored);
    make_folder(folder);
    Film film(file);
    progress.begin("frames", out.frames.size());
    constexpr size_t kTogether = 8;
    double time_s = 0;
    size_t written = 0;
    std::vector<cv::Mat> pictures;
    const auto write = [&] {
        tbb::parallel_for(size_t{0}, pictures.size(), [&](size_t i) {
            cv::Mat rgb;
            cv::cvtColor(pictures[i], rgb, cv::COLOR_BGR2RGB);
            io::write_png(folder / out.frames[written + i].name, io::unwrap(rgb));
            progress.step();
        });
        written += pictures.size();
        pictures.clear();
    };
    for (size_t n = 0; written + pictures.size() < out.frames.size() && film.next(time_s); ++n) {
        if (n != out.frames[written + pictures.size()].index) continue;
        pictures.push_back(film.picture());
        if (pictures.size() == kTogether) write();
    }
    write();
    if (written < out.frames.size()) throw InputError(file.string() + ": could not be read a second time");
    write_file(folder / "frames.json", video_json(out));
}

}  // namespace

VideoFrames extract_frames(const fs::path& file, const fs::path& folder, const VideoOptions& options, Progress& progress) {
    if (options.frames < 4) throw UsageError("--video-frames " + std::to_string(options.frames) + ": at least 4 are needed");
    if (!(options.from_s >= 0) || !(options.to_s == 0 || options.to_s > options.from_s))
        throw UsageError(
            text_of("--video-range %g,%g: seconds from the film's start are expected, the second more than the first", options.from_s, options.to_s));
    VideoFrames out;
    auto [seen, complained, rate] = look_through(file, options, out, progress);
    if (seen.empty()) throw InputError(text_of("%s: has no frame from second %g on", file.c_str(), options.from_s));
    if (!complained.empty()) leave_out_damaged(file, complained, seen, out);

    const std::vector<double> before = motion_before(seen, rate);
    const double total = before.back();
    if (total < kLeastMotion_px) throw InputError(file.string() + ": nothing moves in it. Remedy: a film of an object that turns, or is walked around");

    const auto wanted = static_cast<size_t>(options.frames);
    choose_frames(seen, before, wanted, out);
    if (out.frames.size() < wanted)
        out.warnings.push_back(
            text_of("%s: %zu frames instead of %zu: where it is damaged, or moves on too fast, there are none", file.c_str(), out.frames.size(), wanted));
    if (out.frames.size() < 4) throw InputError(file.string() + ": fewer than 4 frames can be used. Remedy: another film, or --video-range");
    out.looked_at = seen.size();
    out.duration_s = seen.back().time_s - seen.front().time_s;

    write_frames(file, folder, out, progress);
    return out;
}

bool write_film(size_t count, const std::function<Image8(size_t)>& picture, double rate_hz, const fs::path& file, FilmCodec codec) {
    if (count == 0) throw OutputError(file.string() + ": a film needs pictures");
    // FFmpeg writes from the name's ending what kind of file it is, so the temporary one ends likewise.
    fs::path part = file;
    part.replace_extension(".part" + file.extension().string());
    std::vector<int> codecs{cv::VideoWriter::fourcc('m', 'p', '4', 'v')};
    if (codec == FilmCodec::Browser && file.extension() == ".webm") codecs = {cv::VideoWriter::fourcc('V', 'P', '8', '0')};
    else if (codec == FilmCodec::Browser) codecs.insert(codecs.begin(), cv::VideoWriter::fourcc('a', 'v', 'c', '1'));
    bool wanted = true;
    try {
        cv::VideoWriter writer;
        cv::Size size;
        for (size_t i = 0; i < count; ++i) {
            const Image8 p = picture(i);
            if (p.channels != 3) throw OutputError(file.string() + ": a film needs colour pictures");
            if (i == 0) {
                size = {p.width, p.height};
                for (size_t c = 0; c < codecs.size() && !writer.isOpened(); ++c) {
                    writer.open(part.string(), cv::CAP_FFMPEG, codecs[c], rate_hz, size);
                    wanted = c == 0;
                }
                if (!writer.isOpened()) throw OutputError(file.string() + ": a film cannot be written here");
            }
            if (p.width != size.width || p.height != size.height) throw OutputError(file.string() + ": pictures of different sizes make no film");
            cv::Mat bgr;
            cv::cvtColor(io::wrap(p.view()), bgr, cv::COLOR_RGB2BGR);
            writer.write(bgr);
        }
    } catch (...) {
        std::error_code ignored;
        fs::remove(part, ignored);
        throw;
    }
    std::error_code error;
    fs::rename(part, file, error);
    if (error) throw OutputError(file.string() + ": " + error.message());
    return wanted;
}

void write_film(const std::vector<Image8>& pictures, double rate_hz, const fs::path& file) {
    write_film(
        pictures.size(), [&](size_t i) { return pictures[i]; }, rate_hz, file, FilmCodec::Plain);
}

std::string video_json(const VideoFrames& v) {
    nlohmann::ordered_json j{
        {"width", v.width_px},   {"height", v.height_px}, {"looked_at", v.looked_at}, {"duration_s", v.duration_s}, {"frames", nlohmann::json::array()},
        {"warnings", v.warnings}};
    for (const VideoFrame& f : v.frames)
        j["frames"].push_back({{"name", f.name}, {"index", f.index}, {"time_s", f.time_s}, {"motion", f.motion}, {"sharpness", f.sharpness}});
    return j.dump(1) + "\n";
}

VideoFrames read_video_json(const fs::path& file) {
    VideoFrames out;
    try {
        std::ifstream in(file);
        const auto j = nlohmann::json::parse(in);
        out.width_px = j.at("width").get<int>();
        out.height_px = j.at("height").get<int>();
        out.looked_at = j.at("looked_at").get<size_t>();
        out.duration_s = j.at("duration_s").get<double>();
        out.warnings = j.at("warnings").get<std::vector<std::string>>();
        for (const auto& f : j.at("frames"))
            out.frames.push_back({f.at("name").get<std::string>(), f.at("index").get<size_t>(), f.at("time_s").get<double>(), f.at("motion").get<double>(),
                                  f.at("sharpness").get<double>()});
    } catch (const nlohmann::json::exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
    return out;
}

}  // namespace vdbcarve
