// SPDX-License-Identifier: Apache-2.0
// What a build without CUDA links in place of the device: nothing that can be opened.
#include "device/dense_device.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

std::vector<DeviceInfo> cuda_devices() { return {}; }
std::string why_no_cuda() { return "this vdbcarve was built without CUDA"; }

namespace {
[[noreturn]] void absent() { throw BackendError(why_no_cuda()); }
}  // namespace

struct Device::Parts {};

Device::Device(int) { absent(); }
Device::~Device() = default;
Device::Device(Device&&) noexcept = default;
Device& Device::operator=(Device&&) noexcept = default;
void Device::upload(const std::vector<MaskView>&) { absent(); }
void Device::distance(const DistanceOptions&) { absent(); }
std::vector<DistanceField> Device::fields() const { absent(); }
void Device::set_fields(const std::vector<CarveInput>&) { absent(); }
CarveStatistics Device::carve(const std::vector<CarveInput>&, const CarveOptions&, Progress&) { absent(); }
openvdb::FloatGrid::Ptr Device::hull() const { absent(); }
openvdb::MaskGrid::Ptr Device::occupancy() const { absent(); }
void Device::set_hull(const openvdb::FloatGrid&) { absent(); }
void Device::level_set(const LevelSetOptions&) { absent(); }
openvdb::FloatGrid::Ptr Device::surface() const { absent(); }
void Device::set_surface(const openvdb::FloatGrid&) { absent(); }
FairResult Device::fair(const openvdb::FloatGrid&, const std::vector<FairView>&, const FairOptions&, Progress&, const FairEvidence*) { absent(); }
ColorResult Device::color(const openvdb::FloatGrid&, const std::vector<ColorInput>&, const PhotoSource&, const ColorOptions&, Progress&) { absent(); }
StereoResult Device::stereo(const openvdb::FloatGrid&, const std::vector<ColorInput>&, const PhotoSource&, const StereoOptions&, Progress&) { absent(); }
FilterResult Device::filter(const FilterOptions&, Progress&) { absent(); }
void Device::set_colors(const openvdb::Vec3SGrid&) { absent(); }
Image8 Device::render(const Camera&, const RenderOptions&) { absent(); }
bool Device::extract_mesh(bool) { absent(); }
NanoBuffer Device::hull_nanovdb() const { absent(); }
NanoBuffer Device::surface_nanovdb() const { absent(); }
std::vector<std::pair<std::string, double>> Device::milliseconds() const { absent(); }
void Device::clear_times() { absent(); }
size_t Device::bytes() const { absent(); }
size_t Device::free_bytes() const { absent(); }
void Device::wait() const { absent(); }
NanoBuffer Device::hull_bytes() const { absent(); }
Mesh Device::fetch_mesh(bool) { absent(); }

DenseTimes dense_on_device(const std::vector<const uint8_t*>&, int, int, const std::vector<std::array<float, 12>>&, const std::array<int, 3>&, int, int) {
    absent();
}

}  // namespace vdbcarve
