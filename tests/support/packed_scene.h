// SPDX-License-Identifier: Apache-2.0
// A scene as a folder that needs no image library to read: cameras.txt, one PGM a mask and, where
// colour is wanted, one PPM a photograph, black outside the mask. For machines that tests and benchmarks are
// carried to.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/carve.h"
#include "vdbcarve/color.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"

namespace vdbcarve::test {

struct PackedScene {
    std::vector<std::string> names;
    std::vector<Camera> cameras;
    std::vector<Mask> masks;
    std::vector<Photo> photos;  ///< 8-bit RGB; none, or one a view
    Box3d bounds;

    std::vector<MaskView> mask_views() const;
    /// Without fields.
    std::vector<CarveInput> inputs() const;
    std::vector<ColorInput> color_inputs() const;
};

/// Throw Error. Numbers are written exactly, as hexadecimal floats.
void write_packed_scene(const std::filesystem::path& folder, const PackedScene& scene);
PackedScene read_packed_scene(const std::filesystem::path& folder);

}  // namespace vdbcarve::test
