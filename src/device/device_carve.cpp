// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <openvdb/tools/Prune.h>

#include "carve/carve_plan.h"
#include "device/device_parts.h"

namespace vdbcarve {

using cuda::kBlockLeaves;
using cuda::kBlockWords;
using openvdb::Coord;

CarveStatistics Device::carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress) {
    Parts& p = *parts_;
    p.use();
    progress.begin("carve", 2);
    if (p.headers.size() != inputs.size())
        throw UsageError("carve: the device holds fields of " + std::to_string(p.headers.size()) + " views, " + std::to_string(inputs.size()) + " are carved");
    std::vector<CarveInput> bare = inputs;
    for (CarveInput& input : bare) input.field = nullptr;
    check_carve(bare, options);
    cuda::CarveJob job;
    for (size_t i = 0; i < inputs.size(); ++i) {
        const DistanceField& h = p.headers[i];
        const Intrinsics& k = inputs[i].camera.intrinsics;
        if (!p.silhouettes[i].samples || h.mask_width != k.width_px || h.mask_height != k.height_px)
            throw UsageError("carve: view " + inputs[i].name + ": the distance field has not the camera's size");
        if (options.occupancy && h.scale != 1)
            throw UsageError("carve: the binary model wants a sample a pixel, view " + inputs[i].name + " has a field-scale of " + std::to_string(h.scale));
        bare[i].field = &h;
        kernel::CarveView view = make_carve_view(bare[i], options);
        view.silhouette = p.view_of(h.silhouette, p.silhouettes[i]);
        view.ignored = p.ignored[i].samples ? p.view_of(h.ignored, p.ignored[i]) : kernel::FieldView{};
        job.views.push_back(view);
    }
    const CarvePlan plan = plan_carve(inputs.size(), options);
    for (int a = 0; a < 3; ++a) {
        job.origin_world[a] = options.lattice.origin_world[a];
        job.lo[a] = options.bounds_world.min()[a];
        job.hi[a] = options.bounds_world.max()[a];
    }
    job.voxel_size = options.lattice.voxel_size;
    job.band = plan.band;
    job.near_depth = plan.near_depth;
    job.cell_radius = plan.cell_radius;
    job.max_misses = options.max_misses;
    job.need_seen = plan.need_seen;
    job.min = plan.range.min;
    job.max = plan.range.max;
    job.occupancy = options.occupancy;
    p.hull.topology = nullptr;
    p.carve_options.reset();
    p.carve.run(job, p.stream, p.times);
    p.carve_options = options;
    p.carve_inputs = inputs;
    for (CarveInput& input : p.carve_inputs) input.field = nullptr;
    progress.step();
    CarveStatistics s;
    if (!options.occupancy) {
        p.hull.transform = options.lattice.transform();
        p.times.measure("carve: topology", p.stream, [&] {
            p.hull.grid.build(p.carve.topology(), Parts::spec_of("hull", *p.hull.transform, static_cast<float>(plan.band)), p.carve.leaves(), p.stream);
        });
        p.hull.topology = &p.carve.topology();
        s.leaves = p.hull.grid.leaf_count();
    }
    const cuda::CarveCounts counts = p.carve.counts(p.stream);
    s.node_tests = counts.node_tests;
    s.voxel_lookups = counts.voxel_lookups;
    s.inside_voxels = counts.negative;
    s.clipped_share = counts.surface ? static_cast<double>(counts.capped) / static_cast<double>(counts.surface) : 0;
    if (!options.occupancy && counts.negative == 0 && !options.brick && !options.allow_empty) {
        const std::vector<DistanceField> held = fields();
        for (size_t i = 0; i < bare.size(); ++i) bare[i].field = &held[i];
        explain_empty(bare, options);
    }
    progress.step();
    return s;
}

openvdb::MaskGrid::Ptr Device::occupancy() const {
    Parts& p = *parts_;
    p.use();
    if (!p.carve_options || !p.carve_options->occupancy) throw UsageError("the device holds no occupancy");
    const CarveOptions& options = *p.carve_options;
    const auto& blocks = p.carve.topology().origins();
    const cuda::LeafSource leaves = p.carve.leaves();
    std::vector<uint64_t> exist(blocks.size() * kBlockWords), inside(exist.size()), active(static_cast<size_t>(leaves.slots) * 8);
    std::vector<uint32_t> keys(leaves.slots);
    const cuda::TopologyView view = p.carve.topology().view();
    p.stream.to_host(exist.data(), view.leaves, exist.size());
    p.stream.to_host(inside.data(), view.inside, inside.size());
    p.stream.to_host(active.data(), leaves.active, active.size());
    p.stream.to_host(keys.data(), leaves.keys, keys.size());
    p.stream.wait();
    openvdb::MaskGrid::Ptr out = empty_occupancy(options);
    openvdb::MaskTree& tree = out->tree();
    const auto place = [&](size_t block, size_t at) {
        return Coord(blocks[block][0] + static_cast<int>(at >> 8) * 8, blocks[block][1] + static_cast<int>(at >> 4 & 15) * 8,
                     blocks[block][2] + static_cast<int>(at & 15) * 8);
    };
    bool any = false;
    for (size_t slot = 0; slot < keys.size(); ++slot) {
        const size_t block = keys[slot] / kBlockLeaves, at = keys[slot] % kBlockLeaves;
        if (!(exist[block * kBlockWords + at / 64] >> (at & 63) & 1)) continue;
        auto leaf = std::make_unique<openvdb::MaskTree::LeafNodeType>(place(block, at), false, false);
        openvdb::util::NodeMask<3> mask;
        for (openvdb::Index w = 0; w < 8; ++w) mask.getWord<openvdb::Index64>(w) = active[slot * 8 + w];
        leaf->setValueMask(mask);
        tree.addLeaf(leaf.release());
        any = true;
    }
    for (size_t block = 0; block < blocks.size(); ++block) {
        const uint64_t* words = inside.data() + block * kBlockWords;
        if (std::all_of(words, words + kBlockWords, [](uint64_t w) { return w == ~uint64_t{0}; })) {
            tree.addTile(2, place(block, 0), true, true);
            any = true;
            continue;
        }
        for (size_t at = 0; at < kBlockLeaves; ++at)
            if (words[at / 64] >> (at & 63) & 1) {
                tree.addTile(1, place(block, at), true, true);
                any = true;
            }
    }
    if (!any && !options.brick && !options.allow_empty) {
        const std::vector<DistanceField> held = fields();
        std::vector<CarveInput> inputs = p.carve_inputs;
        for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &held[i];
        explain_empty(inputs, options);
    }
    openvdb::tools::prune(tree);
    return out;
}

}  // namespace vdbcarve
