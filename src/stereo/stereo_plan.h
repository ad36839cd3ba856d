// SPDX-License-Identifier: Apache-2.0
// What both backends' stereo starts from. Private.
#pragma once

#include <functional>

#include "render/render_plan.h"
#include "vdbcarve/kernel/stereo_hull.h"
#include "vdbcarve/stereo.h"

namespace vdbcarve {

/// Throws for what stereo() does not take.
void check_stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const StereoOptions& options);

/// A view at the working size: everything but what the hull says.
struct StereoSource {
    Camera camera;  ///< of the working size
    kernel::StereoLens lens{};
    int width = 0, height = 0;  ///< 0: the view is not used
    std::vector<float> grey;
    std::vector<uint8_t> object;  ///< 1: of the object; 2: and not near its rim
    std::vector<kernel::StereoPair> pairs;
};

/// Trusted depths of one view, for the fusion.
struct StereoDepthMap {
    std::vector<kernel::StereoBest> planes;
    std::vector<float> confidence;
};

/// All views at one working size, and what was found. The finest level first; each is half the size of the one before.
struct StereoLevel {
    int scale;  ///< pixels of a photograph a side of one of these
    std::vector<StereoSource> sources;
    std::vector<StereoDepthMap> maps;  ///< empty where the device keeps them
};

/// All levels, without maps; fewer than asked for where pictures would get too small to compare windows in. Photographs are asked for all at once. Throws
/// InputError where the finest is.
std::vector<StereoLevel> stereo_levels(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, int scale,
                                       const StereoOptions& options);

/// Of PatchMatch at a level, numbered as better_plane() counts them: the coarsest searches, finer ones make what it found more exact, each with half as many.
struct StereoPasses {
    int first, last;  ///< the one after
};
StereoPasses stereo_passes(size_t level, size_t levels, const StereoOptions& options);

/// Of the finest level.
int stereo_scale(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const StereoOptions& options);

/// Views that are matched, over all levels.
size_t steps_of(const std::vector<StereoLevel>& levels);

/// A view's coarser depth stands only where none of its finer levels has one: a photograph is heard once. Maps are all in place.
void leave_to_finer(std::vector<StereoLevel>& levels);

/// Before photographs and the hull's answers are in place: those pointers are null.
kernel::StereoReference stereo_reference(const std::vector<StereoSource>& sources, size_t view, double voxel_size);

/// The way of a plane's points from one picture into another.
kernel::StereoPair stereo_pair(const Camera& from, const Camera& to, int view);

/// How the hull is asked about a view.
kernel::HullView hull_view(const RenderFrame& frame, const StereoSource& source, double deepest_world);

/// Counts the maps' pixels that have a depth.
void count_trusted(StereoResult& result);

/// Steps of one name are summed.
void add_milliseconds(StereoResult& result, const std::string& step, double milliseconds);

/// Where the surface lies, for rays.
RenderFrame stereo_frame(const openvdb::FloatGrid& surface);

/// Of its leaves' box.
Vec3d middle_of(const openvdb::FloatGrid& surface);

/// The largest extent of the surface's inside along an axis, world units.
double longest_side(const openvdb::FloatGrid& surface);

kernel::StereoTrustRule trust_rule(const StereoTrust& trust);

// ------------------------------------------------------------------------------------ fusion

/// Which voxels are asked about, and how. Where a view of a level lies in the hull's lattice; its maps are still to be given.
struct FusionPlan {
    struct View {
        size_t level, view;
        kernel::FusionView fusion;  ///< without planes and confidence
    };
    kernel::FusionRule rule;
    std::vector<View> views;             ///< finest level first
    std::vector<openvdb::Coord> blocks;  ///< first voxels of all blocks of 8^3 that hold some of the inside
    openvdb::Coord base;                 ///< the voxel that FusionView counts from
};
FusionPlan plan_fusion(const openvdb::FloatGrid& surface, const std::vector<StereoLevel>& levels, const StereoOptions& options);

/// Blocks of the plan, ascending, that depths say something of.
struct FusedBlocks {
    std::vector<uint32_t> block;
    std::vector<float> values, confidence;  ///< 512 of each
};
FusedBlocks fuse_depths(const openvdb::FloatGrid& surface, const FusionPlan& plan, const std::vector<StereoLevel>& levels, Progress& progress);

using Redistance = std::function<openvdb::FloatGrid::Ptr(openvdb::FloatGrid::Ptr field, int half_width_vox)>;

/// Puts the blocks into the hull, drops what hangs loose, re-distances and measures: the result but for its maps.
void finish_stereo(StereoResult& result, const openvdb::FloatGrid& surface, const FusionPlan& plan, const FusedBlocks& blocks, const StereoOptions& options,
                   const Redistance& redistance);

}  // namespace vdbcarve
