// SPDX-License-Identifier: Apache-2.0
// What `vdbcarve render` does: a result or a file becomes a picture, a sheet or a film.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/backend.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/render.h"

namespace vdbcarve {

struct PictureRequest {
    std::filesystem::path input;   ///< a result's folder, a volume (.vdb, .nvdb) or a mesh
    std::filesystem::path output;  ///< .png; .mp4 or .webm: a turntable film
    bool mesh = false;             ///< of a result: its mesh, not its volume
    bool slack = false;            ///< the volume's grid "slack" as colours
    RenderOptions options;
    OrbitView orbit;
    std::string up;                 ///< world axis; empty: as the result or the file says, else z
    std::string view;               ///< an input view by name: the picture that its camera would take, for comparison with its photograph
    std::filesystem::path cameras;  ///< a camera file with `view` in it; empty: the result's
    std::filesystem::path images;   ///< folder of photographs; empty: where the result says
    int sheet = 0;                  ///< so many input views, evenly chosen, beside their photographs, on one sheet; 0: one picture
    int slices = 9;                 ///< of RenderStyle::Slice: so many on one sheet; 1: one, through `slice_at`
    std::string slice_axis = "z";   ///< x, y or z
    double slice_at = 0.5;          ///< share of the bounds along the axis
    int frames = 120;               ///< of a film, one turn
    double rate_hz = 30;
    Backend backend = Backend::Auto;
    int device = 0;
};

struct PictureSummary {
    std::string backend_used;
    size_t pictures = 0;
    double seconds = 0;              ///< of rendering alone, all pictures
    double device_milliseconds = 0;  ///< of the last picture, on CUDA
    int width_px = 0, height_px = 0;
    double most_slack = 0;  ///< what the last colour stands for, the file's units
};

/// Files appear by rename. Throws InputError, UsageError, OutputError, BackendError.
PictureSummary draw_pictures(const PictureRequest& request, Progress& progress);

}  // namespace vdbcarve
