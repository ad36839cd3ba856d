// SPDX-License-Identifier: Apache-2.0
// Where a pixel's line of sight meets the hull: the room that depths are searched in.
#pragma once

#include "vdbcarve/kernel/render.h"
#include "vdbcarve/kernel/stereo.h"

namespace vdbcarve::kernel {

/// What it takes to ask the hull about a view's pixels.
struct HullView {
    RenderRule rays;
    double depth[4];   ///< along the camera's z, world units: depth[0..2] (voxels from the base) + depth[3]
    double normal[9];  ///< camera axes from world axes
    double deepest;    ///< the search ends so far behind the first surface, world units
    bool orthographic;
};

/// First surface, and last or deepest, on a pixel's line of sight.
VDBCARVE_HD HullSight hull_sight(FieldReader& field, SightCells& cells, const RenderVolume& volume, const HullView& view, int x, int y) {
    HullSight out{0.f, 0.f, {0.f, 0.f, -1.f}};
    PixelRay ray = pixel_ray(view.rays, volume.box, x + 0.5, y + 0.5);
    if (!ray.hits) return out;
    const Vec3 back{-ray.direction.x, -ray.direction.y, -ray.direction.z};
    Vec3 place[2];  // once from before, once from behind
    for (int n = 0; n < 2; ++n) {
        if (n == 1) {
            const CellWalk walk(volume.box, ray.start, ray.direction, kFarthest_vox);
            ray.start = along(ray.start, walk.end, ray.direction);
            ray.direction = back;
        }
        if (!find_surface(field, cells, volume, ray, 0.f, place[n])) {
            if (n == 0) return out;
            place[1] = place[0];
        }
    }
    double z[2];
    for (int n = 0; n < 2; ++n)
        z[n] = view.depth[0] * static_cast<double>(place[n].x) + view.depth[1] * static_cast<double>(place[n].y) +
               view.depth[2] * static_cast<double>(place[n].z) + view.depth[3];
    if (!(view.orthographic || z[0] > 0.0)) return out;
    if (z[1] > z[0] + view.deepest) z[1] = z[0] + view.deepest;
    if (!(z[1] > z[0])) z[1] = z[0];
    out.front = static_cast<float>(view.orthographic ? z[0] : 1.0 / z[0]);
    out.back = static_cast<float>(view.orthographic ? z[1] : 1.0 / z[1]);
    const Vec3 n = field.normal(place[0].x, place[0].y, place[0].z, back);
    const double* r = view.normal;
    const auto row = [&](int a) {
        return static_cast<float>(r[3 * a] * static_cast<double>(n.x) + r[3 * a + 1] * static_cast<double>(n.y) + r[3 * a + 2] * static_cast<double>(n.z));
    };
    out.normal = {row(0), row(1), row(2)};
    return out;
}

}  // namespace vdbcarve::kernel
