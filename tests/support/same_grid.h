// SPDX-License-Identifier: Apache-2.0
// Grids compared node by node: leaves with all their values as bits, active or not, and every tile above them.
#pragma once

#include <gtest/gtest.h>
#include <openvdb/openvdb.h>

#include <cstring>

namespace vdbcarve::test {

template <class Grid>
void expect_same(const Grid& a, const Grid& b) {
    using Value = typename Grid::ValueType;
    using Tiles = typename Grid::TreeType::ValueAllCIter;
    EXPECT_EQ(a.getName(), b.getName());
    EXPECT_EQ(a.getGridClass(), b.getGridClass());
    EXPECT_EQ(a.background(), b.background());
    EXPECT_EQ(a.transform(), b.transform());
    EXPECT_EQ(a.tree().nodeCount(), b.tree().nodeCount());
    EXPECT_TRUE(a.tree().hasSameTopology(b.tree()));
    size_t leaves = 0, differing = 0;
    auto other = b.tree().cbeginLeaf();
    for (auto leaf = a.tree().cbeginLeaf(); leaf; ++leaf, ++other) {
        ASSERT_TRUE(other);
        ASSERT_EQ(leaf->origin(), other->origin());
        ASSERT_TRUE(leaf->valueMask() == other->valueMask()) << leaf->origin();
        const Value *x = leaf->buffer().data(), *y = other->buffer().data();
        for (openvdb::Index n = 0; n < leaf->size(); ++n) differing += std::memcmp(x + n, y + n, sizeof(Value)) != 0;
        ++leaves;
    }
    EXPECT_FALSE(other);
    EXPECT_EQ(differing, 0u) << "values of " << leaves << " leaves";
    size_t tiles = 0;
    auto there = b.tree().cbeginValueAll();
    there.setMaxDepth(Tiles::LEAF_DEPTH - 1);
    auto here = a.tree().cbeginValueAll();
    here.setMaxDepth(Tiles::LEAF_DEPTH - 1);
    for (; here && there; ++here, ++there) tiles += here.getCoord() != there.getCoord() || *here != *there || here.isValueOn() != there.isValueOn();
    EXPECT_EQ(static_cast<bool>(here), static_cast<bool>(there));
    EXPECT_EQ(tiles, 0u);
}

}  // namespace vdbcarve::test
