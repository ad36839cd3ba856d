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
#include "vdbcarve/file_frame.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/stage_visits.h"

namespace vdbcarve {

/// When cameras are looked for, and which of them are taken.
struct CamerasOptions {
    bool find_again = false;           ///< also where there is a camera file
    bool accept_unobservable = false;  ///< go on with cameras that align() does not stand behind
};
template <OptionsOf<CamerasOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"find-again"}, o.find_again, Words(kOnOffWords));
    v(Option{"accept-unobservable", "go on with cameras that the silhouettes do not determine", kAlignGroup, in::kAligning}, o.accept_unobservable, Flag{});
}

/// The voxel grid: at most one of resolution, voxel_size and dims; none: a voxel for a pixel.
struct GridOptions {
    int resolution = 0;                      ///< voxels along the longest side of the bounds
    double voxel_size = 0;                   ///< world units
    std::optional<std::array<int, 3>> dims;  ///< voxels along x, y, z
    std::optional<Box3d> bounds;             ///< world; none: found from the silhouettes
    std::optional<Vec3d> origin;             ///< of the voxel lattice, world
};
template <OptionsOf<GridOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"resolution", "voxels along the longest side of the bounds (default: one for a pixel, 64..1024)", "Grid", in::kCarving}, o.resolution,
      above(0).or_unset(0));
    v(Option{"voxel-size", "edge of a voxel, scene units", "Grid", in::kCarving}, o.voxel_size, above(0).or_unset(0));
    v(Option{"grid", "voxels along x, y and z, like 1024x512x1024", "Grid", in::kCarving}, o.dims, DimsForm{});
    v(Option{"bounds", "xmin,ymin,zmin,xmax,ymax,zmax: clip to this box (default: found from the silhouettes)", "Grid", in::kCarving}, o.bounds, BoxForm{});
    v(Option{"origin", "x,y,z of the voxel lattice's corner (default 0,0,0)", "Grid", in::kCarving}, o.origin, PointForm{});
}

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
inline constexpr Word<bool> kOutsideWords[] = {{"unknown", false}, {"background", true}};
inline constexpr Word<double> kFieldScaleWords[] = {{"auto", 0}};
template <OptionsOf<CarveSettings> O, class V>
void visit(O& o, V& v) {
    v(Option{"max-misses", "a voxel stays although this many views show background there", "Carving", in::kCarving}, o.max_misses, within(0, 15));
    v(Option{"min-seen", "share of the views that must have a point in frame", "Carving", in::kCarving}, o.min_seen, within(0, 1));
    v(Option{"outside", "what lies outside an image: unknown (default) or background (the paper)", "Carving", in::kCarving}, o.outside_is_background,
      Words(kOutsideWords));
    v(Option{"silhouette-offset", "grow silhouettes by this many pixels", "Carving", in::kCarving}, o.silhouette_offset_px, any_number());
    v(Option{"field-scale", "pixels a side of a distance field's sample: auto (at least 2.5 samples to a voxel) or 1, 2, 4 …", "Carving", in::kCarving},
      o.field_scale, within(1, 1e6).or_words(kFieldScaleWords));
    v(Option{"occupancy", "the paper's binary model: nearest pixel, one bit a voxel", "Carving", in::kCarving}, o.occupancy, Flag{});
    v(Option{"half-width"}, o.half_width_vox, within(2, 100));
}

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
/// auto, or a height
struct FloorForm {
    static std::string print(FloorOptions::From from, double height);
    static void parse(const std::string& option, const std::string& text, FloorOptions::From& from, double& height);
    static std::string fault(const std::string& option, FloorOptions::From from, double height);
};
inline constexpr Word<bool> kBaseWords[] = {{"hull", false}, {"flat", true}};
template <OptionsOf<FloorOptions> O, class V>
void visit(O& o, V& v) {
    v.joint(Option{"floor",
                   "height of the table, along up: nothing of the object is lower (reflections are cut off); auto: found in the photographs by the table's "
                   "pattern, else the lowest contour (default: the camera file's, of a mat)",
                   "Result", in::kAligning, "auto|HEIGHT"},
            FloorForm{}, o.from, o.height);
    v(Option{"floor-clear",
             "a flat patch on the floor of the hull is not part of the object (contact shadows), up to this height, scene units (default: 1 % of the height "
             "with "
             "--floor; 0: nothing is cleared)",
             "Result", in::kMeshing},
      o.clear, at_least(0).or_unset(-1));
    v(Option{"base", "the foot: hull (default; bulges where only slanted views bound it) or flat, cut where the lowest contour was seen (needs an up axis)",
             "Result", in::kMeshing},
      o.flat_base, Words(kBaseWords));
    v(Option{"cap-tolerance", "surface farther beyond the highest and lowest contours seen counts as extrapolated, scene units (default: 2 voxels)", "Result",
             in::kMeshing},
      o.cap_tolerance, at_least(0).or_unset(0));
}

/// Which surface inside the hull is taken.
struct SurfaceSettings {
    bool fair = true;  ///< the smoothest that covers every silhouette, not the hull itself
    FairOptions options;
    bool keep_hull = false;  ///< volume.vdb holds the hull's level set, too, as "hull_surface"
};
inline constexpr Word<bool> kSurfaceWords[] = {{"hull", false}, {"fair", true}};
template <OptionsOf<SurfaceSettings> O, class V>
void visit(O& o, V& v) {
    v(
        Option{
            "surface",
            "fair (default): the smoothest surface that covers every silhouette, which may take a little of the object where no silhouette shows it; hull: the "
            "largest that the silhouettes allow, with the slabs and ridges that they leave. With --occupancy always hull",
            "Surface", in::kMeshing},
        o.fair, Words(kSurfaceWords));
    v.part(o.options);
    v.not_in_key(Option{"keep-hull", "volume.vdb holds the hull's level set, too, as hull_surface", "Surface", in::kMeshing}, o.keep_hull, Flag{});
}

struct StereoSettings {
    enum class Use { Off, On, Auto };  ///< Auto: where the photographs show enough, which the depths themselves say
    Use use = Use::Off;                ///< carve concavities by the photographs' depths
    StereoOptions options;
    bool maps = false;  ///< every view's depths and how sure they are, as pictures in OUT/depth

    bool is_wanted() const { return use != Use::Off; }
};
inline constexpr Word<StereoSettings::Use> kStereoWords[] = {
    {"off", StereoSettings::Use::Off}, {"on", StereoSettings::Use::On}, {"auto", StereoSettings::Use::Auto}};
template <OptionsOf<StereoSettings> O, class V>
void visit(O& o, V& v) {
    v(Option{"stereo",
             "on: carve what silhouettes cannot see (concavities) by the photographs' depths, inside the hull; needs texture, and every place seen by three "
             "photographs 8 to 40 degrees apart. off (default). auto: on if at least a fifth of the object's pixels have a depth that other photographs agree "
             "with, which takes as long to find out",
             "Stereo", in::kMeshing},
      o.use, Words(kStereoWords));
    v.part(o.options);
    v(Option{"stereo-maps", "OUT/depth gets every view's depths (32-bit float .tiff, along the camera's z, 0: none) and how sure they are (.png)", "Stereo",
             in::kMeshing},
      o.maps, Flag{});
}

struct ColorSettings {
    /// How the surface is coloured; mode None: not. Gains and `up` are set by the job; `batch` is lowered to keep within the memory limit.
    ColorOptions options;
    bool from_photos = false;  ///< vertex colours straight from the photographs, not from the volume
    int leave_out = 0;         ///< every N-th view is withheld from colouring, to be compared with (evaluate --photos); 0: none
};
inline constexpr Word<bool> kColorSourceWords[] = {{"volume", false}, {"images", true}};
template <OptionsOf<ColorSettings> O, class V>
void visit(O& o, V& v) {
    v.part(o.options);
    v(Option{"color-source",
             "vertex colours from the volume (default: mesh and volume agree), or from the images vertex by vertex (sharper where voxels are coarse)", "Colour",
             in::kMeshing},
      o.from_photos, Words(kColorSourceWords));
    v(Option{"color-leave-out", "withhold every N-th view from colouring, for evaluate --photos to compare with (0: none)", "Colour", in::kMeshing},
      o.leave_out, within(0, 1000));
}

struct FilterSettings {
    std::optional<std::vector<FilterStep>> steps;  ///< none: chosen by how soft the masks are (docs/stages/filter.md)
    bool repair_volume = true;
    double keep_thin_vox = 4;  ///< see FilterOptions; lowered to what the half-width allows
};
template <OptionsOf<FilterSettings> O, class V>
void visit(O& o, V& v) {
    v(
        Option{
            "filter",
            "NAME[:WIDTH][xITERATIONS],…: median, mean-curvature, laplacian, gaussian, edge-preserving; none; auto: none for soft masks, edge-preserving:2 for "
            "hard ones, :2x4 for --occupancy",
            "Filter", in::kMeshing},
        o.steps, FiltersForm{});
    v(Option{"no-volume-repair", "leave the volume as the filter leaves it", "Filter", in::kMeshing}, o.repair_volume, Flag{false});
    v(Option{"keep-thin", "parts thinner than this many voxels are not filtered (0: all are)", "Filter", in::kMeshing}, o.keep_thin_vox, at_least(0));
}

struct MeshSettings {
    Mesher mesher = Mesher::Dual;
    bool normals = false;           ///< of the mesh, Mesher::MarchingCubes
    bool quads = false;             ///< keep quads in .ply and .obj, Mesher::Dual
    double adaptivity = 0;          ///< 0: uniform; up to 1: larger faces where flat
    double min_piece_share = 1e-3;  ///< pieces of the mesh with less of its volume are left out
};
inline constexpr Word<Mesher> kMesherWords[] = {{"dual", Mesher::Dual}, {"marching-cubes", Mesher::MarchingCubes}};
template <OptionsOf<MeshSettings> O, class V>
void visit(O& o, V& v) {
    v(Option{"mesher", "dual (OpenVDB's, default) or marching-cubes", "Result", in::kMeshing}, o.mesher, Words(kMesherWords));
    v(Option{"normals", "vertex normals from the volume's gradient, in mesh.ply (--mesher marching-cubes)", "Result", in::kMeshing}, o.normals, Flag{});
    v(Option{"adaptivity", "0: uniform mesh; up to 1: larger faces where flat", "Result", in::kMeshing}, o.adaptivity, within(0, 1));
    v(Option{"quads", "keep quads in .ply and .obj (--mesher dual)", "Mesh", in::kMeshing}, o.quads, Flag{});
    v(Option{"min-piece", "pieces with less of the mesh's volume are left out, as a share", "Mesh", in::kMeshing}, o.min_piece_share, within(0, 1));
}

/// The finished mesh: smoothed, then decimated.
struct SmoothSettings {
    std::optional<int> iterations;  ///< none: 0, or 10 for an occupancy that is not filtered
    SmoothOptions factors;
    size_t faces = 0;      ///< decimate to so many; 0: no
    double max_error = 0;  ///< decimate as far as this allows, scene units; 0: no
};
template <OptionsOf<SmoothSettings> O, class V>
void visit(O& o, V& v) {
    v(Option{"smooth", "iterations of Taubin's smoothing; auto: 0, or 10 with --occupancy --filter none", "Mesh", in::kMeshing}, o.iterations,
      IterationsForm{});
    v.part(o.factors);
    v(Option{"faces", "decimate to this many faces (0: no)", "Mesh", in::kMeshing}, o.faces, within(0, 2000000000).or_unset(0));
    v(Option{"max-error", "decimate as far as no point moves by more, scene units (0: no)", "Mesh", in::kMeshing}, o.max_error, at_least(0).or_unset(0));
}

/// The files of the result.
struct ResultOptions {
    std::vector<std::string> mesh_formats{"ply", "glb"};
    Dcc dcc = Dcc::None;                               ///< axes, units and the colour grid's name in all volumes and meshes
    bool vdb_half = false;                             ///< volume.vdb with 16-bit floats
    bool stl_mm = false;                               ///< mesh.stl in millimetres
    bool views_grid = false, confidence_grid = false;  ///< further grids of volume.vdb
    bool report = true;                                ///< write report.html, too
};
inline constexpr Word<Dcc> kDccWords[] = {{"none", Dcc::None}, {"blender", Dcc::Blender}, {"houdini", Dcc::Houdini}, {"maya", Dcc::Maya}};
inline constexpr const char* kMeshFormats[] = {"ply", "obj", "glb", "stl"};
/// views, confidence or both
struct ColorGridsForm {
    static constexpr bool kList = true;  ///< the command line takes the words one by one, too
    static std::string print(bool views, bool confidence);
    static void parse(const std::string& option, const std::string& text, bool& views, bool& confidence);
};
template <OptionsOf<ResultOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"mesh-formats", "ply,obj,glb,stl", "Result", in::kMeshing}, o.mesh_formats, OneOf(kMeshFormats));
    v(Option{"dcc",
             "axes, units and colour grid's name for a program, in volumes and meshes alike: blender (z up, m), houdini (y up, m, Cd), maya (y up, cm), none",
             "Result", in::kMeshing},
      o.dcc, Words(kDccWords));
    v(Option{"vdb-half", "16-bit floats in volume.vdb: two thirds of the size, three digits", "Result", in::kMeshing}, o.vdb_half, Flag{});
    v(Option{"stl-mm", "mesh.stl in millimetres, for printers (needs --units, or a scene that says them)", "Result", in::kMeshing}, o.stl_mm, Flag{});
    v.joint(Option{"color-grids", "further grids for volume.vdb: views (how many were blended, 0: no view saw the place), confidence", "Colour", in::kMeshing},
            ColorGridsForm{}, o.views_grid, o.confidence_grid);
    v(Option{"no-report", "no report.html", "Result", in::kMeshing}, o.report, Flag{false});
}

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
    std::function<void(const std::string& json)> on_stage;  ///< one JSON object when a stage ends
};
inline constexpr Word<Backend> kBackendWords[] = {{"auto", Backend::Auto}, {"cpu", Backend::Cpu}, {"cuda", Backend::Cuda}};
template <OptionsOf<RunOptions> O, class V>
void visit(O& o, V& v) {
    v.not_in_key(Option{"output", "folder for the result"}, o.output, Text{});
    v.not_in_key(Option{"backend", "auto (a GPU where there is one), cpu or cuda; the result is the same", "Carving", in::kCarving}, o.backend,
                 Words(kBackendWords));
    v.not_in_key(Option{"device", "number of the CUDA device", "Carving", in::kCarving}, o.device, at_least(0));
    v.not_in_key(Option{"memory-limit", "resident memory that may be used, like 8G or 500M (default: nine tenths of the machine's)", "Options", in::kCarving},
                 o.memory_limit, BytesForm{});
    v.not_in_key(Option{"dry-run", "plan only: views, bounds, grid, memory", "Options", in::kCarving & ~in::kWatch}, o.dry_run, Flag{});
    v.not_in_key(Option{"force", "write into a folder that vdbcarve did not make"}, o.force, Flag{});
    v.ignore(o.last_stage, o.on_stage);
}

}  // namespace vdbcarve
