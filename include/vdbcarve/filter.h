// SPDX-License-Identifier: Apache-2.0
// Stage `filter`: the level set made smoother, its volume kept.
//
// The paper smooths a binary volume by a bilateral or anisotropic filter; here values are distances already, so that little is left to
// do. docs/stages/filter.md compares the filters.
#pragma once

#include <openvdb/openvdb.h>

#include <string>
#include <utility>
#include <vector>

#include "vdbcarve/progress.h"

namespace vdbcarve {

enum class FilterKind {
    Median,          ///< of the (2 w + 1)^3 values around; width 1 or 2
    MeanCurvature,   ///< a step of dt = 1/6 voxel^2 of motion by curvature
    Laplacian,       ///< a step of dt = 1/6 voxel^2 of diffusion: the same on a level set, and cheaper
    Gaussian,        ///< four box means of width w, 1..4
    EdgePreserving,  ///< bilateral by normals (kernel/filter.h): smooths faces, keeps edges and volume; width 1 or 2
};

/// One link of a chain.
struct FilterStep {
    FilterKind kind = FilterKind::Median;
    int width_vox = 1;
    int iterations = 1;
    bool operator==(const FilterStep&) const = default;
};

/// Reads "NAME[:WIDTH][xITERATIONS],…" with the names median, mean-curvature, laplacian, gaussian, edge-preserving; "none" is no step.
/// Throws UsageError naming the part that is wrong.
std::vector<FilterStep> parse_filters(const std::string& text);
/// The same text back, every width and count written out.
std::string filters_text(const std::vector<FilterStep>& steps);

/// What `reconstruct` takes where no chain is given: by the share of soft pixels on the masks' contours, 0 (binary) to 1; negative for the binary model (an
/// occupancy), whose steps are a voxel high.
std::vector<FilterStep> default_filters(double mask_softness);

struct FilterOptions {
    std::vector<FilterStep> steps;
    /// After the chain the surface is moved as a whole until its volume is the one before, to within kVolumeTolerance.
    bool repair_volume = true;
    /// Parts thinner than this many voxels are left as they are, those up to 1 1/2 voxels thicker are filtered in part; 0: nothing is
    /// protected. At most most_keep_thin_vox(). The repair moves them with the rest.
    double keep_thin_vox = 4;
};

/// The largest keep_thin_vox with a half-width.
double most_keep_thin_vox(int half_width_vox);

/// Of volume; the repair takes at most three Newton steps and moves the surface by at most one voxel.
inline constexpr double kVolumeTolerance = 1e-4;
inline constexpr int kMostRepairSteps = 3;

struct FilterResult {
    openvdb::FloatGrid::Ptr surface;
    double volume_before = 0, volume_filtered = 0, volume = 0;  ///< world units cubed: before, after the chain, after the repair
    double offset_vox = 0;                                      ///< by which the repair moved the surface, outwards
    int repair_steps = 0;
    size_t components_before = 0, components = 0;              ///< pieces of the inside, see count_pieces()
    std::vector<std::pair<std::string, double>> milliseconds;  ///< by step; on the GPU device time
    std::string backend_used = "cpu";
};

/// Filters a level set and re-distances it once, at the end. The band grows by leaves where the surface may move, and is cut back. Parts thinner than
/// keep_thin_vox keep their old values. Same bits for any number of threads, on both backends.
/// The grid's leaves become the result's: pass a deepCopy() of one that is to be kept. Cost: passes x leaves; memory: two copies of
/// the leaves' values, three with keep_thin_vox. Throws UsageError for bad options, InputError when the grid is no level set, and ContradictionError when
/// nothing of the object is left.
FilterResult filter(openvdb::FloatGrid::Ptr surface, const FilterOptions& options, Progress& progress);

/// Volumes of the pieces of the inside, connected by faces of voxels, world units cubed, the largest first. Time: that of reading the leaves.
std::vector<double> component_volumes(const openvdb::FloatGrid& surface);

/// How many of them have kLeastPiece_vox voxels or more: single voxels come off edges and tips without a loss.
inline constexpr double kLeastPiece_vox = 64;
size_t count_pieces(const openvdb::FloatGrid& surface);

}  // namespace vdbcarve
