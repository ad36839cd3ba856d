// SPDX-License-Identifier: Apache-2.0
// Photographs become a result while they arrive.
#pragma once

#include <functional>

#include "vdbcarve/pipeline.h"

namespace vdbcarve {

struct WatchOptions {
    ReconstructOptions reconstruct;                        ///< views.scene: the folder that photographs arrive in; it need not have any yet
    size_t first_views = 4;                                ///< so many must be there before bounds and voxels are fixed
    double settle_s = 1;                                   ///< a file that did not change for so long is whole
    double poll_s = 0.25;                                  ///< between looks at the folder
    size_t until_views = 0;                                ///< end when the result is of so many; 0: go on
    double idle_s = 0;                                     ///< end when nothing has changed for so long; 0: go on
    std::function<void(const Reconstruction&)> on_result;  ///< after each reconstruct
};

/// Calls reconstruct() whenever photographs, masks or the camera file have changed, with views.added = {the scene}: bounds and voxels are those of the first
/// result, masks and the hull are taken from the run before and extended by what is new, later stages are run again. Nothing is kept but what is in the output
/// folder, so a watch goes on where another one ended. The last hull is the one that carving all views at once within those bounds gives, bit for bit, in
/// whatever order they came. What is wrong with the photographs so far (too few, one damaged, silhouettes that contradict each other) is said and waited out;
/// where the watch ends without a result, it is thrown. Other errors of reconstruct() are thrown at once. Returns the last result.
Reconstruction watch(const WatchOptions& options, Progress& progress);

}  // namespace vdbcarve
