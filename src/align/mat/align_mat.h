// SPDX-License-Identifier: Apache-2.0
// Cameras from a marker mat: calibration at a fixed focus, after Zhang ("A flexible new technique for camera calibration", PAMI 2000). Private;
// AlignMethod::Mat.
#pragma once

#include "vdbcarve/align.h"

namespace vdbcarve {

/// Cameras in the mat's world: origin in the middle of its pattern, x to the right and y up the print as it is read, z out of it, metres (or options.units),
/// floor at 0. Lenses are found too, as far as corners that were not fitted to say that there is something to be found. Views that have cameras already keep
/// what these say of the lens and the focal length, and get a place only. Throws InputError for fewer than 4 views in which the mat is seen, UsageError for a
/// unit that is not known, UndeterminedError where no camera can be had.
AlignResult align_to_mat(const Views& views, const AlignOptions& options, Progress& progress);

}  // namespace vdbcarve
