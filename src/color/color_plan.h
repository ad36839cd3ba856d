// SPDX-License-Identifier: Apache-2.0
// What both backends' colouring starts from and ends with.
#pragma once

#include <nanovdb/NanoVDB.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "vdbcarve/color.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/kernel/color.h"

namespace vdbcarve {

/// Throws for what color() does not take. Photographs are looked at when they come.
void check_color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const ColorOptions& options);

/// Linear light of every 8-bit (16-bit) sRGB value.
const std::vector<float>& linear_table(bool wide);

/// windowed_normal's weights; empty for a radius of 0. The Gaussian's sigma is half the radius, so that it has faded at the window's side.
std::vector<float> normal_weights(int radius_vox);

/// Masks without what is to be ignored, for the distance to what may be sampled.
class SampledMasks {
  public:
    SampledMasks(const std::vector<ColorInput>& inputs, size_t first, size_t last);
    const std::vector<MaskView>& views() const { return views_; }  ///< an empty one for views that are not used

  private:
    std::vector<Image8> owned_;
    std::vector<MaskView> views_;
};

/// Fields of those masks.
DistanceOptions margin_fields();

/// A view on the surface's lattice, without pixels and field, with a gain of 1. Its weight is 0 everywhere where the view cannot be used.
kernel::ColorView make_color_view(const ColorInput& input, const openvdb::math::Transform& transform, const kernel::ColorBase& base);
/// Throws InputError where the photograph does not fit its camera.
void check_photo(const char* stage, const ColorInput& input, const PhotoView& photo);

kernel::ColorRule color_rule(const ColorOptions& options, const openvdb::CoordBBox& leaves);
kernel::ColorBase color_base(const openvdb::CoordBBox& leaves);
/// Voxels nearer to the surface than this stand in the way; world units.
inline float sight_threshold(const openvdb::FloatGrid& surface) { return kernel::kSightBlock_vox * static_cast<float>(surface.voxelSize()[0]); }

/// What holds the surface's leaves.
openvdb::CoordBBox leaf_box(const openvdb::FloatGrid& surface);

/// At most kExposurePlaces voxels of the contour, spread evenly.
inline constexpr size_t kExposurePlaces = 8192;
std::vector<uint32_t> exposure_places(size_t contour_count);

/// The exposures to colour with: options.gains, or what observe() says of exposure_places(), or gains of 1.
Exposure choose_exposure(const ColorOptions& options, size_t views, const std::function<Observations()>& observe);
void set_gains(std::vector<kernel::ColorView>& views, const std::vector<std::array<double, 3>>& gains);

/// Goes through views batch by batch, loading each; where one batch holds all, it is loaded once and stays.
class ViewBatches {
  public:
    /// `batch` 0: all at once.
    ViewBatches(size_t views, size_t batch) : views_(views), batch_(batch ? std::min(batch, views) : views) {}
    bool all_at_once() const { return batch_ >= views_; }
    /// Calls load(first, last), then work(first, last).
    template <class Load, class Work>
    void each(const Progress& progress, const Load& load, const Work& work) {
        for (size_t first = 0; first < views_; first += batch_) {
            progress.check();
            const size_t last = std::min(views_, first + batch_);
            if (!(held_ && all_at_once())) load(first, last);
            held_ = true;
            work(first, last);
        }
    }

  private:
    size_t views_, batch_;
    bool held_ = false;
};

/// A colour grid to be interpolated in. Not for several threads at once.
class ColorReader {
  public:
    explicit ColorReader(const openvdb::Vec3SGrid& color) : transform_(color.transform()), accessor_(color.getConstAccessor()) {}
    openvdb::Vec3d index_of(const Vec3d& world) const { return transform_.worldToIndex(openvdb::Vec3d(world.x(), world.y(), world.z())); }
    /// False where the voxel has no colour.
    bool voxel(int i, int j, int k, kernel::Rgb& out) const {
        openvdb::Vec3s v;
        if (!accessor_.probeValue(openvdb::Coord(i, j, k), v)) return false;
        out = {v[0], v[1], v[2]};
        return true;
    }
    /// Trilinear; false where no voxel around has a colour.
    bool interpolate(const openvdb::Vec3d& index, kernel::Rgb& out) const {
        return kernel::interpolate_color([&](int i, int j, int k, kernel::Rgb& c) { return voxel(i, j, k, c); }, index[0], index[1], index[2], out);
    }

  private:
    const openvdb::math::Transform& transform_;
    openvdb::Vec3SGrid::ConstAccessor accessor_;
};

/// kernel::SightGrid::walls of a grid in host memory.
std::vector<uint64_t> sight_walls(const nanovdb::NanoGrid<float>& grid, float threshold);

/// work(range) over 0 <= n < count, in parallel.
template <class Work>
void for_ranges(size_t count, size_t grain, const Work& work) {
    tbb::parallel_for(tbb::blocked_range<size_t>(0, count, grain), work);
}

/// Passes that carry colour over a band.
int spread_passes(const openvdb::FloatGrid& surface);

/// Fills what is unknown (known[n] == 0) from what is known; `keys` are morton_of_voxel of the contour's voxels, any order.
/// Nothing to do where nothing or everything is known.
void fill_colors(const std::vector<uint64_t>& keys, const std::vector<uint8_t>& known, std::vector<kernel::Rgb>& colors);

/// Colour for the layers deeper than the band: each from the one before.
void carry_inwards(openvdb::Vec3SGrid& color, const openvdb::FloatGrid& surface, int depth_vox);

/// The grids and statistics, from the contour's voxels (leaf * 512 + offset) and the spread colours, whose grid is `color`.
void finish_color(ColorResult& result, const openvdb::FloatGrid& surface, const std::vector<uint32_t>& contour, const std::vector<uint8_t>& views_blended,
                  const std::vector<float>& confidence, const ColorOptions& options);

/// An empty colour grid with the surface's leaves: values 0, nothing active.
openvdb::Vec3SGrid::Ptr empty_color(const openvdb::FloatGrid& surface);

[[noreturn]] void explain_unseen(const std::vector<ColorInput>& inputs);

}  // namespace vdbcarve
