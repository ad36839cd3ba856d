// SPDX-License-Identifier: Apache-2.0
#include "fair/fair_level.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>

#include "base/vector_loops.h"
#include "vdbcarve/error.h"
#include "vdbcarve/kernel/level_set.h"
#include "volume/same_transform.h"

namespace vdbcarve::fairing {

using kernel::FairField;
using kernel::kFairBand_vox;
using kernel::kInsideTile;
using kernel::kOutsideTile;
using openvdb::Coord;

namespace {

constexpr float kBand = kFairBand_vox;

/// Says of outside tiles how far nothing else is.
void find_free_places(Level& level) {
    constexpr int kMost = 64;
    const int sx = level.size[0], sy = level.size[1], sz = level.size[2];
    const auto pass = [&](int step) {
        const auto first = [step](int size) { return step > 0 ? 0 : size - 1; };
        for (int x = first(sx); x >= 0 && x < sx; x += step)
            for (int y = first(sy); y >= 0 && y < sy; y += step)
                for (int z = first(sz); z >= 0 && z < sz; z += step) {
                    int32_t& here = level.leaf_at[(static_cast<size_t>(x) * static_cast<size_t>(sy) + static_cast<size_t>(y)) * static_cast<size_t>(sz) +
                                                  static_cast<size_t>(z)];
                    if (!kernel::is_outside(here)) continue;
                    int free = step > 0 ? kMost : kernel::free_places(here);
                    for (int n = 0; n < 13; ++n) {  // the neighbours that this pass has been at
                        const int dx = n / 9 - 1, dy = n / 3 % 3 - 1, dz = n % 3 - 1;
                        const int u = x + step * dx, v = y + step * dy, w = z + step * dz;
                        if (u < 0 || v < 0 || w < 0 || u >= sx || v >= sy || w >= sz) continue;
                        const int32_t beside =
                            level.leaf_at[(static_cast<size_t>(u) * static_cast<size_t>(sy) + static_cast<size_t>(v)) * static_cast<size_t>(sz) +
                                          static_cast<size_t>(w)];
                        free = std::min(free, kernel::is_outside(beside) ? kernel::free_places(beside) + 1 : 1);
                    }
                    here = kernel::outside_tile(free);
                }
    };
    pass(1);
    pass(-1);
}

/// Numbers the leaves: the places of the lattice that are not a tile.
void number_leaves(Level& level) {
    level.origin.clear();
    int32_t n = 0;
    level.each_place([&](size_t p, int x, int y, int z) {
        if (level.leaf_at[p] < 0) return;
        level.leaf_at[p] = n++;
        level.origin.emplace_back(8 * x, 8 * y, 8 * z);
    });
    find_free_places(level);
}

void cover(Level& level, const std::array<int, 3>& lo, const std::array<int, 3>& hi) {
    level.lo = lo;
    size_t places = 1;
    for (size_t a = 0; a < 3; ++a) {
        level.size[a] = hi[a] - lo[a] + 1;
        places *= static_cast<size_t>(level.size[a]);
    }
    level.leaf_at.assign(places, kOutsideTile);
}

/// A leaf's values and those of `reach` voxels around, side 8 + 2 reach.
void fill_halo(const Level& level, const std::vector<float>& values, size_t n, int reach, float* halo) {
    const FairField f = level.view(level.hull);  // for its lattice
    const Coord o = level.origin[n];
    const int side = 8 + 2 * reach;
    const auto first = [&](int d) { return d < 0 ? -reach : d == 0 ? 0 : 8; };
    const auto last = [&](int d) { return d < 0 ? 0 : d == 0 ? 8 : 8 + reach; };
    for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy)
            for (int dz = -1; dz <= 1; ++dz) {
                const int32_t m = f.leaf(o.x() + 8 * dx, o.y() + 8 * dy, o.z() + 8 * dz);
                const float* from = m < 0 ? nullptr : values.data() + static_cast<size_t>(m) * kLeafVoxels;
                const int k0 = first(dz), count = last(dz) - k0;
                for (int i = first(dx); i < last(dx); ++i)
                    for (int j = first(dy); j < last(dy); ++j) {
                        float* to = halo + ((i + reach) * side + j + reach) * side + k0 + reach;
                        if (from) std::memcpy(to, from + ((i & 7) << 6 | (j & 7) << 3 | (k0 & 7)), static_cast<size_t>(count) * sizeof(float));
                        else std::fill_n(to, count, FairField::tile(m));
                    }
            }
}

}  // namespace

double Level::volume_vox(const Values& values) const {
    const auto units = tbb::parallel_reduce(
        tbb::blocked_range<size_t>(0, values.of.size(), 64 * kLeafVoxels), uint64_t{0},
        [&](const tbb::blocked_range<size_t>& range, uint64_t sum) {
            for (size_t at = range.begin(); at < range.end(); ++at) sum += kernel::fair_volume_units(values.of[at]);
            return sum;
        },
        std::plus<>());
    return static_cast<double>(units) / kernel::kFairVolumeUnits +
           static_cast<double>(kLeafVoxels) * static_cast<double>(std::count(leaf_at.begin(), leaf_at.end(), kInsideTile));
}

namespace {

/// A leaf's cells reach one voxel beyond it.
void find_least_of(const Level& level, Values& values, size_t n) {
    const FairField f = level.view(values);
    const Coord o = level.origin[n];
    float least = kBand;
    for (int c = 0; c < 8; ++c) {
        const int32_t m = f.leaf(o.x() + 8 * (c >> 2), o.y() + 8 * (c >> 1 & 1), o.z() + 8 * (c & 1));
        if (m < 0) {
            least = kernel::min_f(least, FairField::tile(m));
            continue;
        }
        const float* leaf = values.of.data() + static_cast<size_t>(m) * kLeafVoxels;
        for (int i = 0; i < (c & 4 ? 1 : 8); ++i)
            for (int j = 0; j < (c & 2 ? 1 : 8); ++j)
                for (int k = 0; k < (c & 1 ? 1 : 8); ++k) least = kernel::min_f(least, leaf[i << 6 | j << 3 | k]);
    }
    values.least[n] = least;
}

}  // namespace

void find_least(const Level& level, Values& values) {
    values.least.resize(level.leaves());
    level.for_leaves([&](size_t n) { find_least_of(level, values, n); });
}

void update_least(const Level& level, Values& values, const std::vector<size_t>& changed) {
    const FairField f = level.view(values);
    std::vector<uint8_t> stale(level.leaves());
    std::vector<size_t> asks;
    for (const size_t n : changed)
        for (int c = 0; c < 8; ++c) {
            const Coord o = level.origin[n];
            const int32_t m = f.leaf(o.x() - 8 * (c >> 2), o.y() - 8 * (c >> 1 & 1), o.z() - 8 * (c & 1));
            if (m < 0 || stale[static_cast<size_t>(m)]) continue;
            stale[static_cast<size_t>(m)] = 1;
            asks.push_back(static_cast<size_t>(m));
        }
    Level::for_each_of(asks.size(), [&](size_t n) { find_least_of(level, values, asks[n]); });
}

namespace {

void blur_leaves(const Level& level, const float* weight, const std::vector<float>& from, std::vector<float>& to) {
    constexpr int kSide = 8 + 2 * kernel::kFairReach;
    const VectorLoops& loops = vector_loops();
    to.resize(from.size());
    level.for_leaves([&](size_t n) {
        float halo[kSide * kSide * kSide];
        fill_halo(level, from, n, kernel::kFairReach, halo);
        loops.blur_leaf(halo, weight, to.data() + n * kLeafVoxels);
    });
}

}  // namespace

void move(Level& level, const kernel::FairBlur& blur, bool stiff) {
    const VectorLoops& loops = vector_loops();
    std::vector<float>& blurred = level.scratch;
    blur_leaves(level, blur.weight, level.field.of, blurred);
    if (stiff) {
        blur_leaves(level, blur.weight, blurred, level.more_scratch);
        level.for_leaves([&](size_t n) {
            for (size_t at = n * kLeafVoxels; at < (n + 1) * kLeafVoxels; ++at) blurred[at] = kernel::put_back(blurred[at], level.more_scratch[at]);
        });
    }
    level.for_leaves([&](size_t n) {
        float halo[10 * 10 * 10];
        fill_halo(level, blurred, n, 1, halo);
        loops.straighten_leaf(halo, level.hull.of.data() + n * kLeafVoxels, level.field.of.data() + n * kLeafVoxels);
    });
}

void make_distances(const Level& level, std::vector<float>& values) {
    const VectorLoops& loops = vector_loops();
    // Magnitudes; those beside the surface are fixed, which their sign says.
    std::vector<float> now(values.size()), next(values.size());
    const auto pass = [&](const std::vector<float>& from, const auto& loop, std::vector<float>& to) {
        level.for_leaves([&](size_t n) {
            float halo[10 * 10 * 10];
            fill_halo(level, from, n, 1, halo);
            loop(halo, kBand, to.data() + n * kLeafVoxels);
        });
    };
    pass(values, loops.measure_leaf, now);
    for (int n = kernel::level_set_passes(static_cast<int>(kBand)); n > 0; --n) {
        pass(now, loops.redistance_leaf, next);
        std::swap(now, next);
    }
    level.for_leaves([&](size_t n) {
        for (size_t at = n * kLeafVoxels; at < (n + 1) * kLeafVoxels; ++at) values[at] = values[at] < 0.f ? -std::fabs(now[at]) : std::fabs(now[at]);
    });
}

Level level_of(const openvdb::FloatGrid& hull) {
    std::vector<const openvdb::FloatTree::LeafNodeType*> leaves;
    hull.tree().getNodes(leaves);
    if (leaves.empty()) throw InputError("fair: the hull has no surface");
    std::array<int, 3> lo{}, hi{};
    for (size_t a = 0; a < 3; ++a) {
        const auto by = [a](const auto* x, const auto* y) { return x->origin()[static_cast<int>(a)] < y->origin()[static_cast<int>(a)]; };
        const auto [first, last] = std::minmax_element(leaves.begin(), leaves.end(), by);
        lo[a] = ((*first)->origin()[static_cast<int>(a)] >> 3) - 1;
        hi[a] = ((*last)->origin()[static_cast<int>(a)] >> 3) + 1;
    }
    Level out;
    cover(out, lo, hi);
    for (const auto* leaf : leaves) out.leaf_at[out.place(leaf->origin().x() >> 3, leaf->origin().y() >> 3, leaf->origin().z() >> 3)] = 0;
    const auto tree = hull.getConstAccessor();
    out.each_place([&](size_t p, int x, int y, int z) {
        if (out.leaf_at[p] < 0 && tree.getValue(Coord(8 * x, 8 * y, 8 * z)) < 0.f) out.leaf_at[p] = kInsideTile;
    });
    number_leaves(out);
    out.hull.of.resize(out.leaves() * kLeafVoxels);
    const auto voxel = static_cast<float>(hull.voxelSize()[0]);
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        const Coord o = leaves[n]->origin();
        const auto number = static_cast<size_t>(out.leaf_at[out.place(o.x() >> 3, o.y() >> 3, o.z() >> 3)]);
        const float* from = leaves[n]->buffer().data();
        for (size_t q = 0; q < kLeafVoxels; ++q) out.hull.of[number * kLeafVoxels + q] = kernel::clamp_f(from[q] / voxel, -kBand, kBand);
    });
    return out;
}

Level coarser(const Level& fine, bool whole) {
    Level out;
    out.shift = fine.shift + 1;
    std::array<int, 3> lo{}, hi{};
    for (size_t a = 0; a < 3; ++a) {
        lo[a] = (fine.lo[a] >> 1) - 1;
        hi[a] = ((fine.lo[a] + fine.size[a] - 1) >> 1) + 1;
    }
    cover(out, lo, hi);
    // The band is as many voxels wide as on the finer level, so it is twice as wide: leaves around are needed, too.
    for (const Coord& o : fine.origin)
        for (int dx = -1; dx <= 1; ++dx)
            for (int dy = -1; dy <= 1; ++dy)
                for (int dz = -1; dz <= 1; ++dz) out.leaf_at[out.place((o.x() >> 4) + dx, (o.y() >> 4) + dy, (o.z() >> 4) + dz)] = 0;
    const FairField from = fine.view(fine.hull);
    out.each_place([&](size_t p, int x, int y, int z) {
        if (out.leaf_at[p] < 0 && from.leaf(16 * x, 16 * y, 16 * z) == kInsideTile) out.leaf_at[p] = whole ? 0 : kInsideTile;
    });
    number_leaves(out);
    out.hull.of.resize(out.leaves() * kLeafVoxels);
    out.for_leaves([&](size_t n) {
        const Coord o = out.origin[n];
        for (int q = 0; q < static_cast<int>(kLeafVoxels); ++q) {
            const int i = 2 * (o.x() + (q >> 6)), j = 2 * (o.y() + (q >> 3 & 7)), k = 2 * (o.z() + (q & 7));
            float sum = 0;
            for (int c = 0; c < 8; ++c) sum += from.at(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1));
            out.hull.of[n * kLeafVoxels + static_cast<size_t>(q)] = kernel::coarser_hull(sum);
        }
    });
    make_distances(out, out.hull.of);
    find_least(out, out.hull);
    return out;
}

Level carried_over(const Level& fine, const Level& coarse) {
    Level out;
    out.shift = fine.shift;
    out.lo = fine.lo;
    out.size = fine.size;
    out.leaf_at.assign(fine.leaf_at.size(), kOutsideTile);
    const FairField field = coarse.view(coarse.field), coarse_hull = coarse.view(coarse.hull), hull = fine.view(fine.hull);
    tbb::parallel_for(out.lo[0], out.lo[0] + out.size[0], [&](int x) {
        for (int y = out.lo[1]; y < out.lo[1] + out.size[1]; ++y)
            for (int z = out.lo[2]; z < out.lo[2] + out.size[2]; ++z) {
                const size_t p = out.place(x, y, z);
                if (fine.leaf_at[p] != kInsideTile) {
                    out.leaf_at[p] = fine.leaf_at[p] >= 0 ? 0 : kOutsideTile;
                    continue;
                }
                out.leaf_at[p] = kernel::carried_tile(field, x, y, z);
            }
    });
    number_leaves(out);
    out.hull.of.resize(out.leaves() * kLeafVoxels);
    out.field.of.resize(out.leaves() * kLeafVoxels);
    out.for_leaves([&](size_t n) {
        const Coord o = out.origin[n];
        for (int q = 0; q < static_cast<int>(kLeafVoxels); ++q) {
            const size_t at = n * kLeafVoxels + static_cast<size_t>(q);
            const int i = o.x() + (q >> 6), j = o.y() + (q >> 3 & 7), k = o.z() + (q & 7);
            const float h = hull.at(i, j, k);
            out.hull.of[at] = h;
            out.field.of[at] = kernel::carried_value(h, coarse_hull, field, i, j, k);
        }
    });
    find_least(out, out.hull);
    return out;
}

Level with_field(const Level& hull, const openvdb::FloatGrid& surface) {
    const Level moved = level_of(surface);
    const FairField bound = hull.view(hull.hull), field = moved.view(moved.hull);
    Level out;
    out.lo = hull.lo;
    out.size = hull.size;
    out.leaf_at.assign(hull.leaf_at.size(), kOutsideTile);
    out.each_place([&](size_t p, int x, int y, int z) {
        const int32_t there = field.leaf(8 * x, 8 * y, 8 * z);
        if (hull.leaf_at[p] >= 0 || there >= 0) out.leaf_at[p] = 0;
        else if (hull.leaf_at[p] == kInsideTile && there == kInsideTile) out.leaf_at[p] = kInsideTile;
    });
    number_leaves(out);
    out.hull.of.resize(out.leaves() * kLeafVoxels);
    out.field.of.resize(out.leaves() * kLeafVoxels);
    out.for_leaves([&](size_t n) {
        const Coord o = out.origin[n];
        for (int q = 0; q < static_cast<int>(kLeafVoxels); ++q) {
            const size_t at = n * kLeafVoxels + static_cast<size_t>(q);
            const int i = o.x() + (q >> 6), j = o.y() + (q >> 3 & 7), k = o.z() + (q & 7);
            out.hull.of[at] = bound.at(i, j, k);
            out.field.of[at] = kernel::max_f(field.at(i, j, k), out.hull.of[at]);
        }
    });
    find_least(out, out.hull);
    return out;
}

namespace {

/// The pieces of the inside, connected by faces of voxels: found leaf by leaf, then joined across the leaves' faces.
class Pieces {
  public:
    explicit Pieces(const Level& level) : level_(level), of_(level.field.of.size()), first_(level.leaves() + 1) {
        level.for_leaves([&](size_t n) { first_[n + 1] = number_leaf(n); });
        for (size_t n = 0; n < level.leaves(); ++n) first_[n + 1] += first_[n];
        tiles_ = first_.back();
        parent_.resize(tiles_ + level.leaf_at.size());
        for (size_t n = 0; n < parent_.size(); ++n) parent_[n] = n;
        level.each_place([&](size_t p, int x, int y, int z) {
            if (kernel::is_outside(level.leaf_at[p])) return;
            const int o[3] = {8 * x, 8 * y, 8 * z};
            for (int axis = 0; axis < 3; ++axis)
                if (o[axis] >> 3 != level.lo[static_cast<size_t>(axis)]) join(p, o, axis);
        });
        sizes_.resize(parent_.size());
        for (size_t at = 0; at < of_.size(); ++at)
            if (of_[at]) ++sizes_[root(first_[at / kLeafVoxels] + of_[at] - 1)];
        for (size_t p = 0; p < level.leaf_at.size(); ++p)
            if (level.leaf_at[p] == kInsideTile) sizes_[root(tiles_ + p)] += kLeafVoxels;
    }
    /// Voxels of the piece that a voxel belongs to; 0: it is outside.
    size_t size_at(size_t voxel) { return of_[voxel] ? sizes_[root(first_[voxel / kLeafVoxels] + of_[voxel] - 1)] : 0; }
    /// Of the piece that a place's tile belongs to; 0: the place is none of the inside.
    size_t size_of_tile(size_t place) { return level_.leaf_at[place] == kInsideTile ? sizes_[root(tiles_ + place)] : 0; }
    /// Of every piece, by no order; 0: none.
    const std::vector<size_t>& sizes() const { return sizes_; }

  private:
    size_t number_leaf(size_t n) {
        const float* values = level_.field.of.data() + n * kLeafVoxels;
        uint16_t* of = of_.data() + n * kLeafVoxels;
        uint16_t pieces = 0, open[kLeafVoxels];
        for (uint16_t start = 0; start < kLeafVoxels; ++start) {
            if (of[start] || values[start] >= 0.f) continue;
            size_t count = 0;
            of[start] = ++pieces;
            open[count++] = start;
            while (count) {
                const uint16_t q = open[--count];
                for (const int shift : {6, 3, 0})
                    for (const int step : {-1, 1}) {
                        if ((q >> shift & 7) == (step < 0 ? 0 : 7)) continue;
                        const auto r = static_cast<uint16_t>(q + step * (1 << shift));
                        if (of[r] || values[r] >= 0.f) continue;
                        of[r] = pieces;
                        open[count++] = r;
                    }
            }
        }
        return pieces;
    }
    size_t root(size_t n) {
        while (parent_[n] != n) n = parent_[n] = parent_[parent_[n]];
        return n;
    }
    /// The label of voxel q of a place; the label beyond every label where it is outside.
    size_t label(size_t place, size_t q) const {
        const int32_t n = level_.leaf_at[place];
        if (n == kInsideTile) return tiles_ + place;
        const uint16_t piece = n < 0 ? uint16_t{0} : of_[static_cast<size_t>(n) * kLeafVoxels + q];
        return piece ? first_[static_cast<size_t>(n)] + piece - 1 : parent_.size();
    }
    /// Joins a place with the one before it along an axis.
    void join(size_t place, const int o[3], int axis) {
        int before[3] = {o[0] >> 3, o[1] >> 3, o[2] >> 3};
        --before[axis];
        const size_t beside = level_.place(before[0], before[1], before[2]);
        if (kernel::is_outside(level_.leaf_at[beside])) return;
        const int across = axis == 0 ? 6 : axis == 1 ? 3 : 0, u = axis == 0 ? 3 : 6, v = axis == 2 ? 3 : 0;
        for (size_t a = 0; a < 8; ++a)
            for (size_t b = 0; b < 8; ++b) {
                const size_t q = a << u | b << v, mine = label(place, q), theirs = label(beside, q | size_t{7} << across);
                if (mine < parent_.size() && theirs < parent_.size()) parent_[root(mine)] = root(theirs);
            }
    }

    const Level& level_;
    std::vector<uint16_t> of_;  ///< by voxel, number of the piece within the leaf, from 1
    std::vector<size_t> first_, parent_, sizes_;
    size_t tiles_ = 0;  ///< labels of tiles begin here, by place
};

}  // namespace

size_t drop_pieces(Level& level, double share) {
    Pieces pieces(level);
    const double least = share * static_cast<double>(*std::max_element(pieces.sizes().begin(), pieces.sizes().end()));
    const auto goes = [&](size_t size) { return size > 0 && static_cast<double>(size) < least; };
    const auto dropped = static_cast<size_t>(std::count_if(pieces.sizes().begin(), pieces.sizes().end(), goes));
    for (size_t at = 0; dropped > 0 && at < level.field.of.size(); ++at)
        if (goes(pieces.size_at(at))) level.field.of[at] = 1.f;
    for (size_t p = 0; dropped > 0 && p < level.leaf_at.size(); ++p)
        if (goes(pieces.size_of_tile(p))) level.leaf_at[p] = kOutsideTile;
    return dropped;
}

openvdb::FloatGrid::Ptr empty_surface(const openvdb::FloatGrid& hull) {
    auto out = openvdb::FloatGrid::create(kBand * static_cast<float>(hull.voxelSize()[0]));
    out->setTransform(same_transform(hull.transform()));
    out->setName("surface");
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    return out;
}

openvdb::FloatGrid::Ptr grid_of(const Level& level, const openvdb::FloatGrid& hull) {
    const auto voxel = static_cast<float>(hull.voxelSize()[0]);
    const openvdb::FloatGrid::Ptr out = empty_surface(hull);
    const float band = out->background();
    level.each_place([&](size_t p, int x, int y, int z) {
        const int32_t n = level.leaf_at[p];
        if (kernel::is_outside(n)) return;
        const Coord o(8 * x, 8 * y, 8 * z);
        const float* from = n < 0 ? nullptr : level.field.of.data() + static_cast<size_t>(n) * kLeafVoxels;
        const auto all = [&](auto&& test) { return std::all_of(from, from + kLeafVoxels, test); };
        if (from && all([](float v) { return v >= kBand; })) return;
        if (!from || all([](float v) { return v <= -kBand; })) return out->tree().addTile(1, o, -band, false);
        auto* leaf = out->tree().touchLeaf(o);
        for (openvdb::Index q = 0; q < kLeafVoxels; ++q) {
            const float v = kernel::off_zero(from[q]);
            if (std::fabs(v) < kBand) leaf->setValueOn(q, v * voxel);
            else leaf->setValueOff(q, v < 0 ? -band : band);
        }
    });
    out->pruneGrid();
    return out;
}

}  // namespace vdbcarve::fairing
