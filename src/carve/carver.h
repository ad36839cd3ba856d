// SPDX-License-Identifier: Apache-2.0
// The walk through the tree of voxels, from the coarse to the fine. Private.
#pragma once

#include <openvdb/openvdb.h>

#include <memory>
#include <utility>
#include <vector>

#include "base/vector_loops.h"
#include "carve/carve_plan.h"

namespace vdbcarve::carving {

using kernel::CarveView;
using kernel::NodeAnswer;
using openvdb::Coord;
using Leaf = openvdb::FloatTree::LeafNodeType;
using MaskLeaf = openvdb::MaskTree::LeafNodeType;

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

/// Asks views about nodes. Keeps no state between calls but which views are asked: several threads may ask at once.
class Carver {
  public:
    Carver(const std::vector<CarveInput>& inputs, const CarveOptions& options);

    /// The views whose fields are there. The others keep their ignored regions, which count at the end.
    void set_batch(size_t first, size_t last);
    void set_field(size_t view, const DistanceField* field);
    /// The silhouette of a view is gone; what it ignores stays, read from `kept`.
    void drop_silhouette(size_t view, const SampledField& kept);

    const IndexBox& range() const { return range_; }

    /// Walks a node of a hull that the views i < known made: see extend_hull.
    void extend(const openvdb::FloatTree& hull, size_t known, const OpenNode& node, Extended& out) const;

    /// Surface, caps and inside of a leaf that is kept.
    void count(const Leaf& leaf, Found& found) const;

    /// Asks the batch's views about a node, from the coarse to the fine.
    void ask(OpenNode node, Found& found) const;

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
    NodeAnswer box_around(const IndexBall& ball) const;

    /// Nothing of the node can matter: it lies outside the range, or beyond the bounds. Else notes whether it lies deep inside them.
    bool is_beyond(NodeState& node, const IndexBall& ball) const;

    /// The child's origin, in an order that is the same everywhere.
    static NodeState child_of(const NodeState& node, int child) {
        NodeState out = node;
        out.size = node.size / 2;
        for (int a = 0; a < 3; ++a) out.origin[a] = node.origin[a] + ((child >> (2 - a)) & 1) * out.size;
        return out;
    }

    // More views: carver_extend.cpp

    struct Before {
        const openvdb::FloatTree& hull;
        int views;  ///< that made it
        int need_seen;
        bool unseen_grows;
    };

    /// `grows`: on this node no value of the old hull can be too large, so that the new views, and the frames of all, can only raise it.
    void extend(Walk& walk, const Before& before, const NodeState& node, bool grows, Extended& out) const;

    /// A leaf of the old hull, or of its inside, that nothing but the views that cut it, or a frame, can have changed.
    void raise(Walk& walk, const openvdb::FloatTree& hull, const NodeState& node, Extended& out) const;

    using Block = openvdb::FloatTree::RootNodeType::ChildNodeType::ChildNodeType;  ///< 16 x 16 x 16 leaves

    static bool is_outside(const openvdb::FloatTree& hull, const NodeState& node);

    static void keep(const openvdb::FloatTree& hull, const NodeState& node, std::vector<const Leaf*>& kept);

    /// Views that show most background first: what they carve need not be asked again.
    static bool before_other(const Cut& a, const Cut& b) { return a.silhouette_px != b.silhouette_px ? a.silhouette_px > b.silhouette_px : a.view < b.view; }

    // The walk: carver.cpp

    void descend(Walk& walk, const NodeState& node, size_t level, std::unique_ptr<OpenLeaf> leaf = {}) const;

    Vec3d world_of(const int origin[3], int i, int j, int k) const {
        return options_.lattice.world_from_index(Vec3d(origin[0] + i, origin[1] + j, origin[2] + k));
    }

    /// Which of the kept values decides a cell: the (max_misses + 1)-th largest of all views, certain misses being larger.
    int rank_of(const NodeState& node, const OpenLeaf& leaf, int cell) const { return options_.max_misses - node.certain_misses - leaf.cell_misses[cell]; }

    /// Takes in what the cutting views say of a leaf's voxels. False when all of it is outside.
    bool ask_leaf(Walk& walk, const NodeState& node, OpenLeaf& leaf) const;

    /// kernel::view_value of all voxels of the cells, for a view whose frame may end here.
    void view_values(const CarveView& view, const NodeState& node, unsigned cells, float* values) const;
    static kernel::Vec3 voxel_in_camera(const kernel::LeafToCamera& leaf, int at) {
        return kernel::voxel_in_camera(leaf, static_cast<float>(at >> 6), static_cast<float>(at >> 3 & 7), static_cast<float>(at & 7));
    }

    /// All views have spoken: frames, bounds, and into the tree's form.
    void finish_leaf(Found& found, const NodeState& node, const OpenLeaf& open) const;

    /// Distance of a leaf's voxel to the bounds, in the band.
    float box_value(const int origin[3], int at) const {
        const Vec3d p = world_of(origin, at >> 6, at >> 3 & 7, at & 7);
        const double xyz[3] = {p.x(), p.y(), p.z()};
        return kernel::clamp_f(static_cast<float>(kernel::box_distance(xyz, lo_, hi_)), -band_f_, band_f_);
    }

    /// What statistics say of a finished leaf. Where the value is the bounds' own, the surface is their cap.
    void count_values(Found& found, const int origin[3], bool in_box, const float* value) const;

    /// v = max(v, the need_seen-th smallest distance to the views' frames).
    void raise_unseen(Found& found, const NodeState& node, float* value) const;

    /// The binary model's misses, counted in leaf.largest (in the leaf's own order).
    bool ask_binary(Walk& walk, const NodeState& node, OpenLeaf& leaf) const;

    void finish_binary(Found& found, const NodeState& node, const OpenLeaf& open) const;

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

}  // namespace vdbcarve::carving
