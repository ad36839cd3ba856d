// SPDX-License-Identifier: Apache-2.0
// Depths made of the truth: what fair() takes where photographs would be too slow.
#pragma once

#include <openvdb/openvdb.h>

#include "vdbcarve/fair.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve::test {

struct DepthScene {
    openvdb::FloatGrid::Ptr carved, confidence;

    FairEvidence evidence() const { return {*carved, *confidence}; }
};

/// The hull, carved where x is above `sure_from` by a closed mesh whose distances are off by up to `noise_vox`. There depths are sure within two voxels of it.
DepthScene depth_scene(const openvdb::FloatGrid& hull, const Mesh& truth, double noise_vox, double sure_from);

}  // namespace vdbcarve::test
