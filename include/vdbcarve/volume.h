// SPDX-License-Identifier: Apache-2.0
// Volumes to and from .vdb and .nvdb files.
#pragma once

#include <openvdb/openvdb.h>

#include <filesystem>
#include <string>

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
/// `half`: floats take 16 bits on disk, three digits of each; in memory they are whole again.
void write_vdb(const std::filesystem::path& file, const openvdb::GridCPtrVec& grids, const VdbMetadata& metadata, bool half = false);
/// The same with metadata of another file, which then says who made it.
void write_vdb(const std::filesystem::path& file, const openvdb::GridCPtrVec& grids, const openvdb::MetaMap& metadata, bool half = false);

/// All grids of a file, and its metadata where asked for. Throws InputError.
openvdb::GridPtrVec read_vdb(const std::filesystem::path& file, openvdb::MetaMap* metadata = nullptr);

/// The float grid of that name. Throws InputError naming what the file holds instead.
openvdb::FloatGrid::Ptr read_float_grid(const std::filesystem::path& file, const std::string& name);

/// Writes grids (float, Vec3S, Int32, mask …) into one .nvdb, uncompressed (every reader opens it), with statistics and checksums; appears by rename,
/// same bytes for the same grids. Throws OutputError, and UsageError for a type that NanoVDB has not.
void write_nvdb(const std::filesystem::path& file, const openvdb::GridCPtrVec& grids);

/// The grids of a .nvdb. Throws InputError.
openvdb::GridPtrVec read_nvdb(const std::filesystem::path& file);

}  // namespace vdbcarve
