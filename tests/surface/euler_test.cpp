// SPDX-License-Identifier: Apache-2.0
#include "surface/euler.h"

#include <gtest/gtest.h>
#include <openvdb/tools/Composite.h>
#include <openvdb/tools/LevelSetPlatonic.h>
#include <openvdb/tools/LevelSetSphere.h>

#include <bit>
#include <random>

namespace vdbcarve::test {
namespace {

// Balls, a ball with a void, a ring, and voxels by chance against a count of single cells.
TEST(Euler, CountsHandles) {
    const auto ball = [](float radius, float x) {
        return openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(radius, openvdb::Vec3f(x, 3, -5), 1.f, 3.f);
    };
    EXPECT_EQ(euler_characteristic(*ball(30, 0)), 1);  // with tiles inside
    openvdb::FloatGrid::Ptr two = ball(10, 0);
    openvdb::tools::csgUnion(*two, *ball(9, 40));
    EXPECT_EQ(euler_characteristic(*two), 2);
    openvdb::FloatGrid::Ptr hollow = ball(20, 0);
    openvdb::tools::csgDifference(*hollow, *ball(8, 0));
    EXPECT_EQ(euler_characteristic(*hollow), 2);
    openvdb::FloatGrid::Ptr ring = ball(20, 0);
    openvdb::tools::csgDifference(*ring, *openvdb::tools::createLevelSetBox<openvdb::FloatGrid>(openvdb::BBoxd({-4, -1, -40}, {4, 7, 40}),
                                                                                                *openvdb::math::Transform::createLinearTransform(1), 3.f));
    EXPECT_EQ(euler_characteristic(*ring), 0);
    EXPECT_EQ(count_handles(*ring), 1);
    EXPECT_EQ(count_handles(*two), 0);

    std::mt19937 engine(5);
    openvdb::FloatGrid::Ptr chance = openvdb::FloatGrid::create(3.f);
    const openvdb::CoordBBox box({-9, -3, 2}, {14, 17, 23});
    for (auto c = box.begin(); c; ++c) chance->tree().setValue(*c, engine() % 3 ? 1.f : -1.f);
    const auto tree = chance->getConstAccessor();
    const auto all_inside = [&](const openvdb::Coord& at, int axes) {
        for (int n = 0; n < 8; ++n)
            if ((n & axes) == n && !(tree.getValue(at.offsetBy(n >> 2, n >> 1 & 1, n & 1)) < 0.f)) return 0L;
        return 1L;
    };
    long expected = 0;
    for (auto c = box.begin(); c; ++c)
        for (int axes = 0; axes < 8; ++axes) expected += (std::popcount(static_cast<unsigned>(axes)) % 2 ? -1 : 1) * all_inside(*c, axes);
    EXPECT_EQ(euler_characteristic(*chance), expected);
}

}  // namespace
}  // namespace vdbcarve::test
