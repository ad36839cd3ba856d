// SPDX-License-Identifier: Apache-2.0
#include <openvdb/io/File.h>

#include "base/atomic_file.h"
#include "base/sha256.h"
#include "vdbcarve/error.h"
#include "vdbcarve/volume.h"
#include "vdbcarve/version.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

/// Where OpenVDB's header keeps its identifier: magic (8), file version (4), library version (8), offsets
/// flag (1), then 36 characters.
constexpr std::streamoff kUuidAt = 21;
constexpr size_t kUuidLength = 36;

/// Writes to a stream of ours, whose state is checked: io::File would not notice a full disk.
class CheckedArchive : public openvdb::io::Archive {
  public:
    void write_to(std::ostream& out, const openvdb::GridCPtrVec& grids, const openvdb::MetaMap& meta) const {
        Archive::write(out, grids, /*seekable=*/true, meta);
    }
};

void replace_uuid(const fs::path& file) {
    std::fstream f(file, std::ios::in | std::ios::out | std::ios::binary);
    char old[kUuidLength] = {};
    f.seekg(kUuidAt);
    f.read(old, kUuidLength);
    if (!f || old[8] != '-' || old[13] != '-' || old[18] != '-' || old[23] != '-')
        throw OutputError(file.string() + ": this OpenVDB keeps its file identifier elsewhere; the file would differ from run to run");
    const std::string zero(kUuidLength, '0');
    f.seekp(kUuidAt);
    f.write(zero.data(), kUuidLength);
    f.flush();
    const std::string hash = sha256_of_file(file);
    // Version 8, variant 10: "made by rules of its own" (RFC 9562).
    const std::string uuid = hash.substr(0, 8) + "-" + hash.substr(8, 4) + "-8" + hash.substr(12, 3) + "-a" + hash.substr(15, 3) + "-" + hash.substr(18, 12);
    f.seekp(kUuidAt);
    f.write(uuid.data(), kUuidLength);
    f.flush();
    if (!f) throw OutputError(file.string() + ": writing failed");
}

}  // namespace

void write_vdb(const fs::path& file, const openvdb::GridCPtrVec& grids, const VdbMetadata& m, bool half) {
    openvdb::initialize();
    openvdb::MetaMap meta;
    meta.insertMeta("up_axis", openvdb::StringMetadata(m.up.empty() ? "unknown" : m.up));
    meta.insertMeta("units", openvdb::StringMetadata(m.units.empty() ? "unknown" : m.units));
    meta.insertMeta("views", openvdb::Int32Metadata(static_cast<int>(m.views)));
    meta.insertMeta("voxel_size", openvdb::DoubleMetadata(m.voxel_size));
    if (!m.inputs_sha256.empty()) meta.insertMeta("inputs_sha256", openvdb::StringMetadata(m.inputs_sha256));
    write_vdb(file, grids, meta, half);
}

void write_vdb(const fs::path& file, const openvdb::GridCPtrVec& grids, const openvdb::MetaMap& metadata, bool half) {
    openvdb::initialize();
    AtomicFile target(file);
    try {
        openvdb::MetaMap meta(metadata);
        meta.removeMeta("creator");
        meta.insertMeta("creator", openvdb::StringMetadata(std::string("vdbcarve ") + kVersion));
        openvdb::GridCPtrVec marked;
        for (const openvdb::GridBase::ConstPtr& grid : grids) {
            if (!half) {
                marked.push_back(grid);
                continue;
            }
            const openvdb::GridBase::Ptr copy = openvdb::ConstPtrCast<openvdb::GridBase>(grid)->copyGrid();  // of the head: the tree is shared
            copy->setSaveFloatAsHalf(true);
            marked.push_back(copy);
        }
        CheckedArchive().write_to(target.stream(), marked, meta);
    } catch (const openvdb::Exception& e) {
        throw OutputError(file.string() + ": cannot be written: " + e.what());
    }
    target.close();
    replace_uuid(target.temporary());
    target.commit();
}

openvdb::GridPtrVec read_vdb(const fs::path& file, openvdb::MetaMap* metadata) {
    if (!fs::is_regular_file(file)) throw InputError(file.string() + ": no such file");
    openvdb::initialize();
    try {
        openvdb::io::File in(file.string());
        in.open(false);  // no delayed loading: what is read is held
        if (metadata) *metadata = *in.getMetadata();
        return *in.getGrids();
    } catch (const openvdb::Exception& e) {
        throw InputError(file.string() + ": is not a .vdb that can be read: " + e.what());
    }
}

openvdb::FloatGrid::Ptr read_float_grid(const fs::path& file, const std::string& name) {
    std::string names;
    for (const openvdb::GridBase::Ptr& grid : read_vdb(file)) {
        if (grid->getName() == name)
            if (auto f = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)) return f;
        names += (names.empty() ? "" : ", ") + grid->getName() + " (" + grid->valueType() + ")";
    }
    throw InputError(file.string() + ": has no float grid '" + name + "'; it holds " + names);
}

}  // namespace vdbcarve
