// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/filter.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <chrono>
#include <cstring>

#include "surface/filter_plan.h"
#include "volume/leaf_neighbours.h"
#include "base/vector_loops.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;

/// Adds the leaves beside those whose outermost voxels are in the band: there the surface may be moved to.
void grow_by_leaves(openvdb::FloatTree& tree) {
    std::vector<Leaf*> leaves;
    tree.getNodes(leaves);
    const auto around = neighbours_of(leaves, numbers_of(leaves));
    std::vector<uint8_t> wanted(leaves.size(), 0);
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        const auto& mask = leaves[n]->valueMask();
        uint64_t all = 0;
        for (openvdb::Index w = 0; w < 8; ++w) all |= mask.getWord<openvdb::Index64>(w);
        // A word is a layer across x, a byte of it a row along z.
        constexpr uint64_t kFirst = 0x0101010101010101;
        const bool faces[6] = {mask.getWord<openvdb::Index64>(0) != 0,
                               mask.getWord<openvdb::Index64>(7) != 0,
                               (all & 0xff) != 0,
                               (all >> 56) != 0,
                               (all & kFirst) != 0,
                               (all & kFirst << 7) != 0};
        for (size_t f = 0; f < 6; ++f)
            if (faces[f] && around[n][f] < 0) wanted[n] |= static_cast<uint8_t>(1 << f);
    });
    for (size_t n = 0; n < wanted.size(); ++n)
        for (int f = 0; f < 6; ++f) {
            if (!(wanted[n] >> f & 1)) continue;
            openvdb::Coord c = leaves[n]->origin();
            c[f / 2] += f % 2 ? 8 : -8;
            tree.touchLeaf(c);  // with the tile's value
        }
}

/// Copies a leaf and what lies around it, as far as `reach` along each axis, to where filter_leaf() wants it.
template <class ValuesOf>
void fill_filter_halo(const std::array<int32_t, 27>& around, const ValuesOf& values_of, const int reach[3], float band_vox, float* halo) {
    const auto first = [&](int d, int axis) { return d < 0 ? -reach[axis] : d == 0 ? 0 : 8; };
    const auto last = [&](int d, int axis) { return d < 0 ? 0 : d == 0 ? 8 : 8 + reach[axis]; };
    for (int a = 0; a < 27; ++a) {
        const int dx = a / 9 - 1, dy = a / 3 % 3 - 1, dz = a % 3 - 1;
        const int32_t number = around[static_cast<size_t>(a)];
        const float* from = number >= 0 ? values_of(static_cast<size_t>(number)) : nullptr;
        const float tile = number == kernel::kInsideTile ? -band_vox : band_vox;
        const int k0 = first(dz, 2), count = last(dz, 2) - k0;
        if (count == 0) continue;
        for (int i = first(dx, 0); i < last(dx, 0); ++i)
            for (int j = first(dy, 1); j < last(dy, 1); ++j) {
                float* to = halo + ((i + kernel::kMostFilterWidth) * kFilterHalo + j + kernel::kMostFilterWidth) * kFilterHalo + k0 + kernel::kMostFilterWidth;
                if (from) std::memcpy(to, from + ((i & 7) << 6 | (j & 7) << 3 | (k0 & 7)), static_cast<size_t>(count) * sizeof(float));
                else std::fill_n(to, count, tile);
            }
    }
}

/// Those leaves in which something is thin: what they were, and how much of the change their voxels take.
struct Thin {
    float before[kLeafVoxels], share[kLeafVoxels];
};

class CpuFilter {
    auto in_leaves() {
        return [this](size_t n) { return leaves_[n]->buffer().data(); };
    }

  public:
    CpuFilter(openvdb::FloatTree& tree, float voxel, float band, float band_vox, Progress& progress) : band_vox_(band_vox), progress_(progress) {
        tree.getNodes(leaves_);
        around_ = surroundings_of(tree, leaves_);
        beside_.resize(leaves_.size() * kLeafVoxels);
        for_leaves([&](size_t n, float*) {
            float* v = leaves_[n]->buffer().data();
            for (int at = 0; at < kLeafVoxels; ++at) v[at] = kernel::in_voxels(v[at], voxel, band, band_vox);
        });
    }

    void find_thin(double keep_thin_vox) {
        if (keep_thin_vox <= 0) return;
        std::vector<float> third(beside_.size());
        const auto beside = [this](size_t n) { return beside_.data() + n * kLeafVoxels; };
        const auto further = [&](size_t n) { return third.data() + n * kLeafVoxels; };
        const auto passes = thin_passes(keep_thin_vox);
        pass(passes[0], in_leaves(), beside);
        pass(passes[1], beside, further);
        thin_.resize(leaves_.size());
        pass(passes[2], further, beside);
        for_leaves([&](size_t n, float*) {
            auto thin = std::make_unique<Thin>();
            bool any = false;
            for (int at = 0; at < kLeafVoxels; ++at) {
                thin->share[at] = kernel::change_share(beside(n)[at], static_cast<float>(keep_thin_vox));
                any |= thin->share[at] < 1.f;
            }
            if (!any) return;
            std::memcpy(thin->before, leaves_[n]->buffer().data(), sizeof thin->before);
            thin_[n] = std::move(thin);
        });
    }

    /// The result is in the leaves, in voxels.
    void run(const std::vector<kernel::FilterPass>& passes) {
        const auto beside = [this](size_t n) { return beside_.data() + n * kLeafVoxels; };
        for (size_t p = 0; p < passes.size(); ++p) {
            if (p % 2) pass(passes[p], beside, in_leaves());
            else pass(passes[p], in_leaves(), beside);
        }
        for_leaves([&](size_t n, float*) {
            float* v = leaves_[n]->buffer().data();
            if (passes.size() % 2) std::memcpy(v, beside(n), kLeafVoxels * sizeof(float));
            if (!thin_.empty() && thin_[n]) {
                const Thin& thin = *thin_[n];
                for (int at = 0; at < kLeafVoxels; ++at)
                    if (thin.share[at] < 1.f) v[at] = thin.before[at] + thin.share[at] * (v[at] - thin.before[at]);
            }
            for (int face = 0; face < 6; ++face) {
                const int32_t beyond = around_[n][static_cast<size_t>(kernel::beyond_face(face))];
                if (beyond >= 0) continue;
                const int shift = face / 2 == 0 ? 6 : face / 2 == 1 ? 3 : 0;
                for (int at = 0; at < kLeafVoxels; ++at)
                    if ((at >> shift & 7) == (face % 2 ? 7 : 0)) v[at] = kernel::beside_tile(v[at], beyond);
            }
        });
    }

  private:
    template <class Work>
    void for_leaves(const Work& work) {
        tbb::parallel_for(tbb::blocked_range<size_t>(0, leaves_.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
            alignas(64) float halo[kFilterHaloVoxels] = {};
            for (size_t n = range.begin(); n < range.end(); ++n) work(n, halo);
        });
    }
    template <class From, class To>
    void pass(const kernel::FilterPass& pass, const From& from, const To& to) {
        const int reach[3] = {pass_reach(pass, 0), pass_reach(pass, 1), pass_reach(pass, 2)};
        for_leaves([&](size_t n, float* halo) {
            fill_filter_halo(around_[n], from, reach, band_vox_, halo);
            loops_.filter_leaf(pass, halo, band_vox_, to(n));
        });
        progress_.step();
    }

    const VectorLoops& loops_ = vector_loops();
    float band_vox_;
    Progress& progress_;
    std::vector<Leaf*> leaves_;
    std::vector<std::array<int32_t, 27>> around_;
    std::vector<float> beside_;
    std::vector<std::unique_ptr<Thin>> thin_;
};

}  // namespace

FilterResult filter(openvdb::FloatGrid::Ptr surface, const FilterOptions& options, Progress& progress) {
    const int half_width = half_width_of(*surface);
    check_filter(options, half_width);
    FilterResult out;
    if (options.steps.empty()) {
        out.components_before = out.components = count_pieces(*surface);
        VolumeRepair none;
        none.target = none.before_move = none.volume = volume_units(*surface);
        describe_volumes(out, none, surface->voxelSize()[0]);
        out.surface = std::move(surface);
        return out;
    }
    auto start = std::chrono::steady_clock::now();
    const auto measure = [&](const char* name) {
        const auto now = std::chrono::steady_clock::now();
        out.milliseconds.emplace_back(name, std::chrono::duration<double, std::milli>(now - start).count());
        start = now;
    };
    const auto passes = passes_of(options.steps);
    const auto voxel = static_cast<float>(surface->voxelSize()[0]);
    progress.begin("filter", passes.size() + (options.keep_thin_vox > 0 ? 3 : 0));
    out.components_before = count_pieces(*surface);
    measure("pieces");
    VolumeRepair repair;
    repair.target = volume_units(*surface);
    repair.move = options.repair_volume;
    grow_by_leaves(surface->tree());
    measure("prepare");
    {
        CpuFilter work(surface->tree(), voxel, surface->background(), static_cast<float>(half_width), progress);
        work.find_thin(options.keep_thin_vox);
        measure("thin");
        work.run(passes);
        measure("passes");
    }
    const std::string name = surface->getName();
    try {
        surface = redistance(std::move(surface), half_width, &repair, progress);
    } catch (const InputError&) {
        explain_filtered_away(options);
    }
    surface->setName(name);
    measure("re-distance");
    describe_volumes(out, repair, surface->voxelSize()[0]);
    out.components = count_pieces(*surface);
    out.surface = std::move(surface);
    measure("pieces");
    return out;
}

}  // namespace vdbcarve
