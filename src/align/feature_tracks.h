// SPDX-License-Identifier: Apache-2.0
// Places of the object's texture that several photographs show: Lowe's features (SIFT, IJCV 2004) within the silhouettes. Private.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

struct Sighting {
    int view;
    float x_px, y_px;
};

/// One place and the views that show it, each once, in ascending order.
struct FeatureTrack {
    std::vector<Sighting> sightings;
};

/// Features of each pair of views that match each other, checked by the pair's epipolar geometry (RANSAC), chained to tracks; those that return to a view at
/// another place are dropped. Views without photograph or mask have no features. Throws InputError for photographs that cannot be read. Same result for any
/// number of threads.
std::vector<FeatureTrack> find_tracks(const Views& views, const std::vector<MaskView>& masks, const std::vector<std::pair<size_t, size_t>>& pairs,
                                      Progress& progress);

}  // namespace vdbcarve
