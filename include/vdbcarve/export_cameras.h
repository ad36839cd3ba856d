// SPDX-License-Identifier: Apache-2.0
// Cameras, photographs and masks for other programs: COLMAP's text model, or transforms.json (nerfstudio, instant-ngp).
#pragma once

#include <filesystem>

#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

struct CameraExportOptions {
    /// Photographs as pinhole cameras would have taken them, turned as EXIF says and in sRGB, into images/ beside the cameras, which then have no lens.
    bool undistort = false;
    /// Folder of masks of undistorted photographs (a result's masks/); with `undistort` they go into masks/. Empty: none.
    std::filesystem::path masks;
    /// Its vertices are COLMAP's points, at most 100000 of them, in scene units; empty: a model without points.
    Mesh points;
};

/// Writes `target`: a .json file, or a folder that gets sparse/0/{cameras,images,points3D}.txt. Cameras are those of the scene's frame, every
/// sitting's transform applied; transforms.json has z up where the scene says which way is up, and its applied_transform leads back. Files appear by rename.
/// Throws InputError for cameras that these forms do not have (parallel projection, skewed pixels) and for photographs that are missing.
void export_cameras(const Views& views, const std::filesystem::path& target, const CameraExportOptions& options, Progress& progress);

}  // namespace vdbcarve
