// SPDX-License-Identifier: Apache-2.0
// How far a mesh is from the truth.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// The similarity that takes `from` to `to` with the least squared error (Umeyama 1991). Throws UndeterminedError for
/// fewer than three pairs or pairs on one line.
Similarity align_points(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to);

struct EvaluateOptions {
    std::optional<Similarity> align;  ///< applied to the mesh first
    double threshold = 0;             ///< for completeness, precision, recall; truth's units; 0: 1 % of the truth's largest side
    size_t samples = 100000;          ///< points on each surface, spread evenly by area
    uint64_t seed = 1;
    int volume_resolution = 256;  ///< voxels along the longest side of both, for IoU
};

/// Distances from points of one surface to the nearest point of the other, in the truth's units.
struct SurfaceDistances {
    double mean = 0, median = 0, rms = 0, p90 = 0, p95 = 0, max = 0;
    double within = 0;  ///< share of points within the threshold
};

/// See Seitz et al. 2006 (accuracy, completeness) and Knapitsch et al. 2017 (F-score).
struct Evaluation {
    SurfaceDistances to_truth;    ///< from the mesh: accuracy; `within` is the precision
    SurfaceDistances from_truth;  ///< from the truth: completeness; `within` is the recall
    double chamfer = 0;           ///< mean of both means
    double accuracy90 = 0;        ///< to_truth.p90
    double f_score = 0;
    double hausdorff = 0, hausdorff95 = 0;                          ///< the larger of both directions
    double volume = 0, truth_volume = 0;                            ///< signed
    double volume_excess = 0;                                       ///< volume / truth_volume - 1
    double iou = 0;                                                 ///< |A and B| / |A or B| of the solids; nan when either surface is open
    double truth_lost = 0;                                          ///< share of the truth's volume outside the mesh; nan likewise
    double normal_error_mean_deg = 0, normal_error_median_deg = 0;  ///< at the mesh's points, against the truth's nearest face
    double threshold = 0, truth_size = 0;
    /// CIEDE2000 between both surfaces' vertex colours at the mesh's points within the threshold; nan where either has none.
    double color_median = 0, color_p95 = 0, color_mean = 0;
    Similarity align;
};

/// Point-to-triangle distances by a bounding volume hierarchy. Same numbers for any number of threads.
/// Time: about samples * log(faces). Throws InputError for a mesh without faces.
Evaluation evaluate(const Mesh& mesh, const Mesh& truth, const EvaluateOptions& options, Progress& progress);

struct PhotoOptions {
    std::filesystem::path result;  ///< a folder that reconstruct() made: its masks bound the comparison, its report says which views gave colour
    bool from_volume = false;      ///< render the colour grid of its volume.vdb, not the vertices' colours
    std::filesystem::path save;    ///< a folder for pictures, photograph and rendering side by side; empty: none
};

/// One view's rendering against its photograph.
struct PhotoComparison {
    std::string name;
    bool used = true;  ///< for colouring
    PhotoAgreement agreement;
};

/// Masks in a result's folder do not say what is ignored: such pixels are compared too.
/// Renders a coloured mesh into all cameras that have a photograph. Views one after the other, pictures of one in memory at a time.
/// Throws InputError.
std::vector<PhotoComparison> compare_photos(const Mesh& mesh, const Views& views, const PhotoOptions& options, Progress& progress);

/// How far cameras are from the true ones, after the similarity that fits best: rotations by their mean (Kabsch), then scale and place by the centres.
struct CameraErrors {
    double rotation_rms_deg = 0, rotation_max_deg = 0;
    double centre_rms = 0, centre_median = 0, centre_max = 0;  ///< share of the median distance to the look-at point
    double focal_ratio = 0;                                    ///< median of focal length / true focal length
    double reprojection_rms_px = 0;                            ///< of the given points, in the true cameras' pixels; after the similarity that fits images best
    std::vector<double> rotation_deg, centre;                  ///< of each view
    Similarity truth_from_estimate;                            ///< the one that fits images best where points are given, else the one above
};
/// `points_truth`: where reprojection is measured (of the object; empty: not). Throws UndeterminedError for fewer than 3 cameras.
CameraErrors compare_cameras(const std::vector<Camera>& estimate, const std::vector<Camera>& truth, const std::vector<Vec3d>& points_truth);

std::string evaluation_json(const Evaluation& evaluation);

}  // namespace vdbcarve
