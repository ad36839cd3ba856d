// SPDX-License-Identifier: Apache-2.0
// A level of the pyramid on which the fair surface is found: leaves of the hull and of the field, in one numbering.
#pragma once

#include <openvdb/openvdb.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <array>
#include <cstdint>
#include <vector>

#include "fair/sight_plan.h"
#include "vdbcarve/kernel/fair.h"

namespace vdbcarve::fairing {

inline constexpr size_t kLeafVoxels = 512;

/// Values of leaves, and the least that a point of each leaf's cells can have.
struct Values {
    std::vector<float> of, least;
};

struct Level : LeafLattice {
    std::vector<int32_t> leaf_at;        ///< kernel::FairField
    std::vector<openvdb::Coord> origin;  ///< of each leaf, voxels
    Values hull, field;
    std::vector<float> scratch, more_scratch;  ///< as many as field has, for move()

    size_t leaves() const { return origin.size(); }
    kernel::FairField view(const Values& values) const {
        return {leaf_at.data(), {lo[0], lo[1], lo[2]}, {size[0], size[1], size[2]}, values.of.data(), values.least.data()};
    }
    /// Visits the lattice's places: visit(place, x, y, z), leaf coordinates.
    template <class Visit>
    void each_place(const Visit& visit) const {
        size_t p = 0;
        for (int x = lo[0]; x < lo[0] + size[0]; ++x)
            for (int y = lo[1]; y < lo[1] + size[1]; ++y)
                for (int z = lo[2]; z < lo[2] + size[2]; ++z, ++p) visit(p, x, y, z);
    }
    template <class Work>
    void for_leaves(const Work& work) const {
        for_each_of(leaves(), work);
    }
    template <class Work>
    void for_voxels(const Work& work) const {
        for_leaves([&](size_t n) {
            for (size_t at = n * kLeafVoxels; at < (n + 1) * kLeafVoxels; ++at) work(at);
        });
    }
    /// work(n) for n below `count`, by all threads.
    template <class Work>
    static void for_each_of(size_t count, const Work& work) {
        tbb::parallel_for(tbb::blocked_range<size_t>(0, count, 8), [&](const tbb::blocked_range<size_t>& range) {
            for (size_t n = range.begin(); n < range.end(); ++n) work(n);
        });
    }
    /// Voxels that lie inside, in leaves a part of one.
    double volume_vox(const Values& values) const;
};

/// The hull's leaves, distances in voxels.
Level level_of(const openvdb::FloatGrid& hull);
/// The hull on voxels twice as wide: means of 2^3, re-distanced. `whole`: with leaves all over the inside.
Level coarser(const Level& fine, bool whole);
/// `fine` has a hull alone, `coarse` hull and field. The result has the leaves that either surface needs, the coarse field carried over, and what the finer
/// hull shows beyond the coarser one.
Level carried_over(const Level& fine, const Level& coarse);

/// `hull` has a hull alone. The result has the leaves that it or the surface needs, and the field is the surface, within the hull.
Level with_field(const Level& hull, const openvdb::FloatGrid& surface);

/// FairEngine::move().
void move(Level& level, const kernel::FairBlur& blur, bool stiff);
/// Updates Values::least of every leaf.
void find_least(const Level& level, Values& values);
/// The same where the values of those leaves changed.
void update_least(const Level& level, Values& values, const std::vector<size_t>& changed);
/// Signs stay, distances become true again (kernel/level_set.h).
void make_distances(const Level& level, std::vector<float>& values);
/// FairEngine::drop_pieces().
size_t drop_pieces(Level& level, double share);

/// A level set on the hull's lattice, in world units, that is outside everywhere.
openvdb::FloatGrid::Ptr empty_surface(const openvdb::FloatGrid& hull);
/// The field as such a one.
openvdb::FloatGrid::Ptr grid_of(const Level& level, const openvdb::FloatGrid& hull);

}  // namespace vdbcarve::fairing
