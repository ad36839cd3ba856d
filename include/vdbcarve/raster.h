// SPDX-License-Identifier: Apache-2.0
// Meshes seen by cameras: silhouettes and depth at pixel centres, agreement with masks, a contact sheet.
#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "vdbcarve/geometry.h"
#include "vdbcarve/image.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// What the ray through each pixel centre hits first.
struct Raster {
    ImageF depth;          ///< camera z, world units; infinity where nothing is hit
    Image<uint32_t> face;  ///< index of the triangle, UINT32_MAX where nothing is hit
};

/// Exact at pixel centres; triangles that touch the camera plane are left out. Single-threaded.
Raster rasterize(const Mesh& mesh, const Camera& camera);

/// The mesh in its own colours, without light, as RGBA in sRGB: alpha 255 where the ray through the pixel centre hits. Colours are those of the
/// vertices, interpolated in linear light, or of `color_at` (world), where it is given. Throws UsageError for a mesh without either.
Image8 render_colors(const Mesh& mesh, const Camera& camera, const std::function<std::array<float, 3>(const Vec3d&)>& color_at = {});

/// How well a rendered view agrees with its photograph, in 8-bit sRGB, over the pixels that are hit and, where there is a mask, half covered or
/// more and not ignored.
struct PhotoAgreement {
    size_t pixels = 0;
    double psnr_db = 0;  ///< of R, G and B together; infinity where all are equal
    double ssim = 0;     ///< Wang et al. 2004 on luma, Gaussian window of sigma 1.5 px, weighted within the region only
};
PhotoAgreement compare_photo(ImageView<uint8_t> rendered_rgba, const PhotoView& photo, const MaskView& mask);

/// 255 where the ray through the pixel centre hits the mesh.
Image8 silhouette_of(const Mesh& mesh, const Camera& camera);

/// `hit`: silhouette_of(). `soft`: the same, but pixels with one around (of 8) that differs hold the share that the mesh covers, 0..255, from 8 x 8 rays, on
/// the side of 1/2 that `hit` says. What no pixel centre hits is missing in both.
struct SoftSilhouette {
    Image8 hit, soft;
};
SoftSilhouette soft_silhouette_of(const Mesh& mesh, const Camera& camera);

/// Share of each pixel covered by the mesh, 0..255, from samples x samples rays a pixel.
Image8 coverage_of(const Mesh& mesh, const Camera& camera, int samples);

/// The same camera with an image of `factor` times as many pixels a side.
Camera scaled(const Camera& camera, double factor);

/// How well a mesh's silhouette agrees with a mask. Ignored pixels are left out.
struct SilhouetteAgreement {
    double iou = 0;             ///< |hit and mask| / |hit or mask|; 1 when both are empty
    double contour_p95_px = 0;  ///< distance between the two contours, 95th percentile
    double contour_p99_px = 0;
    size_t missed_px = 0, extra_px = 0;  ///< mask not hit; hit outside the mask
    size_t largest_missed_blob_px = 0;   ///< pixels of the largest connected piece of what is missed
    /// Length, in pixels, of the mask's skeleton where the mask is at most 20 px wide and nothing is hit within 1.5 px: thin
    /// parts that are gone while the area hardly tells.
    size_t thin_length_lost_px = 0;
    std::array<int, 4> missed_blob{};           ///< x0, y0, x1, y1 of the largest missed piece
    std::vector<std::array<int, 2>> thin_lost;  ///< the lost pixels of the skeleton
};
SilhouetteAgreement compare_silhouettes(ImageView<uint8_t> hit, const MaskView& mask);
/// The same for a mesh. `within_pixels`: the mask's contour is known within pixels, and so the mesh's is asked there; at pixel centres alone it would be up to
/// half a pixel off, whatever the mesh is.
SilhouetteAgreement compare_silhouettes(const Mesh& mesh, const Camera& camera, const MaskView& mask, bool within_pixels);

/// One picture of up to 12 evenly chosen views: the mesh, shaded, over the darkened photograph; red where the
/// mask is missed, blue where the mesh sticks out, yellow where thin parts are lost, the largest missed piece framed. `photos` may hold empty images.
struct PreviewView {
    std::string name;
    Camera camera;
    Image8 photo;  ///< RGB, RGBA or grey, undistorted, any size; empty: black
    Image8 mask;
    std::array<int, 4> missed_blob{};           ///< of SilhouetteAgreement, in the mask's pixels: framed in orange
    std::vector<std::array<int, 2>> thin_lost;  ///< drawn in yellow
    std::vector<Vec3d> cut_world;               ///< points of the line along which a floor cuts the object, drawn in cyan
};
Image8 preview_sheet(const Mesh& mesh, const std::vector<PreviewView>& views);

/// A mask over its photograph (which may be empty), at most 1024 pixels wide: what is left out reddish, what is ignored bluish, the silhouette's edge green.
Image8 mask_overlay(ImageView<uint8_t> photo, const Mask& mask);

}  // namespace vdbcarve
