// SPDX-License-Identifier: Apache-2.0
// Where the surface is no more than the cones' end: above the highest contour that was seen, below the lowest, and where no camera looks.
//
// A camera that looks down at 10 degrees sees the far rim of a flat top as the silhouette's upper end; the cones through it rise towards the camera and meet
// over the middle, R tan 10 degrees too high. Nothing in the photographs contradicts that, and nothing supports it.
#pragma once

#include <openvdb/openvdb.h>

#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// The direction that "top" and "bottom" are along when no up axis is known: the one in which the cameras spread least, its sign such that most cameras look
/// down.
Vec3d orbit_axis(const std::vector<Camera>& cameras);

/// The named axis (x, y, z, -x, …), or orbit_axis() for an empty name.
Vec3d up_direction(const std::string& up, const std::vector<Camera>& cameras);

/// Heights along an axis, world units.
struct SeenExtent {
    bool top_seen = false, bottom_seen = false;  ///< false: every silhouette is cut by its frame there
    double highest = 0, lowest = 0;
};

/// How high and how low the object reaches at least. The line of sight through a silhouette's uppermost pixel touches the object somewhere within the hull, at
/// the lowest height it has there or above; the highest such height of all views is the top that was seen. The bottom likewise. masks[i] belongs to cameras[i];
/// views without a mask are left out. Cost: the masks' pixels.
SeenExtent seen_extent(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, const Vec3d& axis);

struct Extrapolation {
    double top_beyond = 0, bottom_beyond = 0;  ///< how far the mesh goes on beyond what was seen, world units
    double capped_share = 0;                   ///< of the area: beyond it by more than the tolerance
    double unseen_share = 0;                   ///< of the area: not capped, and no camera in whose frame it lies is in front of it
};

/// Sets Mesh::extrapolated. Occlusion is not looked at: report.json's synthesised share is about that. Cost: vertices x views.
Extrapolation mark_extrapolated(Mesh& mesh, const std::vector<Camera>& cameras, const SeenExtent& seen, const Vec3d& axis, double tolerance);

/// Takes away what a flat patch on the floor at `height` along `up` (an axis of the world) makes of itself in a hull: a contact shadow that masks took for the
/// object. Cones over a patch meet above it, so it becomes a mound that rises from nothing at its border by at most `slope` (the tangent of the views'
/// elevation over the floor); an object's foot rises like a wall. From the borders inwards, columns of voxels that stand on the floor and are no higher than
/// slope times their distance from the border, and `clear` (world units), go; where a column is higher, it and what is behind it stays. Re-distanced. Throws
/// InputError when nothing is left.
openvdb::FloatGrid::Ptr clear_floor(openvdb::FloatGrid::Ptr surface, const Vec3d& up, double height, double clear, double slope, Progress& progress);

/// The tangent of the elevation, seen from the surface's middle dropped onto the plane at `height` along up, that a third of the cameras stay below.
double slope_of_views(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras, const Vec3d& up, double height);

/// Cuts the level set by the plane at `height` along `up` and keeps what is above; re-distanced. Throws InputError when nothing is.
openvdb::FloatGrid::Ptr cut_flat(openvdb::FloatGrid::Ptr surface, const Vec3d& up, double height, Progress& progress);

}  // namespace vdbcarve
