// SPDX-License-Identifier: Apache-2.0
#include "fair/fair_level.h"

#include <algorithm>
#include <cmath>
#include <cstring>

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

/// Numbers the leaves: the places of the lattice that are not a tile.
void number_leaves(Level& level) {
    level.origin.clear();
    int32_t n = 0;
    level.each_place([&](size_t p, int x, int y, int z) {
        if (level.leaf_at[p] < 0) return;
        level.leaf_at[p] = n++;
        level.origin.emplace_back(8 * x, 8 * y, 8 * z);
    });
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

struct Blur {
    float weight[kernel::kFairReach + 1];

    explicit Blur(double width_vox) {
        double w[kernel::kFairReach + 1], sum = 0;
        for (int n = 0; n <= kernel::kFairReach; ++n) {
            w[n] = std::exp(-n * n / (2 * width_vox * width_vox));
            sum += n ? 2 * w[n] : w[n];
        }
        for (int n = 0; n <= kernel::kFairReach; ++n) weight[n] = static_cast<float>(w[n] / sum);
    }
    /// Of values that are `stride` apart.
    float along(const float* p, int stride) const {
        float sum = weight[0] * p[0];
        for (int n = 1; n <= kernel::kFairReach; ++n) sum += weight[n] * (p[-n * stride] + p[n * stride]);
        return sum;
    }
    void leaf(const float* halo, float* out) const {
        constexpr int R = kernel::kFairReach, S = 8 + 2 * R;
        float x[8 * S * S], y[8 * 8 * S];
        for (int i = 0; i < 8; ++i)
            for (int q = 0; q < S * S; ++q) x[i * S * S + q] = along(halo + (i + R) * S * S + q, S * S);
        for (int i = 0; i < 8; ++i)
            for (int j = 0; j < 8; ++j)
                for (int k = 0; k < S; ++k) y[(i * 8 + j) * S + k] = along(x + (i * S + j + R) * S + k, S);
        for (int row = 0; row < 64; ++row)
            for (int k = 0; k < 8; ++k) out[row * 8 + k] = along(y + row * S + k + R, 1);
    }
};

}  // namespace

double Level::volume_vox(const Values& values) const {
    double sum = 0;
    for (const float v : values.of) sum += static_cast<double>(kernel::clamp_f(0.5f - v, 0.f, 1.f));
    return sum + static_cast<double>(kLeafVoxels) * static_cast<double>(std::count(leaf_at.begin(), leaf_at.end(), kInsideTile));
}

void find_least(const Level& level, Values& values) {
    values.least.resize(level.leaves());
    level.for_leaves([&](size_t n) {
        float halo[10 * 10 * 10], least = kBand;
        fill_halo(level, values.of, n, 1, halo);
        for (int i = 1; i < 10; ++i)
            for (int j = 1; j < 10; ++j)
                for (int k = 1; k < 10; ++k) least = kernel::min_f(least, halo[(i * 10 + j) * 10 + k]);
        values.least[n] = least;
    });
}

void move(Level& level, double width_vox) {
    const Blur blur(width_vox);
    std::vector<float> blurred(level.field.of.size());
    level.for_leaves([&](size_t n) {
        constexpr int kSide = 8 + 2 * kernel::kFairReach;
        float halo[kSide * kSide * kSide];
        fill_halo(level, level.field.of, n, kernel::kFairReach, halo);
        blur.leaf(halo, blurred.data() + n * kLeafVoxels);
    });
    level.for_leaves([&](size_t n) {
        constexpr int kSide = 10;
        float halo[kSide * kSide * kSide];
        fill_halo(level, blurred, n, 1, halo);
        for (int q = 0; q < static_cast<int>(kLeafVoxels); ++q) {
            const float* here = halo + (((q >> 6) + 1) * kSide + (q >> 3 & 7) + 1) * kSide + (q & 7) + 1;
            const size_t at = n * kLeafVoxels + static_cast<size_t>(q);
            level.field.of[at] = kernel::straightened([here](int i, int j, int k) { return here[(i * kSide + j) * kSide + k]; }, level.hull.of[at]);
        }
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
            out.hull.of[n * kLeafVoxels + static_cast<size_t>(q)] = sum == 0.f ? kernel::kLeastDistance : sum * (1.f / 16);
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
                float least = kBand, most = -kBand;
                for (int a = -1; a <= 4; ++a)
                    for (int b = -1; b <= 4; ++b)
                        for (int c = -1; c <= 4; ++c) {
                            const float v = field.at(4 * x + a, 4 * y + b, 4 * z + c);
                            least = kernel::min_f(least, v);
                            most = kernel::max_f(most, v);
                        }
                constexpr float kReach = 2.f;  // coarse voxels
                out.leaf_at[p] = least < kReach && most > -kReach ? 0 : most < 0.f ? kInsideTile : kOutsideTile;
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
            const auto x = static_cast<float>(i), y = static_cast<float>(j), z = static_cast<float>(k);
            const float h = hull.at(i, j, k);
            // What the coarser hull is too coarse for (thin parts) is as the finer one has it.
            const float detail = kernel::min_f(0.f, h - kernel::coarser_value(coarse_hull, x, y, z));
            out.hull.of[at] = h;
            out.field.of[at] = kernel::max_f(h, kernel::clamp_f(kernel::coarser_value(field, x, y, z) + detail, -kBand, kBand));
        }
    });
    find_least(out, out.hull);
    return out;
}

namespace {

/// Numbers the pieces of the inside, connected by faces of voxels.
class Pieces {
  public:
    explicit Pieces(const Level& level) : field_(level.view(level.field)), level_(level), of_(level.field.of.size(), -1), of_tile_(level.leaf_at.size(), -1) {
        for (size_t at = 0; at < of_.size(); ++at)
            if (level.field.of[at] < 0.f && of_[at] < 0) {
                const Coord o = level.origin[at / kLeafVoxels];
                const int q = static_cast<int>(at % kLeafVoxels);
                sizes_.push_back(0);
                reach({o.x() + (q >> 6), o.y() + (q >> 3 & 7), o.z() + (q & 7)});
                while (!open_.empty()) {
                    const Coord c = open_.back();
                    open_.pop_back();
                    go_on_from(c);
                }
            }
    }
    /// Of a voxel; -1: outside.
    int32_t at(size_t place) const { return of_[place]; }
    /// Voxels of each piece.
    const std::vector<size_t>& sizes() const { return sizes_; }

  private:
    void reach(const Coord& c) {
        const int64_t p = field_.place(c.x(), c.y(), c.z());
        if (p == kOutsideTile) return;
        int32_t& piece = p == kInsideTile ? of_tile_[level_.place(c.x() >> 3, c.y() >> 3, c.z() >> 3)] : of_[static_cast<size_t>(p)];
        if (piece >= 0 || (p >= 0 && level_.field.of[static_cast<size_t>(p)] >= 0.f)) return;
        piece = static_cast<int32_t>(sizes_.size() - 1);
        sizes_.back() += p == kInsideTile ? kLeafVoxels : 1;
        open_.push_back(c);
    }
    void go_on_from(const Coord& c) {
        const bool tile = field_.place(c.x(), c.y(), c.z()) == kInsideTile;
        const Coord lo = tile ? Coord(c.x() & ~7, c.y() & ~7, c.z() & ~7) : c;
        const int side = tile ? 8 : 1;
        for (int axis = 0; axis < 3; ++axis)
            for (const int step : {-1, side})
                for (int u = 0; u < side; ++u)
                    for (int v = 0; v < side; ++v) {
                        Coord d = lo;
                        d[axis] += step;
                        d[(axis + 1) % 3] += u;
                        d[(axis + 2) % 3] += v;
                        reach(d);
                    }
    }

    const FairField field_;
    const Level& level_;
    std::vector<int32_t> of_, of_tile_;
    std::vector<size_t> sizes_;
    std::vector<Coord> open_;
};

}  // namespace

size_t drop_pieces(Level& level, double share) {
    const Pieces pieces(level);
    const std::vector<size_t>& sizes = pieces.sizes();
    if (sizes.empty()) return 0;
    const double least = share * static_cast<double>(*std::max_element(sizes.begin(), sizes.end()));
    const auto goes = [&](int32_t piece) { return static_cast<double>(sizes[static_cast<size_t>(piece)]) < least; };
    for (size_t at = 0; at < level.field.of.size(); ++at)
        if (pieces.at(at) >= 0 && goes(pieces.at(at))) level.field.of[at] = 1.f;
    return static_cast<size_t>(std::count_if(sizes.begin(), sizes.end(), [&](size_t s) { return static_cast<double>(s) < least; }));
}

openvdb::FloatGrid::Ptr grid_of(const Level& level, const openvdb::FloatGrid& hull) {
    const auto voxel = static_cast<float>(hull.voxelSize()[0]);
    const float band = kBand * voxel;
    auto out = openvdb::FloatGrid::create(band);
    out->setTransform(same_transform(hull.transform()));
    out->setName("surface");
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    level.each_place([&](size_t p, int x, int y, int z) {
        const int32_t n = level.leaf_at[p];
        if (n == kOutsideTile) return;
        const Coord o(8 * x, 8 * y, 8 * z);
        const float* from = n < 0 ? nullptr : level.field.of.data() + static_cast<size_t>(n) * kLeafVoxels;
        const auto all = [&](auto&& test) { return std::all_of(from, from + kLeafVoxels, test); };
        if (from && all([](float v) { return v >= kBand; })) return;
        if (!from || all([](float v) { return v <= -kBand; })) return out->tree().addTile(1, o, -band, false);
        auto* leaf = out->tree().touchLeaf(o);
        for (openvdb::Index q = 0; q < kLeafVoxels; ++q) {
            const float v = std::fabs(from[q]) < kernel::kLeastDistance ? -kernel::kLeastDistance : from[q];
            if (std::fabs(v) < kBand) leaf->setValueOn(q, v * voxel);
            else leaf->setValueOff(q, v < 0 ? -band : band);
        }
    });
    out->pruneGrid();
    return out;
}

}  // namespace vdbcarve::fairing
