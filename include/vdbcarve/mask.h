// SPDX-License-Identifier: Apache-2.0
// Stage `mask`: one silhouette a view, soft at the edge, in three states (object, background, ignore).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

enum class MaskMethod { Auto, Alpha, Folder, Threshold };
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
    int open_px = 0;                                ///< opening: removes specks and hairs thinner than twice this
    int close_px = 0;                               ///< closing: bridges gaps narrower than twice this
    bool largest_component = true;                  ///< keep the largest connected piece only
    /// Holes up to this share of the object's area are filled (shadows); 1 fills all.
    double fill_holes = 0.005;

    bool operator==(const ThresholdOptions&) const = default;
};

struct MaskOptions {
    MaskMethod method = MaskMethod::Auto;
    std::filesystem::path masks;         ///< folder of object masks
    std::string pattern;                 ///< like "{stem}_m.png", relative to the scene; {name} is the name with extension
    std::filesystem::path ignore_masks;  ///< folder of masks of what neither carves nor confirms
    bool invert = false;                 ///< masks are black where the object is
    bool allow_missing = false;          ///< leave out views without a mask, or with an empty one
    ThresholdOptions threshold;
};

/// Silhouette of a photograph by a threshold. The edge stays soft: coverage crosses 1/2 where the channel
/// crosses the level, linearly in between. 8-bit pixels, 1, 3 or 4 channels.
Mask threshold_mask(ImageView<uint8_t> photo, const ThresholdOptions& options);

struct Masks {
    std::vector<Mask> masks;           ///< in the order of views; undistorted, the size of the camera
    std::vector<std::string> origins;  ///< where each came from, in words
    std::vector<size_t> left_out;      ///< indices of views without a mask (allow_missing); their mask is empty
};

/// Masks of all views: found, checked and undistorted, views in parallel. `edited` holds masks that the
/// user changed by hand in an earlier result, by view index (empty path: none); they win.
/// Throws InputError naming file, view, value and remedy.
Masks make_masks(const Views& views, const std::filesystem::path& scene, const MaskOptions& options,
                 const std::vector<std::filesystem::path>& edited, Progress& progress);

/// The files that the masks of a view would be made from, for keying caches.
std::vector<std::filesystem::path> mask_files(const View& view, const std::filesystem::path& scene,
                                              const MaskOptions& options);

}  // namespace vdbcarve
