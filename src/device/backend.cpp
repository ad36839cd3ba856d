// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/backend.h"

#include "vdbcarve/error.h"

namespace vdbcarve {

const char* name_of(Backend backend) { return backend == Backend::Cuda ? "cuda" : "cpu"; }

Backend choose_backend(Backend wanted, int device) {
    if (wanted == Backend::Cpu) return wanted;
    const auto count = static_cast<int>(cuda_devices().size());
    if (device >= 0 && device < count) return Backend::Cuda;
    if (wanted == Backend::Auto && count == 0) return Backend::Cpu;
    if (count == 0) throw BackendError("--backend cuda: " + why_no_cuda() + ". Remedy: --backend cpu gives the same result");
    throw BackendError("--device " + std::to_string(device) + ": this machine has " + std::to_string(count) + " CUDA device" + (count == 1 ? "" : "s") +
                       ", numbered from 0");
}

}  // namespace vdbcarve
