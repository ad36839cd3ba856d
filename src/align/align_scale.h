// SPDX-License-Identifier: Apache-2.0
// The scale of cameras that were found from silhouettes, which know none. Private.
#pragma once

#include <vector>

#include "vdbcarve/align.h"

namespace vdbcarve {

/// Masks without those of bad views.
std::vector<MaskView> trusted_masks(const AlignResult& r, std::vector<MaskView> masks);

/// Before cameras are looked for (`masks` may be empty): throws UsageError for --known-length with a view that is not there or pixels outside of it, InputError
/// where its mask has background there.
void check_known_length(const Views& views, const std::vector<MaskView>& masks, const KnownLength& known);

/// Scales what was found so that the one length that `o` knows is right. Throws UndeterminedError where it was not seen, InputError where its ends do not show
/// the object.
void apply_scale(AlignResult& r, const std::vector<MaskView>& masks, const AlignOptions& o, Progress& progress);

}  // namespace vdbcarve
