// SPDX-License-Identifier: Apache-2.0
// How many handles a solid has (a ring has one). Private.
#pragma once

#include <openvdb/openvdb.h>

namespace vdbcarve {

/// The Euler characteristic of a level set's inside, voxels connected by faces: pieces minus handles plus voids. One less for every handle.
/// Counted from voxels, and edges, squares and cubes between them (V - E + S - C). Needs leaves on both sides of the surface. Time: that of reading them.
long euler_characteristic(const openvdb::FloatGrid& surface);

/// Handles of all pieces. Taken to have no voids: what cannot be seen cannot be carved.
long count_handles(const openvdb::FloatGrid& surface);

}  // namespace vdbcarve
