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
/// OpenCV's FileStorage as YAML: a calibration and each view's rvec and tvec, named or not.
std::string opencv_calibration_text(const Views& views, bool named);
/// The same as 3x4 matrices called P_0, P_1 … P_10, in an order that is not theirs.
std::string opencv_projections_xml(const Views& views);
/// Metashape's XML: the world is that of a component, turned, 2.5 times as large as the chunk's and moved; the last camera is one that was not aligned.
std::string metashape_text(const Views& views, const std::string& distortion);
/// Bundler's, for cameras with square pixels and centred principal points; before the last there is one that was not registered ("lost.png").
std::string bundler_text(const Views& views);
std::string nvm_text(const Views& views);
/// OpenMVG's sfm_data.json; the last view has no pose ("lost.png").
std::string openmvg_text(const Views& views);
/// Meshroom's .sfm of file version 1.0.0 (lengths in pixels) or 1.2.6 (millimetres on a sensor 36 mm wide, the principal point from the middle on), numbers as
/// strings.
std::string meshroom_text(const Views& views, bool millimetres);
/// RealityCapture's, for cameras with square pixels.
std::string realitycapture_text(const Views& views);
/// A MATLAB 5 file with one 1xN cell array of 3x4 matrices in the integer pixel-centre convention, byte for byte.
std::string matlab_bytes(const Views& views);
void write_colmap_text(const std::filesystem::path& folder, const Views& views);
void write_colmap_binary(const std::filesystem::path& folder, const Views& views);

}  // namespace vdbcarve::test
