// SPDX-License-Identifier: Apache-2.0
#include "dense_oracle.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <functional>

namespace vdbcarve::test {

DenseVolume dense_carve(const std::vector<CarveInput>& inputs, const CarveOptions& o, int margin_vox) {
    DenseVolume out;
    out.box = voxels_in_bounds(o.lattice, o.bounds_world, margin_vox);
    const IndexBox inner = voxels_in_bounds(o.lattice, o.bounds_world, 0);
    std::vector<kernel::CarveView> views;
    for (const CarveInput& i : inputs) views.push_back(make_carve_view(i, o));
    const int ni = out.box.max[0] - out.box.min[0], nj = out.box.max[1] - out.box.min[1], nk = out.box.max[2] - out.box.min[2];
    out.value.resize(static_cast<size_t>(ni) * static_cast<size_t>(nj) * static_cast<size_t>(nk));
    const auto band = static_cast<float>(o.half_width_vox * o.lattice.voxel_size);
    const float near_depth = kernel::kNearPlane_vox * static_cast<float>(o.lattice.voxel_size);
    const auto need = static_cast<size_t>(std::ceil(o.min_seen * static_cast<double>(views.size()) - 1e-9));
    const double lo[3] = {o.bounds_world.min()[0], o.bounds_world.min()[1], o.bounds_world.min()[2]};
    const double hi[3] = {o.bounds_world.max()[0], o.bounds_world.max()[1], o.bounds_world.max()[2]};
    tbb::parallel_for(0, ni, [&](int a) {
        std::vector<float> v(views.size()), e(views.size());
        for (int b = 0; b < nj; ++b)
            for (int c = 0; c < nk; ++c) {
                const int i = out.box.min[0] + a, j = out.box.min[1] + b, k = out.box.min[2] + c;
                size_t background = 0, seen = 0;
                for (size_t n = 0; n < views.size(); ++n) {
                    const kernel::LeafToCamera leaf = kernel::leaf_to_camera(views[n], i & ~7, j & ~7, k & ~7);
                    const kernel::Vec3 p = kernel::voxel_in_camera(leaf, static_cast<float>(i & 7), static_cast<float>(j & 7), static_cast<float>(k & 7));
                    if (o.occupancy) {
                        const kernel::BinaryAnswer answer = kernel::binary_answer(views[n], p, near_depth);
                        background += answer.background;
                        seen += answer.seen;
                    } else {
                        v[n] = kernel::view_value(views[n], p, near_depth, band);
                        e[n] = kernel::unseen_value(views[n], p, near_depth, band);
                    }
                }
                float& result =
                    out.value[(static_cast<size_t>(a) * static_cast<size_t>(nj) + static_cast<size_t>(b)) * static_cast<size_t>(nk) + static_cast<size_t>(c)];
                if (o.occupancy) {
                    const bool in_box = i >= inner.min[0] && i < inner.max[0] && j >= inner.min[1] && j < inner.max[1] && k >= inner.min[2] && k < inner.max[2];
                    result = in_box && background <= static_cast<size_t>(o.max_misses) && seen >= need;
                    continue;
                }
                std::sort(v.begin(), v.end(), std::greater<>());
                std::sort(e.begin(), e.end());
                const auto k_misses = static_cast<size_t>(o.max_misses);
                float value = k_misses < v.size() ? v[k_misses] : -band;
                if (need > 0) value = std::max(value, e[need - 1]);
                const Vec3d w = o.lattice.world_from_index(Vec3d(i, j, k));
                const double p[3] = {w.x(), w.y(), w.z()};
                result = std::max(value, std::clamp(static_cast<float>(kernel::box_distance(p, lo, hi)), -band, band));
            }
    });
    return out;
}

}  // namespace vdbcarve::test
