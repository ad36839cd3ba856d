// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/parallel_for.h>

#include "device/device_parts.h"

namespace vdbcarve {

using cuda::kBlockLeaves;
using cuda::kBlockWords;
using openvdb::Coord;
using Leaf = openvdb::FloatTree::LeafNodeType;

namespace {

/// What a level set's leaves look like on the host; tiles follow from the leaves' signs.
openvdb::FloatGrid::Ptr to_openvdb(const cuda::Grid& grid, const cuda::Stream& stream, const openvdb::math::Transform& transform, Fetcher& fetcher) {
    const cuda::GridSpec& spec = grid.spec();
    openvdb::FloatGrid::Ptr out = openvdb::FloatGrid::create(spec.background);
    out->setTransform(same_transform(transform));
    out->setName(spec.name);
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    using NanoLeaf = cuda::Grid::Leaf;
    std::vector<std::unique_ptr<Leaf>> leaves(grid.leaf_count());
    fetcher.fetch(grid.leaves(), leaves.size() * sizeof(NanoLeaf), sizeof(NanoLeaf), stream, [&](const uint8_t* piece, size_t at, size_t size) {
        const auto* from = reinterpret_cast<const NanoLeaf*>(piece);
        tbb::parallel_for(size_t{0}, size / sizeof(NanoLeaf), [&](size_t n) {
            const nanovdb::Coord o = from[n].origin();
            uint64_t active[8];
            for (int w = 0; w < 8; ++w) active[w] = from[n].valueMask().getWord<uint64_t>(w);
            leaves[at / sizeof(NanoLeaf) + n] = make_leaf(Coord(o[0], o[1], o[2]), from[n].data()->mValues, active, spec.background);
        });
    });
    for (auto& leaf : leaves) out->tree().addLeaf(leaf.release());
    openvdb::tools::signedFloodFill(out->tree());
    return out;
}

}  // namespace

void Device::Parts::upload(Volume& volume, const openvdb::FloatGrid& grid) {
    if (grid.getGridClass() != openvdb::GRID_LEVEL_SET) throw InputError("grid '" + grid.getName() + "' is no level set");
    volume.topology = nullptr;
    volume.transform = same_transform(grid.transform());
    std::vector<const Leaf*> leaves;
    grid.tree().getNodes(leaves);
    // Blocks with leaves, and whole ones inside.
    std::vector<std::array<int, 3>> origins;
    using Lower = openvdb::FloatTree::RootNodeType::ChildNodeType::ChildNodeType;
    using Upper = openvdb::FloatTree::RootNodeType::ChildNodeType;
    std::vector<const Lower*> lowers;
    grid.tree().getNodes(lowers);
    for (const Lower* l : lowers) origins.push_back({l->origin()[0], l->origin()[1], l->origin()[2]});
    std::vector<const Upper*> uppers;
    grid.tree().getNodes(uppers);
    for (const Upper* u : uppers)
        for (auto tile = u->cbeginValueAll(); tile; ++tile)
            if (*tile < 0.f) origins.push_back({tile.getCoord()[0], tile.getCoord()[1], tile.getCoord()[2]});
    volume.own.cover(std::move(origins), stream);
    volume.topology = &volume.own;
    const auto& blocks = volume.own.origins();
    std::vector<uint64_t> exist(blocks.size() * kBlockWords, 0), inside(exist);
    std::vector<uint32_t> keys;
    std::vector<float> values(leaves.size() * Leaf::SIZE);
    std::vector<uint64_t> active(leaves.size() * 8);
    keys.reserve(leaves.size());
    for (size_t b = 0; b < blocks.size(); ++b) {
        const Coord o(blocks[b][0], blocks[b][1], blocks[b][2]);
        const auto* lower = grid.tree().probeConstNode<Lower>(o);
        if (!lower) {
            std::fill_n(inside.begin() + static_cast<long>(b * kBlockWords), kBlockWords, ~uint64_t{0});
            continue;
        }
        for (auto tile = lower->cbeginValueAll(); tile; ++tile)
            if (*tile < 0.f) inside[b * kBlockWords + tile.pos() / 64] |= uint64_t{1} << (tile.pos() & 63);
        for (auto child = lower->cbeginChildOn(); child; ++child) {
            const size_t slot = keys.size();
            exist[b * kBlockWords + child.pos() / 64] |= uint64_t{1} << (child.pos() & 63);
            keys.push_back(static_cast<uint32_t>(b * kBlockLeaves + child.pos()));
            std::memcpy(values.data() + slot * Leaf::SIZE, child->buffer().data(), sizeof(float) * Leaf::SIZE);
            for (openvdb::Index w = 0; w < 8; ++w) active[slot * 8 + w] = child->valueMask().getWord<openvdb::Index64>(w);
        }
    }
    const cuda::TopologyView view = volume.own.view();
    stream.to_device(view.leaves, exist.data(), exist.size());
    stream.to_device(view.inside, inside.data(), inside.size());
    stream.to_device(uploaded_values.ensure(values.size()), values.data(), values.size());
    stream.to_device(uploaded_active.ensure(active.size()), active.data(), active.size());
    stream.to_device(uploaded_keys.ensure(keys.size()), keys.data(), keys.size());
    volume.own.number_leaves(stream);
    volume.grid.build(volume.own, spec_of(grid.getName(), *volume.transform, grid.background()),
                      {uploaded_values.data(), uploaded_active.data(), uploaded_keys.data(), static_cast<uint32_t>(keys.size())}, stream);
    stream.wait();
}

openvdb::FloatGrid::Ptr Device::hull() const {
    parts_->use();
    const auto& volume = parts_->need(parts_->hull, "hull");
    return to_openvdb(volume.grid, parts_->stream, *volume.transform, parts_->fetcher);
}

void Device::set_hull(const openvdb::FloatGrid& hull) {
    parts_->use();
    parts_->upload(parts_->hull, hull);
}

openvdb::FloatGrid::Ptr Device::surface() const {
    parts_->use();
    const auto& volume = parts_->need(parts_->surface, "level set");
    return to_openvdb(volume.grid, parts_->stream, *volume.transform, parts_->fetcher);
}

void Device::set_surface(const openvdb::FloatGrid& surface) {
    parts_->use();
    parts_->upload(parts_->surface, surface);
    parts_->render.clear_colors();
}

NanoBuffer Device::hull_bytes() const {
    parts_->use();
    return parts_->bytes_of(parts_->need(parts_->hull, "hull"));
}
NanoBuffer Device::hull_nanovdb() const {
    parts_->use();
    return parts_->nanovdb_of(parts_->need(parts_->hull, "hull"));
}
NanoBuffer Device::surface_nanovdb() const {
    parts_->use();
    return parts_->nanovdb_of(parts_->need(parts_->surface, "level set"));
}

}  // namespace vdbcarve
