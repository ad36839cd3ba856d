// SPDX-License-Identifier: Apache-2.0
#include <nanovdb/util/GridChecksum.h>
#include <nanovdb/util/GridStats.h>
#include <nanovdb/util/GridValidator.h>
#include <nanovdb/util/IO.h>
#include <nanovdb/util/NanoToOpenVDB.h>
#include <nanovdb/util/OpenToNanoVDB.h>

#include <cstring>

#include "base/atomic_file.h"
#include "volume/nanovdb_bytes.h"
#include "vdbcarve/error.h"
#include "vdbcarve/volume.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using Handle = nanovdb::GridHandle<nanovdb::HostBuffer>;

namespace {

nanovdb::NanoGrid<float>* grid_in(const NanoBuffer& buffer) { return reinterpret_cast<nanovdb::NanoGrid<float>*>(buffer.data.get()); }

Handle handle_of(const openvdb::FloatGrid& grid, bool finished = true) {
    return finished ? nanovdb::openToNanoVDB<nanovdb::HostBuffer>(grid, nanovdb::StatsMode::All, nanovdb::ChecksumMode::Full)
                    : nanovdb::openToNanoVDB<nanovdb::HostBuffer>(grid, nanovdb::StatsMode::Disable, nanovdb::ChecksumMode::Disable);
}

NanoBuffer copy_of(const Handle& handle) {
    NanoBuffer out = allocate_nanovdb(handle.size());
    std::memcpy(out.data.get(), handle.data(), out.size);
    return out;
}

}  // namespace

NanoBuffer allocate_nanovdb(size_t bytes) {
    NanoBuffer out;
    out.size = bytes;
    out.data.reset(static_cast<uint8_t*>(std::aligned_alloc(64, (bytes + 63) / 64 * 64)));
    if (!out.data) throw OutputError("no memory for a volume of " + std::to_string(bytes) + " bytes");
    return out;
}

void finish_nanovdb(NanoBuffer& buffer, const openvdb::math::Transform& transform) {
    nanovdb::NanoGrid<float>* grid = grid_in(buffer);
    const openvdb::math::Mat4d matrix = transform.baseMap()->getAffineMap()->getMat4();
    grid->data()->mMap.set(matrix, matrix.inverse(), 1.0);
    grid->data()->mVoxelSize = nanovdb::Vec3R(transform.baseMap()->getAffineMap()->voxelSize()[0]);
    nanovdb::TreeData<3>* tree = grid->tree().data();
    // No tile is active in a narrow band.
    uint64_t active = 0;
    const nanovdb::NanoLeaf<float>* leaf = grid->tree().getFirstNode<0>();
    for (uint32_t n = 0; n < tree->mNodeCount[0]; ++n) active += leaf[n].valueMask().countOn();
    tree->mVoxelCount = active;
    nanovdb::gridStats(*grid, nanovdb::StatsMode::All);
    nanovdb::updateChecksum(*grid, nanovdb::ChecksumMode::Full);
}

NanoBuffer to_nanovdb(const openvdb::FloatGrid& grid, bool finished) { return copy_of(handle_of(grid, finished)); }

NanoBuffer to_nanovdb(const openvdb::Vec3SGrid& grid) {
    return copy_of(nanovdb::openToNanoVDB<nanovdb::HostBuffer>(grid, nanovdb::StatsMode::Disable, nanovdb::ChecksumMode::Disable));
}

std::string invalid_nanovdb(const NanoBuffer& buffer) { return nanovdb::GridValidator<float>::check(*grid_in(buffer), true); }

void write_nvdb(const fs::path& file, const openvdb::GridCPtrVec& grids) {
    if (grids.empty()) throw UsageError(file.string() + ": no grid to write");
    std::vector<Handle> handles;
    for (const auto& grid : grids) {
        try {
            handles.push_back(nanovdb::openToNanoVDB<nanovdb::HostBuffer>(openvdb::ConstPtrCast<openvdb::GridBase>(grid), nanovdb::StatsMode::All,
                                                                          nanovdb::ChecksumMode::Full));
        } catch (const std::exception& e) {
            throw UsageError(file.string() + ": grid '" + grid->getName() + "' (" + grid->valueType() + ") has no NanoVDB form: " + e.what());
        }
    }
    AtomicFile target(file);
    try {
        nanovdb::io::writeGrids(target.stream(), handles, nanovdb::io::Codec::NONE);
    } catch (const std::exception& e) {
        throw OutputError(file.string() + ": cannot be written: " + e.what());
    }
    target.commit();
}

openvdb::GridPtrVec read_nvdb(const fs::path& file) {
    if (!fs::is_regular_file(file)) throw InputError(file.string() + ": no such file");
    openvdb::initialize();
    openvdb::GridPtrVec out;
    try {
        for (const Handle& handle : nanovdb::io::readGrids<nanovdb::HostBuffer, std::vector>(file.string())) out.push_back(nanovdb::nanoToOpenVDB(handle));
    } catch (const std::exception& e) {
        throw InputError(file.string() + ": is not a .nvdb that can be read: " + e.what());
    }
    if (out.empty()) throw InputError(file.string() + ": has no grid");
    return out;
}

}  // namespace vdbcarve
