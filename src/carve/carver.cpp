// SPDX-License-Identifier: Apache-2.0
#include "carve/carver.h"

#include <algorithm>
#include <cmath>

namespace vdbcarve::carving {

Carver::Carver(const std::vector<CarveInput>& inputs, const CarveOptions& options) : options_(options), inputs_(inputs) {
    for (const CarveInput& input : inputs_) views_.push_back(make_carve_view(input, options));
    const CarvePlan plan = plan_carve(views_.size(), options);
    band_ = plan.band;
    band_f_ = static_cast<float>(band_);
    near_ = plan.near_depth;
    cell_radius_ = plan.cell_radius;
    need_seen_ = plan.need_seen;
    range_ = plan.range;
    for (int a = 0; a < 3; ++a) {
        lo_[a] = options.bounds_world.min()[a];
        hi_[a] = options.bounds_world.max()[a];
    }
    set_batch(0, inputs.size());
}

void Carver::set_batch(size_t first, size_t last) {
    batch_.clear();
    for (size_t i = first; i < last; ++i) batch_.push_back(static_cast<uint16_t>(i));
    last_ = last == views_.size();
}

void Carver::set_field(size_t view, const DistanceField* field) {
    inputs_[view].field = field;
    views_[view] = make_carve_view(inputs_[view], options_);
}

void Carver::drop_silhouette(size_t view, const SampledField& kept) {
    views_[view].silhouette = {};
    views_[view].ignored = kept.empty() ? kernel::FieldView{} : kept.view();
}

void Carver::count(const Leaf& leaf, Found& found) const {
    const Coord origin = leaf.origin();
    const int at[3] = {origin.x(), origin.y(), origin.z()};
    const bool in_box = box_around(ball_of(at, 8)) == NodeAnswer::In;
    count_values(found, at, in_box, leaf.buffer().data());
}

void Carver::ask(OpenNode node, Found& found) const {
    std::vector<std::vector<uint16_t>> lists(8);
    Walk walk{found, lists, {}};
    descend(walk,
            {{node.origin[0], node.origin[1], node.origin[2]},
             node.size,
             batch_.data(),
             static_cast<int>(batch_.size()),
             node.certain_misses,
             need_seen_ <= 0,
             false},
            0, std::move(node.leaf));
}

NodeAnswer Carver::box_around(const IndexBall& ball) const {
    const Vec3d c = options_.lattice.world_from_index(Vec3d(ball.i, ball.j, ball.k));
    const double p[3] = {c.x(), c.y(), c.z()};
    const double d = kernel::box_distance(p, lo_, hi_);
    const double rounding = 1e-3 * options_.lattice.voxel_size;
    if (d - ball.radius - rounding > band_) return NodeAnswer::Out;
    return d + ball.radius + rounding < -band_ ? NodeAnswer::In : NodeAnswer::Mixed;
}

bool Carver::is_beyond(NodeState& node, const IndexBall& ball) const {
    for (int a = 0; a < 3; ++a) {
        const auto s = static_cast<size_t>(a);
        if (node.origin[a] >= range_.max[s] || node.origin[a] + node.size <= range_.min[s]) return true;
    }
    if (node.in_box) return false;
    const NodeAnswer box = box_around(ball);
    node.in_box = box == NodeAnswer::In;
    return box == NodeAnswer::Out;
}

void Carver::descend(Walk& walk, const NodeState& node, size_t level, std::unique_ptr<OpenLeaf> leaf) const {
    NodeState state = node;
    const IndexBall ball = ball_of(node);
    if (is_beyond(state, ball)) return;

    walk.cuts.clear();
    walk.found.node_tests += static_cast<size_t>(node.view_count);
    for (int i = 0; i < node.view_count; ++i) {
        const CarveView& view = views_[node.views[i]];
        const kernel::NodeAnswers answers = kernel::node_answers(view, kernel::node_ball(view, ball.i, ball.j, ball.k, ball.radius), near_, band_);
        if (answers.hull == NodeAnswer::Out) {
            if (++state.certain_misses > options_.max_misses) return;
        } else if (answers.hull == NodeAnswer::Mixed) {
            walk.cuts.push_back({answers.silhouette_px, node.views[i], answers.clear_of_frame});
        }
    }
    // With other views still to come nothing is known about how many see the node.
    if (last_ && !state.seen) {
        int seen_whole = 0, seen_maybe = 0;
        walk.found.node_tests += views_.size();
        for (const CarveView& view : views_) {
            const NodeAnswer unseen = kernel::node_answers(view, kernel::node_ball(view, ball.i, ball.j, ball.k, ball.radius), near_, band_).unseen;
            seen_whole += unseen == NodeAnswer::In;
            seen_maybe += unseen != NodeAnswer::Out;
        }
        if (seen_maybe < need_seen_) return;
        state.seen = seen_whole >= need_seen_;
    }
    if (!leaf) {
        if (!last_ && walk.cuts.empty()) {
            walk.found.open.push_back({{node.origin[0], node.origin[1], node.origin[2]}, node.size, state.certain_misses, {}});
            return;
        }
        // No view can still bring the node past the allowed misses, nor can the frame or the box.
        if (last_ && state.seen && state.in_box && state.certain_misses + static_cast<int>(walk.cuts.size()) <= options_.max_misses) {
            if (!options_.occupancy) return;
            // A node that reaches past the brick is cut up further; leaves are clipped voxel by voxel.
            if (in_range(node)) {
                walk.found.inside.emplace_back(Coord(node.origin[0], node.origin[1], node.origin[2]), node.size);
                return;
            }
        }
    }
    if (node.size == 8) {
        if (!leaf) {
            leaf = std::make_unique<OpenLeaf>();
            const size_t ranks = options_.occupancy ? 1 : static_cast<size_t>(options_.max_misses) + 1;
            leaf->largest.assign(ranks * kLeafVoxels, options_.occupancy ? 0.f : -band_f_);
        }
        std::sort(walk.cuts.begin(), walk.cuts.end(), before_other);
        const bool some_left = options_.occupancy ? ask_binary(walk, state, *leaf) : ask_leaf(walk, state, *leaf);
        if (!some_left) return;
        if (!last_) walk.found.open.push_back({{node.origin[0], node.origin[1], node.origin[2]}, node.size, state.certain_misses, std::move(leaf)});
        else if (options_.occupancy) finish_binary(walk.found, state, *leaf);
        else finish_leaf(walk.found, state, *leaf);
        return;
    }
    if (walk.lists.size() <= level) walk.lists.resize(level + 1);
    walk.lists[level].clear();
    for (const Cut& cut : walk.cuts) walk.lists[level].push_back(cut.view);
    state.view_count = static_cast<int>(walk.cuts.size());
    for (int child = 0; child < 8; ++child) {
        NodeState next = child_of(state, child);
        // The list of this level may move when a deeper level grows the outer vector, so it is looked up anew.
        next.views = walk.lists[level].data();
        descend(walk, next, level + 1);
    }
}

bool Carver::ask_leaf(Walk& walk, const NodeState& node, OpenLeaf& leaf) const {
    const int ranks = options_.max_misses + 1;
    const VectorLoops& loops = vector_loops();
    alignas(64) float values[kLeafVoxels];
    const auto bury = [&](int cell) {
        if (rank_of(node, leaf, cell) < 0) leaf.alive &= ~(1u << cell);
    };
    for (int cell = 0; cell < kLeafCells; ++cell) bury(cell);
    for (const Cut& cut : walk.cuts) {
        if (!leaf.alive) return false;
        const CarveView& view = views_[cut.view];
        CellAnswers answers{0, leaf.alive, 0};
        if (ranks == 1 && cut.clear_of_frame) {
            answers = loops.raise_leaf(view, node.origin, leaf.alive, cell_radius_, band_f_, leaf.largest.data());
            leaf.alive &= ~(answers.out | answers.full);
            walk.found.voxel_lookups += static_cast<size_t>(__builtin_popcount(answers.mixed)) * kCellVoxels;
            continue;
        }
        std::fill_n(values, kLeafVoxels, -band_f_);
        if (cut.clear_of_frame) answers = loops.raise_leaf(view, node.origin, leaf.alive, cell_radius_, band_f_, values);
        else view_values(view, node, leaf.alive, values);
        for (int cell = 0; cell < kLeafCells; ++cell) {
            if (answers.out >> cell & 1) {
                ++leaf.cell_misses[cell];
                bury(cell);
            }
            if (!(answers.mixed >> cell & 1)) continue;
            walk.found.voxel_lookups += kCellVoxels;
            const float* v = values + cell * kCellVoxels;
            float* largest = leaf.largest.data() + cell * kCellVoxels;
            const int rank = rank_of(node, leaf, cell);
            float smallest = band_f_;
            for (int n = 0; n < kCellVoxels; ++n) {
                float x = v[n];
                for (int r = 0; r < ranks && x > -band_f_; ++r)
                    if (x > largest[r * kLeafVoxels + n]) std::swap(x, largest[r * kLeafVoxels + n]);
                smallest = kernel::min_f(smallest, largest[rank * kLeafVoxels + n]);
            }
            if (smallest >= band_f_) leaf.alive &= ~(1u << cell);
        }
    }
    return leaf.alive != 0;
}

void Carver::view_values(const CarveView& view, const NodeState& node, unsigned cells, float* values) const {
    const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
    for_each_row([&](int at, int in_cell) {
        if (!(cells >> (in_cell >> 6) & 1)) return;
        for (int k = 0; k < 4; ++k) values[in_cell + k] = kernel::view_value(view, voxel_in_camera(to_camera, at + k), near_, band_f_);
    });
}

void Carver::finish_leaf(Found& found, const NodeState& node, const OpenLeaf& open) const {
    alignas(64) float value[kLeafVoxels];
    const float* ranked[kLeafCells];
    for (int cell = 0; cell < kLeafCells; ++cell)
        ranked[cell] = open.alive >> cell & 1 ? open.largest.data() + rank_of(node, open, cell) * kLeafVoxels + cell * kCellVoxels : nullptr;
    for_each_row([&](int at, int in_cell) {
        const float* from = ranked[in_cell >> 6];
        if (from) std::copy_n(from + (in_cell & 63), 4, value + at);
        else std::fill_n(value + at, 4, band_f_);
    });
    if (!node.seen) raise_unseen(found, node, value);
    if (!node.in_box)
        for (int at = 0; at < kLeafVoxels; ++at) value[at] = kernel::max_f(value[at], box_value(node.origin, at));
    openvdb::util::NodeMask<3> active;
    uint64_t any = 0;
    for (int i = 0; i < 8; ++i) {
        uint64_t word = 0;
        for (int jk = 0; jk < 64; ++jk) {
            const float v = value[i << 6 | jk];
            word |= static_cast<uint64_t>(v > -band_f_ && v < band_f_) << jk;
        }
        active.getWord<openvdb::Index64>(static_cast<openvdb::Index>(i)) = word;
        any |= word;
    }
    count_values(found, node.origin, node.in_box, value);
    if (!any) return;
    auto leaf = std::make_unique<Leaf>(openvdb::PartialCreate(), Coord(node.origin[0], node.origin[1], node.origin[2]), band_f_, false);
    leaf->allocate();
    std::copy_n(value, kLeafVoxels, leaf->buffer().data());
    leaf->setValueMask(active);
    found.leaves.push_back(std::move(leaf));
}

void Carver::count_values(Found& found, const int origin[3], bool in_box, const float* value) const {
    const float surface = 0.5f * static_cast<float>(options_.lattice.voxel_size);
    for (int at = 0; at < kLeafVoxels; ++at) {
        found.negative += value[at] < 0;
        const bool near_surface = std::fabs(value[at]) <= surface;
        found.surface += near_surface;
        found.capped += near_surface && !in_box && value[at] == box_value(origin, at);
    }
}

void Carver::raise_unseen(Found& found, const NodeState& node, float* value) const {
    std::vector<float> all(views_.size() * kLeafVoxels), one(views_.size());
    for (size_t n = 0; n < views_.size(); ++n) {
        const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(views_[n], node.origin[0], node.origin[1], node.origin[2]);
        for (int at = 0; at < kLeafVoxels; ++at)
            all[n * kLeafVoxels + static_cast<size_t>(at)] = kernel::unseen_value(views_[n], voxel_in_camera(to_camera, at), near_, band_f_);
    }
    found.voxel_lookups += views_.size() * kLeafVoxels;
    const auto nth = one.begin() + (need_seen_ - 1);
    for (size_t at = 0; at < kLeafVoxels; ++at) {
        for (size_t n = 0; n < views_.size(); ++n) one[n] = all[n * kLeafVoxels + at];
        std::nth_element(one.begin(), nth, one.end());
        value[at] = kernel::max_f(value[at], *nth);
    }
}

bool Carver::ask_binary(Walk& walk, const NodeState& node, OpenLeaf& leaf) const {
    for (const Cut& cut : walk.cuts) {
        const CarveView& view = views_[cut.view];
        const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
        for (int at = 0; at < kLeafVoxels; ++at)
            leaf.largest[static_cast<size_t>(at)] += kernel::binary_answer(view, voxel_in_camera(to_camera, at), near_).background;
        walk.found.voxel_lookups += kLeafVoxels;
    }
    return true;
}

void Carver::finish_binary(Found& found, const NodeState& node, const OpenLeaf& open) const {
    int seen[kLeafVoxels] = {};
    if (!node.seen)
        for (const CarveView& view : views_) {
            const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
            for (int at = 0; at < kLeafVoxels; ++at) seen[at] += kernel::seen_at(view, voxel_in_camera(to_camera, at), near_);
            found.voxel_lookups += kLeafVoxels;
        }
    auto leaf = std::make_unique<MaskLeaf>(Coord(node.origin[0], node.origin[1], node.origin[2]), false, false);
    bool any = false;
    for (int at = 0; at < kLeafVoxels; ++at) {
        if (node.certain_misses + static_cast<int>(open.largest[static_cast<size_t>(at)]) > options_.max_misses || (!node.seen && seen[at] < need_seen_))
            continue;
        if (!in_range(node.origin, at)) continue;
        leaf->setValueOn(static_cast<openvdb::Index>(at));
        any = true;
    }
    if (any) found.mask_leaves.push_back(std::move(leaf));
}

}  // namespace vdbcarve::carving
