// SPDX-License-Identifier: Apache-2.0
#include "align/align_scale.h"

#include <openvdb/tools/RayIntersector.h>

#include <array>

#include "surface/coarse_hull.h"
#include "base/statistics.h"
#include "base/text.h"
#include "views/view_called.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/error.h"
#include "vdbcarve/kernel/distance.h"

namespace vdbcarve {
namespace {

/// The distance, in the world found, between the places of the hull that two pixels of one view show.
double seen_length(const AlignResult& r, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, const KnownLength& known) {
    const Camera& camera = cameras[view_called(r.views, known.view, "--known-length")];
    Progress quiet;
    const openvdb::FloatGrid::Ptr hull = coarse_hull(r.views.names(), cameras, masks, 256, 0.6, quiet);
    using Intersector = openvdb::tools::LevelSetRayIntersector<openvdb::FloatGrid>;
    const Intersector intersector(*hull);
    std::array<Vec3d, 2> places;
    for (size_t k = 0; k < 2; ++k) {
        const Vec2d& pixel = k ? known.to_px : known.from_px;
        const Camera::Ray ray = camera.ray(pixel);
        openvdb::Vec3d hit;
        const Intersector::RayType sight({ray.origin.x(), ray.origin.y(), ray.origin.z()}, {ray.direction.x(), ray.direction.y(), ray.direction.z()});
        if (!intersector.intersectsWS(sight, hit))
            throw InputError(text_of(
                "--known-length: pixel %g, %g of %s does not show the object as the cameras found have it. Remedy: places farther within the silhouette",
                pixel.x(), pixel.y(), known.view.c_str()));
        places[k] = {hit.x(), hit.y(), hit.z()};
    }
    const double length = (places[1] - places[0]).norm();
    if (!(length > 0)) throw InputError("--known-length: both pixels of " + known.view + " show the same place. Remedy: others, farther apart");
    return length;
}

}  // namespace

std::vector<MaskView> trusted_masks(const AlignResult& r, std::vector<MaskView> masks) {
    for (size_t i = 0; i < masks.size(); ++i)
        if (r.aligned[i].bad) masks[i] = {};
    return masks;
}

void check_known_length(const Views& views, const std::vector<MaskView>& masks, const KnownLength& known) {
    const size_t view = view_called(views, known.view, "--known-length");
    const Intrinsics& k = views.views[view].camera.intrinsics;
    const ImageView<uint8_t> mask = masks.empty() ? ImageView<uint8_t>() : masks[view].coverage;
    const int width = mask.empty() ? k.width_px : mask.width, height = mask.empty() ? k.height_px : mask.height;
    for (const Vec2d& p : {known.from_px, known.to_px}) {
        if (!(p.x() >= 0 && p.y() >= 0 && p.x() < width && p.y() < height))
            throw UsageError(text_of("--known-length: pixel %g, %g is outside of %s, which has %d x %d pixels. Remedy: two places within its silhouette", p.x(),
                                     p.y(), known.view.c_str(), width, height));
        if (!mask.empty() && !kernel::is_object(mask.at(static_cast<int>(p.x()), static_cast<int>(p.y()))))
            throw InputError(text_of("--known-length: pixel %g, %g of %s is background in its mask. Remedy: two places within the silhouette", p.x(), p.y(),
                                     known.view.c_str()));
    }
    if (known.from_px == known.to_px) throw UsageError("--known-length: both pixels of " + known.view + " are the same. Remedy: two places of the object");
}

void apply_scale(AlignResult& r, const std::vector<MaskView>& masks, const AlignOptions& o, Progress& progress) {
    if (r.method == AlignMethod::Mat) return;  // which is metric
    double scale = 1;
    const std::vector<Camera> cameras = r.views.cameras();
    if (o.known_distance > 0) {
        Box3d outline;
        for (const auto& t : r.touches_world) outline.extend(Vec3d(t[0], t[1], t[2]));
        const Vec3d middle = outline.isEmpty() ? Vec3d::Zero().eval() : Vec3d(outline.center());
        std::vector<double> distances;
        for (size_t i = 0; i < cameras.size(); ++i)
            if (!masks[i].coverage.empty()) distances.push_back((cameras[i].centre_world() - middle).norm());
        scale = o.known_distance / median(distances);
    } else if (o.known_height > 0) {
        const std::vector<MaskView> trusted = trusted_masks(r, masks);
        Progress quiet;
        const openvdb::FloatGrid::Ptr hull = coarse_hull(r.views.names(), cameras, trusted, 256, 0.6, quiet);
        const SeenExtent seen = seen_extent(*hull, cameras, trusted, up_direction(r.views.up, cameras));
        if (!seen.top_seen || !seen.bottom_seen)
            throw UndeterminedError(
                "--known-height: every silhouette is cut by its frame above or below, so how high the object is was not seen. Remedy: --known-distance");
        scale = o.known_height / (seen.highest - seen.lowest);
    } else if (o.known_length) {
        scale = o.known_length->length / seen_length(r, cameras, trusted_masks(r, masks), *o.known_length);
    } else {
        if (r.method != AlignMethod::Refine) r.views.units.clear();
        return;
    }
    if (r.method != AlignMethod::Refine || !o.units.empty()) r.views.units = o.units;  // else the camera file's
    for (View& v : r.views.views) v.camera.camera_from_world.translation *= scale;
    for (Sitting& s : r.views.sittings) s.scene_from_sitting.translation *= scale;
    if (r.views.floor) *r.views.floor *= scale;
    for (Camera& c : r.other_cameras) c.camera_from_world.translation *= scale;
    for (auto& t : r.touches_world)
        for (float& x : t) x = static_cast<float>(x * scale);
    const std::string& units = r.views.units;
    progress.note(text_of("scale: one camera distance is %.6g%s%s", scale,
                          units.empty() ? ", of the unit of the length given; which one it is was not said (--units)" : " ", units.c_str()));
}

}  // namespace vdbcarve
