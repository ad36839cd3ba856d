// SPDX-License-Identifier: Apache-2.0
#include "synthetic/photograph.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "synthetic/noise.h"
#include "vdbcarve/color_space.h"

namespace vdbcarve::synth {
namespace {

/// Linear light from the room, as a function of the viewing direction.
Vec3d room(const Vec3d& d) {
    const double n = noise(6 * d + Vec3d(31, 7, 3)), m = noise(17 * d + Vec3d(5, 11, 40));
    const double wall = 0.10 + 0.25 * n + 0.08 * m, floor = d.z() < -0.1 ? 0.7 : 1.0;
    const double stripe = std::sin(14 * std::atan2(d.y(), d.x())) > 0.6 ? 0.6 : 1.0;
    return floor * stripe * wall * Vec3d(0.9, 1.0, 1.05 + 0.3 * m);
}

}  // namespace

Room room_of(const Rig& rig, double azimuth_rad, const Mat3d& side_from_scene) {
    Room place;
    place.up_scene = side_from_scene.transpose() * Vec3d::UnitZ();
    place.room_from_scene = side_from_scene;
    if (rig.motion == Rig::Motion::Turntable) place.room_from_scene = Mat3d(Eigen::AngleAxisd(-azimuth_rad, Vec3d::UnitZ())) * side_from_scene;
    return place;
}

Image8 photograph(const Object& object, const Camera& camera, const Image8& coverage, const Object::Surface* surface, const PhotoLook& look, const Room& place,
                  const Lamps& lamps) {
    const Intrinsics& k = camera.intrinsics;
    Image8 out(k.width_px, k.height_px, 3);
    const Vec3d key = place.key();
    const double foot = look.table ? object.lowest(place.up_scene) : 0;
    const auto shade = [&](const SurfacePoint& p, const Vec3d& to_eye) {
        const double highlight =
            look.gloss > 0 && p.normal.dot(key) > 0 ? look.gloss * std::pow(std::max(0.0, p.normal.dot((key + to_eye).normalized())), 60) : 0;
        const Vec3d spilt = look.backdrop ? Vec3d(look.spill * std::pow(1 - std::max(0.0, p.normal.dot(to_eye)), 2) * *look.backdrop) : Vec3d::Zero();
        return Vec3d(place.diffuse(p.normal, look) * object.albedo_at(p) + Vec3d::Constant(highlight) + spilt);
    };
    // What a ray sees past the object: the room, or the table with the object's shadow and reflection.
    const auto beyond = [&](const Camera::Ray& ray) -> Vec3d {
        const double down = ray.direction.dot(place.up_scene), above = ray.origin.dot(place.up_scene) - foot;
        if (look.table && down < -1e-6 && above > 0) {
            const Vec3d p = ray.origin - above / down * ray.direction;
            const Vec3d from_middle = p - object.centre() - (p - object.centre()).dot(place.up_scene) * place.up_scene;
            if (from_middle.norm() < 3 * object.radius()) {
                const Vec3d lifted = p + 1e-4 * object.radius() * place.up_scene;
                const double grain = noise(8 * (place.room_from_scene * from_middle) / object.radius());
                Vec3d wood = (0.5 + 0.3 * grain) * Vec3d(0.45, 0.33, 0.22);
                if (surface && object.hit({lifted, key})) wood *= 0.35;
                if (surface && look.table_reflection > 0)
                    if (const auto t = object.hit({lifted, (ray.direction - 2 * down * place.up_scene).normalized()}))
                        wood = (1 - look.table_reflection) * wood +
                               look.table_reflection * 0.7 *
                                   albedo((lifted + *t * (ray.direction - 2 * down * place.up_scene) - object.centre()) / object.radius(), object.pattern());
                return wood;
            }
        }
        const Vec3d towards = place.room_from_scene * ray.direction;
        // Folds, and light that falls off to the sides.
        if (look.backdrop) return (0.75 + 0.35 * noise(3 * towards) + 0.1 * towards.x()) * *look.backdrop;
        return room(towards);
    };
    for (int y = 0; y < k.height_px; ++y)
        for (int x = 0; x < k.width_px; ++x) {
            const Camera::Ray ray = camera.ray({x + 0.5, y + 0.5});
            const double alpha = surface ? coverage.at(x, y) / 255.0 : 0;
            Vec3d light = alpha < 1 ? beyond(ray) : Vec3d::Zero().eval();
            if (alpha > 0) {
                // A pixel that is partly covered but whose centre sees past takes a neighbour's surface.
                const SurfacePoint* point = nullptr;
                for (const auto& [dx, dy] : {std::pair{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}}) {
                    const int nx = x + dx, ny = y + dy;
                    if (nx < 0 || ny < 0 || nx >= k.width_px || ny >= k.height_px) continue;
                    const auto& s = (*surface)[static_cast<size_t>(ny) * static_cast<size_t>(k.width_px) + static_cast<size_t>(nx)];
                    if (s) {
                        point = &*s;
                        break;
                    }
                }
                if (point) light = (1 - alpha) * light + alpha * shade(*point, -ray.direction);
            }
            const double here = 1 + lamps.across * (2 * (x + 0.5) / k.width_px - 1);
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = srgb8_from_linear(here * lamps.gain[c] * light[c]);
        }
    return out;
}

void add_sensor_noise(Image8& photo, double sigma, uint64_t seed) {
    for (size_t i = 0; i < photo.data.size(); ++i)
        photo.data[i] = static_cast<uint8_t>(
            std::clamp(std::lround(photo.data[i] + sigma * wobble(static_cast<int>(i % 65521), static_cast<int>(i / 65521), 0, seed)), 0L, 255L));
}

}  // namespace vdbcarve::synth
