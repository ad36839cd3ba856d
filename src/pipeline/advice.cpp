// SPDX-License-Identifier: Apache-2.0
#include "pipeline/advice.h"

namespace vdbcarve::pipeline {

void accept_or_refuse(const std::vector<std::string>& why, const std::string& what, bool accept, Progress& progress) {
    std::string list;
    for (const std::string& w : why) list += "\n  - " + w;
    if (!accept) throw UndeterminedError(what + ". Remedy: as each finding says, or --accept-unobservable to go on with them" + list);
    progress.warn(what + ", and used all the same (--accept-unobservable)" + list);
}

void warn_of_idle_options(const ReconstructOptions& options, Progress& progress) {
    if (!options.stereo.is_wanted() && options.run.last_stage == LastStage::Export && (options.stereo.options != StereoOptions() || options.stereo.maps))
        progress.warn("--stereo-scale, --stereo-depth, --stereo-levels and --stereo-maps do nothing without --stereo on or auto");
    if (!makes_fair(options) && options.run.last_stage == LastStage::Export &&
        (options.surface.options.fairness != FairOptions().fairness || options.surface.keep_hull))
        progress.warn("--fairness and --keep-hull do nothing with --surface hull or --occupancy");
}

std::string ask_check(const ReconstructOptions& options, const Shoot& shoot) {
    const std::string scene = shoot.folder.string() + (options.views.cameras.empty() ? "" : " --cameras " + options.views.cameras.string());
    return "`vdbcarve check " + scene + "`, with the options for masks given here, says what fits" +
           (shoot.alignment ? "" : ", tries other readings of the poses and writes the one that fits (--write-cameras FILE)");
}

}  // namespace vdbcarve::pipeline
