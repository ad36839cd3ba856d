// SPDX-License-Identifier: Apache-2.0
// Stage `render`: pictures of volumes and meshes, to be looked at. (What is measured about meshes in images is in raster.h.)
#pragma once

#include <openvdb/openvdb.h>

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

enum class RenderStyle {
    Surface,  ///< the level set's zero, interpolated, under light, with ambient occlusion
    Voxels,   ///< voxels inside as cubes, nothing interpolated: the volume as it is (Denkowski 2013, Fig. 3)
    XRay,     ///< how thick the object is
    Slice     ///< its section with a plane
};

/// Points with normal . x = offset, world.
struct Plane {
    Vec3d normal = Vec3d::UnitZ();
    double offset = 0;
};

struct RenderOptions {
    RenderStyle style = RenderStyle::Surface;
    int samples = 2;                                ///< rays along a pixel's side
    bool color = true;                              ///< the volume's own colours, where it has any
    std::array<double, 3> plain{0.55, 0.55, 0.56};  ///< linear light of what has none
    int ambient_rays = 6;                           ///< a ray into how many directions it is asked whether the sky is hidden; 0: no ambient occlusion
    double ambient_reach = 0.08;                    ///< and how far, as a share of the volume's longest side
    double iso = 0;                                 ///< the surface lies where the level set has this value, world units; within the band
    Plane slice;                                    ///< of RenderStyle::Slice
    std::optional<std::array<uint8_t, 3>> background{{255, 255, 255}};  ///< sRGB; none: transparent
    Vec3d up = Vec3d::Zero();                                           ///< where the sky is, world; zero: the image's up
};

/// The box that holds the inside of a level set, world. Throws UsageError for a grid that is no level set with voxels as cubes, or has no inside.
Box3d box_of_inside(const openvdb::FloatGrid& surface);

/// A level set made ready to be rendered on the CPU: once for many pictures. On a GPU: Device::render().
class RenderVolume {
  public:
    /// `color` (linear light, active where there is one) may be null. Throws like box_of_inside().
    RenderVolume(const openvdb::FloatGrid& surface, const openvdb::Vec3SGrid* color);
    ~RenderVolume();
    RenderVolume(RenderVolume&&) noexcept;

    /// box_of_inside().
    const Box3d& bounds_world() const;

  private:
    friend Image8 render(RenderVolume&, const Camera&, const RenderOptions&);
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

/// The picture, RGBA in sRGB; CPU and GPU give the same bytes. Time: dragon, 1024 voxels, 1024 x 1024 pixels, samples 1: BENCHMARKS.md.
Image8 render(RenderVolume& volume, const Camera& camera, const RenderOptions& options);

/// A mesh under the same light, in its own colours where it has any; rasterised, without ambient occlusion. Styles other than Surface: UsageError.
Image8 render(const Mesh& mesh, const Camera& camera, const RenderOptions& options);

/// A camera that sees a box whole, looking at its centre. Azimuth counterclockwise about `up`, from x (from y where up is along x).
struct OrbitView {
    bool whole_turn = false;  ///< as far away as is needed from every azimuth
    double azimuth_deg = 30, elevation_deg = 20;
    double fov_deg = 30;  ///< of the smaller side; 0: orthographic
    int width_px = 1024, height_px = 1024;
};
Camera orbit_camera(const Box3d& box_world, const Vec3d& up_world, const OrbitView& view);

/// A camera for slices: looks along -axis, orthographic, upright as far as may be; its image is as wide or as high as longest_px, and has the box's shape.
Camera slice_camera(const Box3d& box_world, const Vec3d& axis_world, const Vec3d& up_world, int longest_px);

/// Pictures of one size side by side, `columns` in a row, with a line of text under each; white between.
Image8 sheet_of(const std::vector<Image8>& pictures, const std::vector<std::string>& names, int columns);

/// Where the result's photographs stand beside pictures of it: of equal size, RGB. A transparent picture is laid over white, a photograph is made
/// as large as the picture.
Image8 beside_photo(ImageView<uint8_t> photo, ImageView<uint8_t> picture);

}  // namespace vdbcarve
