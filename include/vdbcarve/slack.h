// SPDX-License-Identifier: Apache-2.0
// How much the silhouettes leave open: the distance between the fair surface and the hull's.
#pragma once

#include <openvdb/openvdb.h>

#include <vector>

#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// Grid "slack": for every voxel of the surface's band, how far below the hull's surface the nearest point of `surface` lies, world units. 0 where both agree:
/// there the silhouettes alone say where the object ends. Both are level sets on one lattice; `hull` has a half-width of 3 voxels. Beyond that band distances
/// come from the hull on coarser voxels, good to about a sixth. Cost: a few passes over both bands. Throws InputError for a hull without surface.
openvdb::FloatGrid::Ptr slack(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface);

/// Sets Mesh::slack, interpolated; 0 for a vertex that lies outside of the grid's band.
void set_slack(Mesh& mesh, const openvdb::FloatGrid& slack);

/// Slack by area.
struct SlackShares {
    double known_share = 0;  ///< of the surface: what is not extrapolated
    double mean = 0;         ///< of that, scene units
    double half = 0;         ///< half of the whole surface has no more; infinite where less than half is known
    double most = 0;         ///< and so has `most_share` of it
    double most_share = 0;   ///< 0.9, or what is known where that is less
};
/// Extrapolated vertices (Mesh::extrapolated) count as not known. The mesh has slack.
SlackShares slack_shares(const Mesh& mesh);

}  // namespace vdbcarve
