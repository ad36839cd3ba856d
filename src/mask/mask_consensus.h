// SPDX-License-Identifier: Apache-2.0
// What one silhouette says against all others. Private.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// A view against a hull that bears some dissenting views. Pictures are `factor` times the mask's size.
struct Consensus {
    double factor = 1;
    Image8 hull;           ///< 255 where the hull is seen
    Image8 carved;         ///< 255 deep within what this mask calls background, where the hull is all the same: this view carves it, nearly alone
    Image8 extra;          ///< 255 within what it calls object, far from the hull: nobody else sees anything there
    double carved_px = 0;  ///< their areas, in pixels of an object of 250
    double extra_px = 0;

    /// A mistake rather than what only this view can know. What the object's size and the angles between the views let a hull bulge by is no contradiction.
    bool broken() const { return carved_px >= kLeast_px || extra_px >= kLeast_px; }
    static constexpr double kLeast_px = 25;
};

/// Of every view that is `asked`, against the hull of those that are `trusted`, of which max_misses may dissent; views without a mask have empty pictures.
/// Throws what carving throws where nothing is left, or the hull has no bounds. Time: a carve at 96 voxels and a picture of each view.
std::vector<Consensus> consensus_of(const std::vector<std::string>& names, const std::vector<Camera>& cameras, const std::vector<MaskView>& trusted,
                                    const std::vector<MaskView>& asked, int max_misses, Progress& progress);

/// Which views' masks are broken: the worst one is left out and the others are asked again, until none is or a quarter is gone, or the rest has no hull. Fewer
/// than 8 views outvote nobody. In order of views.
std::vector<size_t> find_broken_masks(const std::vector<std::string>& names, const std::vector<Camera>& cameras, std::vector<MaskView> masks,
                                      Progress& progress);

/// Mends broken masks. Outside the hull of all other views there is no object; within it, where the mask disagrees, the photograph decides (GrabCut, its
/// colours learnt where both agree). Without one (an empty picture, or a silhouette) what disagrees is ignored from then on. Returns in words what was done,
/// for each of `broken`. photo_of(i): RGB without lens distortion, the size of the mask, or empty.
std::vector<std::string> repair_masks(const std::vector<std::string>& names, const std::vector<Camera>& cameras, std::vector<Mask>& masks,
                                      const std::vector<size_t>& broken, const std::function<Image8(size_t)>& photo_of, Progress& progress);

}  // namespace vdbcarve
