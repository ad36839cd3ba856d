// SPDX-License-Identifier: Apache-2.0
// The whole job: a scene becomes a folder of results, stage by stage, resumable.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/align.h"
#include "vdbcarve/backend.h"
#include "vdbcarve/color.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/export.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/smooth.h"
#include "vdbcarve/stereo.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/video.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// The last stage to run.
enum class LastStage { Mask, Align, Carve, Export };

struct ReconstructOptions {
    /// views.scene may be a film: its frames become the photographs. Where views.added is not empty and the output holds a result with the same cameras, that
    /// result's bounds and voxels are kept, so that its hull is extended by the views that it lacks.
    ViewsOptions views;
    VideoOptions video;
    MaskOptions mask;
    AlignOptions align;                ///< where cameras are to be found or improved
    bool align_again = false;          ///< also where there is a camera file
    bool accept_unobservable = false;  ///< go on with cameras that align() does not stand behind
    DistanceOptions distance;

    // The grid: at most one of resolution, voxel_size and grid.
    int resolution = 0;                      ///< voxels along the longest side of the bounds
    double voxel_size = 0;                   ///< world units
    std::optional<std::array<int, 3>> grid;  ///< voxels along x, y, z
    std::optional<Box3d> bounds;             ///< world; none: found from the silhouettes
    std::optional<Vec3d> origin;             ///< of the voxel lattice, world

    int field_scale = 0;  ///< pixels a side of a distance field's sample; 0: by resolution
    int max_misses = 0;
    double min_seen = 0.6;
    bool outside_is_background = false;
    bool occupancy = false;
    int half_width_vox = 3;
    double adaptivity = 0;
    Mesher mesher = Mesher::Dual;
    bool normals = false;           ///< of the mesh, Mesher::MarchingCubes
    bool quads = false;             ///< keep quads in .ply and .obj, Mesher::Dual
    double min_piece_share = 1e-3;  ///< pieces of the mesh with less of its volume are left out

    std::optional<std::vector<FilterStep>> filters;  ///< none: chosen by how soft the masks are (src/filter.md)
    bool repair_volume = true;
    double keep_thin_vox = 4;              ///< see FilterOptions; lowered to what the half-width allows
    std::optional<int> smooth_iterations;  ///< none: 0, or 10 for an occupancy that is not filtered
    SmoothOptions smooth;                  ///< its factors
    size_t faces = 0;                      ///< decimate to so many; 0: no
    double max_error = 0;                  ///< decimate as far as this allows, scene units; 0: no

    /// The table that the object stands on: below it there is nothing (reflections), and what lies flatter on it than floor_clear is not the object (contact
    /// shadows). Needs an up axis.
    enum class FloorFrom { File, Given, Found };
    FloorFrom floor_from =
        FloorFrom::File;       ///< the camera file's, where it has one (a mat); `floor`; or found in the photographs, else from the lowest contour
    double floor = 0;          ///< its height along up, scene units
    double floor_clear = -1;   ///< scene units; < 0: 1 % of the object's height, none for the camera file's floor
    bool flat_base = false;    ///< cut the foot by a plane where the lowest contour was seen; needs an up axis
    double cap_tolerance = 0;  ///< surface farther beyond the highest and lowest contours is called extrapolated, scene units; 0: two voxels

    bool use_stereo = false;   ///< carve concavities by the photographs' depths
    StereoOptions stereo;      ///< backend and device are set by the job
    bool stereo_maps = false;  ///< every view's depths and how sure they are, as pictures in OUT/depth
    /// How the surface is coloured; mode None: not. Gains, backend, device and `up` are set by the job; `batch` is lowered to keep within memory_limit.
    ColorOptions color;
    bool color_from_photos = false;                    ///< vertex colours straight from the photographs, not from the volume
    int color_leave_out = 0;                           ///< every so manieth view is left out of colouring, to be compared with (evaluate --photos); 0: none
    bool views_grid = false, confidence_grid = false;  ///< further grids of volume.vdb
    Dcc dcc = Dcc::None;                               ///< axes, units and the colour grid's name in all volumes and meshes
    bool vdb_half = false;                             ///< volume.vdb with 16-bit floats
    bool stl_mm = false;                               ///< mesh.stl in millimetres

    /// Resident memory that may be used, bytes; 0: nine tenths of the machine's. Fields are made in batches and the hull
    /// is carved in bricks where it would not do otherwise.
    size_t memory_limit = 0;

    std::filesystem::path output;
    std::vector<std::string> mesh_formats{"ply", "glb"};
    Backend backend = Backend::Auto;
    int device = 0;  ///< number of the CUDA device
    LastStage last_stage = LastStage::Export;
    bool force = false;                                     ///< write into a folder that vdbcarve did not make
    bool dry_run = false;                                   ///< plan only
    bool report = true;                                     ///< write report.html, too
    std::string config_text;                                ///< effective configuration, written as config.toml
    std::function<void(const std::string& json)> on_stage;  ///< one JSON object when a stage ends
};

struct Reconstruction {
    std::string report_json;  ///< what report.json holds (of a dry run: the plan)
    MeshMeasures mesh;
    double median_iou = 0, minimum_iou = 0;
    size_t views = 0;           ///< that were carved with
    size_t added_views = 0;     ///< of them, those that the hull of an earlier run was extended by
    double extend_seconds = 0;  ///< for that: their fields and the hull, without masks and files
    std::string contradiction;  ///< why the result, which was written, is not to be trusted: most silhouettes contradict it; empty: they do not
};

/// Runs the stages that are not already in output/stages for the same inputs, options and code version.
/// Files of the result appear by rename; the same inputs give the same bytes (report.json and config.toml
/// apart, which hold times and paths). Throws Error.
Reconstruction reconstruct(const ReconstructOptions& options, Progress& progress);

/// File names of the views' masks in output/masks, by view.
std::vector<std::string> mask_names(const Views& views);

/// The cameras of a result with their photographs, from where its report says that they are, or from the folder `images`; a view whose photograph is not there
/// any more has none. Throws InputError.
Views result_views(const std::filesystem::path& output, const std::filesystem::path& images, Progress& progress);

/// The same of the last run in that folder, finished, failed or killed: the cameras that it went on with. Throws InputError, also where it never had any.
Views last_views(const std::filesystem::path& output, const std::filesystem::path& images, Progress& progress);

/// How a file of a result lies to the scene, as its report says; the scene's own frame where it says nothing.
FileFrame frame_from_scene(const std::filesystem::path& output, const std::string& file);

/// Empties output/stages of a folder that vdbcarve made; results stay. Returns the bytes freed.
size_t clean(const std::filesystem::path& output);

}  // namespace vdbcarve
