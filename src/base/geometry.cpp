// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/geometry.h"

#include <Eigen/Dense>
#include <Eigen/SVD>
#include <cmath>
#include <numbers>

#include "vdbcarve/error.h"

namespace vdbcarve {

Mat4d Rigid3::matrix() const {
    Mat4d m = Mat4d::Identity();
    m.topLeftCorner<3, 3>() = rotation;
    m.topRightCorner<3, 1>() = translation;
    return m;
}

Mat3d Intrinsics::matrix() const {
    Mat3d k;
    k << fx, skew, cx, 0, fy, cy, 0, 0, 1;
    return k;
}

double Intrinsics::sigma_max() const {
    // Closed form of the larger singular value of [fx skew; 0 fy].
    const double sum = fx * fx + fy * fy + skew * skew;
    const double det = fx * fy;
    return std::sqrt(0.5 * (sum + std::sqrt(std::max(0.0, sum * sum - 4 * det * det))));
}

std::optional<Vec2d> Camera::project(const Vec3d& point_world) const {
    const Vec3d p = camera_from_world * point_world;
    const Intrinsics& k = intrinsics;
    if (k.orthographic) return Vec2d(k.fx * p.x() + k.skew * p.y() + k.cx, k.fy * p.y() + k.cy);
    if (p.z() <= 0) return std::nullopt;
    const double mx = p.x() / p.z(), my = p.y() / p.z();
    return Vec2d(k.fx * mx + k.skew * my + k.cx, k.fy * my + k.cy);
}

Camera::Ray Camera::ray(const Vec2d& pixel) const {
    const Intrinsics& k = intrinsics;
    const double my = (pixel.y() - k.cy) / k.fy;
    const double mx = (pixel.x() - k.cx - k.skew * my) / k.fx;
    const Rigid3 world_from_camera = camera_from_world.inverse();
    if (k.orthographic) return {world_from_camera * Vec3d(mx, my, 0), forward_world()};
    return {world_from_camera.translation, (world_from_camera.rotation * Vec3d(mx, my, 1)).normalized()};
}

bool Lens::distorts() const {
    if (model == Model::None) return false;
    // A fisheye bends rays even with all coefficients zero.
    if (model == Model::OpenCVFisheye) return true;
    for (double c : coefficients)
        if (c != 0) return true;
    return false;
}

DecomposedProjection decompose_projection(const Mat34d& projection) {
    const Mat3d m = projection.leftCols<3>();
    const double scale = m.norm();
    if (!(scale > 0) || !std::isfinite(scale) || std::abs(m.determinant()) < 1e-14 * scale * scale * scale)
        throw InputError("a projection matrix is not finite or its left 3x3 block is singular");
    // RQ by QR of the reversed transpose: with J the row reversal, (J m)^T = Q R gives m = (J R^T J)(J Q^T).
    const Mat3d reversal = Mat3d::Identity().rowwise().reverse();
    const Eigen::HouseholderQR<Mat3d> qr((reversal * m).transpose());
    const Mat3d q = qr.householderQ();
    const Mat3d r = qr.matrixQR().triangularView<Eigen::Upper>();
    Mat3d k = reversal * r.transpose() * reversal;
    Mat3d rotation = reversal * q.transpose();
    for (int i = 0; i < 3; ++i) {
        if (k(i, i) < 0) {
            k.col(i) *= -1;
            rotation.row(i) *= -1;
        }
    }
    // m = k * rotation with k(i,i) > 0. P is defined up to a factor, its sign included: det R = +1 picks it.
    const double sign = rotation.determinant() < 0 ? -1.0 : 1.0;
    DecomposedProjection out;
    out.camera_from_world.rotation = sign * rotation;
    out.camera_from_world.translation = sign * k.triangularView<Eigen::Upper>().solve(projection.col(3));
    out.k = k / k(2, 2);
    return out;
}

std::optional<Vec3d> point_nearest_to(const std::vector<Camera::Ray>& rays, double least_parallax) {
    Mat3d normal = Mat3d::Zero();
    Vec3d right = Vec3d::Zero();
    for (const Camera::Ray& ray : rays) {
        const Mat3d across = Mat3d::Identity() - ray.direction * ray.direction.transpose();
        normal += across;
        right += across * ray.origin;
    }
    const Eigen::SelfAdjointEigenSolver<Mat3d> eigen(normal);
    if (rays.size() < 2 || eigen.eigenvalues()[0] < least_parallax * eigen.eigenvalues()[2]) return std::nullopt;
    return normal.ldlt().solve(right);
}

std::optional<Vec3d> look_at_point(const std::vector<Camera>& cameras) {
    std::vector<Camera::Ray> axes;
    for (const Camera& camera : cameras) axes.push_back({camera.centre_world(), camera.forward_world()});
    return point_nearest_to(axes, 1e-4);
}

Mat3d rotation_from_quaternion(double w, double x, double y, double z) {
    const Eigen::Quaterniond q(w, x, y, z);
    if (!(q.norm() > 0) || !std::isfinite(q.norm())) throw InputError("a rotation quaternion is zero or not finite");
    return q.normalized().toRotationMatrix();
}

Mat3d turned(const Vec3d& degrees) {
    const Vec3d r = degrees * std::numbers::pi / 180;
    return (Eigen::AngleAxisd(r.z(), Vec3d::UnitZ()) * Eigen::AngleAxisd(r.y(), Vec3d::UnitY()) * Eigen::AngleAxisd(r.x(), Vec3d::UnitX())).toRotationMatrix();
}

bool is_rotation(const Mat3d& m, double tolerance) {
    return m.allFinite() && (m * m.transpose() - Mat3d::Identity()).cwiseAbs().maxCoeff() < tolerance && m.determinant() > 0;
}

Mat3d nearest_rotation(const Mat3d& m) {
    const Eigen::JacobiSVD<Mat3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
    return svd.matrixU() * svd.matrixV().transpose();
}

}  // namespace vdbcarve
