// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "vdbcarve/kernel/host_device.h"

namespace vdbcarve::kernel {

// On the device one instruction each, on the host what compilers make vectors of. They differ for NaN alone, which no
// caller has.
VDBCARVE_HD float min_f(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fminf(a, b);
#else
    return b < a ? b : a;
#endif
}

VDBCARVE_HD float max_f(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fmaxf(a, b);
#else
    return a < b ? b : a;
#endif
}

/// Rounds down; std::floor is a call on machines without SSE 4.1.
VDBCARVE_HD int floor_of(float x) {
    const int n = static_cast<int>(x);
    return n - (x < static_cast<float>(n));
}

}  // namespace vdbcarve::kernel
