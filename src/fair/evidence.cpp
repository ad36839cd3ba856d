// SPDX-License-Identifier: Apache-2.0
#include "fair/evidence.h"

namespace vdbcarve::fairing {

using kernel::FairField;
using openvdb::Coord;

std::vector<float> confidence_of(const openvdb::FloatGrid& confidence, const std::vector<Coord>& origin) {
    std::vector<float> out(origin.size() * kLeafVoxels);
    Level::for_each_of(origin.size(), [&](size_t n) {
        const auto* leaf = confidence.tree().probeConstLeaf(origin[n]);
        for (openvdb::Index q = 0; leaf && q < kLeafVoxels; ++q) out[n * kLeafVoxels + q] = leaf->getValue(q);
    });
    return out;
}

Evidence::Evidence(const FairEvidence& said) {
    Said first{level_of(said.carved), {}};
    find_least(first.carved, first.carved.hull);
    first.weight = confidence_of(said.confidence, first.carved.origin);
    levels_.push_back(std::move(first));
}

void Evidence::coarsen() {
    Said next{coarser(levels_.back().carved, false), {}};
    next.weight.resize(next.carved.leaves() * kLeafVoxels);
    const kernel::FairDepths fine = levels_.back().view();
    next.carved.for_leaves([&](size_t n) {
        const Coord o = next.carved.origin[n];
        for (int q = 0; q < static_cast<int>(kLeafVoxels); ++q)
            next.weight[n * kLeafVoxels + static_cast<size_t>(q)] = kernel::coarser_weight(fine, o.x() + (q >> 6), o.y() + (q >> 3 & 7), o.z() + (q & 7));
    });
    levels_.push_back(std::move(next));
}

template <class Work>
void Evidence::each_voxel(Level& level, const Work& work) const {
    const kernel::FairDepths said = levels_[static_cast<size_t>(level.shift)].view();
    level.for_leaves([&](size_t n) {
        const Coord o = level.origin[n];
        const int32_t m = said.carved.leaf(o.x(), o.y(), o.z());
        const size_t there = static_cast<size_t>(std::max(m, 0)) * kLeafVoxels;
        for (size_t q = 0; q < kLeafVoxels; ++q) {
            const size_t at = n * kLeafVoxels + q;
            if (m < 0) work(level.field.of[at], FairField::tile(m), 0.f, level.hull.of[at]);
            else work(level.field.of[at], said.carved.values[there + q], said.weight[there + q], level.hull.of[at]);
        }
    });
}

void Evidence::begin(Level& level) const {
    each_voxel(level, [](float& value, float target, float, float) { value = kernel::max_f(value, target); });
}

void Evidence::follow(Level& level, float share) const {
    each_voxel(level, [share](float& value, float target, float weight, float hull) { value = kernel::led_value(value, target, share * weight, hull); });
}

}  // namespace vdbcarve::fairing
