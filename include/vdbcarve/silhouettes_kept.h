// SPDX-License-Identifier: Apache-2.0
// Whether depths and masks speak of the same object.
#pragma once

#include <vector>

#include "vdbcarve/fair.h"

namespace vdbcarve {

/// How far depths agree with the silhouettes: of the lines of sight one to two pixels inside a contour that the hull meets, the share that what the depths
/// carved meets, too; 1 where there are none. Exact masks give more than 0.95; masks that are larger than the object, or filled where one sees through it,
/// less. Of a dozen of the views. Errors like fair().
double silhouettes_kept(const openvdb::FloatGrid& hull, const FairEvidence& evidence, const std::vector<FairView>& views);

}  // namespace vdbcarve
