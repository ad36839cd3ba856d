// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include "device/device_parts.h"

namespace vdbcarve {

std::vector<DeviceInfo> cuda_devices() {
    int count = 0;
    if (cudaGetDeviceCount(&count) != cudaSuccess) {
        (void)cudaGetLastError();
        return {};
    }
    std::vector<DeviceInfo> out;
    for (int d = 0; d < count; ++d) {
        cudaDeviceProp p{};
        if (cudaGetDeviceProperties(&p, d) != cudaSuccess) return {};
        out.push_back({p.name, p.totalGlobalMem, p.multiProcessorCount});
    }
    return out;
}

std::string why_no_cuda() {
    int count = 0;
    const cudaError_t error = cudaGetDeviceCount(&count);
    (void)cudaGetLastError();
    if (error == cudaSuccess && count > 0) return {};
    int driver = 0;
    if (cudaDriverGetVersion(&driver) == cudaSuccess && driver == 0) return "this machine has no CUDA device that can be used (no NVIDIA driver)";
    return std::string("this machine has no CUDA device that can be used (") + (error == cudaSuccess ? "none found" : cudaGetErrorString(error)) + ")";
}

Device::Device(int device) : parts_(std::make_unique<Parts>(device)) {}
Device::~Device() = default;
Device::Device(Device&&) noexcept = default;
Device& Device::operator=(Device&&) noexcept = default;

std::vector<std::pair<std::string, double>> Device::milliseconds() const {
    parts_->use();
    return parts_->times.milliseconds();
}
void Device::clear_times() { parts_->times.clear(); }
size_t Device::bytes() const {
    const Parts& p = *parts_;
    return p.distance.bytes() + p.uploaded_fields.bytes() + p.carve.bytes() + p.hull.grid.bytes() + p.surface.grid.bytes() + p.fused.grid.bytes() +
           p.level_set.bytes() + p.filter.bytes() + p.fair.bytes() + p.fair_sight.bytes() + p.fair_depths.bytes() + p.mesh.bytes() + p.color.bytes() +
           p.render.bytes() + p.stereo.bytes() + p.uploaded_values.bytes() + p.photos.bytes();
}
size_t Device::free_bytes() const {
    parts_->use();
    size_t free = 0, total = 0;
    VDBCARVE_CUDA(cudaMemGetInfo(&free, &total));
    return free;
}
void Device::wait() const {
    parts_->use();
    parts_->stream.wait();
}

}  // namespace vdbcarve
