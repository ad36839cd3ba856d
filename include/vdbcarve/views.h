// SPDX-License-Identifier: Apache-2.0
// Stage `views`: camera files and photographs become one list of views in one convention.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

/// One photograph and its camera.
struct View {
    std::string name;                  ///< as the camera file spells it, folders included
    std::filesystem::path image_path;  ///< the photograph; empty where there is none
    std::filesystem::path mask_path;   ///< named by the camera file; empty where it names none
    int orientation = 1;               ///< EXIF's, by which the stored photograph is turned to be the camera's; 1: not at all
    Camera camera;                     ///< pinhole (or orthographic), after the lens was removed
    Lens lens;                         ///< what has to be removed from image and mask
    std::string sitting = "0";         ///< which sitting of the object this view belongs to
    std::string unused;                ///< why it is neither carved with nor coloured from; empty: it is
    std::filesystem::path scene;       ///< the added scene that it is from, where its mask is looked for; empty: from the scene itself
};

/// The object may be turned over or moved between two rounds of photographs: each round is a sitting, with
/// its own transform into the scene: x_scene = scene_from_sitting.rotation * (scale * x_sitting)
/// + scale * scene_from_sitting.translation.
struct Sitting {
    std::string id = "0";
    Rigid3 scene_from_sitting;
    double scale = 1.0;
};

struct Views {
    std::vector<View> views;
    std::vector<Sitting> sittings{Sitting{}};
    std::filesystem::path camera_file;  ///< where the cameras came from
    std::string format;                 ///< name of the importer
    std::string up;                     ///< world up axis: "x", "y", "z", "-x", … or empty when unknown
    std::string units;                  ///< length unit of the world, or empty when unknown
    std::optional<double> floor;        ///< height along `up` of what the object stands on: nothing of it is lower
    std::vector<std::string> left_out;  ///< names of views without an image (allow_missing)
    std::vector<std::string>
        without_camera;  ///< pictures beside the photographs that the camera file does not know; looked for where they may still be arriving (is_whole)
    std::vector<std::string> unverified;  ///< why its cameras must not be trusted (exit 5 of align); empty: nothing speaks against them
    bool metric = true;                   ///< false: a projective world, without angles and distances
    bool posed = true;                    ///< false: there was no camera file; focal lengths may be 0 (unknown), poses mean nothing

    /// The cameras in the scene's frame, every sitting's transform applied.
    std::vector<Camera> cameras() const;
    std::vector<std::string> names() const;
};

enum class PixelCentre { Default, Corner, Integer };

struct ViewsOptions {
    std::filesystem::path scene;                      ///< folder with images/, masks/, camera files, or photos directly
    std::filesystem::path images;                     ///< overrides where images are looked for
    std::filesystem::path cameras;                    ///< overrides which camera file is read; "none": no file is
    bool allow_unposed = false;                       ///< without a camera file, views have photographs only, for align()
    PixelCentre pixel_centre = PixelCentre::Default;  ///< overrides the format's rule
    bool accept_non_metric = false;                   ///< carve in a projective world all the same
    bool allow_missing = false;                       ///< leave out views whose image or mask is missing
    bool cameras_only = false;                        ///< images need not be there when the file knows their sizes
    std::string up, units;                            ///< override what the file says
    /// Further scenes whose views are taken too, each with a camera file of its own in the same world (or, like the scene, with none). A photograph that is
    /// there already is not taken twice, so the scene itself may be among them.
    std::vector<std::filesystem::path> added;
    /// Photographs may still be arriving: one for which this says no is not there yet, and nobody is warned of those that are missing. Empty: all that is there
    /// is whole.
    std::function<bool(const std::filesystem::path& photo)> is_whole;
};

/// Finds and reads the camera file of a scene and resolves its images. Order of search, first match by
/// content: transforms.json, transforms_train.json, our cameras.json, sparse/0, sparse, colmap, the
/// folder itself (COLMAP, binary before text), *_par.txt, *.pa. Views come in natural order of names.
/// Without any, where allow_unposed says so, every photograph (or mask, where there are only masks) is a view without a pose, its focal length
/// the one that the file says (EXIF), or 0. Views of two scenes may not share a name. Throws InputError naming the file, view, value and remedy.
Views load_views(const ViewsOptions& options, Progress& progress);

/// Throws InputError for cameras that cannot be carved with (not finite, left-handed, no focal length, no
/// size …); every bad field of the first bad view is named.
void check_views(const Views& views);

/// The text of a cameras.json: transforms.json form with a `vdbcarve` object for what that form cannot say.
/// Reading it again gives the same cameras to 1e-12.
std::string cameras_json(const Views& views, const std::filesystem::path& relative_to = {});

/// Writes that, by rename; images are named relative to the file's folder. Throws OutputError.
void write_cameras(const Views& views, const std::filesystem::path& file);

/// The view's photograph as its camera would have taken it without distortion. Throws InputError naming the file, also
/// where it has not the camera's size.
Photo load_photo(const View& view);

/// The same in 8 bits a channel.
Image8 load_photo8(const View& view);

/// File names of the views' masks in a result's folder `masks`, by view.
std::vector<std::string> mask_names(const Views& views);

/// "image_2" before "image_10".
bool natural_less(const std::string& a, const std::string& b);

}  // namespace vdbcarve
