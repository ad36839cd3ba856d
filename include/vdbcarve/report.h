// SPDX-License-Identifier: Apache-2.0
// Stage `report`: one page about a result, to be opened in a browser, without a network.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/progress.h"

namespace vdbcarve {

struct ReportOptions {
    std::filesystem::path images;     ///< folder of photographs; empty: where the result says
    size_t most_faces = 150'000;      ///< of the model in the page; 0: no model, a picture only
    int photo_width_px = 420;         ///< of the photographs in the page
    size_t most_photos = 150;         ///< of so many views, the worst ones
    size_t most_bytes = 25'000'000;   ///< of the page: the model gets coarser until it fits
};

/// What the page says: the model in 3-D, photographs with the hull's contour (worst agreement first), where the cameras stood, warnings with remedies, time and
/// memory by stage, figures and settings. Everything is in the one file. Time: a second or two for 36 views, and 4 us for each face that the model loses.
/// Throws InputError for a folder that is no result of reconstruct.
std::string report_html(const std::filesystem::path& result, const ReportOptions& options, Progress& progress);

/// The page into a file, which appears by rename. Returns its bytes.
size_t write_report(const std::filesystem::path& result, const std::filesystem::path& file, const ReportOptions& options, Progress& progress);

/// Whether pages have the viewer in them; where the program was built without it, they have a picture and say so.
bool report_has_viewer();

}  // namespace vdbcarve
