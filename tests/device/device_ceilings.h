// SPDX-License-Identifier: Apache-2.0
// What the device can do at most, measured: the yardsticks for its kernels.
#pragma once

namespace vdbcarve::test {

struct DeviceCeilings {
    double copy_gb_s;         ///< bytes read plus bytes written by a large copy within the device
    double upload_gb_s;       ///< from page-locked host memory
    double instructions_g_s;  ///< warp instructions a second of separate float additions and multiplications, 1e9
};

DeviceCeilings measure_ceilings();

}  // namespace vdbcarve::test
