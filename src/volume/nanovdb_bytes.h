// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/openvdb.h>

#include "vdbcarve/nano_buffer.h"

namespace vdbcarve {

/// Throws OutputError where there is no memory.
NanoBuffer allocate_nanovdb(size_t bytes);

/// Fills what a grid built on the device lacks: the affine map as OpenVDB states it, bounding boxes and statistics of all nodes, checksum.
void finish_nanovdb(NanoBuffer& grid, const openvdb::math::Transform& transform);

/// The grid as NanoVDB, by NanoVDB's own converter; without statistics and checksum where `finished` is false.
NanoBuffer to_nanovdb(const openvdb::FloatGrid& grid, bool finished = true);

NanoBuffer to_nanovdb(const openvdb::Vec3SGrid& grid);

/// NanoVDB's validator, checksum included. What is wrong, or nothing.
std::string invalid_nanovdb(const NanoBuffer& grid);

}  // namespace vdbcarve
