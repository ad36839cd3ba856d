// SPDX-License-Identifier: Apache-2.0
// Axes and units of all files.
#pragma once

#include <openvdb/openvdb.h>

#include <array>
#include <optional>
#include <string>

#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// The program that files are made for: name of the colour grid, axes and units of all of them.
enum class Dcc {
    None,     ///< the scene's own, as far as the format lets it
    Blender,  ///< z up, metres; color
    Houdini,  ///< y up, metres; Cd
    Maya      ///< y up, centimetres; color
};
const char* color_grid_name(Dcc dcc);

/// How coordinates in a file come from the scene's: x_file = scale * axes * x_scene.
struct FileFrame {
    std::array<std::array<int, 3>, 3> axes{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};  ///< a rotation of -1, 0 and 1
    double scale = 1;
    std::string up;     ///< of the file's coordinates; empty: unknown
    std::string units;  ///< m, cm, mm or the scene's own; empty: unknown
    bool operator==(const FileFrame&) const = default;
    bool moves() const;  ///< whether any point changes
};

/// Metres to a unit ("m", "cm", "mm", "km", "inch", "ft" and their longer names), or nothing where it is not known.
std::optional<double> metres_per(const std::string& unit);

/// What a scene's axis and unit are, and what files are wanted for.
struct FrameRequest {
    std::string up;  ///< x, y, z, -x, -y, -z; empty: unknown
    std::string units;
    Dcc dcc = Dcc::None;
    bool stl_mm = false;
};

/// The frame of files with an extension. .obj and .glb are turned to y up, always: their readers turn them back; .glb is in metres where the unit is known.
/// The rest is the scene's, or what `dcc` says. Axes and units that are not known stay as they are. Throws UsageError for another up axis, and for
/// stl_mm where the unit is not known.
FileFrame file_frame(const std::string& extension, const FrameRequest& request);

/// What is not known of a file's frame although its readers will assume it, and the remedy; empty where all is known, or nobody assumes.
std::string unknown_frame(const std::string& extension, const FrameRequest& request);

/// OpenVDB calls transforms with voxels of less than this singular (a determinant below 3e-15).
inline constexpr double kLeastVoxel = 1.6e-5;

/// The way back; up and units are not known.
FileFrame inverse(const FileFrame& frame);

/// The mesh with positions and normals in the frame.
Mesh in_frame(Mesh mesh, const FileFrame& frame);
/// The grid with its voxels moved, so that its transform still only scales and shifts; distances of level sets are scaled. Float, Vec3S,
/// Int32 and mask grids whose transform scales evenly by voxel and shifts. Throws InputError for others. The very same grid where nothing changes.
openvdb::GridBase::ConstPtr in_frame(const openvdb::GridBase::ConstPtr& grid, const FileFrame& frame);

}  // namespace vdbcarve
