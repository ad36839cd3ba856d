// SPDX-License-Identifier: Apache-2.0
// preview.png: the mesh's outline over photographs, with what it misses.
#pragma once

#include <filesystem>
#include <vector>

#include "pipeline/values.h"
#include "vdbcarve/raster.h"

namespace vdbcarve::pipeline {

/// Of all views; those without a mask stay as they are made.
std::vector<SilhouetteAgreement> compare_with_masks(const Mesh& mesh, const std::vector<Camera>& cameras, const Silhouettes& masks,
                                                    const std::vector<size_t>& which, Progress& progress);

/// A sheet of the views `which`. `shoot` is that whose cameras are shown. Where they are not verified, it says so across the sheet.
Image8 draw_preview(const Mesh& mesh, const Shoot& shoot, const Silhouettes& masks, const std::vector<size_t>& which,
                    const std::vector<SilhouetteAgreement>& agreement, Progress& progress);

/// So many indices of `of`, evenly spread.
std::vector<size_t> spread_evenly(const std::vector<size_t>& of, size_t most);

}  // namespace vdbcarve::pipeline
