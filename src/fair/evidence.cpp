// SPDX-License-Identifier: Apache-2.0
#include "fair/evidence.h"

#include <atomic>
#include <cmath>

#include "fair/sight_plan.h"
#include "vdbcarve/silhouettes_kept.h"

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

namespace vdbcarve {

double silhouettes_kept(const openvdb::FloatGrid& hull, const FairEvidence& evidence, const std::vector<FairView>& views) {
    using namespace fairing;
    constexpr size_t kViews = 12;
    std::vector<FairView> some;
    for (size_t v = 0; v < views.size(); v += (views.size() + kViews - 1) / kViews) some.push_back(views[v]);
    Level before = level_of(hull), after = level_of(evidence.carved);
    for (Level* level : {&before, &after}) find_least(*level, level->hull);
    const SightPlan plan = plan_sight(before, hull.transform(), some, 1, true);
    Progress quiet;
    const std::vector<DistanceField> fields = distance_fields(plan.masks, plan.fields, quiet);
    std::atomic<size_t> all{0}, kept{0};
    tbb::parallel_for(size_t{0}, some.size(), [&](size_t v) {
        const kernel::FairMask m = mask_of(fields[v], fields[v].silhouette.samples.data(), fields[v].ignored.samples.data());
        const auto meets = [&](const Level& level, int i, int j) {
            const FairField f = level.view(level.hull);
            kernel::FairRay ray;
            int at = 0;
            return kernel::line_of_sight(plan.eyes[v], f, m.x0 + i + 0.5, m.y0 + j + 0.5, ray) &&
                   kernel::least_on(f, ray, kernel::kHullSamples, 0.f, 0.f, at) <= 0.f;
        };
        for (int j = 0; j < m.height; ++j)
            for (int i = j % 3; i < m.width; i += 3) {  // a third of them says as much
                if (!(std::fabs(m.inside(i, j) + 1.5f) <= 0.5f) || m.says_nothing(i, j) || !meets(before, i, j)) continue;
                ++all;
                if (meets(after, i, j)) ++kept;
            }
    });
    return all ? static_cast<double>(kept) / static_cast<double>(all) : 1;
}

}  // namespace vdbcarve
