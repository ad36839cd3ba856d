// SPDX-License-Identifier: Apache-2.0
// One small file about a result, or about a run that failed, for somebody else to look into.
#pragma once

#include <cstddef>
#include <filesystem>

#include "vdbcarve/progress.h"

namespace vdbcarve {

struct BundleOptions {
    std::filesystem::path images;  ///< folder of photographs; empty: where the result says
    int width_px = 640;            ///< masks (and photographs) are made smaller to this, their cameras with them; 0: as they are
    bool photos = false;           ///< photographs, and the model with its colours; otherwise silhouettes and the bare shape are all that is shown
};

/// Writes a .tar.gz with report.json and report.html, config.toml, what the last run failed of, versions of program, libraries and machine, and `scene`, a
/// scene of masks and cameras that the run can be repeated with at the masks' size. Lenses are removed already; what masks ignore is not in it. Of a folder
/// that reconstruct, carve, align or mask made, finished or not. The same folder gives the same bytes on the same machine. Returns the archive's bytes. Throws
/// InputError where the folder is none of ours or holds no mask, and OutputError.
size_t bundle(const std::filesystem::path& result, const std::filesystem::path& file, const BundleOptions& options, Progress& progress);

}  // namespace vdbcarve
