// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

/// Linear light.
struct Rgb {
    float r, g, b;
};

VDBCARVE_HD Rgb plus(const Rgb& a, float w, const Rgb& b) { return {a.r + w * b.r, a.g + w * b.g, a.b + w * b.b}; }
VDBCARVE_HD Rgb minus(const Rgb& a, const Rgb& b) { return {a.r - b.r, a.g - b.g, a.b - b.b}; }
VDBCARVE_HD float luminance(const Rgb& c) { return 0.2126f * c.r + 0.7152f * c.g + 0.0722f * c.b; }

/// What a view shows of a point, for comparing exposures: weight 0 where nothing can be compared.
struct Observation {
    Rgb color;  ///< no gain applied
    float weight;
};

}  // namespace vdbcarve::kernel
