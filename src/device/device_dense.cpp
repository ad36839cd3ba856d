// SPDX-License-Identifier: Apache-2.0
#include "device/dense_device.h"

#include <chrono>

#include "cuda/dense_cuda.h"
#include "base/statistics.h"

namespace vdbcarve {

DenseTimes dense_on_device(const std::vector<const uint8_t*>& masks, int width, int height, const std::vector<std::array<float, 12>>& pixel_from_index,
                           const std::array<int, 3>& dims, int device, int runs) {
    VDBCARVE_CUDA(cudaSetDevice(device));
    cuda::Stream stream;
    cuda::DenseStage dense;
    std::vector<double> uploads, carves;
    for (int run = -1; run < runs; ++run) {
        const auto start = std::chrono::steady_clock::now();
        dense.upload(masks, width, height, pixel_from_index, stream);
        const double upload = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
        cuda::Event begin, end;
        begin.record(stream);
        dense.run(dims, stream);
        end.record(stream);
        const double ms = end.milliseconds_since(begin);
        if (run < 0) continue;  // warming up
        uploads.push_back(upload);
        carves.push_back(ms);
    }
    return {median(uploads), median(carves), dense.count(stream)};
}

}  // namespace vdbcarve
