// SPDX-License-Identifier: Apache-2.0
// Camera files written from the formats' definitions, independently of the importers.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/views.h"

namespace vdbcarve::test {

std::string middlebury_text(const Views& views);
std::string transforms_text(const Views& views);
/// 3x4 in the integer pixel-centre convention, times a factor.
std::string projection_text(const View& view, double factor);
void write_colmap_text(const std::filesystem::path& folder, const Views& views);
void write_colmap_binary(const std::filesystem::path& folder, const Views& views);

}  // namespace vdbcarve::test
