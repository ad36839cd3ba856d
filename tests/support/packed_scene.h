// SPDX-License-Identifier: Apache-2.0
// A scene as a folder that needs no image library to read: cameras.txt and one PGM a mask. For machines that tests and benchmarks are
// carried to.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/carve.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"

namespace vdbcarve::test {

struct PackedScene {
    std::vector<std::string> names;
    std::vector<Camera> cameras;
    std::vector<Mask> masks;
    Box3d bounds;

    std::vector<MaskView> mask_views() const;
    /// Without fields.
    std::vector<CarveInput> inputs() const;
};

/// Throw Error. Numbers are written exactly, as hexadecimal floats.
void write_packed_scene(const std::filesystem::path& folder, const PackedScene& scene);
PackedScene read_packed_scene(const std::filesystem::path& folder);

}  // namespace vdbcarve::test
