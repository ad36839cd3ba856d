// SPDX-License-Identifier: Apache-2.0
#include "base/pixel_size.h"
#include "vdbcarve/geometry.h"

#include <Eigen/SVD>
#include <random>

#include "support/scenes.h"

namespace vdbcarve::test {
namespace {

Camera random_camera(std::mt19937& engine) {
    std::uniform_real_distribution<double> u(-1, 1);
    Camera c;
    c.intrinsics = {700 + 100 * u(engine), 650 + 100 * u(engine), 5 * u(engine), 320 + 20 * u(engine), 240 + 20 * u(engine), 640, 480, false};
    c.camera_from_world.rotation = rotation_from_quaternion(u(engine), u(engine), u(engine), u(engine));
    c.camera_from_world.translation = Vec3d(u(engine), u(engine), 4 + u(engine));
    return c;
}

TEST(Geometry, TransformsChainByTheirNames) {
    std::mt19937 engine(1);
    const Rigid3 b_from_a = random_camera(engine).camera_from_world, c_from_b = random_camera(engine).camera_from_world;
    const Vec3d x(0.3, -1, 2);
    EXPECT_LT(((c_from_b * b_from_a) * x - c_from_b * (b_from_a * x)).norm(), 1e-12);
    EXPECT_LT((b_from_a.inverse() * (b_from_a * x) - x).norm(), 1e-12);
    EXPECT_LT((b_from_a.matrix() * b_from_a.inverse().matrix() - Mat4d::Identity()).norm(), 1e-12);
}

TEST(Geometry, RaysGoThroughTheirPixels) {
    std::mt19937 engine(2);
    for (int n = 0; n < 100; ++n) {
        Camera c = random_camera(engine);
        c.intrinsics.orthographic = n % 2;
        const Vec2d pixel(17.25, 401.5);
        const Camera::Ray ray = c.ray(pixel);
        const auto back = c.project(ray.origin + 3.7 * ray.direction);
        ASSERT_TRUE(back);
        ASSERT_LT((*back - pixel).norm(), 1e-9);
        ASSERT_NEAR(ray.direction.norm(), 1, 1e-12);
    }
}

TEST(Geometry, SigmaMaxIsTheLargestSingularValue) {
    std::mt19937 engine(3);
    for (int n = 0; n < 100; ++n) {
        Intrinsics k = random_camera(engine).intrinsics;
        k.skew *= 40;
        const Eigen::JacobiSVD<Eigen::Matrix2d> svd(k.matrix().topLeftCorner<2, 2>().eval());
        ASSERT_NEAR(k.sigma_max(), svd.singularValues()[0], 1e-9);
    }
}

TEST(Geometry, ProjectionMatricesComeApartAgain) {
    std::mt19937 engine(4);
    for (int n = 0; n < 100; ++n) {
        const Camera c = random_camera(engine);
        Mat34d p;
        p << c.camera_from_world.rotation, c.camera_from_world.translation;
        p = (n % 2 ? -3.1 : 0.02) * c.intrinsics.matrix() * p;
        const DecomposedProjection d = decompose_projection(p);
        ASSERT_LT((d.k - c.intrinsics.matrix()).norm(), 1e-8);
        ASSERT_LT((d.camera_from_world.rotation - c.camera_from_world.rotation).norm(), 1e-10);
        ASSERT_LT((d.camera_from_world.translation - c.camera_from_world.translation).norm(), 1e-8);
    }
    EXPECT_THROW(decompose_projection(Mat34d::Zero()), InputError);
}

TEST(Geometry, LookAtPoint) {
    const Shoot s = shoot(small_spec("torus", 5, 16, 12));
    std::vector<Camera> cameras = s.scene.views.cameras();
    const auto target = look_at_point(cameras);
    ASSERT_TRUE(target);
    EXPECT_LT(target->norm(), 0.05);
    cameras.resize(1);
    EXPECT_FALSE(look_at_point(cameras));
}

TEST(Geometry, QuaternionsNeedNoUnitLengthButSome) {
    EXPECT_LT((rotation_from_quaternion(2, 0, 0, 2) - rotation_from_quaternion(0.5, 0, 0, 0.5)).norm(), 1e-12);
    EXPECT_THROW(rotation_from_quaternion(0, 0, 0, 0), InputError);
    EXPECT_FALSE(is_rotation(Vec3d(1, 1, -1).asDiagonal().toDenseMatrix()));
}

TEST(PixelSize, IsTheMedianOfTheCamerasThatHaveThePointBeforeThem) {
    Camera near;  // at the origin, along +z
    near.intrinsics = {100, 100, 0, 50, 50, 100, 100, false};
    Camera far = near, behind = near, tall = near, parallel = near;
    far.camera_from_world.translation = {0, 0, 6};
    behind.camera_from_world.translation = {0, 0, -10};
    tall.intrinsics.fy = 400;
    parallel.intrinsics.orthographic = true;
    const Vec3d point(0.5, 0, 2);
    EXPECT_EQ(pixel_size_at({}, point), 0);
    EXPECT_EQ(pixel_size_at({behind}, point), 0);
    EXPECT_DOUBLE_EQ(pixel_size_at({near}, point), 0.02);
    EXPECT_DOUBLE_EQ(pixel_size_at({near, behind, far, far}, point), 0.08);
    EXPECT_DOUBLE_EQ(pixel_size_at({tall}, point), 0.01);
    EXPECT_DOUBLE_EQ(pixel_size_at({parallel}, point), 0.01);
}

}  // namespace
}  // namespace vdbcarve::test
