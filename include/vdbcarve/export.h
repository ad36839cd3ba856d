// SPDX-License-Identifier: Apache-2.0
// Stage `export`: volumes to and from .vdb and .nvdb files.
#pragma once

#include <openvdb/openvdb.h>

#include <filesystem>
#include <string>
#include <vector>

namespace vdbcarve {

struct VdbMetadata {
    std::string units, up;
    size_t views = 0;
    double voxel_size = 0;
    std::string inputs_sha256;  ///< one hash over everything the volume was made from
};

/// Writes grids into one .vdb, blosc-compressed where OpenVDB can; appears by rename and holds the same bytes
/// for the same grids: the random identifier in OpenVDB's header is replaced by one made from the content.
/// Throws OutputError.
void write_vdb(const std::filesystem::path& file, const openvdb::GridCPtrVec& grids, const VdbMetadata& metadata);

/// All grids of a file. Throws InputError.
openvdb::GridPtrVec read_vdb(const std::filesystem::path& file);

/// The float grid of that name. Throws InputError naming what the file holds instead.
openvdb::FloatGrid::Ptr read_float_grid(const std::filesystem::path& file, const std::string& name);

/// Writes float grids into one .nvdb, uncompressed (every reader opens it), with statistics and checksums; appears by rename,
/// same bytes for the same grids. Throws OutputError.
void write_nvdb(const std::filesystem::path& file, const std::vector<openvdb::FloatGrid::ConstPtr>& grids);

/// The float grids of a .nvdb. Throws InputError.
std::vector<openvdb::FloatGrid::Ptr> read_nvdb(const std::filesystem::path& file);

}  // namespace vdbcarve
