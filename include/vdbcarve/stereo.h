// SPDX-License-Identifier: Apache-2.0
// Stage `stereo`: what silhouettes cannot see. Depth by photo-consistency, searched inside the hull, carves its concavities.
//
// The hull bounds the search, closes what has no texture, and is never left: the result is the hull, or less. PatchMatch stereo (Bleyer et al. 2011; Galliani
// et al. 2015), fused as a truncated signed distance (Curless and Levoy 1996) into the hull's own leaves.
#pragma once

#include <openvdb/openvdb.h>

#include <string>
#include <vector>

#include "vdbcarve/color.h"

namespace vdbcarve {

/// What a depth needs, to be believed. Pixels are those of the working size, so that a finer photograph asks for a finer match.
struct StereoTrust {
    double most_cost = 0.5;         ///< 1 - ZNCC, mean of the better half of the views
    double least_contrast = 0.005;  ///< standard deviation of grey in the window, of 1
    double least_margin = 0.02;     ///< by which it costs less than any other depth of the search, 3 px or more away
    int agreeing = 2;               ///< other views that find the same
    double agreement_px = 1.0;      ///< as far apart as that
    double normal_deg = 45;         ///< and their normals
    double rim_px = 2;              ///< inside the silhouette
    bool operator==(const StereoTrust&) const = default;
};

inline constexpr int kMostStereoScale = 16;
/// By default photographs are compared at the smallest size at which a pixel covers no more than this of a voxel; whatever the machine.
inline constexpr double kStereoPixel_vox = 0.35;

struct StereoOptions {
    int pairs = 6;                                    ///< other views a view is compared with, 2..8
    double least_angle_deg = 8, most_angle_deg = 40;  ///< between their lines of sight to the object
    int scale = 0;                                    ///< pixels of a photograph a side of one that is worked with, 1..16; 0: default_stereo_scale()
    int levels = 3;             ///< sizes of photographs that are worked with, each half of the one before: the coarser ones see less texture as more
    int passes = 6;             ///< of PatchMatch, for the coarsest; each finer one takes half as many
    double depth_share = 0.35;  ///< the search ends so far behind the hull's front, of the object's longest side
    StereoTrust trust;
    double truncation_vox = 1.5;  ///< of distances before a depth
    double reach_share = 0.01;    ///< so far behind it a depth is evidence of the object, of its longest side; at least two truncations
    double coarser_weight = 0.2;  ///< of a level's depths against those of the finer one
    double least_weight = 0.8;    ///< confidence x cosine, summed over views, from which on depths count as much as the hull
    /// The larger of hull and depth is what is left, so that noise of depths would eat into a hull that is right. Where they nearly agree the hull is: near it
    /// depths have to say more by so many pixels of the object, which is how far they may be off.
    double hull_margin_px = 1;
    double least_piece = 0.01;  ///< loose pieces of less than this share of the piece of the hull that they were part of are dropped
    bool operator==(const StereoOptions&) const = default;
};

/// One view's depths. Empty where the view was not used.
struct DepthMap {
    ImageF depth;       ///< along the camera's z, world units; 0: none that is trusted
    ImageF confidence;  ///< 0..1
};

struct StereoViewStatistics {
    size_t pairs = 0;           ///< views it was compared with; 0: none is at a useful angle
    size_t object_pixels = 0;   ///< of the working size, that see the hull
    size_t matched_pixels = 0;  ///< cost, contrast and margin are good
    size_t trusted_pixels = 0;  ///< and other views agree
};

struct StereoResult {
    openvdb::FloatGrid::Ptr surface;     ///< level set, inside the one given
    openvdb::FloatGrid::Ptr confidence;  ///< of the band's voxels: weight of the depths near them, 0..1; 0: the hull's word alone. Name "stereo_confidence"
    std::vector<DepthMap> maps;          ///< by view
    std::vector<StereoViewStatistics> views;
    int scale = 1;
    size_t fragments = 0, voids = 0;       ///< loose pieces that were dropped, and enclosed holes that were not carved
    double volume_before = 0, volume = 0;  ///< world units cubed
    std::vector<std::pair<std::string, double>> milliseconds;
    std::string backend_used = "cpu";
};

/// A power of two, 1..16 (kStereoPixel_vox). `cameras`: of the photographs.
int default_stereo_scale(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras);

/// Carves a hull's level set by the photographs' depths. Photographs are asked for all at once; the gains between them do not matter (ZNCC). Same bits for any
/// number of threads. Time: pixels of the object x views x about 25 planes x pairs x 25 samples. Memory: the photographs, and 40 bytes a working pixel and
/// view (beside a GPU 14), a third more for the coarser ones. Throws InputError naming the view whose photograph does not fit its camera or is too small,
/// UsageError for bad options.
StereoResult stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const StereoOptions& options,
                    Progress& progress);

}  // namespace vdbcarve
