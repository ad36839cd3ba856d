// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/slack.h"

#include <openvdb/tools/Interpolation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "fair/fair_level.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/kernel/level_set.h"
#include "volume/same_transform.h"

namespace vdbcarve {

using namespace fairing;
using openvdb::Coord;

namespace {

/// The hull's distances, in voxels of the finest level: within each level's band the level's, deeper in those of a coarse dense block.
class HullDistance {
  public:
    explicit HullDistance(const openvdb::FloatGrid& hull) {
        levels_.push_back(level_of(hull));
        constexpr int kFewLeaves = 12;
        for (int n = *std::max_element(levels_[0].size.begin(), levels_[0].size.end()); n > kFewLeaves; n /= 2)
            levels_.push_back(coarser(levels_.back(), false));
        sweep();
    }
    /// How deep a point lies. 0 outside.
    float depth(float x, float y, float z) const {
        constexpr float kWithinBand_vox = kernel::kFairBand_vox - 0.5f;
        float side = 1.f;
        for (const Level& level : levels_) {
            const kernel::FairField f = level.view(level.hull);
            const kernel::FairCell c = cell(x, y, z, side);
            const float value = kernel::value_in(f, f.leaf(c.i, c.j, c.k), c);
            if (value > -kWithinBand_vox) return kernel::max_f(-value * side, 0.f);
            side *= 2.f;
        }
        side *= 0.5f;
        const kernel::FairCell c = cell(x, y, z, side);
        float v[8];
        for (int n = 0; n < 8; ++n) v[n] = deep_at(c.i + (n >> 2), c.j + (n >> 1 & 1), c.k + (n & 1));
        return side * kernel::trilinear(v, c);
    }

  private:
    static kernel::FairCell cell(float x, float y, float z, float side) {
        const float shift = 0.5f * (side - 1.f);
        return kernel::fair_cell((x - shift) / side, (y - shift) / side, (z - shift) / side);
    }
    /// Of a voxel of the coarsest level.
    float deep_at(int i, int j, int k) const {
        const Level& level = levels_.back();
        const int x = i - 8 * level.lo[0], y = j - 8 * level.lo[1], z = k - 8 * level.lo[2];
        if (x < 0 || y < 0 || z < 0 || x >= 8 * level.size[0] || y >= 8 * level.size[1] || z >= 8 * level.size[2]) return 0.f;
        return deep_[deep_place(x, y, z)];
    }
    /// Where voxel (x, y, z) from the coarsest level's first one lies.
    size_t deep_place(int x, int y, int z) const {
        const std::array<int, 3>& leaves = levels_.back().size;
        return (static_cast<size_t>(x) * 8 * static_cast<size_t>(leaves[1]) + static_cast<size_t>(y)) * 8 * static_cast<size_t>(leaves[2]) +
               static_cast<size_t>(z);
    }
    /// Fast sweeping (Zhao, Math. Comp. 2005) from the band inwards: all eight orders, twice.
    void sweep() {
        const Level& level = levels_.back();
        const kernel::FairField f = level.view(level.hull);
        const int n[3] = {8 * level.size[0], 8 * level.size[1], 8 * level.size[2]};
        const auto at = [this](int x, int y, int z) { return deep_place(x, y, z); };
        constexpr float kFar = 1e6f, kKnown_vox = kernel::kFairBand_vox - 1.f;
        deep_.resize(at(n[0] - 1, n[1] - 1, n[2] - 1) + 1);
        for (int x = 0; x < n[0]; ++x)
            for (int y = 0; y < n[1]; ++y)
                for (int z = 0; z < n[2]; ++z) {
                    const float v = f.at(x + 8 * level.lo[0], y + 8 * level.lo[1], z + 8 * level.lo[2]);
                    deep_[at(x, y, z)] = v < -kKnown_vox ? kFar : kernel::max_f(-v, 0.f);
                }
        for (int order = 0; order < 16; ++order) {
            const auto place = [&](int axis, int step) { return order >> axis & 1 ? n[axis] - 2 - step : 1 + step; };
            for (int a = 0; a < n[0] - 2; ++a)
                for (int b = 0; b < n[1] - 2; ++b)
                    for (int c = 0; c < n[2] - 2; ++c) {
                        const int x = place(0, a), y = place(1, b), z = place(2, c);
                        float& here = deep_[at(x, y, z)];
                        if (here <= kKnown_vox) continue;
                        const auto least = [&](size_t p, size_t q) { return kernel::min_f(deep_[p], deep_[q]); };
                        here = kernel::min_f(here, kernel::eikonal(least(at(x - 1, y, z), at(x + 1, y, z)), least(at(x, y - 1, z), at(x, y + 1, z)),
                                                                   least(at(x, y, z - 1), at(x, y, z + 1))));
                    }
        }
    }

    std::vector<Level> levels_;
    std::vector<float> deep_;  ///< of the coarsest level's voxels, x leads
};

}  // namespace

openvdb::FloatGrid::Ptr slack(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface) {
    const HullDistance hull_distance(hull);
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    auto out = openvdb::FloatGrid::create(0.f);
    out->setTree(std::make_shared<openvdb::FloatTree>(surface.tree(), 0.f, openvdb::TopologyCopy()));
    out->setTransform(same_transform(surface.transform()));
    out->setName("slack");
    std::vector<openvdb::FloatTree::LeafNodeType*> leaves;
    out->tree().getNodes(leaves);
    tbb::parallel_for(tbb::blocked_range<size_t>(0, leaves.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
        openvdb::FloatGrid::ConstAccessor at(surface.tree());
        for (size_t n = range.begin(); n < range.end(); ++n)
            for (auto v = leaves[n]->beginValueOn(); v; ++v) {
                const Coord c = v.getCoord();
                const float here = at.getValue(c) / voxel;
                float slope[3];
                for (int a = 0; a < 3; ++a) {
                    Coord before = c, after = c;
                    --before[a];
                    ++after[a];
                    slope[a] = 0.5f * (at.getValue(after) - at.getValue(before)) / voxel;
                }
                const float length2 = kernel::max_f((slope[0] * slope[0] + slope[1] * slope[1]) + slope[2] * slope[2], 0.25f);
                float p[3];
                for (int a = 0; a < 3; ++a) p[a] = static_cast<float>(c[a]) - here * slope[a] / length2;
                v.setValue(voxel * hull_distance.depth(p[0], p[1], p[2]));
            }
    });
    return out;
}

void set_slack(Mesh& mesh, const openvdb::FloatGrid& slack) {
    mesh.slack.resize(mesh.vertices.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, mesh.vertices.size(), 4096), [&](const tbb::blocked_range<size_t>& range) {
        const openvdb::FloatGrid::ConstAccessor tree(slack.tree());
        const openvdb::tools::GridSampler<openvdb::FloatGrid::ConstAccessor, openvdb::tools::BoxSampler> at(tree, slack.transform());
        for (size_t v = range.begin(); v < range.end(); ++v)
            mesh.slack[v] = at.wsSample(openvdb::Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]));
    });
}

SlackShares slack_shares(const Mesh& mesh) {
    const auto point = [&](uint32_t v) { return Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
    std::vector<double> area(mesh.vertices.size());
    double all = 0, known = 0, sum = 0;
    for (const auto& t : mesh.triangles) {
        const Vec3d a = point(t[0]);
        const double third = (point(t[1]) - a).cross(point(t[2]) - a).norm() / 6;
        for (const uint32_t v : t) area[v] += third;
        all += 3 * third;
    }
    std::vector<uint32_t> order;
    for (uint32_t v = 0; v < area.size(); ++v)
        if (mesh.extrapolated.empty() || !mesh.extrapolated[v]) {
            order.push_back(v);
            known += area[v];
            sum += area[v] * static_cast<double>(mesh.slack[v]);
        }
    std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return mesh.slack[a] != mesh.slack[b] ? mesh.slack[a] < mesh.slack[b] : a < b; });
    SlackShares out;
    if (!(all > 0)) return out;
    out.known_share = known / all;
    out.mean = known > 0 ? sum / known : 0;
    out.most_share = std::min(0.9, out.known_share);
    out.half = out.most = std::numeric_limits<double>::infinity();
    double so_far = 0;
    for (const uint32_t v : order) {
        so_far += area[v];
        const double here = static_cast<double>(mesh.slack[v]);
        if (so_far >= 0.5 * all) out.half = std::min(out.half, here);
        if (so_far >= out.most_share * all * (1 - 1e-9)) out.most = std::min(out.most, here);
    }
    return out;
}

}  // namespace vdbcarve
