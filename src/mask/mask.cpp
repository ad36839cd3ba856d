// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/mask.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "base/atomic_file.h"
#include "views/scene_path.h"
#include "image/exif.h"
#include "image/image_io.h"
#include "mask/mask_clean_up.h"
#include "mask/mask_files.h"
#include "mask/mask_methods.h"
#include "image/opencv_image.h"
#include "mask/otsu.h"
#include "base/sha256.h"
#include "base/text.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using io::in_scene;

namespace {

Image8 channel_of(ImageView<uint8_t> photo, MaskChannel channel) {
    Image8 out(photo.width, photo.height);
    for (size_t i = 0; i < photo.pixels(); ++i) {
        const uint8_t* p = photo.data + i * static_cast<size_t>(photo.channels);
        const uint8_t r = p[0], g = photo.channels >= 3 ? p[1] : p[0], b = photo.channels >= 3 ? p[2] : p[0];
        const uint8_t high = std::max({r, g, b}), low = std::min({r, g, b});
        switch (channel) {
            case MaskChannel::Brightness:
                out.data[i] = high;
                break;
            case MaskChannel::Saturation:
                out.data[i] = high ? static_cast<uint8_t>(255 * (high - low) / high) : 0;
                break;
            case MaskChannel::Red:
                out.data[i] = r;
                break;
            case MaskChannel::Green:
                out.data[i] = g;
                break;
            case MaskChannel::Blue:
                out.data[i] = b;
                break;
        }
    }
    return out;
}

Histogram histogram_of(const Image8& channel) {
    Histogram h{};
    for (uint8_t v : channel.data) ++h[v];
    return h;
}

/// One level for all photographs: the same lamp and background stood behind them.
double common_level(const Views& views, const std::vector<fs::path>& edited, MaskChannel channel) {
    std::vector<Histogram> histograms(views.views.size());
    tbb::parallel_for(size_t{0}, histograms.size(), [&](size_t i) {
        if (i >= edited.size() || edited[i].empty()) histograms[i] = histogram_of(channel_of(io::read_photo8(views.views[i].image_path), channel));
    });
    Histogram sum{};
    for (const Histogram& h : histograms)
        for (size_t v = 0; v < 256; ++v) sum[v] += h[v];
    return otsu_level(sum, true);
}

/// 8-bit coverage that crosses 1/2 exactly between `level - 1` and `level`, with one slope on both sides.
Image8 soft_step(const Image8& channel, double level, bool invert) {
    const double gain = 127.0 / std::max({level, 255.0 - level, 1.0});
    uint8_t table[256];
    for (int v = 0; v < 256; ++v) {
        const double x = std::floor(127.5 + (v - level + 0.5) * gain + 0.5);
        const auto coverage = static_cast<uint8_t>(std::clamp(x, 0.0, 255.0));
        table[v] = invert ? static_cast<uint8_t>(255 - coverage) : coverage;
    }
    Image8 out(channel.width, channel.height);
    for (size_t i = 0; i < out.data.size(); ++i) out.data[i] = table[channel.data[i]];
    return out;
}

/// From the cache, where the command has seen the same photograph before.
Image8 mask_of_command(const View& view, const MaskOptions& options, Progress& progress) {
    const std::vector<std::string> words = words_of_command(options.command);
    const fs::path folder = options.cache.empty() ? fs::temp_directory_path() : options.cache;
    fs::path known;
    if (!options.cache.empty()) {
        make_folder(folder);
        Sha256 key;
        for (const std::string& w : words) key.add(w);
        known = folder / (key.add(sha256_of_file(view.image_path)).hex().substr(0, 24) + ".png");
        if (fs::is_regular_file(known)) return io::read_image8(known);
    }
    const Image8 made = mask_by_command(words, view.image_path, folder, progress);
    if (!known.empty()) io::write_png(known, made);
    return made;
}

/// A mask of a photograph that its camera turns (EXIF): those who make masks heed the orientation or leave pixels as stored, and their
/// picture's size tells which.
Image8 like_photo(const View& view, Image8 mask) {
    const Intrinsics& k = view.camera.intrinsics;
    const bool as_stored = view.orientation >= 5 && mask.width == k.height_px && mask.height == k.width_px && mask.width != mask.height;
    return as_stored ? io::turned(std::move(mask), view.orientation) : mask;
}

struct Made {
    Mask mask;
    std::string origin;
    std::string problem;  ///< why there is none
};

void check_size(const View& view, const Image8& image, const fs::path& path, const char* what) {
    const Intrinsics& k = view.camera.intrinsics;
    if (image.width == k.width_px && image.height == k.height_px) return;
    throw InputError(other_size(path.string() + " (" + what + ")", image.width, image.height, view.name, k.width_px, k.height_px));
}

/// Its alpha, where that says anything; else, by Auto, the image where it is a silhouette.
void mask_of_image_itself(const Image8& image, const View& view, MaskMethod method, Made& out) {
    Mask& mask = out.mask;
    bool varies = false;
    if (image.channels == 4) {
        mask.coverage = Image8(image.width, image.height);
        for (size_t i = 0; i < mask.coverage.data.size(); ++i) {
            mask.coverage.data[i] = image.data[4 * i + 3];
            varies |= mask.coverage.data[i] != mask.coverage.data[0];
        }
    }
    if (varies) {
        out.origin = "alpha of " + view.image_path.string();
    } else if (method == MaskMethod::Auto && image.channels != 4) {
        Image8 grey;
        try {
            grey = grey_of(image, view.image_path);
        } catch (const InputError&) {
        }
        if (!grey.empty() && is_two_level(grey)) {
            mask.coverage = grey;
            out.origin = view.image_path.string() + " (the image itself is a silhouette)";
        }
    }
    if (out.origin.empty()) {
        out.problem = method == MaskMethod::Alpha ? "its image has no alpha that says anything" : "no mask file, and its image has no alpha";
    }
}

/// By a method that looks at the photograph.
void mask_of_photo(const View& view, const fs::path& scene, const MaskOptions& options, Progress& progress, Made& out) {
    Mask& mask = out.mask;
    const MaskMethod method = options.method;
    const Image8 image = io::read_photo8(view.image_path, view.orientation);
    check_size(view, image, view.image_path, "the image");
    const auto photo = [&](const char* what) {
        if (image.channels < 3) throw InputError(view.image_path.string() + ": is grey; " + what + " wants colour. Remedy: --mask threshold");
        out.origin = what + (" of " + view.image_path.string());
        return image.view();
    };
    if (method == MaskMethod::Threshold) {
        mask = threshold_mask(image, options.threshold, options.clean_up);
        out.origin = "threshold of " + view.image_path.string();
    } else if (method == MaskMethod::Chroma) {
        mask = chroma_mask(photo("chroma key"), options.chroma, options.clean_up);
    } else if (method == MaskMethod::CleanPlate) {
        const fs::path plate_path = plate_file(view, scene, options);
        const Image8 plate = io::read_photo8(plate_path, view.orientation == 1 ? 1 : io::exif_orientation(plate_path));
        check_size(view, plate, plate_path, "the clean plate");
        if (plate.channels < 3) throw InputError(plate_path.string() + ": is grey; a clean plate in colour is wanted");
        mask = plate_mask(photo("difference from the clean plate"), plate, options.plate, options.clean_up);
    } else if (method == MaskMethod::GrabCut) {
        const Image8 seed = options.grabcut.from_threshold
                                ? seed_of_mask(threshold_mask(image, options.threshold, options.clean_up).coverage, 0.02 * std::min(image.width, image.height))
                                : seed_of_box(image.width, image.height, options.grabcut.box_px);
        mask = grabcut_mask(photo("GrabCut"), seed, options.grabcut, options.clean_up);
    } else if (method == MaskMethod::Command) {
        mask.coverage = like_photo(view, mask_of_command(view, options, progress));
        check_size(view, mask.coverage, view.image_path, "what --mask-command made");
        refuse_class_numbers(mask.coverage, view.image_path);
        out.origin = options.command + " on " + view.image_path.string();
    } else {
        mask_of_image_itself(image, view, method, out);
    }
}

/// The mask as a camera without distortion would have seen it; a coverage that was edited already is such.
void remove_distortion(const View& view, bool edited, Mask& mask) {
    const Intrinsics& k = view.camera.intrinsics;
    Image8 outside;
    Image8 straight = io::undistort(mask.coverage, k, view.lens, &outside);
    if (!edited) mask.coverage = std::move(straight);
    if (!mask.ignore.empty()) {
        Image8 ignore = io::undistort(mask.ignore, k, view.lens, nullptr);
        for (uint8_t& v : ignore.data) v = v >= 128 ? 255 : 0;
        mask.ignore = std::move(ignore);
    }
    // Pixels that the lens never imaged are unknown, not background.
    if (std::any_of(outside.data.begin(), outside.data.end(), [](uint8_t v) { return v != 0; })) {
        if (mask.ignore.empty()) mask.ignore = Image8(k.width_px, k.height_px);
        for (size_t i = 0; i < outside.data.size(); ++i) mask.ignore.data[i] |= outside.data[i];
    }
}

/// The mask of one view; `edited` (or empty) is one that the user changed: it replaces the coverage, undistorted
/// as it is, and what is to be ignored stays.
Made make_one(const View& view, const fs::path& first_scene, const MaskOptions& options, const fs::path& edited, Progress& progress) {
    const fs::path& scene = view.scene.empty() ? first_scene : view.scene;
    Made out;
    Mask& mask = out.mask;
    const MaskMethod method = options.method;
    const bool want_folder = method == MaskMethod::Folder || method == MaskMethod::Auto;
    const fs::path file = want_folder && edited.empty() ? object_mask_file(view, scene, options) : fs::path();
    if (!edited.empty()) {
        mask.coverage = grey_of(io::read_image8(edited), edited);
        check_size(view, mask.coverage, edited, "the edited mask");
        out.origin = edited.string() + " (edited by hand)";
    } else if (!file.empty()) {
        mask.coverage = like_photo(view, grey_of(io::read_image8(file), file));
        check_size(view, mask.coverage, file, "the mask");
        refuse_class_numbers(mask.coverage, file);
        out.origin = file.string();
    } else if (method == MaskMethod::Folder) {
        // A silhouette set has its masks as its images.
        const Image8 image = io::read_photo8(view.image_path, view.orientation);
        if (image.channels == 1 && is_two_level(image)) {
            check_size(view, image, view.image_path, "the image");
            mask.coverage = image;
            out.origin = view.image_path.string() + " (the image itself)";
        } else {
            out.problem = "no mask file found";
            return out;
        }
    } else {
        mask_of_photo(view, scene, options, progress, out);
        if (!out.problem.empty()) return out;
    }
    if (options.invert && edited.empty())
        for (uint8_t& v : mask.coverage.data) v = static_cast<uint8_t>(255 - v);
    if (const fs::path ignore = ignore_mask_file(view, scene, options); !ignore.empty()) {
        mask.ignore = like_photo(view, grey_of(io::read_image8(ignore), ignore));
        check_size(view, mask.ignore, ignore, "the ignore mask");
        for (uint8_t& v : mask.ignore.data) v = v >= 128 ? 255 : 0;
    }
    if (view.lens.distorts()) remove_distortion(view, !edited.empty(), mask);
    return out;
}

struct Census {
    double object_share, border_share;
};

Census census(const Mask& mask) {
    const Image8& m = mask.coverage;
    size_t object = 0, border = 0, border_object = 0;
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x) {
            const bool on = m.at(x, y) >= 128;
            object += on;
            if (x == 0 || y == 0 || x == m.width - 1 || y == m.height - 1) {
                ++border;
                border_object += on;
            }
        }
    return {static_cast<double>(object) / static_cast<double>(m.pixels()), static_cast<double>(border_object) / static_cast<double>(border)};
}

}  // namespace

Mask threshold_mask(ImageView<uint8_t> photo, const ThresholdOptions& options, const MaskCleanUp& cleaning) {
    Image8 channel = channel_of(photo, options.channel);
    double level = options.level;
    if (level < 0) level = otsu_level(histogram_of(channel), level == ThresholdOptions::kAuto);
    Mask out;
    out.coverage = soft_step(channel, level, options.invert);
    cv::Mat binary = io::wrap(out.coverage.view()) >= 128;
    clean_up(binary, cleaning);
    // Where the clean-up changed its mind the edge is hard; elsewhere it stays as soft as the photograph.
    for (int y = 0; y < binary.rows; ++y)
        for (int x = 0; x < binary.cols; ++x) {
            uint8_t& c = out.coverage.at(x, y);
            const bool on = binary.at<uint8_t>(y, x) != 0;
            if (on != (c >= 128)) c = on ? 255 : 0;
        }
    return out;
}

std::vector<fs::path> mask_files(const View& view, const fs::path& first_scene, const MaskOptions& options) {
    const fs::path& scene = view.scene.empty() ? first_scene : view.scene;
    std::vector<fs::path> out;
    const bool want_folder = options.method == MaskMethod::Folder || options.method == MaskMethod::Auto;
    const fs::path object = want_folder ? object_mask_file(view, scene, options) : fs::path();
    out.push_back(object.empty() ? view.image_path : object);
    if (options.method == MaskMethod::CleanPlate) out.push_back(plate_file(view, scene, options));
    if (const fs::path ignore = ignore_mask_file(view, scene, options); !ignore.empty()) out.push_back(ignore);
    return out;
}

MaskOptions settle(const Views& views, const MaskOptions& given, const std::vector<fs::path>& edited, Progress& progress) {
    MaskOptions options = given;
    if (options.method == MaskMethod::Threshold && options.threshold.level == ThresholdOptions::kAuto) {
        options.threshold.level = common_level(views, edited, options.threshold.channel);
        progress.note("threshold " + std::to_string(std::lround(options.threshold.level)) + " of 255, found from all photographs together");
    }
    if (options.method == MaskMethod::Chroma && (!options.chroma.key_rgb || !(options.chroma.level > 0))) {
        std::vector<fs::path> photos;
        for (size_t i = 0; i < views.views.size(); ++i)
            if (i >= edited.size() || edited[i].empty()) photos.push_back(views.views[i].image_path);
        find_chroma_key(photos, options.chroma);
        const auto& key = *options.chroma.key_rgb;
        progress.note(text_of("chroma key %d,%d,%d, object below %.2f of it%s", key[0], key[1], key[2], options.chroma.level,
                              given.chroma.key_rgb ? "" : "; found at the photographs' borders"));
    }
    return options;
}

Masks make_masks(const Views& views, const fs::path& scene, const MaskOptions& given, const std::vector<fs::path>& edited, Progress& progress,
                 std::vector<std::optional<KnownMask>> known) {
    if (!given.masks.empty() && !fs::is_directory(in_scene(given.masks, scene))) throw InputError(given.masks.string() + ": --masks is not a folder");
    if (!given.ignore_masks.empty() && !fs::is_directory(in_scene(given.ignore_masks, scene)))
        throw InputError(given.ignore_masks.string() + ": --ignore-masks is not a folder");
    const size_t n = views.views.size();
    const MaskOptions options = settle(views, given, edited, progress);
    if (options.method == MaskMethod::CleanPlate && options.plate.plate.empty())
        throw UsageError("--mask clean-plate: which? Remedy: --clean-plate FILE, or a folder with one of each view's name");
    if (options.method == MaskMethod::Command) words_of_command(options.command);  // said before anything is done
    std::vector<Made> made(n);
    progress.begin("mask", n);
    tbb::task_arena arena(options.method == MaskMethod::Command ? options.command_jobs : tbb::task_arena::automatic);
    arena.execute([&] {
        tbb::parallel_for(size_t{0}, n, [&](size_t i) {
            const View& view = views.views[i];
            if (i < known.size() && known[i]) made[i] = {std::move(known[i]->mask), std::move(known[i]->origin), {}};
            else made[i] = make_one(view, scene, options, i < edited.size() ? edited[i] : fs::path(), progress);
            progress.step();
        });
    });

    std::map<std::string, std::string> taken;  // mask file -> view
    for (size_t i = 0; i < n; ++i) {
        if (made[i].origin.empty()) continue;
        const auto [other, fresh] = taken.emplace(made[i].origin, views.views[i].name);
        if (!fresh)
            throw InputError(made[i].origin + ": is the mask of both " + other->second + " and " + views.views[i].name +
                             ". Remedy: keep the images' folders below the mask folder too");
    }

    Masks out;
    std::vector<std::string> missing, empty, full, inverted, bordered;
    std::string reason;
    for (size_t i = 0; i < n; ++i) {
        const std::string& name = views.views[i].name;
        if (!made[i].problem.empty()) {
            missing.push_back(name);
            reason = made[i].problem;
            out.left_out.push_back(i);
        } else {
            const Census c = census(made[i].mask);
            if (c.object_share == 0) {
                empty.push_back(name + " (" + made[i].origin + ")");
                out.left_out.push_back(i);
                made[i].mask = {};
            } else if (c.object_share > 0.999) {
                full.push_back(name + " (" + made[i].origin + ")");
            } else if (c.border_share > 0.5) {
                inverted.push_back(name);
            } else if (c.border_share > 0) {
                bordered.push_back(name);
            }
        }
        out.masks.push_back(std::move(made[i].mask));
        out.origins.push_back(made[i].origin);
    }
    if (!missing.empty() && !options.allow_missing)
        throw InputError(std::to_string(missing.size()) + " of " + std::to_string(n) + " views have no mask (" + reason + "): " + some_of(missing) +
                         ". Remedy: --mask threshold (or chroma, clean-plate, grabcut), --masks DIR, or --allow-missing to leave such views out");
    if (!empty.empty() && !options.allow_missing)
        throw InputError("empty mask (no object pixel) in " + std::to_string(empty.size()) + " of " + std::to_string(n) + " views: " + some_of(empty) +
                         ". It would carve everything away. Remedy: mend the mask, or --allow-missing to leave such views out");
    if (!missing.empty()) progress.warn("views without a mask are left out: " + some_of(missing));
    if (!empty.empty()) progress.warn("views with an empty mask are left out: " + some_of(empty));
    if (out.left_out.size() == n) throw InputError("no view has a mask");
    if (!full.empty()) progress.warn("mask is object everywhere, it carves nothing: " + some_of(full));
    if (2 * inverted.size() >= n)
        throw InputError("the border of " + std::to_string(inverted.size()) + " of " + std::to_string(n) + " masks is mostly object: " + some_of(inverted) +
                         ". They look inverted (white = object is expected). Remedy: --mask-invert");
    if (!inverted.empty()) progress.warn("the mask's border is mostly object (inverted?): " + some_of(inverted));
    if (!bordered.empty())
        progress.warn("the object leaves the frame in " + std::to_string(bordered.size()) + " views: " + some_of(bordered) +
                      "; what lies outside an image is unknown there unless --outside says otherwise");
    return out;
}

}  // namespace vdbcarve
