// SPDX-License-Identifier: Apache-2.0
// What depths say of the surface, on every level of the pyramid.
#pragma once

#include <vector>

#include "fair/fair_level.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::fairing {

/// How sure depths are in the voxels of leaves with those origins, leaf by leaf.
std::vector<float> confidence_of(const openvdb::FloatGrid& confidence, const std::vector<openvdb::Coord>& origin);

class Evidence {
  public:
    explicit Evidence(const FairEvidence& said);
    void coarsen();
    /// The field takes the larger of its values and of what the depths carved.
    void begin(Level& level) const;
    /// FairEngine::follow().
    void follow(Level& level, float share) const;

  private:
    /// work(value, target, weight, hull) of every voxel of a level.
    template <class Work>
    void each_voxel(Level& level, const Work& work) const;

    struct Said {
        Level carved;  ///< by the depths, as "hull"
        std::vector<float> weight;
        kernel::FairDepths view() const { return {carved.view(carved.hull), weight.data()}; }
    };
    std::vector<Said> levels_;
};

}  // namespace vdbcarve::fairing
