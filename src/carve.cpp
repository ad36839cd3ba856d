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
    v.fx = static_cast<float>(k.fx);
    v.skew = static_cast<float>(k.skew);
    v.fy = static_cast<float>(k.fy);
    v.cx = static_cast<float>(k.cx);
    v.cy = static_cast<float>(k.cy);
    v.sigma_max = static_cast<float>(k.sigma_max() * (1 + 1e-6));  // stays an upper bound after rounding
    v.width_px = k.width_px;
    v.height_px = k.height_px;
    v.orthographic = k.orthographic;
    v.outside = options.outside;
    v.silhouette_px = input.silhouette_px.data;
    v.ignored_px = input.ignored_px.data;
    return v;
}

namespace {

using kernel::CarveView;
using kernel::NodeAnswer;
using Leaf = openvdb::FloatTree::LeafNodeType;
using MaskLeaf = openvdb::MaskTree::LeafNodeType;

constexpr int kMaxMisses = 15;  // a voxel keeps its largest k + 1 values on the stack
constexpr int kLeafVoxels = 512;

/// What the tree walk found below one root node, in the order of the walk.
struct Found {
    std::vector<std::unique_ptr<Leaf>> leaves;
    std::vector<std::unique_ptr<MaskLeaf>> mask_leaves;
    std::vector<std::pair<Coord, int>> inside;  // whole nodes (origin, size), for occupancy
    size_t node_tests = 0, voxel_lookups = 0, surface = 0, capped = 0, negative = 0;
};

struct NodeState {
    int origin[3];
    int size;
    const uint16_t* views;  ///< those that still matter
    int view_count;
    int certain_misses;     ///< views that show background all over the node
    bool seen;              ///< enough views have the whole node in frame
    bool in_box;            ///< the whole node lies deeper inside the bounds than the band
};

// The portable binary picks the widest vector unit at run time. The same operations in the same order, without
// fused multiply-add, give the same bits on each. (Sanitizers start after such choices are made.)
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define VDBCARVE_VECTOR_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define VDBCARVE_VECTOR_CLONES
#endif

/// kernel::silhouette_value at all voxels of a leaf: one loop a step, so that all but the look-ups become vectors.
VDBCARVE_VECTOR_CLONES
void leaf_silhouette_values(const CarveView& view, const kernel::LeafToCamera& leaf, float band, float* __restrict values) {
    float x[kLeafVoxels], y[kLeafVoxels], z[kLeafVoxels], u[kLeafVoxels], v[kLeafVoxels];
    float s00[kLeafVoxels], s10[kLeafVoxels], s01[kLeafVoxels], s11[kLeafVoxels];
    const CarveView c = view;  // a copy: nothing the loops write can change it
    for (int at = 0; at < kLeafVoxels; ++at) {
        const kernel::Vec3 p = kernel::voxel_in_camera(leaf, at >> 6, (at >> 3) & 7, at & 7);
        x[at] = p.x;
        y[at] = p.y;
        z[at] = p.z;
    }
    for (int at = 0; at < kLeafVoxels; ++at) {
        const kernel::Projected p = kernel::project(c, {x[at], y[at], z[at]});
        x[at] = p.mx;
        y[at] = p.my;
        u[at] = p.u;
        v[at] = p.v;
    }
    for (int at = 0; at < kLeafVoxels; ++at) {
        const kernel::Patch p = kernel::fetch_patch(c.silhouette_px, c.width_px, c.height_px, u[at], v[at]);
        s00[at] = p.s00;
        s10[at] = p.s10;
        s01[at] = p.s01;
        s11[at] = p.s11;
        u[at] = p.a;
        v[at] = p.b;
    }
    for (int at = 0; at < kLeafVoxels; ++at) {
        const kernel::Patch patch{s00[at], s10[at], s01[at], s11[at], u[at], v[at]};
        values[at] = kernel::patch_value(c, patch, {x[at], y[at], 0.f, 0.f}, z[at], band);
    }
}

class Carver {
  public:
    Carver(const std::vector<CarveInput>& inputs, const CarveOptions& options) : options_(options) {
        for (const CarveInput& input : inputs) views_.push_back(make_carve_view(input, options));
        const double h = options.lattice.voxel_size;
        band_ = options.occupancy ? 0.0 : options.half_width_vox * h;
        band_f_ = static_cast<float>(band_);
        near_ = kernel::kNearPlane_vox * static_cast<float>(h);
        need_seen_ = static_cast<int>(std::ceil(options.min_seen * static_cast<double>(views_.size()) - 1e-9));
        for (int a = 0; a < 3; ++a) {
            lo_[a] = options.bounds_world.min()[a];
            hi_[a] = options.bounds_world.max()[a];
        }
        range_ = voxels_in_bounds(options.lattice, options.bounds_world, options.occupancy ? 0 : options.half_width_vox + 1);
        if (options.brick)
            for (size_t a = 0; a < 3; ++a) {
                range_.min[a] = std::max(range_.min[a], options.brick->min[a]);
                range_.max[a] = std::min(range_.max[a], options.brick->max[a]);
            }
    }

    const IndexBox& range() const { return range_; }
    float band() const { return band_f_; }

    void carve_root(const int origin[3], int size, Found& found) const {
        std::vector<uint16_t> all(views_.size());
        for (size_t i = 0; i < all.size(); ++i) all[i] = static_cast<uint16_t>(i);
        std::vector<std::vector<uint16_t>> lists(8);
        Walk walk{found, lists, {}};
        descend(walk, {{origin[0], origin[1], origin[2]}, size, all.data(), static_cast<int>(all.size()), 0, need_seen_ <= 0, false}, 0);
    }

  private:
    struct Walk {
        Found& found;
        std::vector<std::vector<uint16_t>>& lists;  ///< active views, one list a level
        std::vector<char> clear_of_frame;           ///< of the views in the last list made (NodeAnswers)
    };

    void descend(Walk& walk, const NodeState& node, size_t level) const {
        for (int a = 0; a < 3; ++a) {
            const auto s = static_cast<size_t>(a);
            if (node.origin[a] >= range_.max[s] || node.origin[a] + node.size <= range_.min[s]) return;
        }
        const double half = 0.5 * (node.size - 1), h = options_.lattice.voxel_size;
        const double ci = node.origin[0] + half, cj = node.origin[1] + half, ck = node.origin[2] + half;
        const double radius = std::sqrt(3.0) * half * h;

        NodeState state = node;
        if (!state.in_box) {
            const Vec3d c = options_.lattice.world_from_index(Vec3d(ci, cj, ck));
            const double p[3] = {c.x(), c.y(), c.z()};
            const double d = kernel::box_distance(p, lo_, hi_);
            const double rounding = 1e-3 * h;
            if (d - radius - rounding > band_) return;
            state.in_box = d + radius + rounding < -band_;
        }

        if (walk.lists.size() <= level) walk.lists.resize(level + 1);
        std::vector<uint16_t>& list = walk.lists[level];
        list.clear();
        walk.clear_of_frame.clear();
        walk.found.node_tests += static_cast<size_t>(node.view_count);
        for (int i = 0; i < node.view_count; ++i) {
            const CarveView& view = views_[node.views[i]];
            const kernel::NodeAnswers answers = kernel::node_answers(view, kernel::node_ball(view, ci, cj, ck, radius), near_, band_);
            if (answers.hull == NodeAnswer::Out) {
                if (++state.certain_misses > options_.max_misses) return;
            } else if (answers.hull == NodeAnswer::Mixed) {
                list.push_back(node.views[i]);
                walk.clear_of_frame.push_back(answers.clear_of_frame);
            }
        }
        if (!state.seen) {
            int seen_whole = 0, seen_maybe = 0;
            walk.found.node_tests += views_.size();
            for (const CarveView& view : views_) {
                const NodeAnswer unseen = kernel::node_answers(view, kernel::node_ball(view, ci, cj, ck, radius), near_, band_).unseen;
                seen_whole += unseen == NodeAnswer::In;
                seen_maybe += unseen != NodeAnswer::Out;
            }
            if (seen_maybe < need_seen_) return;
            state.seen = seen_whole >= need_seen_;
        }
        state.views = list.data();
        state.view_count = static_cast<int>(list.size());

        // No view can still bring the node past the allowed misses, nor can the frame or the box.
        if (state.seen && state.in_box && state.certain_misses + state.view_count <= options_.max_misses) state.view_count = 0;
        if (state.seen && state.in_box && state.view_count == 0) {
            // A node that reaches past the brick is cut up further; leaves are clipped voxel by voxel.
            const bool whole = !options_.occupancy || in_range(node);
            if (whole) {
                if (options_.occupancy) walk.found.inside.emplace_back(Coord(node.origin[0], node.origin[1], node.origin[2]), node.size);
                return;
            }
        }
        if (node.size == 8) {
            if (options_.occupancy)
                ask_leaf_binary(walk.found, state);
            else
                ask_leaf(walk.found, state, walk.clear_of_frame);
            return;
        }
        const int half_size = node.size / 2;
        for (int child = 0; child < 8; ++child) {
            NodeState next = state;
            next.size = half_size;
            for (int a = 0; a < 3; ++a) next.origin[a] = node.origin[a] + ((child >> (2 - a)) & 1) * half_size;
            // The list of this level may move when a deeper level grows the outer vector, so it is looked up anew.
            next.views = walk.lists[level].data();
            descend(walk, next, level + 1);
        }
    }

    Vec3d world_of(const int origin[3], int i, int j, int k) const {
        return options_.lattice.world_from_index(Vec3d(origin[0] + i, origin[1] + j, origin[2] + k));
    }

    void ask_leaf(Found& found, const NodeState& node, const std::vector<char>& clear_of_frame) const {
        // The rank-th largest value among the views that still matter; certain misses are larger than all.
        const int rank = options_.max_misses - node.certain_misses + 1;
        float largest[kMaxMisses + 1][kLeafVoxels];
        for (int r = 0; r < rank; ++r) std::fill_n(largest[r], kLeafVoxels, -band_f_);
        float values[kLeafVoxels];
        for (int n = 0; n < node.view_count; ++n) {
            view_values(views_[node.views[n]], node, clear_of_frame[static_cast<size_t>(n)] != 0, values);
            found.voxel_lookups += kLeafVoxels;
            float smallest = band_f_;
            if (rank == 1) {
                for (int at = 0; at < kLeafVoxels; ++at) {
                    largest[0][at] = kernel::max_f(largest[0][at], values[at]);
                    smallest = kernel::min_f(smallest, largest[0][at]);
                }
            } else {
                for (int at = 0; at < kLeafVoxels; ++at) {
                    float v = values[at];
                    for (int r = 0; r < rank && v > -band_f_; ++r)
                        if (v > largest[r][at]) std::swap(v, largest[r][at]);
                    smallest = kernel::min_f(smallest, largest[rank - 1][at]);
                }
            }
            if (smallest >= band_f_) return;  // outside everywhere already
        }
        float* value = largest[rank - 1];
        if (!node.seen) raise_unseen(found, node, value);

        auto leaf = std::make_unique<Leaf>(Coord(node.origin[0], node.origin[1], node.origin[2]), band_f_, false);
        float* data = leaf->buffer().data();
        const float surface = 0.5f * static_cast<float>(options_.lattice.voxel_size);
        bool any = false;
        for (int i = 0; i < 8; ++i)
            for (int j = 0; j < 8; ++j)
                for (int k = 0; k < 8; ++k) {
                    const int at = i << 6 | j << 3 | k;
                    float v = value[at];
                    bool cap = false;
                    if (!node.in_box) {
                        const Vec3d p = world_of(node.origin, i, j, k);
                        const double xyz[3] = {p.x(), p.y(), p.z()};
                        const float box = kernel::clamp_f(static_cast<float>(kernel::box_distance(xyz, lo_, hi_)), -band_f_, band_f_);
                        cap = box > v;
                        v = kernel::max_f(v, box);
                    }
                    data[at] = v;
                    found.negative += v < 0;
                    if (v > -band_f_ && v < band_f_) {
                        leaf->setValueOn(static_cast<openvdb::Index>(at));
                        any = true;
                        if (std::fabs(v) <= surface) {
                            ++found.surface;
                            found.capped += cap;
                        }
                    }
                }
        if (any) found.leaves.push_back(std::move(leaf));
    }

    /// kernel::view_value of all voxels of a leaf.
    void view_values(const CarveView& view, const NodeState& node, bool clear_of_frame, float* values) const {
        const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
        if (clear_of_frame) {
            leaf_silhouette_values(view, to_camera, band_f_, values);
            return;
        }
        for (int at = 0; at < kLeafVoxels; ++at)
            values[at] = kernel::view_value(view, kernel::voxel_in_camera(to_camera, at >> 6, (at >> 3) & 7, at & 7), near_, band_f_);
    }

    /// v = max(v, the need_seen-th smallest distance to the views' frames).
    void raise_unseen(Found& found, const NodeState& node, float* value) const {
        std::vector<float> all(views_.size() * kLeafVoxels), one(views_.size());
        for (size_t n = 0; n < views_.size(); ++n) {
            const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(views_[n], node.origin[0], node.origin[1], node.origin[2]);
            for (int i = 0; i < 8; ++i)
                for (int j = 0; j < 8; ++j)
                    for (int k = 0; k < 8; ++k)
                        all[n * kLeafVoxels + static_cast<size_t>(i << 6 | j << 3 | k)] =
                            kernel::unseen_value(views_[n], kernel::voxel_in_camera(to_camera, i, j, k), near_, band_f_);
        }
        found.voxel_lookups += views_.size() * kLeafVoxels;
        const auto nth = one.begin() + (need_seen_ - 1);
        for (size_t at = 0; at < kLeafVoxels; ++at) {
            for (size_t n = 0; n < views_.size(); ++n) one[n] = all[n * kLeafVoxels + at];
            std::nth_element(one.begin(), nth, one.end());
            value[at] = kernel::max_f(value[at], *nth);
        }
    }

    void ask_leaf_binary(Found& found, const NodeState& node) const {
        int misses[kLeafVoxels], seen[kLeafVoxels];
        std::fill_n(misses, kLeafVoxels, node.certain_misses);
        std::fill_n(seen, kLeafVoxels, 0);
        const auto ask = [&](const CarveView& view, bool count_misses, bool count_seen) {
            const kernel::LeafToCamera to_camera = kernel::leaf_to_camera(view, node.origin[0], node.origin[1], node.origin[2]);
            for (int i = 0; i < 8; ++i)
                for (int j = 0; j < 8; ++j)
                    for (int k = 0; k < 8; ++k) {
                        const kernel::BinaryAnswer a = kernel::binary_answer(view, kernel::voxel_in_camera(to_camera, i, j, k), near_);
                        misses[i << 6 | j << 3 | k] += count_misses && a.background;
                        seen[i << 6 | j << 3 | k] += count_seen && a.seen;
                    }
            found.voxel_lookups += kLeafVoxels;
        };
        for (int n = 0; n < node.view_count; ++n) ask(views_[node.views[n]], true, false);
        if (!node.seen)
            for (const CarveView& view : views_) ask(view, false, true);
        auto leaf = std::make_unique<MaskLeaf>(Coord(node.origin[0], node.origin[1], node.origin[2]), false, false);
        bool any = false;
        for (int at = 0; at < kLeafVoxels; ++at) {
            if (misses[at] > options_.max_misses || (!node.seen && seen[at] < need_seen_)) continue;
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
    std::vector<CarveView> views_;
    double band_ = 0;
    float band_f_ = 0, near_ = 0;
    int need_seen_ = 0;
    double lo_[3], hi_[3];
    IndexBox range_;
};

void check_options(const std::vector<CarveInput>& inputs, const CarveOptions& o) {
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
        for (size_t a = 0; a < 3; ++a)
            need(o.brick->min[a] % 8 == 0 && o.brick->max[a] % 8 == 0, "the limits of a brick must be multiples of 8");
    if (!bad.empty()) throw UsageError("carve: " + bad);
    if (!o.lattice.origin_world.allFinite()) throw UsageError("carve: the origin is not finite");
    const Vec3d dims = o.bounds_world.sizes() / o.lattice.voxel_size;
    if (!(dims.maxCoeff() <= 65536))
        throw UsageError("carve: " + std::to_string(std::llround(dims.maxCoeff())) + " voxels along one side, at most 65536. Remedy: larger voxels");
    const Vec3d far = o.lattice.index_from_world(o.bounds_world.min()).cwiseAbs().cwiseMax(o.lattice.index_from_world(o.bounds_world.max()).cwiseAbs());
    if (far.maxCoeff() > 1e9) throw UsageError("carve: the bounds are " + std::to_string(far.maxCoeff()) + " voxels from the origin, at most 1e9. Remedy: --origin near the object");
    for (const CarveInput& i : inputs) {
        const Intrinsics& k = i.camera.intrinsics;
        if (i.silhouette_px.pixels() > 0x7fffffff) throw UsageError("carve: view " + i.name + ": more than 2^31 pixels");
        if (i.silhouette_px.width != k.width_px || i.silhouette_px.height != k.height_px)
            throw UsageError("carve: view " + i.name + ": the distance field has not the camera's size");
    }
}

/// Says why nothing is left, by asking every view about a raster of points.
[[noreturn]] void explain_empty(const std::vector<CarveInput>& inputs, const CarveOptions& options) {
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
                             (tally.fewest <= kMaxMisses ? ", or allow --max-misses " + std::to_string(tally.fewest) : std::string()) + "; if those masks mean 'do not use', give them as --ignore-masks");
}

}  // namespace

CarveResult carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress) {
    check_options(inputs, options);
    const Carver carver(inputs, options);
    const IndexBox& range = carver.range();

    // Root nodes large enough to skip empty space, small enough to share out: the result does not depend on it.
    const auto roots_of = [&](int size) {
        std::vector<std::array<int, 3>> out;
        const auto down = [size](int x) { return (x >= 0 ? x / size : -((size - 1 - x) / size)) * size; };
        for (int i = down(range.min[0]); i < range.max[0]; i += size)
            for (int j = down(range.min[1]); j < range.max[1]; j += size)
                for (int k = down(range.min[2]); k < range.max[2]; k += size) out.push_back({i, j, k});
        return out;
    };
    int root_size = 128;
    std::vector<std::array<int, 3>> roots = roots_of(root_size);
    while (roots.size() < 256 && root_size > 16) roots = roots_of(root_size /= 2);

    std::vector<Found> found(roots.size());
    progress.begin("carve", roots.size());
    tbb::parallel_for(size_t{0}, roots.size(), [&](size_t r) {
        carver.carve_root(roots[r].data(), root_size, found[r]);
        progress.step();
    });

    CarveResult result;
    size_t surface = 0, capped = 0, negative = 0;
    for (Found& f : found) {
        result.statistics.node_tests += f.node_tests;
        result.statistics.voxel_lookups += f.voxel_lookups;
        result.statistics.leaves += f.leaves.size() + f.mask_leaves.size();
        surface += f.surface;
        capped += f.capped;
        negative += f.negative;
    }
    result.statistics.clipped_share = surface ? static_cast<double>(capped) / static_cast<double>(surface) : 0;

    if (options.occupancy) {
        result.occupancy = openvdb::MaskGrid::create(false);
        result.occupancy->setTransform(options.lattice.transform());
        result.occupancy->setName("occupancy");
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
        result.statistics.active_voxels = tree.activeVoxelCount();
        result.statistics.bytes = tree.memUsage();
        return result;
    }

    // Leaves without a negative voxel hold the outer band of a surface that no voxel is inside of.
    if (negative == 0 && !options.brick && !options.allow_empty) explain_empty(inputs, options);
    result.hull = openvdb::FloatGrid::create(carver.band());
    result.hull->setTransform(options.lattice.transform());
    result.hull->setName("hull");
    result.hull->setGridClass(openvdb::GRID_LEVEL_SET);
    openvdb::FloatTree& tree = result.hull->tree();
    for (Found& f : found)
        for (auto& leaf : f.leaves) tree.addLeaf(leaf.release());
    openvdb::tools::signedFloodFill(tree);
    result.statistics.active_voxels = tree.activeVoxelCount();
    result.statistics.bytes = tree.memUsage();
    return result;
}

openvdb::FloatGrid::Ptr merge_bricks(const std::vector<openvdb::FloatGrid::Ptr>& bricks) {
    if (bricks.empty()) throw UsageError("merge_bricks: no bricks");
    const openvdb::FloatGrid& first = *bricks.front();
    openvdb::FloatGrid::Ptr out = openvdb::FloatGrid::create(first.background());
    out->setTransform(first.transform().copy());
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
