// SPDX-License-Identifier: Apache-2.0
// What the stages of a run hand to each other. Views are always meant by their index in Shoot::views, never by name.
#pragma once

#include <openvdb/openvdb.h>

#include <array>
#include <atomic>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "carve/carve_plan.h"
#include "known_hull.h"
#include "pipeline/key.h"
#include "pipeline/memory_plan.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/color.h"
#include "vdbcarve/volume.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/stereo.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/video.h"
#include "vdbcarve/views.h"

namespace vdbcarve::pipeline {

/// Cameras that this run found.
struct Alignment {
    nlohmann::json said;                                      ///< alignment_json(), for the report
    std::string direction;                                    ///< cw, ccw
    std::string picture_name;                                 ///< what `picture` is called in OUT, without extension
    std::vector<double> residual_px;                          ///< by view
    std::filesystem::path orbit_svg, picture, other_cameras;  ///< in OUT/stages; the last two need not be there
};

/// The height of what the object stands on, along up.
struct FloorFound {
    double height = 0;
    std::string from;                           ///< "given", "photographs", "lowest contour"
    std::optional<double> likeness, next_best;  ///< see Floor
};

/// What was photographed, and from where.
struct Shoot {
    Views views;
    std::string up_given;              ///< --up; empty: the camera file's counts
    std::filesystem::path folder;      ///< of the photographs: the scene, or a video's frames
    std::optional<VideoFrames> video;  ///< the scene is one
    std::filesystem::path video_file;
    std::optional<Alignment> alignment;  ///< cameras were found in this run
    std::optional<FloorFound> floor;     ///< found or given in this run; views.floor has its height

    void stand_on(const FloorFound& found) {
        floor = found;
        views.floor = found.height;
    }
    std::string up() const { return up_given.empty() ? views.up : up_given; }
};

/// Masks of all views, and which views are carved with.
struct Silhouettes {
    std::string key;
    Masks masks;
    std::vector<std::string> names;             ///< file names in OUT/masks, by view
    std::vector<std::filesystem::path> files;   ///< of the coverage in OUT/stages, by view; empty: none
    std::vector<std::filesystem::path> edited;  ///< masks in OUT that the user changed, by view; empty: not
    std::vector<std::string> file_hashes;       ///< of everything that a view is made from, by view
    std::vector<nlohmann::json> inputs;         ///< SHA-256 of each of those files, by view, for the report
    std::string inputs_sha256, camera_file_sha256;
    std::vector<size_t> used;  ///< views that are carved with
};

/// The bounds and voxels of a result that views are added to.
struct KeptGrid {
    Box3d bounds;
    double voxel_size = 0;
    Vec3d origin = Vec3d::Zero();
    bool automatic = true, floor_clips = false;
};

/// The lattice that is carved, for the report and for later runs.
struct GridFacts {
    std::array<int, 3> dims{};
    double voxel_size = 0;
    std::array<double, 3> origin{};
    std::array<double, 6> bounds{};  ///< minimum, maximum
    bool bounds_automatic = true;
    bool floor_clips = false;  ///< the bounds end at the floor
    double bounds_seconds = 0, pixel_footprint = 0, px_per_voxel = 0;
    int field_scale = 1;
    std::optional<MemoryExpected> expected;     ///< none: it was not worth asking
    std::optional<CarveStatistics> statistics;  ///< none: not carved
    std::vector<std::string> bricks;            ///< files of a hull that did not fit whole
};
/// What the report says of a carve; the voxels inside are not among it.
nlohmann::json statistics_json(const CarveStatistics& s);
CarveStatistics statistics_of(const nlohmann::json& j);
void to_json(nlohmann::json& j, const GridFacts& g);
void from_json(const nlohmann::json& j, GridFacts& g);

/// What is carved: the lattice, the views' distance fields, and how both fit into memory. `needed` false: the hull is there.
struct Plan {
    bool needed = false;
    CarveOptions carve;
    DistanceOptions field_options;
    GridFacts grid;
    JobSize job;
    MemoryPlan memory;
    std::vector<CarveInput> inputs;      ///< views that are carved with; where a known hull is extended, first those that made it
    std::vector<MaskView> masks;         ///< of inputs
    std::vector<DistanceField> fields;   ///< those of inputs, or none where they are on the device or made in batches
    std::string base_key, hull_id;       ///< what a hull depends on but for its views, and with them
    std::vector<std::string> view_keys;  ///< of inputs, by camera and mask
    std::optional<KnownHull> known;      ///< made of the first inputs, to be extended by the others
    double extend_seconds = 0;
    size_t warnings_before = 0;  ///< the hull's note keeps those from here on

    /// The very hull is there, under another key.
    bool known_whole() const { return known && known->views.size() == inputs.size(); }
};

struct Hull {
    std::string key;  ///< of the voxels' content: the same hull asked for in other words has the same
    GridFacts grid;
    std::string backend = "cpu";       ///< where it was carved
    openvdb::FloatGrid::Ptr level;     ///< raw values; null: still in its file
    openvdb::MaskGrid::Ptr occupancy;  ///< instead, with --occupancy; null: still in its file
    std::filesystem::path file;        ///< in OUT/stages; not there where it is in bricks
    std::vector<std::filesystem::path> brick_files;
    size_t added_views = 0;  ///< that an earlier hull was extended by
    double extend_seconds = 0;
};

/// The level set, and what it went through.
struct Surface {
    std::string key;
    openvdb::FloatGrid::Ptr grid;
    std::optional<double> floor_clear;  ///< what was cleared off the floor, scene units
    openvdb::FloatGrid::Ptr hull;       ///< the level set of the hull, to be kept beside; null: not
    nlohmann::json fair;                ///< what the report says of it; null: it is the hull's
    openvdb::FloatGrid::Ptr slack;      ///< slack.h; null: it is the hull's
    openvdb::GridBase::Ptr stereo_confidence;
    double trusted_share = 0, silhouettes_kept = 1;  ///< of the depths: object pixels with one that others agree with; silhouettes_kept.h
    nlohmann::json stereo;                           ///< what the report says of them; null: none were made
    std::filesystem::path stereo_sheet, depth_maps;  ///< in OUT/stages; empty or not there: none
    nlohmann::json filter = nlohmann::json::object();
    std::string filter_chain = "none";
    std::optional<std::array<double, 2>> filter_volumes;  ///< before and after the chain, without the repair
};

struct ViewColor {
    bool used = false;
    std::array<double, 3> gain{1, 1, 1};
    double first_choice_share = 0;  ///< of the surface's voxels
};

struct Colors {
    std::string key;
    openvdb::Vec3SGrid::Ptr grid;  ///< null: no colour
    openvdb::GridBase::Ptr views, confidence;
    std::vector<ViewColor> of_view;  ///< by index in Silhouettes::used; empty: no colour
    nlohmann::json said;             ///< for the report; null: not coloured
};

struct MeshStep {
    size_t dropped_pieces = 0;
    double dropped_volume_share = 0;
    double expected_bytes = 0;
    int slabs = 1;
};

struct MeshMade {
    std::string key;
    Mesh mesh;
    MeshStep step;
    std::optional<double> vertices_seen_share;  ///< with colours straight from the photographs
    MeshMeasures measures;
    int smooth_iterations = 0;
    std::optional<double> volume_before_smooth;
};

/// Cameras of the views that are carved with.
std::vector<Camera> used_cameras(const Shoot& shoot, const Silhouettes& masks);
/// Masks by view, of the views that are carved with; the others' are empty.
std::vector<MaskView> used_mask_views(const Shoot& shoot, const Silhouettes& masks);
/// What the photographs of the views that are carved with show, and from where.
void add_photographs(Key& key, const Shoot& shoot, const Silhouettes& masks);
/// Up as a direction; the axis of the orbit where it is not known.
Vec3d up_direction(const Shoot& shoot, const Silhouettes& masks);
/// What .vdb files say of themselves.
VdbMetadata metadata_of(const Shoot& shoot, const Silhouettes& masks, double voxel_size);
/// The photograph without its lens's distortion, in 8 bits; where it cannot be read, that is said and it is empty.
Image8 photo_to_show(const View& view, Progress& progress);
/// Photographs that are silhouettes themselves, or copies of them, have no colour to give.
bool photos_are_masks(const Shoot& shoot, const Silhouettes& masks);
/// The views that are carved with, as colouring and stereo take them; every `leave_out`-th is withheld (0: none is).
std::vector<ColorInput> color_inputs(const Shoot& shoot, const Silhouettes& masks, int leave_out);

/// Photographs of the views that are carved with, read when they are asked for. One that cannot be read is warned of once and gives no colour.
class Photographs {
  public:
    Photographs(const Shoot& shoot, const Silhouettes& masks, Progress& progress)
        : shoot_(shoot), masks_(masks), progress_(progress), missing_(masks.used.size()) {}
    PhotoSource source();
    /// By index in Silhouettes::used: it could not be read.
    bool is_missing(size_t used) const { return missing_[used].said; }
    /// It is known to be missing, from an earlier run that said so.
    void set_missing(size_t used) { missing_[used].said = true; }

  private:
    struct Missing {
        std::atomic<bool> said{false};
    };
    const Shoot& shoot_;
    const Silhouettes& masks_;
    Progress& progress_;
    std::vector<Missing> missing_;
};

inline constexpr double kPhotoBytesPerPixel = 12;
/// Bytes of the largest photograph, its field and what making both needs besides.
double largest_photo_bytes(const Shoot& shoot, const Silhouettes& masks);

}  // namespace vdbcarve::pipeline
