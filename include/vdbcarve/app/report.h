// SPDX-License-Identifier: Apache-2.0
// Stage `report`: one page about a result, to be opened in a browser, without a network.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

struct ReportOptions {
    std::filesystem::path images;    ///< folder of photographs; empty: where the result says
    bool photos = true;              ///< false: only the contours on them, and the model without its colours
    size_t most_faces = 250'000;     ///< of the model in the page; 0: no model, a picture only
    int photo_width_px = 420;        ///< of the photographs in the page
    size_t most_photos = 150;        ///< of so many views, the worst ones
    size_t most_bytes = 25'000'000;  ///< of the page: the model gets coarser until it fits
};

/// What the page says: the model in 3-D, photographs with the hull's contour (worst agreement first), where the cameras stood, warnings with remedies, time and
/// memory by stage, figures and settings. Everything is in the one file. Time: a second or two for 36 views, and for the model 4 us for each face that it
/// loses, at most some seconds: one of many more faces than wanted is made coarse by a raster first. Throws InputError for a folder that is no result of
/// reconstruct. `mesh`: the result's, in the scene's frame, where it is at hand; null: read from the folder.
std::string report_html(const std::filesystem::path& result, const ReportOptions& options, Progress& progress, const Mesh* mesh = nullptr);

/// The page into a file, which appears by rename. Returns its bytes.
size_t write_report(const std::filesystem::path& result, const std::filesystem::path& file, const ReportOptions& options, Progress& progress,
                    const Mesh* mesh = nullptr);

/// Whether pages have the viewer in them; where the program was built without it, they have a picture and say so.
bool report_has_viewer();

}  // namespace vdbcarve
