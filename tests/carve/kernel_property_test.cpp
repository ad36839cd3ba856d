// SPDX-License-Identifier: Apache-2.0
// The bounds of kernel/carve.h, derived in docs/stages/derivations.md, tried on random cameras, balls and fields.
#include "vdbcarve/kernel/carve.h"

#include <random>

#include "support/scenes.h"

namespace vdbcarve::test {
namespace {

using namespace kernel;

struct Random {
    std::mt19937_64 engine{17};
    double operator()(double lo, double hi) { return lo + (hi - lo) * static_cast<double>(engine() >> 11) * 0x1p-53; }
    Vec3d in_ball(double radius) {
        for (;;) {
            const Vec3d p((*this)(-1, 1), (*this)(-1, 1), (*this)(-1, 1));
            if (p.norm() <= 1) return radius * p;
        }
    }
};

// DELTA of a ball bounds the displacement of every projected point, and is attained.
TEST(BallSpread, BoundsEveryProjectionAndIsAttained) {
    Random random;
    double tightest = 0;
    for (int n = 0; n < 3000; ++n) {
        const Vec3d c(random(-3, 3), random(-3, 3), random(0.5, 6));
        const double rho = random(0.01, 0.95) * c.z();
        if (c.squaredNorm() - rho * rho <= 0) continue;
        const double spread = ball_spread({c.x(), c.y(), c.z(), rho});
        const Eigen::Vector2d m(c.x() / c.z(), c.y() / c.z());
        double worst = 0;
        for (int s = 0; s < 400; ++s) {
            Vec3d p;
            if (s % 2) {
                p = c + rho * random.in_ball(1).normalized();
            } else {
                // In the plane through the axis and the centre, where the largest displacement lies.
                const Vec3d radial = Vec3d(c.x(), c.y(), 0).normalized();
                const double a = s * 2 * 3.14159265358979 / 400;
                p = c + rho * (std::cos(a) * radial + std::sin(a) * Vec3d::UnitZ());
            }
            if (p.z() <= 0) continue;
            worst = std::max(worst, (Eigen::Vector2d(p.x() / p.z(), p.y() / p.z()) - m).norm());
        }
        ASSERT_LE(worst, spread * (1 + 1e-9));
        tightest = std::max(tightest, worst / spread);
    }
    EXPECT_GT(tightest, 0.999);
}

struct Bench {
    Shoot shoot_;
    std::vector<CarveView> views;
    CarveOptions options;
};

Bench make_bench(bool ortho, Outside outside) {
    SyntheticSpec spec = small_spec("ellipsoids", 5);
    spec.rig.orthographic = ortho;
    spec.rig.fill = 1.2;
    spec.rig.pixel_aspect = 1.3;
    Bench s{shoot(spec,
                  [](SyntheticScene& scene) {
                      for (View& v : scene.views.views) v.camera.intrinsics.skew = 0.1 * v.camera.intrinsics.fx;
                      Mask& m = scene.masks[1];
                      m.ignore = Image8(m.coverage.width, m.coverage.height);
                      for (int y = 30; y < 70; ++y)
                          for (int x = 10; x < 40; ++x) m.ignore.at(x, y) = 255;
                  }),
            {},
            {}};
    s.options = options_for(s.shoot_, 40);
    s.options.outside = outside;
    for (const CarveInput& i : s.shoot_.inputs) s.views.push_back(make_carve_view(i, s.options));
    return s;
}

class NodeBounds : public testing::TestWithParam<std::pair<bool, Outside>> {};

// OUT, IN and the unseen answers hold at every voxel of the node, in frame or not, behind the camera or not.
TEST_P(NodeBounds, HoldAtEveryVoxel) {
    const Bench s = make_bench(GetParam().first, GetParam().second);
    Random random;
    const double h = s.options.lattice.voxel_size;
    const float near_depth = kNearPlane_vox * static_cast<float>(h);
    size_t decided = 0, unseen_decided = 0;
    for (int n = 0; n < 40000; ++n) {
        const CarveView& view = s.views[static_cast<size_t>(n) % s.views.size()];
        const int size = 8 << (n % 3);
        const double band = h * (n % 4);
        const double reach = n % 5 == 0 ? 200 : 60;
        const int o[3] = {static_cast<int>(random(-reach, reach)) & ~7, static_cast<int>(random(-reach, reach)) & ~7,
                          static_cast<int>(random(-reach, reach)) & ~7};
        const double half = 0.5 * (size - 1);
        const NodeAnswers a = node_answers(view, node_ball(view, o[0] + half, o[1] + half, o[2] + half, std::sqrt(3.0) * half * h), near_depth, band);
        decided += a.hull != NodeAnswer::Mixed;
        unseen_decided += a.unseen != NodeAnswer::Mixed;
        if (a.hull == NodeAnswer::Mixed && a.unseen == NodeAnswer::Mixed) continue;
        // A band of zero is the binary model's question.
        const float value_band = static_cast<float>(band > 0 ? band : h);
        for (int t = 0; t < 40; ++t) {
            // Corners first, then anywhere.
            const int i = t < 8 ? (t & 1) * (size - 1) : static_cast<int>(random(0, size)),
                      j = t < 8 ? (t >> 1 & 1) * (size - 1) : static_cast<int>(random(0, size)),
                      k = t < 8 ? (t >> 2) * (size - 1) : static_cast<int>(random(0, size));
            const Vec3 p = voxel_in_camera(leaf_to_camera(view, (o[0] + i) & ~7, (o[1] + j) & ~7, (o[2] + k) & ~7), static_cast<float>((o[0] + i) & 7),
                                           static_cast<float>((o[1] + j) & 7), static_cast<float>((o[2] + k) & 7));
            if (band > 0) {
                const float v = view_value(view, p, near_depth, value_band), e = unseen_value(view, p, near_depth, value_band);
                if (a.hull == NodeAnswer::Out) {
                    ASSERT_EQ(v, value_band);
                }
                if (a.hull == NodeAnswer::In) {
                    ASSERT_EQ(v, -value_band);
                }
                if (a.unseen == NodeAnswer::Out) {
                    ASSERT_EQ(e, value_band);
                }
                if (a.unseen == NodeAnswer::In) {
                    ASSERT_EQ(e, -value_band);
                }
            } else {
                const BinaryAnswer b = binary_answer(view, p, near_depth);
                if (a.hull != NodeAnswer::Mixed) {
                    ASSERT_EQ(b.background, a.hull == NodeAnswer::Out);
                }
                if (a.unseen != NodeAnswer::Mixed) {
                    ASSERT_EQ(b.seen, a.unseen == NodeAnswer::In);
                }
            }
        }
    }
    EXPECT_GT(decided, 5000u);
    EXPECT_GT(unseen_decided, 5000u);
}

INSTANTIATE_TEST_SUITE_P(Cameras, NodeBounds,
                         testing::Values(std::pair{false, Outside::Unknown}, std::pair{false, Outside::Background}, std::pair{true, Outside::Unknown},
                                         std::pair{true, Outside::Background}));

// No jump anywhere: across the frame's border, the camera plane and the near plane the value changes by at most
// a small multiple of the step. Without this a sign could flip between two voxels with no band between them.
TEST(ViewValue, IsContinuousInSign) {
    for (const Outside outside : {Outside::Unknown, Outside::Background}) {
        const Bench s = make_bench(false, outside);
        Random random;
        const float h = static_cast<float>(s.options.lattice.voxel_size), band = 3 * h, near_depth = kNearPlane_vox * h;
        for (int n = 0; n < 300000; ++n) {
            const CarveView& view = s.views[static_cast<size_t>(n) % s.views.size()];
            const Vec3d p(random(-4, 4), random(-4, 4), n % 3 ? random(-0.5, 6) : random(-2 * h, 2 * h)),
                q = p + random.in_ball(1).normalized() * static_cast<double>(h);
            const auto f = [&](const Vec3d& x) {
                return view_value(view, {static_cast<float>(x.x()), static_cast<float>(x.y()), static_cast<float>(x.z())}, near_depth, band);
            };
            const float a = f(p), b = f(q);
            // Opposite sides one voxel apart: both must still be within the band.
            if ((a < 0) != (b < 0)) {
                ASSERT_LT(std::fabs(a), band) << p.transpose() << " | " << q.transpose();
                ASSERT_LT(std::fabs(b), band) << p.transpose() << " | " << q.transpose();
            }
        }
    }
}

// v is the distance to the plane through the camera centre and the silhouette line: checked on a straight edge.
TEST(ViewValue, IsTheDistanceToTheConesPlane) {
    Random random;
    for (int n = 0; n < 50; ++n) {
        const double angle = random(0, 6.28), cx = random(90, 110), cy = random(70, 80), skew = random(-20, 20);
        const Vec2d normal(std::cos(angle), std::sin(angle));
        std::vector<int16_t> samples;
        for (int y = 0; y < 150; ++y)
            for (int x = 0; x < 200; ++x) samples.push_back(static_cast<int16_t>(std::lround(64 * normal.dot(Vec2d(x + 0.5 - cx, y + 0.5 - cy)))));
        CarveView view{};
        view.fx = 180, view.fy = 150, view.skew = static_cast<float>(skew), view.cx = 100, view.cy = 75;
        view.sigma_max = static_cast<float>(Intrinsics{180, 150, skew, 100, 75, 200, 150, false}.sigma_max());
        view.frame_width = 200, view.frame_height = 150;
        view.silhouette = {samples.data(), 200, 150, 0, 0, 400, nullptr, 0, -1e30f, -1e30f, 1e30f, 1e30f};
        // The plane in camera space: n . (A m + c - line) = 0 for m = (X, Y) / Z.
        const Vec3d plane(normal.x() * 180, normal.x() * skew + normal.y() * 150, normal.dot(Vec2d(100 - cx, 75 - cy)));
        for (int t = 0; t < 200; ++t) {
            const double z = random(2, 5);
            const Vec3d p(z * random(-0.4, 0.4), z * random(-0.35, 0.35), z);
            const double exact = plane.dot(p) / plane.norm();
            if (std::fabs(exact) > 0.05) continue;
            const float v = view_value(view, {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())}, 1e-4f, 1.f);
            // Samples are rounded to 1/64 px, a pixel is z / 150 at most; the rounded gradient is off by 1/64 in length and direction.
            ASSERT_NEAR(v, exact, 1.0 / 64 * z / 150 + 5e-3 * std::fabs(exact));
        }
    }
}

TEST(FrameDistance, EqualsTheDistanceToTheRectangle) {
    Random random;
    for (int n = 0; n < 20000; ++n) {
        const double u = random(-60, 160), v = random(-50, 130);
        const PixelDistance d = frame_distance(static_cast<float>(u), static_cast<float>(v), 100, 80);
        const double dx = std::max({-u, u - 100, 0.0}), dy = std::max({-v, v - 80, 0.0});
        const double exact = dx > 0 || dy > 0 ? std::hypot(dx, dy) : -std::min({u, 100 - u, v, 80 - v});
        ASSERT_NEAR(d.value_px, exact, 1e-4);
        ASSERT_NEAR(std::hypot(d.nx, d.ny), 1, 1e-5);
    }
    EXPECT_TRUE(std::isfinite(frame_distance(3e30f, 1e30f, 100, 80).value_px));
}

TEST(BoxDistance, EqualsBruteForce) {
    const double lo[3] = {-1, 0, 2}, hi[3] = {1, 3, 2.5};
    Random random;
    for (int n = 0; n < 2000; ++n) {
        const double p[3] = {random(-3, 3), random(-2, 5), random(0, 5)};
        double outside2 = 0, inside = -1e9;
        for (int a = 0; a < 3; ++a) {
            outside2 += std::pow(std::max({lo[a] - p[a], p[a] - hi[a], 0.0}), 2);
            inside = std::max({inside, lo[a] - p[a], p[a] - hi[a]});
        }
        ASSERT_NEAR(box_distance(p, lo, hi), outside2 > 0 ? std::sqrt(outside2) : inside, 1e-12);
    }
}

}  // namespace
}  // namespace vdbcarve::test
