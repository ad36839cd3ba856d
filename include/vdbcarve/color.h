// SPDX-License-Identifier: Apache-2.0
// Stage `color`: the photographs' colours on the surface, and around it.
//
// After Denkowski, "GPU accelerated 3D object reconstruction", ICCS 2013, sections 3 and 4 (listing 4.2): the voxels of the contour take
// their colour from the view that looks at them most squarely. Two changes: only from views that see them, where the paper paints
// hidden surfaces with what stands in front (its Fig. 5); and by default from three views, blended.
#pragma once

#include <openvdb/openvdb.h>

#include <array>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "vdbcarve/exposure.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

enum class ColorMode {
    None,
    Best,  ///< the paper's rule: the view with the largest n . view among those that see the voxel
    Blend  ///< the three weightiest by (n . view)^4, distance to the silhouette's edge and resolution, without outliers
};

/// One view: a photograph of the camera's size, its mask, and whether it may be used.
struct ColorInput {
    std::string name;
    Camera camera;
    MaskView mask;
    PhotoView photo;  ///< not looked at where photographs come in batches
    bool use = true;  ///< false: left out of colouring, to be compared with later
};

/// Photographs of the inputs first <= i < last, undistorted; empty ones for views that cannot be used.
using PhotoSource = std::function<std::vector<Photo>(size_t first, size_t last)>;

inline constexpr int kMaxNormalRadius_vox = 5;

struct ColorOptions {
    ColorMode mode = ColorMode::Blend;
    bool test_occlusion = true;  ///< false: hidden surfaces take the colour of what stands in front, as in the paper
    bool skip_upright = false;   ///< the paper's listing 4.2, lines 1 and 2: faces that look straight up or down are left to the fill
    Vec3d up = Vec3d::UnitZ();   ///< for that; world, unit
    bool exposure = true;        ///< estimate a gain for each photograph
    ExposureOptions exposure_options;
    std::vector<std::array<double, 3>> gains;  ///< by view; used instead of an estimate when not empty
    int depth_vox = 3;                         ///< layers, from the surface inwards, that get colour (the paper's free parameter)
    int normal_radius_vox = 0;                 ///< 0: normals from the level set; else the paper's Gaussian window of so many voxels (1..kMaxNormalRadius_vox)
    size_t batch = 0;                          ///< views whose photographs are in memory together; 0: all
};

struct ColorStatistics {
    size_t surface_voxels = 0;           ///< of the contour
    size_t colored = 0;                  ///< seen by a view
    size_t synthesised = 0;              ///< filled from neighbours: no view sees them
    std::vector<size_t> voxels_of_view;  ///< for which the view was the weightiest
};

struct ColorResult {
    /// Linear RGB. Active: the contour, the band outside, `depth_vox` layers inside. Name "color".
    openvdb::Vec3SGrid::Ptr color;
    openvdb::Int32Grid::Ptr views;       ///< on the contour: views blended, 0 where synthesised. Name "views".
    openvdb::FloatGrid::Ptr confidence;  ///< on the contour: cosine between normal and the squarest view used, 0 where synthesised. Name "confidence".
    Exposure exposure;                   ///< gains of 1 where none were estimated or given
    ColorStatistics statistics;
    std::vector<std::pair<std::string, double>> milliseconds;  ///< by step; on the GPU device time
    std::string backend_used = "cpu";
};

/// Colours a level set from all photographs at once. No sample is taken nearer than 3 px to the mask's edge, outside the image or the
/// mask, or from ignored pixels. Lines of sight are followed through the level set (kernel/ray.h). 8-bit and 16-bit photographs are decoded
/// from sRGB to linear light by table; all means are of linear light. Voxels of the contour that no view sees are filled harmonically
/// from those that are seen. From there colour is carried outwards to the band's end and inwards. Same bits for any number of threads, on both backends.
/// Cost: about voxels of the contour x (views + lines of sight that can matter). Memory: 150 bytes a voxel of the contour, 6.7 kB a leaf.
/// Throws InputError naming the view whose photograph does not fit its camera, UsageError for bad options, ContradictionError when no view
/// sees any of the surface.
ColorResult color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const ColorOptions& options, Progress& progress);

/// The same with options.batch photographs in memory at a time. Same bits.
ColorResult color_in_batches(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const ColorOptions& options,
                             Progress& progress);

/// Vertex colours from the volume, trilinear (the paper's choice). Vertices without a coloured voxel around take the nearest one's within
/// four voxels. Returns the number of those that found none and stay black.
size_t color_vertices(Mesh& mesh, const openvdb::Vec3SGrid& color);

/// Vertex colours straight from the photographs, by the same rules as the volume's; vertices that no view sees take the volume's.
/// Gains are options.gains, those of ColorResult::exposure, and not estimated; on the CPU. Returns the share of vertices seen.
double color_vertices_from_photos(Mesh& mesh, const openvdb::FloatGrid& surface, const openvdb::Vec3SGrid& color, const std::vector<ColorInput>& inputs,
                                  const PhotoSource& photos, const ColorOptions& options, Progress& progress);

}  // namespace vdbcarve
