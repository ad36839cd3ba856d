// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/synthetic.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "image/image_io.h"
#include "synthetic/mask_damage.h"
#include "synthetic/noise.h"
#include "synthetic/object.h"
#include "synthetic/photograph.h"
#include "synthetic/rig.h"

namespace vdbcarve {

using namespace synth;

namespace {

std::string frame_name(size_t i, const char* extension) {
    const std::string n = std::to_string(i);
    return std::string(4 - std::min<size_t>(4, n.size()), '0') + n + extension;
}

std::vector<TrueColor> colors_at(const SyntheticSpec& spec, const Object& object, const std::vector<Vec3d>& points) {
    object.prepare_nearest();
    const std::vector<Direction> where = directions(spec.rig);
    const bool moving_light = spec.rig.motion == Rig::Motion::Turntable;
    std::vector<TrueColor> out(points.size());
    tbb::parallel_for(size_t{0}, points.size(), [&](size_t n) {
        const SurfacePoint p = object.nearest(points[n], out[n].distance);
        double light = 0, weight = 0;
        for (const Direction& d : where) {
            const Vec3d eye(std::cos(d.elevation_rad) * std::cos(d.azimuth_rad), std::cos(d.elevation_rad) * std::sin(d.azimuth_rad),
                            std::sin(d.elevation_rad));
            const double w = moving_light ? std::pow(std::max(0.0, p.normal.dot(eye)), 4) : 1.0;
            light += w * room_of(spec.rig, d.azimuth_rad, Mat3d::Identity()).diffuse(p.normal, spec.look);
            weight += w;
            if (!moving_light) break;
        }
        const Vec3d c = (weight > 0 ? light / weight : 1.0) * object.albedo_at(p);
        out[n].color = {static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])};
    });
    return out;
}

void check_spec(const SyntheticSpec& spec) {
    const Rig& rig = spec.rig;
    std::string bad;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) bad += (bad.empty() ? "" : "; ") + what;
    };
    need(rig.width_px >= 2 && rig.height_px >= 2, "the image must be at least 2 x 2");
    need(rig.fov_deg > 0 && rig.fov_deg < 170, "the field of view must be within 0..170 degrees");
    need(rig.pixel_aspect > 0 && rig.fill > 0, "pixel aspect and fill must be > 0");
    need(rig.sittings == 1 || rig.sittings == 2, "one or two sittings");
    need(std::abs(rig.speed_variation) <= 0.9, "the speed's variation is at most 0.9");
    need(std::abs(rig.breathing) <= 0.5, "focus breathing is at most 0.5");
    need(std::abs(rig.crop_drift_px) <= 1000, "the crop drifts by at most 1000 px");
    need(spec.look.jpeg_quality >= 0 && spec.look.jpeg_quality <= 100, "the JPEG quality must be 1..100 (0: PNG)");
    const MaskDamage& d = spec.damage;
    need(d.noise_px >= 0 && d.noise_px <= 50 && std::abs(d.dilate_px) <= 50 && d.correlation_px >= 0,
         "masks' noise and dilation are 0..50 px, its correlation is >= 0");
    need(d.holes >= 0 && d.blobs >= 0 && d.radius_px >= 1 && d.radius_px <= 500 && d.share >= 0 && d.share <= 1,
         "masks' holes and blobs are >= 0, of radius 1..500 px, in a share 0..1 of the views");
    need(spec.look.exposure_jitter >= 0 && spec.look.exposure_jitter < 1, "the exposure's jitter is 0..1");
    need(spec.texture.empty() || !spec.mesh.texcoords.empty(), "a texture needs a mesh with texture coordinates (.obj)");
    need(spec.look.blur_px >= 0 && spec.look.blur_px <= 50 && spec.look.noise >= 0 && spec.look.gloss >= 0, "blur is 0..50 px, noise and gloss are >= 0");
    need(rig.lens.coefficients.empty() || rig.lens.coefficients.size() == 4, "a lens has four coefficients: k1, k2, p1, p2");
    need(!(rig.lens.distorts() && rig.orthographic), "a parallel projection has no lens");
    if (!bad.empty()) throw UsageError("synth: " + bad);
}

/// Cameras stand around the object, then take their pictures.
class Shoot {
  public:
    explicit Shoot(const SyntheticSpec& spec)
        : spec_(spec), rig_(spec.rig), where_(directions(spec.rig)), hands_(hands_of(where_.size(), spec.look.film_rate_hz, spec.seed)) {
        if (where_.empty()) throw UsageError("synth: zero views");
        object_.emplace(spec);
        const double half_fov = 0.5 * rad(rig_.fov_deg);
        distance_ = rig_.distance > 0 ? rig_.distance : object_->radius() / std::sin(std::atan(rig_.fill * std::tan(half_fov)));
        intrinsics_.width_px = rig_.width_px;
        intrinsics_.height_px = rig_.height_px;
        intrinsics_.cx = 0.5 * rig_.width_px;
        intrinsics_.cy = 0.5 * rig_.height_px;
        intrinsics_.orthographic = rig_.orthographic;
        intrinsics_.fy = rig_.orthographic ? 0.5 * rig_.height_px * rig_.fill / object_->radius() : 0.5 * rig_.height_px / std::tan(half_fov);
        intrinsics_.fx = intrinsics_.fy / rig_.pixel_aspect;
        scene_from_side_.rotation = turned({90, 0, 35}).transpose();
        scene_from_side_.translation = object_->centre() - scene_from_side_.rotation * object_->centre();
    }

    SyntheticScene run(Progress& progress) {
        scene_.look = spec_.look;
        scene_.truth = object_->truth();
        for (size_t i = 0; i < where_.size(); ++i) add_view(i);
        scene_.views.up = scene_.nominal.up = "z";
        if (rig_.sittings == 2) {
            scene_.views.sittings.push_back({"1", scene_from_side_, 1.0});
            scene_.nominal.sittings.push_back({"1", Rigid3(), 1.0});  // how it was tipped is not known to the photographer
        }
        cameras_ = scene_.views.cameras();
        Dice light(spec_.seed + 1000003);
        for (size_t i = 0; i < where_.size(); ++i) scene_.exposures.push_back(1 + spec_.look.exposure_jitter * light());
        scene_.masks.resize(where_.size());
        if (spec_.damage.any()) scene_.true_masks.resize(where_.size());
        if (spec_.photos) scene_.photos.resize(where_.size());
        if (spec_.photos && spec_.look.plates) scene_.plates.resize(where_.size());
        progress.begin("synth", where_.size());
        tbb::parallel_for(size_t{0}, where_.size(), [&](size_t i) {
            take_pictures(i);
            progress.step();
        });
        if (spec_.photos) {
            std::vector<Vec3d> points;
            for (const auto& v : scene_.truth.vertices) points.emplace_back(v[0], v[1], v[2]);
            for (const TrueColor& c : colors_at(spec_, *object_, points)) scene_.truth.colors.push_back(c.color);
        }
        return std::move(scene_);
    }

  private:
    bool in_second(size_t i) const { return rig_.sittings == 2 && 2 * i >= where_.size(); }

    void add_view(size_t i) {
        const auto place = [&](double azimuth, double elevation) {
            return Vec3d(object_->centre() +
                         distance_ * Vec3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)));
        };
        View view;
        view.name = "images/" + frame_name(i, spec_.photos && spec_.look.jpeg_quality > 0 ? ".jpg" : ".png");
        view.mask_path = "masks/" + frame_name(i, ".png");
        view.lens = rig_.lens;
        view.sitting = in_second(i) ? "1" : "0";
        view.camera = look_at(place(where_[i].azimuth_rad, where_[i].elevation_rad), object_->centre(), 0, intrinsics_);
        scene_.nominal.views.push_back(view);
        const Hand& hand = hands_[i];
        const double azimuth = where_[i].azimuth_rad + rad(rig_.shake_angle_deg) * hand[0],
                     elevation = where_[i].elevation_rad + rad(rig_.shake_elevation_deg) * hand[1];
        Vec3d moved, aim;
        for (size_t a = 0; a < 3; ++a) {
            moved[static_cast<int>(a)] = rig_.shake_position * distance_ * hand[2 + 2 * a];
            aim[static_cast<int>(a)] = rig_.shake_look_at * distance_ * hand[3 + 2 * a];
        }
        Intrinsics breathed = intrinsics_;
        const double factor = 1 + rig_.breathing * std::sin(2 * kPi * 1.7 * static_cast<double>(i) / static_cast<double>(where_.size()) + 0.6);
        breathed.fx *= factor;
        breathed.fy *= factor;
        const double passed = 2 * kPi * static_cast<double>(i) / static_cast<double>(where_.size());
        breathed.cx += rig_.crop_drift_px * std::sin(2.3 * passed + 1.1);
        breathed.cy += rig_.crop_drift_px * std::sin(1.4 * passed + 2.6);
        view.camera = look_at(place(azimuth, elevation) + moved, object_->centre() + aim, rad(rig_.shake_roll_deg) * hand[8], breathed);
        scene_.views.views.push_back(view);
        azimuths_.push_back(azimuth);
    }

    void take_pictures(size_t i) {
        // With a lens the picture is taken without it first, with room around, and then bent.
        Camera camera = cameras_[i];
        const int margin = rig_.lens.distorts() ? std::max(rig_.width_px, rig_.height_px) / 5 : 0;
        camera.intrinsics.width_px += 2 * margin;
        camera.intrinsics.height_px += 2 * margin;
        camera.intrinsics.cx += margin;
        camera.intrinsics.cy += margin;
        // A mesh's masks come from its own rasteriser.
        const Object::Surface surface = spec_.photos || !spec_.solids.empty() ? object_->surface(camera, spec_.photos) : Object::Surface();
        Image8 mask = object_->coverage(camera, surface);
        Image8 photo, plate;
        if (spec_.photos) {
            const Mat3d side_from_scene = in_second(i) ? Mat3d(scene_from_side_.rotation.transpose()) : Mat3d(Mat3d::Identity());
            const Room place = room_of(rig_, azimuths_[i], side_from_scene);
            photo = photograph(*object_, camera, mask, &surface, spec_.look, place,
                               Lamps::wandering(spec_.look.light_drift, i, where_.size(), scene_.exposures[i]));
            if (spec_.look.plates) plate = photograph(*object_, camera, mask, nullptr, spec_.look, place, {});
        }
        if (margin > 0) {
            const Intrinsics& own = cameras_[i].intrinsics;
            mask = io::distort(mask, margin, own, rig_.lens);
            for (Image8* picture : {&photo, &plate})
                if (!picture->empty()) *picture = io::distort(*picture, margin, own, rig_.lens);
        }
        const auto expose = [&](Image8& picture, uint64_t seed) {
            if (spec_.look.blur_px > 0) picture = io::blurred(picture, spec_.look.blur_px);
            if (spec_.look.noise > 0) add_sensor_noise(picture, spec_.look.noise, seed);
        };
        if (spec_.photos) {
            expose(photo, spec_.seed * 7919 + i);
            scene_.photos[i] = std::move(photo);
        }
        if (!plate.empty()) {
            expose(plate, spec_.seed * 6007 + i);
            scene_.plates[i] = std::move(plate);
        }
        if (spec_.damage.any()) {
            scene_.true_masks[i].coverage = mask;
            const double every = spec_.damage.share;
            const bool holes_here = std::floor((static_cast<double>(i) + 1) * every) > std::floor(static_cast<double>(i) * every);
            damage(mask, spec_.damage, holes_here, spec_.seed * 104729 + i);
        }
        scene_.masks[i].coverage = std::move(mask);
    }

    const SyntheticSpec& spec_;
    const Rig& rig_;
    const std::vector<Direction> where_;
    const std::vector<Hand> hands_;
    std::optional<Object> object_;
    double distance_ = 0;
    Intrinsics intrinsics_;
    Rigid3 scene_from_side_;  ///< the second sitting: the object tipped over about its middle; its cameras stand in the sitting's own frame
    std::vector<double> azimuths_;
    std::vector<Camera> cameras_;
    SyntheticScene scene_;
};

}  // namespace

SyntheticScene synthesize(const SyntheticSpec& spec, Progress& progress) {
    check_spec(spec);
    return Shoot(spec).run(progress);
}

std::vector<TrueColor> surface_colors(const SyntheticSpec& spec, const std::vector<Vec3d>& points) { return colors_at(spec, Object(spec), points); }

}  // namespace vdbcarve
