// SPDX-License-Identifier: Apache-2.0
#include "align/orbit_model.h"

#include <cmath>
#include <numbers>

namespace vdbcarve {

Camera OrbitCamera::camera(int width_px, int height_px) const {
    Camera out;
    out.intrinsics.fx = fx;
    out.intrinsics.fy = fx * aspect;
    out.intrinsics.cx = cx;
    out.intrinsics.cy = cy;
    out.intrinsics.width_px = width_px;
    out.intrinsics.height_px = height_px;
    out.camera_from_world = {camera_from_world, -(camera_from_world * centre)};
    return out;
}

OrbitModel::OrbitModel(std::vector<OrbitView> views, int rings) : views_(std::move(views)), rings_(static_cast<size_t>(rings)) {
    all_.resize(first_of_views() + views_.size() * kViewParts);
}

Rigid3 OrbitModel::scene_from_ring(size_t r) const {
    Vec3d turn, shift;
    for (int a = 0; a < 3; ++a) {
        turn[a] = ring(r, static_cast<RingPart>(SittingTurn + a)).value;
        shift[a] = ring(r, static_cast<RingPart>(SittingShift + a)).value;
    }
    const double angle = turn.norm();
    return {angle > 0 ? Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix() : Mat3d::Identity().eval(), shift};
}

double OrbitModel::azimuth(size_t i) const {
    const OrbitView& v = views_[i];
    double out = std::exp(global(LnArc).value) * v.azimuth_rad + ring(static_cast<size_t>(v.ring), RingAzimuth).value + of(i, Azimuth).value;
    for (int h = 0; h < kHarmonics / 2; ++h) {
        const double phase = 2 * std::numbers::pi * (h + 1) * v.turn;
        out += harmonic(2 * h).value * std::sin(phase) + harmonic(2 * h + 1).value * (std::cos(phase) - 1);
    }
    return out;
}

double OrbitModel::focal_px(size_t i) const { return views_[i].focal_px * std::exp(global(LnFocal).value + of(i, ViewLnFocal).value); }

OrbitCamera OrbitModel::camera(size_t i) const {
    const OrbitView& v = views_[i];
    const auto r = static_cast<size_t>(v.ring);
    const Eigen::AngleAxisd tilt(of(i, Tilt).value + ring(r, RingTilt).value, Vec3d::UnitX());
    const Eigen::AngleAxisd roll(of(i, Roll).value + ring(r, RingRoll).value, Vec3d::UnitZ());
    const Eigen::AngleAxisd pan(of(i, Pan).value + ring(r, RingPan).value, Vec3d::UnitY());
    OrbitCamera out;
    out.fx = focal_px(i);
    out.aspect = v.aspect;
    out.cx = v.cx + global(CentreX).value + of(i, ViewCentreX).value;
    out.cy = v.cy + global(CentreY).value + of(i, ViewCentreY).value;
    if (v.camera_from_world) {
        const Mat3d& from = v.camera_from_world->rotation;
        const Vec3d centre = v.camera_from_world->inverse().translation;
        out.centre = centre + centre.norm() * (from.transpose() * Vec3d(of(i, Azimuth).value, -of(i, Height).value, -of(i, LnDistance).value));
        out.camera_from_world = (roll * tilt * pan).toRotationMatrix() * from;
        return out;
    }
    const double p = azimuth(i), e = ring(r, Elevation).value, d = std::exp(ring(r, RingDistance).value + of(i, LnDistance).value);
    const double sp = std::sin(p), cp = std::cos(p), se = std::sin(e), ce = std::cos(e);
    out.centre = {d * ce * cp, d * ce * sp, d * se + ring(r, RingHeight).value + of(i, Height).value};
    Mat3d look;
    look.row(0) = Vec3d(-sp, cp, 0);               // to the right
    look.row(1) = Vec3d(se * cp, se * sp, -ce);    // down
    look.row(2) = Vec3d(-ce * cp, -ce * sp, -se);  // forwards, to the axis
    out.camera_from_world = (roll * tilt * pan).toRotationMatrix() * look;
    const Rigid3 scene = scene_from_ring(r);
    out.camera_from_world = out.camera_from_world * scene.rotation.transpose();
    out.centre = scene * out.centre;
    return out;
}

std::vector<OrbitCamera> OrbitModel::cameras() const {
    std::vector<OrbitCamera> out;
    for (size_t i = 0; i < views_.size(); ++i) out.push_back(camera(i));
    return out;
}

std::vector<size_t> OrbitModel::free() const {
    std::vector<size_t> out;
    for (size_t p = 0; p < all_.size(); ++p)
        if (all_[p].free()) out.push_back(p);
    return out;
}

double OrbitModel::prior_cost() const {
    double sum = 0;
    for (const Parameter& p : all_) sum += p.prior_cost();
    return sum;
}

std::vector<std::vector<CameraColumn>> OrbitModel::columns() const {
    constexpr double kStep = 1e-5;
    std::vector<std::vector<CameraColumn>> out(views_.size());
    OrbitModel moved = *this;
    const std::vector<size_t> which = free();
    for (size_t column = 0; column < which.size(); ++column) {
        const size_t p = which[column];
        size_t first = 0, last = views_.size();
        int only_ring = -1;
        if (p >= first_of_views()) {
            first = (p - first_of_views()) / kViewParts;
            last = first + 1;
        } else if (p >= static_cast<size_t>(kGlobals)) {
            only_ring = static_cast<int>((p - static_cast<size_t>(kGlobals)) / kRingParts);
        }
        const double value = all_[p].value;
        for (size_t i = first; i < last; ++i) {
            if (only_ring >= 0 && views_[i].ring != only_ring) continue;
            moved.all_[p].value = value + kStep;
            const OrbitCamera more = moved.camera(i);
            moved.all_[p].value = value - kStep;
            const OrbitCamera less = moved.camera(i);
            const double scale = 1 / (2 * kStep);
            const Mat3d turn = more.camera_from_world * less.camera_from_world.transpose();
            CameraColumn c;
            c.parameter = static_cast<int>(column);
            // The antisymmetric part of a small rotation is its vector.
            c.direction = {0.5 * (turn(2, 1) - turn(1, 2)) * scale,
                           0.5 * (turn(0, 2) - turn(2, 0)) * scale,
                           0.5 * (turn(1, 0) - turn(0, 1)) * scale,
                           (more.centre.x() - less.centre.x()) * scale,
                           (more.centre.y() - less.centre.y()) * scale,
                           (more.centre.z() - less.centre.z()) * scale,
                           std::log(more.fx / less.fx) * scale,
                           (more.cx - less.cx) * scale,
                           (more.cy - less.cy) * scale};
            out[i].push_back(c);
        }
        moved.all_[p].value = value;
    }
    return out;
}

}  // namespace vdbcarve
