// SPDX-License-Identifier: Apache-2.0
// Linear light, sRGB (IEC 61966-2-1), and how different two colours look.
#pragma once

#include <array>
#include <cstdint>

namespace vdbcarve {

/// Linear light, 0..1, of an sRGB value 0..1; and back. Values outside are clamped on the way back.
double linear_from_srgb(double srgb);
double srgb_from_linear(double linear);
/// The nearest 8-bit sRGB value of linear light; clamped to 0..255.
uint8_t srgb8_from_linear(double linear);

/// CIE L*a*b* (D65 white) of linear RGB with sRGB primaries.
std::array<double, 3> lab_from_linear(const std::array<double, 3>& linear);
/// CIEDE2000 between two L*a*b* colours: about 1 is just noticeable. After Sharma, Wu and Dalal, "The CIEDE2000
/// Color-Difference Formula", Color Research and Application 30 (2005).
double ciede2000(const std::array<double, 3>& lab1, const std::array<double, 3>& lab2);

}  // namespace vdbcarve
