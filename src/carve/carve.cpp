// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/carve.h"

#include <openvdb/tools/Prune.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <set>

#include "carve/carve_plan.h"
#include "volume/same_transform.h"
#include "base/vector_loops.h"

namespace vdbcarve {

using openvdb::Coord;

openvdb::math::Transform::Ptr Lattice::transform() const {
    auto t = openvdb::math::Transform::createLinearTransform(voxel_size);
    t->postTranslate(openvdb::Vec3d(origin_world.x(), origin_world.y(), origin_world.z()) + openvdb::Vec3d(0.5 * voxel_size));
    return t;
}

IndexBox voxels_in_bounds(const Lattice& lattice, const Box3d& bounds, int margin_vox) {
    IndexBox box;
    for (int a = 0; a < 3; ++a) {
        // 1e-6 voxel forgives the rounding of bounds that were meant to fall on voxel faces.
        const double lo = (bounds.min()[a] - lattice.origin_world[a]) / lattice.voxel_size - 0.5;
        const double hi = (bounds.max()[a] - lattice.origin_world[a]) / lattice.voxel_size - 0.5;
        box.min[static_cast<size_t>(a)] = static_cast<int>(std::ceil(lo - 1e-6)) - margin_vox;
        box.max[static_cast<size_t>(a)] = static_cast<int>(std::floor(hi + 1e-6)) + 1 + margin_vox;
    }
    return box;
}

kernel::CarveView make_carve_view(const CarveInput& input, const CarveOptions& options) {
    const Intrinsics& k = input.camera.intrinsics;
    const double h = options.lattice.voxel_size;
    const Rigid3& pose = input.camera.camera_from_world;
    const Vec3d first = pose * options.lattice.world_from_index(Vec3d::Zero());
    kernel::CarveView v{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) v.camera_from_index[4 * r + c] = pose.rotation(r, c) * h;
        v.camera_from_index[4 * r + 3] = first[r];
    }
    // Coarser samples are an image of fewer pixels.
    const double scale = input.field ? 1.0 / input.field->scale : 1.0;
    v.fx = static_cast<float>(k.fx * scale);
    v.skew = static_cast<float>(k.skew * scale);
    v.fy = static_cast<float>(k.fy * scale);
    v.cx = static_cast<float>(k.cx * scale);
    v.cy = static_cast<float>(k.cy * scale);
    v.sigma_max = static_cast<float>(k.sigma_max() * scale * (1 + 1e-6));  // stays an upper bound after rounding
    v.frame_width = static_cast<float>(k.width_px * scale);
    v.frame_height = static_cast<float>(k.height_px * scale);
    v.orthographic = k.orthographic;
    v.outside = options.outside;
    if (input.field) {
        v.silhouette = input.field->silhouette.view();
        if (!input.field->ignored.empty()) v.ignored = input.field->ignored.view();
    }
    return v;
}

CarvePlan plan_carve(size_t views, const CarveOptions& options) {
    const double h = options.lattice.voxel_size;
    CarvePlan plan;
    plan.band = options.occupancy ? 0.0 : options.half_width_vox * h;
    plan.near_depth = kernel::kNearPlane_vox * static_cast<float>(h);
    plan.cell_radius = static_cast<float>(kernel::kCellRadius_vox * h);
    plan.need_seen = static_cast<int>(std::ceil(options.min_seen * static_cast<double>(views) - 1e-9));
    plan.range = voxels_in_bounds(options.lattice, options.bounds_world, options.occupancy ? 0 : options.half_width_vox + 1);
    if (options.brick)
        for (size_t a = 0; a < 3; ++a) {
            plan.range.min[a] = std::max(plan.range.min[a], options.brick->min[a]);
            plan.range.max[a] = std::min(plan.range.max[a], options.brick->max[a]);
        }
    return plan;
}

FieldPlan plan_fields(const std::vector<Camera>& cameras, const CarveOptions& options, int scale) {
    // Pixels across a voxel: largest over the bounds' corners, and at their middle.
    const double h = options.lattice.voxel_size;
    const Box3d& box = options.bounds_world;
    const double radius = 0.5 * box.sizes().norm();
    std::vector<double> middle;
    double most = 0, fewest = INFINITY;
    for (const Camera& camera : cameras) {
        const Intrinsics& k = camera.intrinsics;
        double at_middle = k.sigma_max() * h, nearest = at_middle, farthest = at_middle;
        if (!k.orthographic) {
            const double depth = (camera.camera_from_world * box.center()).z();
            if (depth <= 0) continue;
            at_middle /= depth;
            nearest = 0, farthest = INFINITY;
            for (int c = 0; c < 8; ++c) {
                const Vec3d y = camera.camera_from_world * Vec3d(box.corner(static_cast<Box3d::CornerType>(c)));
                // A camera within the bounds: what is nearer than a fifth of the way is left to the coarse bound.
                const double z = std::max(y.z(), 0.2 * std::min(depth, radius));
                nearest = std::max(nearest, k.sigma_max() * h / z * std::sqrt(1 + (y.x() * y.x() + y.y() * y.y()) / (z * z)));
                farthest = std::min(farthest, k.sigma_max() * h / z);
            }
        }
        middle.push_back(at_middle);
        most = std::max(most, nearest);
        fewest = std::min(fewest, farthest);
    }
    FieldPlan plan;
    if (middle.empty()) return plan;
    std::nth_element(middle.begin(), middle.begin() + static_cast<long>(middle.size() / 2), middle.end());
    plan.px_per_voxel = middle[middle.size() / 2];
    // The binary model asks the very pixel.
    plan.scale = options.occupancy ? 1 : (scale > 0 ? scale : std::max(1, static_cast<int>(fewest / kSamplesPerVoxel)));
    // A leaf (its voxel centres reach sqrt(3) * 3.5 voxels from its middle) is decided by the samples, larger nodes by blocks.
    const double band_vox = options.occupancy ? 0 : options.half_width_vox;
    // In whole steps, so that a view that comes later seldom changes it.
    const double reach = (band_vox + std::sqrt(3.0) * 3.5) * most / plan.scale * 1.05 + kernel::kFieldSlop_px + 1;
    plan.reach_samples = std::clamp(8 * std::ceil(reach / 8), 8.0, 0.9 * kernel::kMaxReach_px);
    return plan;
}

namespace {

using kernel::CarveView;
using kernel::NodeAnswer;
using Leaf = openvdb::FloatTree::LeafNodeType;
using MaskLeaf = openvdb::MaskTree::LeafNodeType;

constexpr int kMaxMisses = 15;  // a voxel keeps its largest k + 1 values on the stack

/// A leaf that is not decided yet: of each voxel the largest values so far (cell order), largest first.
struct OpenLeaf {
    std::vector<float> largest;        ///< ranks x 512
    unsigned alive = 0xff;             ///< cells that are not outside everywhere
    int cell_misses[kLeafCells] = {};  ///< views that show background all over the cell, certain_misses of the node apart
};

/// A node between two batches of views: what is not outside yet.
struct OpenNode {
    int origin[3];
    int size;
    int certain_misses = 0;          ///< views that show background all over the node
    std::unique_ptr<OpenLeaf> leaf;  ///< once a view cuts it
};

/// What the tree walk found below one root node, in the order of the walk.
struct Found {
    std::vector<std::unique_ptr<Leaf>> leaves;
    std::vector<std::unique_ptr<MaskLeaf>> mask_leaves;
    std::vector<std::pair<Coord, int>> inside;  // whole nodes (origin, size), for occupancy
    std::vector<OpenNode> open;                 // before the last batch
    size_t node_tests = 0, voxel_lookups = 0, surface = 0, capped = 0, negative = 0;
};

/// What adding views to a hull found below one root node.
struct Extended {
    Found found;                    ///< leaves that the new views cut
    std::vector<const Leaf*> kept;  ///< leaves of the old hull that no new view says anything about
    std::vector<OpenNode> again;    ///< to be asked of all views
};

struct NodeState {
    int origin[3];
    int size;
    const uint16_t* views;  ///< those of the batch that still matter
    int view_count;
    int certain_misses;  ///< views that show background all over the node
    bool seen;           ///< enough views have the whole node in frame
    bool in_box;         ///< the whole node lies deeper inside the bounds than the band
};

/// Place, in a leaf, of the four voxels that a cell's row holds, and back: see cell_order.
template <class Copy>
void for_each_row(const Copy& copy) {
    for (int i = 0; i < 8; ++i)
        for (int j = 0; j < 8; ++j)
            for (int k = 0; k < 8; k += 4) {
                const int at = i << 6 | j << 3 | k;
                copy(at, cell_order(at));
            }
}

class Carver {
  public:
    Carver(const std::vector<CarveInput>& inputs, const CarveOptions& options) : options_(options), inputs_(inputs) {
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

    /// The views whose fields are there. The others keep their ignored regions, which count at the end.
    void set_batch(size_t first, size_t last) {
        batch_.clear();
        for (size_t i = first; i < last; ++i) batch_.push_back(static_cast<uint16_t>(i));
        last_ = last == views_.size();
    }
    void set_field(size_t view, const DistanceField* field) {
        inputs_[view].field = field;
        views_[view] = make_carve_view(inputs_[view], options_);
    }
    /// The silhouette of a view is gone; what it ignores stays, read from `kept`.
    void drop_silhouette(size_t view, const SampledField& kept) {
        views_[view].silhouette = {};
        views_[view].ignored = kept.empty() ? kernel::FieldView{} : kept.view();
    }

    const IndexBox& range() const { return range_; }

    /// Walks a node of a hull that the views i < known made: see extend_hull.
    void extend(const openvdb::FloatTree& hull, size_t known, const OpenNode& node, Extended& out) const {
        std::vector<std::vector<uint16_t>> lists;
        Walk walk{out.found, lists, {}};
        const auto need_known = static_cast<int>(plan_carve(known, options_).need_seen);
        // Of more views more must see a place: where as many more as there are, the need_seen-th smallest distance to a frame only grows.
        const bool unseen_grows = need_seen_ - need_known >= static_cast<int>(batch_.size());
        extend(walk, {hull, static_cast<int>(known), need_known, unseen_grows},
               {{node.origin[0], node.origin[1], node.origin[2]}, node.size, batch_.data(), static_cast<int>(batch_.size()), 0, false, false}, false, out);
    }

    /// Surface, caps and inside of a leaf that is kept.
    void count(const Leaf& leaf, Found& found) const {
        const Coord origin = leaf.origin();
        const int at[3] = {origin.x(), origin.y(), origin.z()};
        const bool in_box = box_around(ball_of(at, 8)) == NodeAnswer::In;
        count_values(found, at, in_box, leaf.buffer().data());
    }

    /// Asks the batch's views about a node, from the coarse to the fine.
    void ask(OpenNode node, Found& found) const {
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

  private:
    struct Cut {
        float silhouette_px;
        uint16_t view;
        bool clear_of_frame;
    };
    struct Walk {
        Found& found;
        std::vector<std::vector<uint16_t>>& lists;  ///< views that still matter, one list a level
        std::vector<Cut> cuts;                      ///< those of the last list made
    };

    /// Of a node's voxel centres: the middle in index coordinates, the radius in world units.
    struct IndexBall {
        double i, j, k, radius;
    };
    IndexBall ball_of(const int origin[3], int size) const {
        const double half = 0.5 * (size - 1);
        return {origin[0] + half, origin[1] + half, origin[2] + half, std::sqrt(3.0) * half * options_.lattice.voxel_size};
    }
    IndexBall ball_of(const NodeState& node) const { return ball_of(node.origin, node.size); }

    /// The bounds, about a ball: beyond their band, deeper inside than it, or neither for certain.
    NodeAnswer box_around(const IndexBall& ball) const {
        const Vec3d c = options_.lattice.world_from_index(Vec3d(ball.i, ball.j, ball.k));
        const double p[3] = {c.x(), c.y(), c.z()};
        const double d = kernel::box_distance(p, lo_, hi_);
        const double rounding = 1e-3 * options_.lattice.voxel_size;
        if (d - ball.radius - rounding > band_) return NodeAnswer::Out;
        return d + ball.radius + rounding < -band_ ? NodeAnswer::In : NodeAnswer::Mixed;
    }

    /// Nothing of the node can matter: it lies outside the range, or beyond the bounds. Else notes whether it lies deep inside them.
    bool is_beyond(NodeState& node, const IndexBall& ball) const {
        for (int a = 0; a < 3; ++a) {
            const auto s = static_cast<size_t>(a);
            if (node.origin[a] >= range_.max[s] || node.origin[a] + node.size <= range_.min[s]) return true;
        }
        if (node.in_box) return false;
        const NodeAnswer box = box_around(ball);
        node.in_box = box == NodeAnswer::In;
        return box == NodeAnswer::Out;
    }

    /// The child's origin, in an order that is the same everywhere.
    static NodeState child_of(const NodeState& node, int child) {
        NodeState out = node;
        out.size = node.size / 2;
        for (int a = 0; a < 3; ++a) out.origin[a] = node.origin[a] + ((child >> (2 - a)) & 1) * out.size;
        return out;
    }

    // ----------------------------------------------------------------------------- more views

    struct Before {
        const openvdb::FloatTree& hull;
        int views;  ///< that made it
        int need_seen;
        bool unseen_grows;
    };

    /// `grows`: on this node no value of the old hull can be too large, so that the new views, and the frames of all, can only raise it.
    void extend(Walk& walk, const Before& before, const NodeState& node, bool grows, Extended& out) const {
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
                const NodeAnswer unseen =
                    kernel::node_answers(views_[v], kernel::node_ball(views_[v], ball.i, ball.j, ball.k, ball.radius), near_, band_).unseen;
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

    /// A leaf of the old hull, or of its inside, that nothing but the views that cut it, or a frame, can have changed.
    void raise(Walk& walk, const openvdb::FloatTree& hull, const NodeState& node, Extended& out) const {
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

    using Block = openvdb::FloatTree::RootNodeType::ChildNodeType::ChildNodeType;  ///< 16 x 16 x 16 leaves

    static bool is_outside(const openvdb::FloatTree& hull, const NodeState& node) {
        const Coord origin(node.origin[0], node.origin[1], node.origin[2]);
        if (node.size > 8 && hull.probeConstNode<Block>(origin)) return false;  // some of it may not be
        return !hull.probeConstLeaf(origin) && hull.getValue(origin) > 0;
    }

    static void keep(const openvdb::FloatTree& hull, const NodeState& node, std::vector<const Leaf*>& kept) {
        const Coord origin(node.origin[0], node.origin[1], node.origin[2]);
        const Block* block = hull.probeConstNode<Block>(origin);
        if (!block) return;
        for (int i = 0; i < node.size; i += 8)
            for (int j = 0; j < node.size; j += 8)
                for (int k = 0; k < node.size; k += 8)
                    if (const Leaf* leaf = block->probeConstLeaf(origin.offsetBy(i, j, k))) kept.push_back(leaf);
    }

    /// Views that show most background first: what they carve need not be asked again.
    static bool before_other(const Cut& a, const Cut& b) { return a.silhouette_px != b.silhouette_px ? a.silhouette_px > b.silhouette_px : a.view < b.view; }

    // ----------------------------------------------------------------------------- the walk

    void descend(Walk& walk, const NodeState& node, size_t level, std::unique_ptr<OpenLeaf> leaf = {}) const {
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

    Vec3d world_of(const int origin[3], int i, int j, int k) const {
        return options_.lattice.world_from_index(Vec3d(origin[0] + i, origin[1] + j, origin[2] + k));
    }

    /// Which of the kept values decides a cell: the (max_misses + 1)-th largest of all views, certain misses being larger.
    int rank_of(const NodeState& node, const OpenLeaf& leaf, int cell) const { return options_.max_misses - node.certain_misses - leaf.cell_misses[cell]; }

    /// Takes in what the cutting views say of a leaf's voxels. False when all of it is outside.
    bool ask_leaf(Walk& walk, const NodeState& node, OpenLeaf& leaf) const {
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

    /// kernel::view_value of all voxels of the cells, for a view whose frame may end here.
    void view_values(const CarveView& view, const NodeState& node, unsigned cells, float* values) const {
        const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
        for_each_row([&](int at, int in_cell) {
            if (!(cells >> (in_cell >> 6) & 1)) return;
            for (int k = 0; k < 4; ++k) values[in_cell + k] = kernel::view_value(view, voxel_in_camera(to_camera, at + k), near_, band_f_);
        });
    }
    static kernel::Vec3 voxel_in_camera(const kernel::LeafToCamera& leaf, int at) {
        return kernel::voxel_in_camera(leaf, static_cast<float>(at >> 6), static_cast<float>(at >> 3 & 7), static_cast<float>(at & 7));
    }

    /// All views have spoken: frames, bounds, and into the tree's form.
    void finish_leaf(Found& found, const NodeState& node, const OpenLeaf& open) const {
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

    /// Distance of a leaf's voxel to the bounds, in the band.
    float box_value(const int origin[3], int at) const {
        const Vec3d p = world_of(origin, at >> 6, at >> 3 & 7, at & 7);
        const double xyz[3] = {p.x(), p.y(), p.z()};
        return kernel::clamp_f(static_cast<float>(kernel::box_distance(xyz, lo_, hi_)), -band_f_, band_f_);
    }

    /// What statistics say of a finished leaf. Where the value is the bounds' own, the surface is their cap.
    void count_values(Found& found, const int origin[3], bool in_box, const float* value) const {
        const float surface = 0.5f * static_cast<float>(options_.lattice.voxel_size);
        for (int at = 0; at < kLeafVoxels; ++at) {
            found.negative += value[at] < 0;
            const bool near_surface = std::fabs(value[at]) <= surface;
            found.surface += near_surface;
            found.capped += near_surface && !in_box && value[at] == box_value(origin, at);
        }
    }

    /// v = max(v, the need_seen-th smallest distance to the views' frames).
    void raise_unseen(Found& found, const NodeState& node, float* value) const {
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

    /// The binary model's misses, counted in leaf.largest (in the leaf's own order).
    bool ask_binary(Walk& walk, const NodeState& node, OpenLeaf& leaf) const {
        for (const Cut& cut : walk.cuts) {
            const CarveView& view = views_[cut.view];
            const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
            for (int at = 0; at < kLeafVoxels; ++at)
                leaf.largest[static_cast<size_t>(at)] += kernel::binary_answer(view, voxel_in_camera(to_camera, at), near_).background;
            walk.found.voxel_lookups += kLeafVoxels;
        }
        return true;
    }

    void finish_binary(Found& found, const NodeState& node, const OpenLeaf& open) const {
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

    bool in_range(const NodeState& node) const { return in_range(node.origin, 0) && in_range(node.origin, kLeafVoxels - 1, node.size - 8); }
    /// Voxel `at` of the leaf at origin + shift lies in the range.
    bool in_range(const int origin[3], int at, int shift = 0) const {
        const int ijk[3] = {at >> 6, (at >> 3) & 7, at & 7};
        for (int a = 0; a < 3; ++a) {
            const int x = origin[a] + ijk[a] + shift;
            if (x < range_.min[static_cast<size_t>(a)] || x >= range_.max[static_cast<size_t>(a)]) return false;
        }
        return true;
    }

    const CarveOptions& options_;
    std::vector<CarveInput> inputs_;
    std::vector<CarveView> views_;
    std::vector<uint16_t> batch_;  ///< the views asked now
    bool last_ = true;             ///< no views come after them
    double band_ = 0;
    float band_f_ = 0, near_ = 0, cell_radius_ = 0;
    int need_seen_ = 0;
    double lo_[3], hi_[3];
    IndexBox range_;
};

}  // namespace

void check_field(const std::string& name, const Intrinsics& k, const DistanceField& field, const CarveOptions& options) {
    if (field.silhouette.samples.size() > 0x7fffffff) throw UsageError("carve: view " + name + ": more than 2^31 pixels");
    if (field.silhouette.empty() || field.mask_width != k.width_px || field.mask_height != k.height_px)
        throw UsageError("carve: view " + name + ": the distance field has not the camera's size");
    if (options.occupancy && field.scale != 1)
        throw UsageError("carve: the binary model wants a sample a pixel, view " + name + " has a field-scale of " + std::to_string(field.scale));
}

void check_carve(const std::vector<CarveInput>& inputs, const CarveOptions& o) {
    std::string bad;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) bad += (bad.empty() ? "" : "; ") + what;
    };
    need(!inputs.empty(), "no views");
    need(inputs.size() < 65536, "more than 65535 views");
    need(std::isfinite(o.lattice.voxel_size) && o.lattice.voxel_size > 0, "voxel size is " + std::to_string(o.lattice.voxel_size) + ", must be > 0");
    need(!o.bounds_world.isEmpty() && o.bounds_world.min().allFinite() && o.bounds_world.max().allFinite(), "bounds are empty or not finite");
    need(o.max_misses >= 0 && o.max_misses <= kMaxMisses, "max-misses is " + std::to_string(o.max_misses) + ", must be 0.." + std::to_string(kMaxMisses));
    need(o.min_seen >= 0 && o.min_seen <= 1, "min-seen is " + std::to_string(o.min_seen) + ", must be 0..1");
    need(o.half_width_vox >= 2 && o.half_width_vox <= 100, "half-width is " + std::to_string(o.half_width_vox) + " voxels, must be 2..100");
    if (o.brick)
        for (size_t a = 0; a < 3; ++a) need(o.brick->min[a] % 8 == 0 && o.brick->max[a] % 8 == 0, "the limits of a brick must be multiples of 8");
    if (!bad.empty()) throw UsageError("carve: " + bad);
    if (!o.lattice.origin_world.allFinite()) throw UsageError("carve: the origin is not finite");
    const Vec3d dims = o.bounds_world.sizes() / o.lattice.voxel_size;
    if (!(dims.maxCoeff() <= 65536))
        throw UsageError("carve: " + std::to_string(std::llround(dims.maxCoeff())) + " voxels along one side, at most 65536. Remedy: larger voxels");
    const Vec3d far = o.lattice.index_from_world(o.bounds_world.min()).cwiseAbs().cwiseMax(o.lattice.index_from_world(o.bounds_world.max()).cwiseAbs());
    if (far.maxCoeff() > 1e9)
        throw UsageError("carve: the bounds are " + std::to_string(far.maxCoeff()) + " voxels from the origin, at most 1e9. Remedy: --origin near the object");
    for (const CarveInput& i : inputs) {
        const Intrinsics& k = i.camera.intrinsics;
        if (i.field) check_field(i.name, k, *i.field, o);
    }
}

void explain_empty(const std::vector<CarveInput>& inputs, const CarveOptions& options) {
    for (const CarveInput& input : inputs)
        if (!input.field)
            throw ContradictionError(
                "the hull is empty: the silhouettes contradict each other. Remedy: a lower --resolution carves all views at once and names them");
    constexpr int kSide = 48;
    const auto n = inputs.size();
    std::vector<kernel::CarveView> views;
    for (const CarveInput& i : inputs) views.push_back(make_carve_view(i, options));
    const Vec3d lo = options.lattice.index_from_world(options.bounds_world.min());
    const Vec3d hi = options.lattice.index_from_world(options.bounds_world.max());
    struct Tally {
        int fewest = INT32_MAX, most_seen = 0;
        size_t points = 0;
        std::vector<size_t> blame;
    } tally;
    tally.blame.assign(n, 0);
    std::vector<size_t> out;
    for (int p = 0; p < kSide * kSide * kSide; ++p) {
        const Vec3d f((p % kSide + 0.5) / kSide, (p / kSide % kSide + 0.5) / kSide, (p / kSide / kSide + 0.5) / kSide);
        const Vec3d x = lo + f.cwiseProduct(hi - lo);
        int seen = 0;
        out.clear();
        for (size_t v = 0; v < n; ++v) {
            const double* m = views[v].camera_from_index;
            kernel::Vec3 c;
            c.x = static_cast<float>(m[0] * x[0] + m[1] * x[1] + m[2] * x[2] + m[3]);
            c.y = static_cast<float>(m[4] * x[0] + m[5] * x[1] + m[6] * x[2] + m[7]);
            c.z = static_cast<float>(m[8] * x[0] + m[9] * x[1] + m[10] * x[2] + m[11]);
            const kernel::BinaryAnswer a = kernel::binary_answer(views[v], c, 0.f);
            seen += a.seen;
            if (a.background) out.push_back(v);
        }
        tally.most_seen = std::max(tally.most_seen, seen);
        if (seen < std::ceil(options.min_seen * static_cast<double>(n) - 1e-9)) continue;
        if (static_cast<int>(out.size()) > tally.fewest) continue;
        if (static_cast<int>(out.size()) < tally.fewest) {
            tally.fewest = static_cast<int>(out.size());
            tally.points = 0;
            tally.blame.assign(n, 0);
        }
        ++tally.points;
        for (size_t v : out) ++tally.blame[v];
    }
    if (tally.fewest == INT32_MAX)
        throw UsageError("the bounds are not where the cameras look: no point of them is in frame of more than " + std::to_string(tally.most_seen) + " of " +
                         std::to_string(n) + " views, and --min-seen " + std::to_string(options.min_seen).substr(0, 4) +
                         " wants more. Remedy: mend --bounds (or leave them out), or lower --min-seen");
    std::vector<size_t> order(n);
    for (size_t v = 0; v < n; ++v) order[v] = v;
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return tally.blame[a] > tally.blame[b]; });
    std::string names;
    for (size_t i = 0; i < n && i < 5 && tally.blame[order[i]] > 0 && tally.blame[order[i]] * 5 >= tally.blame[order[0]]; ++i)
        names += (i ? ", " : "") + inputs[order[i]].name + " (" + std::to_string(100 * tally.blame[order[i]] / tally.points) + " %)";
    if (tally.fewest <= options.max_misses)
        throw ContradictionError("the hull is thinner than the voxels and got lost. Remedy: a finer --resolution, or tighter --bounds");
    throw ContradictionError("the hull is empty: every point in the bounds is background in at least " + std::to_string(tally.fewest) + " of " +
                             std::to_string(n) + " views. Where it is fewest, these views carve (share of such points): " + names +
                             ". Remedy: look at their masks and cameras, leave them out" +
                             (tally.fewest <= kMaxMisses ? ", or allow --max-misses " + std::to_string(tally.fewest) : std::string()) +
                             "; if those masks mean 'do not use', give them as --ignore-masks");
}

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

openvdb::FloatGrid::Ptr empty_hull(const CarveOptions& options) {
    openvdb::FloatGrid::Ptr hull = openvdb::FloatGrid::create(static_cast<float>(options.half_width_vox * options.lattice.voxel_size));
    hull->setTransform(options.lattice.transform());
    hull->setName("hull");
    hull->setGridClass(openvdb::GRID_LEVEL_SET);
    return hull;
}

openvdb::MaskGrid::Ptr empty_occupancy(const CarveOptions& options) {
    openvdb::MaskGrid::Ptr occupancy = openvdb::MaskGrid::create(false);
    occupancy->setTransform(options.lattice.transform());
    occupancy->setName("occupancy");
    return occupancy;
}

void measure_tree(CarveResult& result) {
    const auto& tree = result.occupancy ? static_cast<const openvdb::TreeBase&>(result.occupancy->tree()) : result.hull->tree();
    result.statistics.leaves = tree.leafCount();
    result.statistics.active_voxels = tree.activeVoxelCount();
    result.statistics.bytes = tree.memUsage();
}

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
