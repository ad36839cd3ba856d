// SPDX-License-Identifier: Apache-2.0
// Photographs become a result while they arrive.
#pragma once

#include <chrono>
#include <functional>
#include <thread>

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
    /// The clock, for tests to simulate: seconds since whenever, and a pause.
    std::function<double()> now_s = [] { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); };
    std::function<void(double)> sleep_s = [](double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); };
};
/// What watch has besides the options of reconstruct.
template <OptionsOf<WatchOptions> O, class V>
void visit(O& o, V& v) {
    v.not_in_key(
        Option{"first-views", "views that must be here before bounds and voxels are fixed (--bounds, --voxel-size fix them by hand)", "Watch", in::kWatch},
        o.first_views, within(1, 65535));
    v.not_in_key(Option{"until", "end when the result is of this many views (0: go on)", "Watch", in::kWatch}, o.until_views, at_least(0));
    v.not_in_key(Option{"idle", "end when nothing has changed for this many seconds (0: go on until Ctrl-C)", "Watch", in::kWatch}, o.idle_s, at_least(0));
    v.not_in_key(Option{"settle", "a file that did not change for this many seconds is complete", "Watch", in::kWatch}, o.settle_s, at_least(0));
    v.ignore(o.reconstruct, o.poll_s, o.on_result, o.now_s, o.sleep_s);
}

/// Calls reconstruct() whenever photographs, masks or the camera file have changed, with views.added = {the scene}: bounds and voxels are those of the first
/// result, masks and the hull are taken from the run before and extended by what is new, later stages are run again. Nothing is kept but what is in the output
/// folder, so a watch goes on where another one ended. The last hull is the one that carving all views at once within those bounds gives, bit for bit, in
/// whatever order they came. What is wrong with the photographs so far (too few, one damaged, silhouettes that contradict each other) is said and waited out;
/// where the watch ends without a result, it is thrown. Other errors of reconstruct() are thrown at once. Returns the last result.
Reconstruction watch(const WatchOptions& options, Progress& progress);

}  // namespace vdbcarve
