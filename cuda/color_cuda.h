// SPDX-License-Identifier: Apache-2.0
// Colouring on the device: kernel/color.h and kernel/color_fill.h over the contour's voxels and the surface's leaves.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "grid_cuda.h"
#include "vdbcarve/kernel/color.h"

namespace vdbcarve::cuda {

/// One surface at a time, in this order: find_contour; observe, as often as wanted; find_views batch after batch; decide; fill; spread.
class ColorStage {
  public:
    ColorStage();
    ~ColorStage();

    /// The contour's voxels and their points; `weights` as of normal_weights(). Waits for their number, which it returns.
    uint32_t find_contour(const Grid& surface, const kernel::ColorBase& base, int normal_radius_vox, const std::vector<float>& weights, const Stream& stream,
                          StageTimes& times);

    /// Tables that texels are looked up in, device memory.
    const float* linear(bool wide, const std::vector<float>& table, const Stream& stream);

    /// What views first <= i < last (views[0] is `first`) show of places (numbers of contour voxels): out[place * (last - first) + i - first].
    void observe(const std::vector<kernel::ColorView>& views, const kernel::ColorRule& rule, const std::vector<uint32_t>& places,
                 std::vector<kernel::Observation>& out, const Stream& stream, StageTimes& times);
    /// Adds views first <= i < first + views.size() to every point's candidates; the first call begins anew.
    void find_views(const std::vector<kernel::ColorView>& views, int first, const kernel::ColorRule& rule, const Stream& stream, StageTimes& times);
    /// Candidates become colours. `views` are all of them. Returns how many voxels have one; waits for that.
    uint32_t decide(const std::vector<kernel::ColorView>& views, const kernel::ColorRule& rule, const Stream& stream, StageTimes& times);
    void fill(const Grid& surface, const Stream& stream, StageTimes& times);
    void spread(const Grid& surface, const Topology& topology, int depth_vox, int passes, const Stream& stream, StageTimes& times);

    uint32_t contour_count() const;
    const uint32_t* contour() const;       ///< leaf * 512 + offset
    const uint8_t* views_blended() const;  ///< by contour voxel
    const float* confidence() const;
    const uint32_t* voxels_of_view() const;  ///< by view
    const kernel::Rgb* leaf_colors() const;  ///< 512 a leaf
    const uint8_t* layers() const;           ///< 512 a leaf, kernel::kNoLayer where there is no colour
    size_t bytes() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace vdbcarve::cuda
