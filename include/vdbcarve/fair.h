// SPDX-License-Identifier: Apache-2.0
// Stage `fair`: the smoothest surface inside the hull that still covers every silhouette.
//
// The hull is the largest surface that the silhouettes allow, and shows it: slabs and ridges wherever views leave room. Of all surfaces inside it that cover
// every object pixel, this is the one of nearly least area (Kolev and Cremers, ECCV 2008, pose the problem). docs/stages/fair.md says how it is found.
#pragma once

#include <openvdb/openvdb.h>

#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

struct FairOptions {
    /// How far the surface may be smoothed, as a share of the hull's longest side: sqrt(steps) * width of the Gaussian that one step blurs with.
    double fairness = 0.06;
};

/// What a view shows: its camera, without lens distortion, and its mask.
struct FairView {
    Camera camera;
    MaskView mask;
};

/// What depths say: the level set that they carve from the hull, on its lattice, and for its band how sure they are, 0..1 (StereoResult). Borrowed.
struct FairEvidence {
    const openvdb::FloatGrid& carved;
    const openvdb::FloatGrid& confidence;
};

struct FairResult {
    openvdb::FloatGrid::Ptr surface;    ///< name "surface", a level set of half-width 3 voxels
    double hull_volume = 0;             ///< world units cubed
    double volume = 0;                  ///< the fair surface's
    size_t lines_of_sight = 0;          ///< pixels at least half a pixel inside a contour
    size_t uncovered = 0;               ///< of these, what the hull covers and the surface does not
    size_t pieces_dropped = 0;          ///< pieces in the air that no silhouette asks for
    std::vector<double> level_seconds;  ///< by level, the coarsest first
};

/// `hull` is a level set whose zero crossing is what the silhouettes leave (half-width 3 voxels or more). The result lies inside it: no value is below the
/// hull's. A line of sight through the middle of a pixel that is half a pixel or more inside its view's contour meets the surface if it meets the hull; lines
/// closer to the contour keep the hull's contour where the surface is near it. Pixels that a mask ignores, and places that no view shows, force nothing. Coarse
/// to fine: the motion happens where the longest side has about 128 voxels, finer levels add detail. Same bits for any number of threads. Cost: about (pixels
/// of the silhouettes) + 12 passes over the finest level's band. Memory: 5 values for every voxel of the leaves near both surfaces. Throws UsageError for a
/// fairness outside 0..0.5 and InputError for a hull without surface.
/// `evidence`, or null: where depths are sure the surface follows them, within the hull and over every silhouette; where they are silent it is as without.
FairResult fair(const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                const FairEvidence* evidence = nullptr);

/// `surface` as something changed it after fair(), such as a filter: put back inside the hull, and over every silhouette again where the hull allows it. Half
/// widths of 3 voxels or more; the result's is 3. `level_seconds` and `pieces_dropped` are empty. Cost: pixels of the silhouettes. Errors like fair().
FairResult cover_again(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface, const std::vector<FairView>& views, Progress& progress);

}  // namespace vdbcarve
