// SPDX-License-Identifier: Apache-2.0
#include "device_ceilings.h"

#include <algorithm>

#include "cuda/device_buffer.h"
#include "cuda/stream.h"

namespace vdbcarve::test {
namespace {

constexpr int kRounds = 4096, kChains = 8;

/// Independent chains of an addition and a multiplication, which --fmad=false keeps apart.
__global__ void __launch_bounds__(256) arithmetic(float* out, float a, float b) {
    float x[kChains];
    for (int n = 0; n < kChains; ++n) x[n] = static_cast<float>(threadIdx.x + n);
    for (int r = 0; r < kRounds; ++r)
#pragma unroll
        for (int n = 0; n < kChains; ++n) x[n] = x[n] * a + b;
    float sum = 0;
    for (int n = 0; n < kChains; ++n) sum += x[n];
    out[blockIdx.x * blockDim.x + threadIdx.x] = sum;
}

}  // namespace

DeviceCeilings measure_ceilings() {
    using namespace cuda;
    Stream stream;
    DeviceCeilings out{};
    const size_t bytes = size_t{1} << 30;
    DeviceBuffer<char> from(bytes), to(bytes);
    PinnedBuffer<char> host(bytes / 4);
    stream.zero(from.data(), bytes);
    const auto best_ms = [&](const auto& work) {
        double best = 1e30;
        for (int run = 0; run < 8; ++run) {
            Event begin, end;
            begin.record(stream);
            work();
            end.record(stream);
            best = std::min(best, static_cast<double>(end.milliseconds_since(begin)));
        }
        return best;
    };
    out.copy_gb_s = 2.0 * bytes / 1e6 / best_ms([&] { VDBCARVE_CUDA(cudaMemcpyAsync(to.data(), from.data(), bytes, cudaMemcpyDeviceToDevice, stream.get())); });
    out.upload_gb_s = bytes / 4 / 1e6 / best_ms([&] { stream.to_device(from.data(), host.data(), bytes / 4); });
    const int blocks = 132 * 8 * 4;
    DeviceBuffer<float> sums(static_cast<size_t>(blocks) * 256);
    const double ms = best_ms([&] {
        arithmetic<<<blocks, 256, 0, stream.get()>>>(sums.data(), 0.999f, 0.001f);
        VDBCARVE_LAUNCHED();
    });
    out.instructions_g_s = 2.0 * kRounds * kChains * blocks * 8 / 1e6 / ms;
    return out;
}

}  // namespace vdbcarve::test
