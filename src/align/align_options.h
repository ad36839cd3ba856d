// SPDX-License-Identifier: Apache-2.0
// Which options an alignment heeds. Private.
#pragma once

#include "vdbcarve/align.h"

namespace vdbcarve {

/// Throws UsageError naming every option that is out of range, contradicts another, or that the method does not heed.
void check_align_options(const AlignOptions& o, const Views& scene, size_t masks);

}  // namespace vdbcarve
