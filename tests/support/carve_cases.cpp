// SPDX-License-Identifier: Apache-2.0
#include "support/carve_cases.h"

namespace vdbcarve::test {
namespace {

Shoot skewed() {
    SyntheticSpec spec = small_spec("ellipsoids", 8);
    spec.rig.pixel_aspect = 1.4;
    return shoot(spec, [](SyntheticScene& s) {
        // Skewed pixels: masks stay, so this is another object, but a legal one.
        for (View& v : s.views.views) v.camera.intrinsics.skew = 9;
    });
}

Shoot truncated() {
    SyntheticSpec spec = small_spec("ellipsoids", 10);
    spec.rig.fill = 1.5;
    return shoot(spec);
}

Shoot ignoring() {
    return shoot(small_spec("torus", 10), [](SyntheticScene& s) {
        for (size_t i = 0; i < 7; ++i) {
            Mask& m = s.masks[i];
            m.ignore = Image8(m.coverage.width, m.coverage.height);
            for (int y = 20; y < 60; ++y)
                for (int x = 50; x < 90; ++x) m.ignore.at(x, y) = 255;
        }
    });
}

Shoot orthographic() {
    SyntheticSpec spec = small_spec("boxes", 9);
    spec.rig.orthographic = true;
    return shoot(spec);
}

Shoot far_origin() {
    return shoot(small_spec("ellipsoids", 8), [](SyntheticScene& s) {
        const Vec3d shift(4.5e4, -3.2e4, 120);
        for (View& v : s.views.views) v.camera.camera_from_world.translation -= v.camera.camera_from_world.rotation * shift;
        for (auto& v : s.truth.vertices)
            for (int a = 0; a < 3; ++a) v[static_cast<size_t>(a)] += static_cast<float>(shift[a]);
    });
}

}  // namespace

const std::vector<CarveCase>& carve_cases() {
    static const std::vector<CarveCase> all{
        {"orbit", [] { return shoot(small_spec("ellipsoids", 12)); }, [](CarveOptions&) {}},
        {"one_miss_allowed", [] { return shoot(small_spec("ellipsoids", 12)); }, [](CarveOptions& o) { o.max_misses = 1; }},
        {"three_misses_allowed", [] { return shoot(small_spec("cup", 9)); }, [](CarveOptions& o) { o.max_misses = 3; }},
        {"truncated_views", truncated, [](CarveOptions&) {}},
        {"truncated_views_one_miss", truncated,
         [](CarveOptions& o) {
             o.max_misses = 1;
             o.min_seen = 0.8;
         }},
        {"outside_is_background", truncated, [](CarveOptions& o) { o.outside = Outside::Background; }},
        {"every_view_must_see", truncated, [](CarveOptions& o) { o.min_seen = 1.0; }},
        {"ignored_regions", ignoring, [](CarveOptions& o) { o.min_seen = 0.7; }},
        // The bounds reach past the cameras: nodes at the camera planes, behind them and around the centres.
        {"camera_inside_the_bounds", [] { return shoot(small_spec("ellipsoids", 6)); },
         [](CarveOptions& o) {
             const Vec3d grow(3.2, 3.2, 0.3);
             o.bounds_world = Box3d(o.bounds_world.min() - grow, o.bounds_world.max() + grow);
             o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / 72;
             o.min_seen = 0.3;
         }},
        {"camera_inside_the_bounds_background", [] { return shoot(small_spec("ellipsoids", 6)); },
         [](CarveOptions& o) {
             const Vec3d grow(3.2, 3.2, 0.3);
             o.bounds_world = Box3d(o.bounds_world.min() - grow, o.bounds_world.max() + grow);
             o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / 72;
             o.outside = Outside::Background;
             o.min_seen = 0;
         }},
        {"bounds_cut_the_object", [] { return shoot(small_spec("torus", 8)); },
         [](CarveOptions& o) {
             Vec3d hi = o.bounds_world.max();
             hi.x() -= 0.45 * o.bounds_world.sizes().x();
             o.bounds_world = Box3d(o.bounds_world.min(), hi);
             o.lattice.origin_world = Vec3d(0.1234, -0.777, 3.1);
         }},
        {"non_square_pixels_and_grid", skewed, [](CarveOptions& o) { o.min_seen = 0.2; }},
        {"orthographic", orthographic, [](CarveOptions&) {}},
        {"far_world_origin", far_origin, [](CarveOptions&) {}},
        {"wide_band", [] { return shoot(small_spec("torus", 7)); }, [](CarveOptions& o) { o.half_width_vox = 6; }},
        {"coarser_voxels_than_pixels", [] { return shoot(small_spec("ellipsoids", 8, 512, 384)); }, [](CarveOptions&) {}, 24},
        {"finer_voxels_than_pixels", [] { return shoot(small_spec("ellipsoids", 5, 48, 36)); }, [](CarveOptions&) {}, 100},
    };
    return all;
}

}  // namespace vdbcarve::test
