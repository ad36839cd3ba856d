// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/carve.h"

#include <openvdb/tools/Prune.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <memory>
#include <set>

#include "carve/carve_plan.h"
#include "carve/carver.h"
#include "vdbcarve/error.h"
#include "volume/same_transform.h"

namespace vdbcarve {

using namespace carving;

namespace {

/// Root nodes large enough to skip empty space, small enough to share out: the result does not depend on it.
std::vector<OpenNode> root_nodes(const IndexBox& range) {
    const auto roots_of = [&](int size) {
        std::vector<OpenNode> out;
        const auto down = [size](int x) { return (x >= 0 ? x / size : -((size - 1 - x) / size)) * size; };
        for (int i = down(range.min[0]); i < range.max[0]; i += size)
            for (int j = down(range.min[1]); j < range.max[1]; j += size)
                for (int k = down(range.min[2]); k < range.max[2]; k += size) out.push_back({{i, j, k}, size, 0, {}});
        return out;
    };
    int size = 128;
    std::vector<OpenNode> roots = roots_of(size);
    while (roots.size() < 256 && size > 16) roots = roots_of(size /= 2);
    return roots;
}

/// All views about some nodes. One batch or several: `fields_of` is null when the inputs hold all fields.
std::vector<Found> ask_nodes(Carver& carver, std::vector<OpenNode> nodes, const std::vector<CarveInput>& inputs, size_t batch, const FieldSource* fields_of,
                             const CarveOptions& options, Progress& progress) {
    std::vector<Found> found(nodes.size());
    const size_t batches = fields_of ? (inputs.size() + batch - 1) / batch : 1;
    progress.begin("carve", nodes.size() * batches);
    std::vector<SampledField> ignored(inputs.size());
    for (size_t b = 0; b < batches; ++b) {
        std::vector<DistanceField> fields;
        const size_t first = b * batch, last = fields_of ? std::min(inputs.size(), first + batch) : inputs.size();
        if (fields_of) {
            fields = (*fields_of)(first, last);
            for (size_t i = first; i < last; ++i) {
                check_field(inputs[i].name, inputs[i].camera.intrinsics, fields[i - first], options);
                carver.set_field(i, &fields[i - first]);
            }
            carver.set_batch(first, last);
        }
        tbb::parallel_for(size_t{0}, nodes.size(), [&](size_t r) {
            Found& f = found[r];
            if (b == 0) {
                carver.ask(std::move(nodes[r]), f);
            } else {
                std::vector<OpenNode> open = std::move(f.open);
                f.open.clear();
                for (OpenNode& node : open) carver.ask(std::move(node), f);
            }
            progress.step();
        });
        for (size_t i = first; i < last && fields_of; ++i) {
            ignored[i] = std::move(fields[i - first].ignored);
            carver.drop_silhouette(i, ignored[i]);
        }
    }
    return found;
}

/// Sums of what was counted.
struct Sums {
    size_t surface = 0, capped = 0, negative = 0;
};

Sums sum_up(const std::vector<Found>& found, CarveStatistics& statistics) {
    Sums sums;
    for (const Found& f : found) {
        statistics.node_tests += f.node_tests;
        statistics.voxel_lookups += f.voxel_lookups;
        statistics.leaves += f.leaves.size() + f.mask_leaves.size();
        sums.surface += f.surface;
        sums.capped += f.capped;
        sums.negative += f.negative;
    }
    statistics.inside_voxels = sums.negative;
    statistics.clipped_share = sums.surface ? static_cast<double>(sums.capped) / static_cast<double>(sums.surface) : 0;
    return sums;
}

CarveResult run(const std::vector<CarveInput>& inputs, size_t batch, const FieldSource* fields_of, const CarveOptions& options, Progress& progress) {
    check_carve(inputs, options);
    Carver carver(inputs, options);
    std::vector<Found> found = ask_nodes(carver, root_nodes(carver.range()), inputs, batch, fields_of, options, progress);
    CarveResult result;
    const size_t negative = sum_up(found, result.statistics).negative;

    if (options.occupancy) {
        result.occupancy = empty_occupancy(options);
        openvdb::MaskTree& tree = result.occupancy->tree();
        bool any = false;
        for (Found& f : found) {
            for (auto& leaf : f.mask_leaves) tree.addLeaf(leaf.release());
            for (const auto& [origin, size] : f.inside) {
                // Level 1 tiles are 8 wide, level 2 tiles 128; sizes between are filled with the former.
                const int step = size == 128 ? 128 : 8;
                for (int i = 0; i < size; i += step)
                    for (int j = 0; j < size; j += step)
                        for (int k = 0; k < size; k += step) tree.addTile(step == 128 ? 2 : 1, origin.offsetBy(i, j, k), true, true);
            }
            any |= !f.inside.empty();
        }
        if (result.statistics.leaves == 0 && !any && !options.brick && !options.allow_empty) explain_empty(inputs, options);
        openvdb::tools::prune(tree);
        measure_tree(result);
        return result;
    }

    // Leaves without a negative voxel hold the outer band of a surface that no voxel is inside of.
    if (negative == 0 && !options.brick && !options.allow_empty) explain_empty(inputs, options);
    result.hull = empty_hull(options);
    openvdb::FloatTree& tree = result.hull->tree();
    for (Found& f : found)
        for (auto& leaf : f.leaves) tree.addLeaf(leaf.release());
    openvdb::tools::signedFloodFill(tree);
    measure_tree(result);
    return result;
}

}  // namespace

CarveResult carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress) {
    for (const CarveInput& input : inputs)
        if (!input.field) throw UsageError("carve: view " + input.name + " has no distance field");
    return run(inputs, inputs.size(), nullptr, options, progress);
}

CarveResult carve_in_batches(const std::vector<CarveInput>& inputs, size_t batch, const FieldSource& fields_of, const CarveOptions& options,
                             Progress& progress) {
    if (batch == 0) throw UsageError("carve: a batch of no views");
    std::vector<CarveInput> bare = inputs;
    for (CarveInput& input : bare) input.field = nullptr;
    return run(bare, batch, &fields_of, options, progress);
}

CarveResult extend_hull(openvdb::FloatGrid::Ptr hull, size_t known, const std::vector<CarveInput>& inputs, const FieldSource& fields_of,
                        const CarveOptions& options, Progress& progress) {
    check_carve(inputs, options);
    if (options.occupancy || options.brick) throw UsageError("extend_hull: of a whole hull only, neither of an occupancy nor of a brick");
    if (known == 0 || known >= inputs.size())
        throw UsageError("extend_hull: of " + std::to_string(inputs.size()) + " views " + std::to_string(known) + " are said to have made the hull");
    for (size_t i = known; i < inputs.size(); ++i)
        if (!inputs[i].field) throw UsageError("extend_hull: view " + inputs[i].name + " has no distance field");
    const auto band = static_cast<float>(options.half_width_vox * options.lattice.voxel_size);
    if (hull->background() != band || hull->transform() != *options.lattice.transform()) throw UsageError("extend_hull: the hull lies on another lattice");

    // Known views are asked for their frames only, in the pixels of the fields.
    DistanceField frame_only;
    frame_only.scale = inputs[known].field->scale;
    std::vector<CarveInput> framed = inputs;
    for (CarveInput& input : framed)
        if (!input.field) input.field = &frame_only;
    Carver carver(framed, options);
    carver.set_batch(known, inputs.size());
    const std::vector<OpenNode> roots = root_nodes(carver.range());
    std::vector<Extended> extended(roots.size());
    progress.begin("carve", roots.size());
    tbb::parallel_for(size_t{0}, roots.size(), [&](size_t r) {
        carver.extend(hull->tree(), known, roots[r], extended[r]);
        for (const Leaf* leaf : extended[r].kept) carver.count(*leaf, extended[r].found);
        progress.step();
    });
    std::vector<Found> found;
    std::vector<OpenNode> again;
    std::vector<const Leaf*> kept;
    for (Extended& e : extended) {
        found.push_back(std::move(e.found));
        std::move(e.again.begin(), e.again.end(), std::back_inserter(again));
        kept.insert(kept.end(), e.kept.begin(), e.kept.end());
    }
    if (!again.empty()) {
        Carver all(inputs, options);
        for (Found& f : ask_nodes(all, std::move(again), inputs, inputs.size(), &fields_of, options, progress)) found.push_back(std::move(f));
    }
    CarveResult result;
    const size_t negative = sum_up(found, result.statistics).negative;
    if (negative == 0 && !options.allow_empty) {
        std::vector<CarveInput> blamed = inputs;
        const std::vector<DistanceField> fields = fields_of(0, inputs.size());
        for (size_t i = 0; i < inputs.size(); ++i) blamed[i].field = &fields[i];
        explain_empty(blamed, options);
    }
    result.hull = empty_hull(options);
    openvdb::FloatTree& tree = result.hull->tree();
    std::sort(kept.begin(), kept.end());
    std::vector<Leaf*> old;
    hull->tree().stealNodes(old);
    for (Leaf* leaf : old) {
        if (std::binary_search(kept.begin(), kept.end(), leaf)) tree.addLeaf(leaf);
        else delete leaf;
    }
    for (Found& f : found)
        for (auto& leaf : f.leaves) tree.addLeaf(leaf.release());
    openvdb::tools::signedFloodFill(tree);
    measure_tree(result);
    return result;
}

openvdb::FloatGrid::Ptr merge_bricks(const std::vector<openvdb::FloatGrid::Ptr>& bricks) {
    if (bricks.empty()) throw UsageError("merge_bricks: no bricks");
    const openvdb::FloatGrid& first = *bricks.front();
    openvdb::FloatGrid::Ptr out = openvdb::FloatGrid::create(first.background());
    out->setTransform(same_transform(first.transform()));
    out->setName(first.getName());
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    std::set<Coord> origins;
    for (const auto& brick : bricks) {
        if (brick->transform() != first.transform() || brick->background() != first.background())
            throw UsageError("merge_bricks: the bricks do not share one lattice");
        for (auto leaf = brick->tree().cbeginLeaf(); leaf; ++leaf)
            if (!origins.insert(leaf->origin()).second) throw UsageError("merge_bricks: two bricks overlap");
    }
    std::vector<Leaf*> leaves;
    for (const auto& brick : bricks) {
        brick->tree().stealNodes(leaves);
        brick->clear();
    }
    // The order of insertion decides the layout of nothing but the node pool; sort for the same bits.
    std::sort(leaves.begin(), leaves.end(), [](const Leaf* a, const Leaf* b) { return a->origin() < b->origin(); });
    for (Leaf* leaf : leaves) out->tree().addLeaf(leaf);
    openvdb::tools::signedFloodFill(out->tree());
    return out;
}

}  // namespace vdbcarve
