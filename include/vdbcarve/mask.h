// SPDX-License-Identifier: Apache-2.0
// Stage `mask`: one silhouette a view, soft at the edge, in three states (object, background, ignore).
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

enum class MaskMethod {
    Auto,  ///< files, else alpha, else images that are silhouettes
    Alpha,
    Folder,
    Threshold,   ///< what is brighter (or darker, or more colourful) than the background
    Chroma,      ///< what has not the colour of a cloth behind it
    CleanPlate,  ///< what is not there in a photograph of the background alone
    GrabCut,     ///< what has the object's colours rather than the background's (Rother, Kolmogorov and Blake 2004)
    Command      ///< whatever a program of somebody else's says
};
enum class MaskChannel { Brightness, Saturation, Red, Green, Blue };

struct ThresholdOptions {
    /// Object where the channel is at least this (0..255); kAuto: Otsu's threshold of the channel's square root,
    /// on which photon noise is even, so that an object's shaded side is not lost to a black background;
    /// kOtsu: Otsu's threshold of the channel. make_masks finds
    /// kAuto's level from all photographs together, threshold_mask from its one.
    double level = kAuto;
    static constexpr double kAuto = -1, kOtsu = -2;
    MaskChannel channel = MaskChannel::Brightness;  ///< brightness: the largest of R, G, B
    bool invert = false;                            ///< object is what is below the level
    bool operator==(const ThresholdOptions&) const = default;
};

struct ChromaOptions {
    std::optional<std::array<uint8_t, 3>> key_rgb;  ///< the cloth's colour, sRGB; none: what the photographs' borders mostly have
    double level = 0;                               ///< object where less than this share of the key is, 0..1; 0: found from all photographs together
    bool operator==(const ChromaOptions&) const = default;
};

struct PlateOptions {
    std::filesystem::path plate;  ///< one photograph for all views, or a folder with one of each view's name
    double level = 2.5;           ///< object where the difference, smoothed, is more than so many standard deviations of a pixel
    bool shadows = true;          ///< what is the plate's colour, only darker, is a shadow and no object; so is an object of the plate's own colour
    bool operator==(const PlateOptions&) const = default;
};

struct GrabCutOptions {
    std::optional<std::array<int, 4>> box_px;  ///< x0, y0, x1, y1 that hold the object in every view; none: all but a border of a twentieth
    bool from_threshold = false;               ///< start from ThresholdOptions' mask instead of a box
    int iterations = 5;
    bool operator==(const GrabCutOptions&) const = default;
};

/// What is done to masks made from photographs (not to those of files or commands).
struct MaskCleanUp {
    int open_px = 0;                ///< opening: removes specks and hairs thinner than twice this
    int close_px = 0;               ///< closing: bridges gaps narrower than twice this
    bool largest_component = true;  ///< keep the largest connected piece only
    double fill_holes = 0.005;      ///< holes up to this share of the object's area are filled (shadows); 1 fills all
    bool operator==(const MaskCleanUp&) const = default;
};

struct MaskOptions {
    MaskMethod method = MaskMethod::Auto;
    std::filesystem::path masks;         ///< folder of object masks
    std::string pattern;                 ///< like "{stem}_m.png", relative to the scene; {name} is the name with extension
    std::filesystem::path ignore_masks;  ///< folder of masks of what neither carves nor confirms
    bool invert = false;                 ///< masks are black where the object is
    bool allow_missing = false;          ///< leave out views without a mask, or with an empty one
    ThresholdOptions threshold;
    ChromaOptions chroma;
    PlateOptions plate;
    GrabCutOptions grabcut;
    std::string command;   ///< "tool {in} {out}": run for every photograph, without a shell
    int command_jobs = 1;  ///< commands at a time
    MaskCleanUp clean_up;
    bool repair = false;          ///< once cameras are known, masks that contradict all others are mended (or what is wrong of them ignored)
    std::filesystem::path cache;  ///< folder where a command's masks are kept, by content; empty: nowhere
};

/// Silhouette of a photograph by a threshold. The edge stays soft: coverage crosses 1/2 where the channel
/// crosses the level, linearly in between. 8-bit pixels, 1, 3 or 4 channels.
Mask threshold_mask(ImageView<uint8_t> photo, const ThresholdOptions& options, const MaskCleanUp& cleaning = {});

/// Silhouette before a cloth of one colour. Chroma by brightness decides, so folds and shadows on the cloth are cloth; along the edge coverage is the share
/// that a mixture of the object's and the cloth's light has. Key and level must be there (make_masks finds them). 8-bit sRGB, 3 or 4 channels.
Mask chroma_mask(ImageView<uint8_t> photo, const ChromaOptions& options, const MaskCleanUp& cleaning = {});

/// Silhouette by difference from a photograph of the background alone, both 8-bit sRGB of one size. Lamps that drifted in strength, colour and side are allowed
/// for; noise is measured in the pair. The object may take half of the picture.
Mask plate_mask(ImageView<uint8_t> photo, ImageView<uint8_t> plate, const PlateOptions& options, const MaskCleanUp& cleaning = {});

/// Silhouette by GrabCut. `seed`: 0 background for certain, 255 object for certain, from 128 on rather object. Same result every time.
Mask grabcut_mask(ImageView<uint8_t> photo, ImageView<uint8_t> seed, const GrabCutOptions& options, const MaskCleanUp& cleaning = {});
Image8 seed_of_box(int width, int height, const std::optional<std::array<int, 4>>& box_px);
/// Of a mask that is right but for `uncertain_px` along its edge.
Image8 seed_of_mask(ImageView<uint8_t> coverage, double uncertain_px);

/// The options with what is found from all photographs together found: the level of a threshold, a cloth's colour and level. make_masks does it where it was
/// not done.
MaskOptions settle(const Views& views, const MaskOptions& options, const std::vector<std::filesystem::path>& edited, Progress& progress);

/// A mask that was made before, from the same files with the same settled options.
struct KnownMask {
    Mask mask;
    std::string origin;
};

struct Masks {
    std::vector<Mask> masks;           ///< in the order of views; undistorted, the size of the camera
    std::vector<std::string> origins;  ///< where each came from, in words
    std::vector<size_t> left_out;      ///< indices of views without a mask (allow_missing); their mask is empty
};

/// Masks of all views: found, checked and undistorted, views in parallel. `edited` holds masks that the
/// user changed by hand in an earlier result, by view index (empty path: none); they win. `known` holds, by view index (or nothing at all), masks that need not
/// be made. Throws InputError naming file, view, value and remedy.
Masks make_masks(const Views& views, const std::filesystem::path& scene, const MaskOptions& options, const std::vector<std::filesystem::path>& edited,
                 Progress& progress, std::vector<std::optional<KnownMask>> known = {});

/// The files that the masks of a view would be made from, for keying caches.
std::vector<std::filesystem::path> mask_files(const View& view, const std::filesystem::path& scene, const MaskOptions& options);

/// How soft a mask's contour is: the share of its pixels that are neither object nor background; about 1 for soft masks, 0 for black and white.
double contour_softness(ImageView<uint8_t> coverage);
/// From so much softness on, contours are known within pixels.
inline constexpr double kSoftContours = 0.5;

}  // namespace vdbcarve
