// SPDX-License-Identifier: Apache-2.0
// A hull of some views, extended by more.
#include "carve/carver.h"

#include <algorithm>

namespace vdbcarve::carving {

void Carver::extend(const openvdb::FloatTree& hull, size_t known, const OpenNode& node, Extended& out) const {
    std::vector<std::vector<uint16_t>> lists;
    Walk walk{out.found, lists, {}};
    const auto need_known = static_cast<int>(plan_carve(known, options_).need_seen);
    // Of more views more must see a place: where as many more as there are, the need_seen-th smallest distance to a frame only grows.
    const bool unseen_grows = need_seen_ - need_known >= static_cast<int>(batch_.size());
    extend(walk, {hull, static_cast<int>(known), need_known, unseen_grows},
           {{node.origin[0], node.origin[1], node.origin[2]}, node.size, batch_.data(), static_cast<int>(batch_.size()), 0, false, false}, false, out);
}

void Carver::extend(Walk& walk, const Before& before, const NodeState& node, bool grows, Extended& out) const {
    NodeState state = node;
    const IndexBall ball = ball_of(node);
    if (is_beyond(state, ball)) return;
    const auto deeper = [&] {
        for (int child = 0; child < 8; ++child) extend(walk, before, child_of(state, child), grows, out);
    };
    const auto ask_again = [&] { out.again.push_back({{node.origin[0], node.origin[1], node.origin[2]}, node.size, 0, {}}); };
    if (!state.seen || !grows) {
        int surely_then = 0, maybe_then = 0, surely = 0, maybe = 0;
        walk.found.node_tests += views_.size();
        for (size_t v = 0; v < views_.size(); ++v) {
            const NodeAnswer unseen = kernel::node_answers(views_[v], kernel::node_ball(views_[v], ball.i, ball.j, ball.k, ball.radius), near_, band_).unseen;
            surely += unseen == NodeAnswer::In;
            maybe += unseen != NodeAnswer::Out;
            if (static_cast<int>(v) == before.views - 1) surely_then = surely, maybe_then = maybe;
        }
        if (maybe < need_seen_) return;  // nothing is here, whatever was
        state.seen = surely >= need_seen_;
        grows = before.unseen_grows || surely_then >= before.need_seen;
        if (!grows) {
            const bool appears = maybe_then < before.need_seen && state.seen;
            if (appears || node.size == 8) ask_again();
            else deeper();
            return;
        }
    }
    if (is_outside(before.hull, node)) return;
    walk.cuts.clear();
    walk.found.node_tests += static_cast<size_t>(node.view_count);
    int misses = 0;
    for (int i = 0; i < node.view_count; ++i) {
        const CarveView& view = views_[node.views[i]];
        const kernel::NodeAnswers answers = kernel::node_answers(view, kernel::node_ball(view, ball.i, ball.j, ball.k, ball.radius), near_, band_);
        misses += answers.hull == NodeAnswer::Out;
        if (answers.hull == NodeAnswer::Mixed) walk.cuts.push_back({answers.silhouette_px, node.views[i], answers.clear_of_frame});
    }
    const bool untouched = misses == 0 && walk.cuts.empty();
    if (misses > options_.max_misses) return;
    if (untouched && state.seen) {
        keep(before.hull, node, out.kept);
    } else if (options_.max_misses > 0 && !untouched) {
        // Which of the views' values counts depends on all of them.
        if (walk.cuts.empty() || node.size == 8) ask_again();
        else deeper();
    } else if (node.size > 8) {
        deeper();
    } else {
        raise(walk, before.hull, state, out);
    }
}

void Carver::raise(Walk& walk, const openvdb::FloatTree& hull, const NodeState& node, Extended& out) const {
    OpenLeaf leaf;
    leaf.largest.assign(static_cast<size_t>(options_.max_misses + 1) * kLeafVoxels, -band_f_);
    if (const Leaf* old = hull.probeConstLeaf(Coord(node.origin[0], node.origin[1], node.origin[2]))) {
        const float* from = old->buffer().data();
        float* to = leaf.largest.data() + options_.max_misses * kLeafVoxels;  // the one that counts
        for_each_row([&](int at, int in_cell) { std::copy_n(from + at, 4, to + in_cell); });
    }
    std::sort(walk.cuts.begin(), walk.cuts.end(), before_other);
    if (ask_leaf(walk, node, leaf)) finish_leaf(out.found, node, leaf);
}

bool Carver::is_outside(const openvdb::FloatTree& hull, const NodeState& node) {
    const Coord origin(node.origin[0], node.origin[1], node.origin[2]);
    if (node.size > 8 && hull.probeConstNode<Block>(origin)) return false;  // some of it may not be
    return !hull.probeConstLeaf(origin) && hull.getValue(origin) > 0;
}

void Carver::keep(const openvdb::FloatTree& hull, const NodeState& node, std::vector<const Leaf*>& kept) {
    const Coord origin(node.origin[0], node.origin[1], node.origin[2]);
    const Block* block = hull.probeConstNode<Block>(origin);
    if (!block) return;
    for (int i = 0; i < node.size; i += 8)
        for (int j = 0; j < node.size; j += 8)
            for (int k = 0; k < node.size; k += 8)
                if (const Leaf* leaf = block->probeConstLeaf(origin.offsetBy(i, j, k))) kept.push_back(leaf);
}

}  // namespace vdbcarve::carving
