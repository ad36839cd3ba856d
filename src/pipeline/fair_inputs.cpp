// SPDX-License-Identifier: Apache-2.0
#include "pipeline/fair_inputs.h"

#include "vdbcarve/level_set.h"

namespace vdbcarve::pipeline {

std::vector<FairView> fair_views(const Shoot& shoot, const Silhouettes& masks) {
    std::vector<FairView> out;
    const std::vector<Camera> cameras = used_cameras(shoot, masks);
    for (size_t u = 0; u < cameras.size(); ++u) out.push_back({cameras[u], view_of(masks.masks.masks[masks.used[u]])});
    return out;
}

openvdb::FloatGrid::Ptr to_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress) {
    const LevelSetOptions band;
    return half_width_vox < band.half_width_vox ? level_set(grid->deepCopy(), band, progress) : grid;
}

openvdb::FloatGrid::Ptr from_fair_band(const openvdb::FloatGrid::Ptr& grid, int half_width_vox, Progress& progress) {
    LevelSetOptions band;
    if (half_width_vox == band.half_width_vox) return grid;
    band.half_width_vox = half_width_vox;
    return level_set(grid, band, progress);
}

}  // namespace vdbcarve::pipeline
