// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <openvdb/math/Transform.h>

namespace vdbcarve {

/// A transform of its own with the very same numbers: it shares the other's map, which is never changed once made. (Transform::copy()
/// makes a map anew, which can cost the voxel size its last bit.)
inline openvdb::math::Transform::Ptr same_transform(const openvdb::math::Transform& transform) { return std::make_shared<openvdb::math::Transform>(transform); }

}  // namespace vdbcarve
