// SPDX-License-Identifier: Apache-2.0
// What is used of OpenCV's markers, which moved from contrib to the main modules in 4.7. Private.
#pragma once

#include <string>

#include "vdbcarve/image.h"

namespace vdbcarve {

/// Markers in a dictionary like "6X6_250"; 0 for none of that name.
int dictionary_size(const std::string& name);

/// Bits along a marker's side, without its border. The dictionary must exist.
int marker_bits(const std::string& name);

/// A marker with its black border, `side` pixels wide.
Image8 marker_image(const std::string& dictionary, int id, int side);

}  // namespace vdbcarve
