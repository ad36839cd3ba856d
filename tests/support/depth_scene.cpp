// SPDX-License-Identifier: Apache-2.0
#include "support/depth_scene.h"

#include <openvdb/tools/MeshToVolume.h>

#include <algorithm>
#include <cmath>

namespace vdbcarve::test {

namespace {

/// -1 to 1, the same for the same voxel.
float noise_at(const openvdb::Coord& c) {
    uint32_t h = static_cast<uint32_t>(c.x()) * 73856093u ^ static_cast<uint32_t>(c.y()) * 19349663u ^ static_cast<uint32_t>(c.z()) * 83492791u;
    h = (h ^ h >> 13) * 0x5bd1e995u;
    return static_cast<float>((h ^ h >> 15) & 0xffff) / 32767.5f - 1.f;
}

}  // namespace

DepthScene depth_scene(const openvdb::FloatGrid& hull, const Mesh& truth, double noise_vox, double sure_from) {
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    const openvdb::math::Transform& lattice = hull.transform();
    for (const auto& v : truth.vertices) points.emplace_back(lattice.worldToIndex(openvdb::Vec3d(v[0], v[1], v[2])));
    for (const auto& t : truth.triangles) triangles.emplace_back(t[0], t[1], t[2]);
    const auto distances = openvdb::tools::meshToLevelSet<openvdb::FloatGrid>(*openvdb::math::Transform::createLinearTransform(1.0), points, triangles, 4.f);
    const auto at = distances->getConstAccessor();
    const auto voxel = static_cast<float>(hull.voxelSize()[0]);
    const float band = hull.background();
    DepthScene out{hull.deepCopy(), openvdb::FloatGrid::create(0.f)};
    out.confidence->setTransform(lattice.copy());
    const auto is_sure = [&](const openvdb::Coord& c) { return lattice.indexToWorld(c).x() > sure_from; };
    const auto said = [&](const openvdb::Coord& c) {
        return is_sure(c) ? std::clamp((at.getValue(c) + static_cast<float>(noise_vox) * noise_at(c)) * voxel, -band, band) : -band;
    };
    // The hull's inside beyond its band becomes voxels where the truth's band is.
    for (auto leaf = distances->tree().cbeginLeaf(); leaf; ++leaf)
        if (out.carved->tree().getValue(leaf->origin()) < band) out.carved->tree().touchLeaf(leaf->origin());
    for (auto tile = out.carved->tree().beginValueAll(); tile; ++tile)
        if (!tile.isVoxelValue() && *tile < 0.f && said(tile.getCoord()) > 0.f) tile.setValue(band);
    for (auto leaf = out.carved->tree().beginLeaf(); leaf; ++leaf)
        for (openvdb::Index q = 0; q < openvdb::FloatTree::LeafNodeType::SIZE; ++q) {
            const openvdb::Coord c = leaf->offsetToGlobalCoord(q);
            const float value = std::max(leaf->getValue(q), said(c));
            leaf->setValueOnly(q, value);
            leaf->setActiveState(q, std::fabs(value) < band);
            const float d = at.getValue(c);
            if (std::fabs(d) < 2.f && is_sure(c)) out.confidence->tree().setValue(c, 1.f - 0.25f * std::fabs(d));
        }
    return out;
}

}  // namespace vdbcarve::test
