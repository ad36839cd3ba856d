// SPDX-License-Identifier: Apache-2.0
// Cameras and rigid transforms.
//
// Conventions, owned here: camera axes are OpenCV's (x right, y down, z forward). Image coordinates are in
// pixels with the centre of the first pixel at (0.5, 0.5), so an image covers [0, width] x [0, height].
// A transform `b_from_a` takes coordinates in frame a to frame b.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <optional>
#include <string>
#include <vector>

namespace vdbcarve {

using Vec2d = Eigen::Vector2d;
using Vec3d = Eigen::Vector3d;
using Mat3d = Eigen::Matrix3d;
using Mat34d = Eigen::Matrix<double, 3, 4>;
using Mat4d = Eigen::Matrix4d;
using Box3d = Eigen::AlignedBox3d;

/// x_b = rotation * x_a + translation.
struct Rigid3 {
    Mat3d rotation = Mat3d::Identity();
    Vec3d translation = Vec3d::Zero();

    Vec3d operator*(const Vec3d& x) const { return rotation * x + translation; }
    Rigid3 operator*(const Rigid3& b_from_a) const { return {rotation * b_from_a.rotation, rotation * b_from_a.translation + translation}; }
    Rigid3 inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }
    Mat4d matrix() const;
};

/// [fx skew cx; 0 fy cy; 0 0 1], in pixels; an orthographic camera has fx, fy in pixels per world unit.
struct Intrinsics {
    double fx = 0, fy = 0, skew = 0, cx = 0, cy = 0;
    int width_px = 0, height_px = 0;
    bool orthographic = false;

    Mat3d matrix() const;
    /// Largest factor by which [fx skew; 0 fy] stretches any direction.
    double sigma_max() const;
};

/// A camera after lens distortion was removed.
struct Camera {
    Intrinsics intrinsics;
    Rigid3 camera_from_world;

    Vec3d centre_world() const { return camera_from_world.inverse().translation; }
    /// Unit viewing direction (camera z) in world coordinates.
    Vec3d forward_world() const { return camera_from_world.rotation.row(2).transpose(); }
    /// Image position of a world point, or nothing where it is not in front of the camera.
    std::optional<Vec2d> project(const Vec3d& point_world) const;
    /// Ray through an image point: origin and unit direction, world.
    struct Ray {
        Vec3d origin, direction;
    };
    Ray ray(const Vec2d& pixel) const;
};

/// Lens distortion, named and parametrised as COLMAP does; coefficients in the model's own order.
struct Lens {
    enum class Model { None, SimpleRadial, Radial, OpenCV, OpenCVFisheye, FullOpenCV };
    Model model = Model::None;
    std::vector<double> coefficients;
    bool distorts() const;
};

/// x_to = scale * rotation * x_from + translation.
struct Similarity {
    double scale = 1;
    Mat3d rotation = Mat3d::Identity();
    Vec3d translation = Vec3d::Zero();
    Vec3d operator*(const Vec3d& x) const { return scale * (rotation * x) + translation; }
};

/// K, R, t of a finite projective camera: P ~ K [R | t], by RQ decomposition. K has a positive diagonal
/// and K(2,2) = 1. The overall sign of P is chosen so that det R = +1.
struct DecomposedProjection {
    Mat3d k;
    Rigid3 camera_from_world;
};
/// Throws InputError when P's left 3x3 block is singular.
DecomposedProjection decompose_projection(const Mat34d& projection);

/// The point closest, in the sense of least squares, to all rays (unit directions); nothing where they are parallel: the
/// smallest eigenvalue of the normal matrix is below `least_parallax` of the largest.
std::optional<Vec3d> point_nearest_to(const std::vector<Camera::Ray>& rays, double least_parallax);
/// The same for the optical axes.
std::optional<Vec3d> look_at_point(const std::vector<Camera>& cameras);

/// Rotation from a quaternion that need not be of unit length. Throws InputError where it is zero.
Mat3d rotation_from_quaternion(double w, double x, double y, double z);

/// Turns about x, then y, then z.
Mat3d turned(const Vec3d& degrees);

/// True when the matrix is a rotation within the tolerance (orthonormal, determinant +1).
bool is_rotation(const Mat3d& m, double tolerance = 1e-3);
/// The rotation nearest to a matrix (polar decomposition).
Mat3d nearest_rotation(const Mat3d& m);

}  // namespace vdbcarve
