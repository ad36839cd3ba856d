// SPDX-License-Identifier: Apache-2.0
// The stages on one CUDA device, each result staying there for the next until it is asked for; bit for bit the results of the
// stage functions, which work on the CPU.
#pragma once

#include <openvdb/openvdb.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "vdbcarve/backend.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/color.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/nano_buffer.h"
#include "vdbcarve/render.h"
#include "vdbcarve/stereo.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// Not for several threads at once. Memory on the device is kept for the next run of the same stage. All functions throw
/// BackendError for errors of CUDA, its want of memory included.
class Device {
  public:
    /// Throws BackendError where the device is not there.
    explicit Device(int device = 0);
    ~Device();
    Device(Device&&) noexcept;
    Device& operator=(Device&&) noexcept;

    /// Masks to the device, then their fields. The masks stay: distance() can be called again. Views without a mask have no field.
    void upload(const std::vector<MaskView>& masks);
    void distance(const DistanceOptions& options);
    std::vector<DistanceField> fields() const;
    /// The inputs' fields to the device, instead.
    void set_fields(const std::vector<CarveInput>& inputs);

    /// Carves from the fields on the device; inputs[i] is the camera of field i, its own field is not looked at.
    /// Errors like carve(). Statistics of the tree (active voxels, bytes) are left out.
    CarveStatistics carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress);
    openvdb::FloatGrid::Ptr hull() const;
    openvdb::MaskGrid::Ptr occupancy() const;
    /// A hull of elsewhere to the device, instead.
    void set_hull(const openvdb::FloatGrid& hull);

    /// Re-distances the hull; the hull stays. Errors like level_set().
    void level_set(const LevelSetOptions& options);
    openvdb::FloatGrid::Ptr surface() const;
    void set_surface(const openvdb::FloatGrid& surface);

    /// The fair surface inside the surface, which must be `hull` and stays. Masks and fields on the device are replaced by its own. Errors like fair().
    FairResult fair(const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                    const FairEvidence* evidence = nullptr);

    /// Colours the surface, which must be `surface`. Masks and fields on the device are replaced by colouring's own. Errors like color().
    ColorResult color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const ColorOptions& options,
                      Progress& progress);

    /// Carves the surface, which must be `surface`, by depths found and fused on the device, whose surface then is the result's. Errors like stereo().
    StereoResult stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const StereoOptions& options,
                        Progress& progress);

    /// Filters the surface in its place. The result's grid and counts of pieces are not set: surface() brings it home. Errors like filter().
    FilterResult filter(const FilterOptions& options, Progress& progress);

    /// Colours of the surface (linear light, active where there is one), for render(); until the next ones, or another surface is set.
    void set_colors(const openvdb::Vec3SGrid& colors);
    /// A picture of the surface, or of the hull where there is none yet: see render(). Its device time is "render", that of what is made ready for it "render:
    /// walls".
    Image8 render(const Camera& camera, const RenderOptions& options);

    /// Marching cubes of the surface, on the device. False where only extract_mesh() of the grid on the CPU can: no level set with
    /// a whole band is such (cuda/mesh_cuda.h).
    bool extract_mesh(bool normals);
    /// What extract_mesh() made, home. Throws UsageError when that is nothing.
    Mesh fetch_mesh(bool normals);

    /// The NanoVDB grids as the device built them, with statistics and checksum filled in: valid, and the bytes of to_nanovdb().
    NanoBuffer hull_nanovdb() const;
    NanoBuffer surface_nanovdb() const;
    /// The hull's bytes as they lie on the device, unfinished.
    NanoBuffer hull_bytes() const;

    /// Device time of every step since the last call of clear_times(), in milliseconds. Waits for the device.
    std::vector<std::pair<std::string, double>> milliseconds() const;
    /// Of one step; 0 where it did not run.
    double milliseconds(const std::string& step) const;
    void clear_times();
    /// Bytes that the stages hold on the device.
    size_t bytes() const;
    /// Bytes of the device that nobody holds now.
    size_t free_bytes() const;
    void wait() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

/// One stage on the device, as the stage function without a device does it on the CPU: what it needs goes there, its result comes home. What the device held
/// of that stage is replaced.
std::vector<DistanceField> distance_fields(Device& device, const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress);
CarveResult carve(Device& device, const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress);
openvdb::FloatGrid::Ptr level_set(Device& device, const openvdb::FloatGrid& hull, const LevelSetOptions& options, Progress& progress);
openvdb::FloatGrid::Ptr level_set_of_occupancy(Device& device, const openvdb::MaskGrid& occupancy, const LevelSetOptions& options, Progress& progress);
FairResult fair(Device& device, const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                const FairEvidence* evidence = nullptr);
ColorResult color_in_batches(Device& device, const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos,
                             const ColorOptions& options, Progress& progress);
StereoResult stereo(Device& device, const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos,
                    const StereoOptions& options, Progress& progress);
FilterResult filter(Device& device, const openvdb::FloatGrid& surface, const FilterOptions& options, Progress& progress);
/// On the CPU where the device cannot: for Mesher::Dual, and for grids that Device::extract_mesh() does not take.
Mesh extract_mesh(Device& device, const openvdb::FloatGrid& surface, const MeshOptions& options, Progress& progress);

}  // namespace vdbcarve
