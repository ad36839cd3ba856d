// SPDX-License-Identifier: Apache-2.0
// Masks as they come: frayed, grown, with holes and blobs.
#pragma once

#include "vdbcarve/synthetic.h"

namespace vdbcarve::synth {

void damage(Image8& mask, const MaskDamage& d, bool holes_here, uint64_t seed);

}  // namespace vdbcarve::synth
