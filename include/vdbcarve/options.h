// SPDX-License-Identifier: Apache-2.0
// What reconstruct() lets its caller choose for each stage, where that is not simply the stage's own options struct.
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/backend.h"
#include "vdbcarve/color.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/export.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/smooth.h"
#include "vdbcarve/stereo.h"

namespace vdbcarve {

/// When cameras are looked for, and which of them are taken.
struct CamerasOptions {
    bool find_again = false;           ///< also where there is a camera file
    bool accept_unobservable = false;  ///< go on with cameras that align() does not stand behind
};

/// The voxel grid: at most one of resolution, voxel_size and dims; none: a voxel for a pixel.
struct GridOptions {
    int resolution = 0;                      ///< voxels along the longest side of the bounds
    double voxel_size = 0;                   ///< world units
    std::optional<std::array<int, 3>> dims;  ///< voxels along x, y, z
    std::optional<Box3d> bounds;             ///< world; none: found from the silhouettes
    std::optional<Vec3d> origin;             ///< of the voxel lattice, world
};

/// How the hull is carved.
struct CarveSettings {
    double silhouette_offset_px = 0;  ///< grows (+) or shrinks (-) every silhouette
    int field_scale = 0;              ///< pixels a side of a distance field's sample; 0: by resolution
    int max_misses = 0;               ///< so many views may show background and a voxel stays
    double min_seen = 0.6;            ///< share of the views that must have a point in frame
    bool outside_is_background = false;
    bool occupancy = false;  ///< the paper's binary model
    int half_width_vox = 3;  ///< of the level set's band
};

/// The table that the object stands on: below it there is nothing (reflections), and what lies flatter on it than `clear` is not the object (contact shadows).
/// Needs an up axis.
struct FloorOptions {
    enum class From { File, Given, Found };
    From from = From::File;    ///< the camera file's, where it has one (a mat); `height`; or found in the photographs, else from the lowest contour
    double height = 0;         ///< along up, scene units
    double clear = -1;         ///< scene units; < 0: 1 % of the object's height, none for the camera file's floor
    bool flat_base = false;    ///< cut the foot by a plane where the lowest contour was seen; needs an up axis
    double cap_tolerance = 0;  ///< surface farther beyond the highest and lowest contours is called extrapolated, scene units; 0: two voxels
};

struct StereoSettings {
    bool on = false;  ///< carve concavities by the photographs' depths
    StereoOptions options;
    bool maps = false;  ///< every view's depths and how sure they are, as pictures in OUT/depth
};

struct ColorSettings {
    /// How the surface is coloured; mode None: not. Gains and `up` are set by the job; `batch` is lowered to keep within the memory limit.
    ColorOptions options;
    bool from_photos = false;  ///< vertex colours straight from the photographs, not from the volume
    int leave_out = 0;         ///< every N-th view is withheld from colouring, to be compared with (evaluate --photos); 0: none
};

struct FilterSettings {
    std::optional<std::vector<FilterStep>> steps;  ///< none: chosen by how soft the masks are (src/filter.md)
    bool repair_volume = true;
    double keep_thin_vox = 4;  ///< see FilterOptions; lowered to what the half-width allows
};

struct MeshSettings {
    Mesher mesher = Mesher::Dual;
    bool normals = false;           ///< of the mesh, Mesher::MarchingCubes
    bool quads = false;             ///< keep quads in .ply and .obj, Mesher::Dual
    double adaptivity = 0;          ///< 0: uniform; up to 1: larger faces where flat
    double min_piece_share = 1e-3;  ///< pieces of the mesh with less of its volume are left out
};

/// The finished mesh: smoothed, then decimated.
struct SmoothSettings {
    std::optional<int> iterations;  ///< none: 0, or 10 for an occupancy that is not filtered
    SmoothOptions factors;
    size_t faces = 0;      ///< decimate to so many; 0: no
    double max_error = 0;  ///< decimate as far as this allows, scene units; 0: no
};

/// The files of the result.
struct ResultOptions {
    std::vector<std::string> mesh_formats{"ply", "glb"};
    Dcc dcc = Dcc::None;                               ///< axes, units and the colour grid's name in all volumes and meshes
    bool vdb_half = false;                             ///< volume.vdb with 16-bit floats
    bool stl_mm = false;                               ///< mesh.stl in millimetres
    bool views_grid = false, confidence_grid = false;  ///< further grids of volume.vdb
    bool report = true;                                ///< write report.html, too
};

/// The last stage to run.
enum class LastStage { Mask, Align, Carve, Export };

/// Where a run puts its result and what it may use; nothing of it changes the result.
struct RunOptions {
    std::filesystem::path output;
    Backend backend = Backend::Auto;
    int device = 0;  ///< number of the CUDA device
    /// Resident memory that may be used, bytes; 0: nine tenths of the machine's. Fields are made in batches and the hull is carved in bricks where it would not
    /// do otherwise.
    size_t memory_limit = 0;
    LastStage last_stage = LastStage::Export;
    bool force = false;                                     ///< write into a folder that vdbcarve did not make
    bool dry_run = false;                                   ///< plan only
    std::string config_text;                                ///< effective configuration, written as config.toml
    std::function<void(const std::string& json)> on_stage;  ///< one JSON object when a stage ends
};

}  // namespace vdbcarve
