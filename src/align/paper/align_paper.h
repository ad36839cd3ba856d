// SPDX-License-Identifier: Apache-2.0
// Alignment as the seed paper does it (Denkowski, "GPU accelerated 3D object reconstruction", ICCS 2013, section 3), as far as the text says how;
// docs/stages/align-paper.md says what was filled in, and what comes of it. Private; AlignMethod::Paper.
#pragma once

#include <array>

#include "align/coherence_fit.h"
#include "align/orbit_model.h"
#include "vdbcarve/align.h"

namespace vdbcarve {

struct PaperFit {
    OrbitModel model;        ///< fixed camera, every view with an angle, aim and roll of its own
    double model_iou = 0;    ///< of the two views that the model was made of with the model's renderings
    double path_energy = 0;  ///< mean over views of 1 - IoU with the rendering that the path chose
    Image8 energy_map;       ///< a row a view, a column a degree, dark where alike; the path in red
};

/// Views that stand for front and side: `wanted` by name (empty: the first, and the one whose nominal angle is nearest to a quarter of a turn on).
/// Throws UsageError for names that are no view's or have no silhouette.
std::array<size_t, 2> paper_views(const Views& views, const Silhouettes& silhouettes, const std::vector<OrbitView>& nominal,
                                  const std::array<std::string, 2>& wanted);

/// The object turning as `nominal` azimuths say, whose mean step is all that is used of them. Renders 360 silhouettes and compares each view with each;
/// seconds.
PaperFit fit_like_the_paper(const std::vector<MaskView>& masks, const Silhouettes& silhouettes, const std::vector<OrbitView>& nominal,
                            std::array<size_t, 2> front_and_side, Progress& progress);

}  // namespace vdbcarve
