// SPDX-License-Identifier: Apache-2.0
// Where the work is done. The result is the same everywhere, bit for bit.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace vdbcarve {

enum class Backend { Auto, Cpu, Cuda };

struct DeviceInfo {
    std::string name;
    size_t memory_bytes = 0;
    int multiprocessors = 0;
};

/// The CUDA devices that this build can use on this machine; none where it was built without CUDA.
std::vector<DeviceInfo> cuda_devices();
/// Why there is none, in a sentence; empty where there is.
std::string why_no_cuda();

/// Auto becomes Cuda where there are CUDA devices, else Cpu. Throws BackendError when CUDA is demanded and not there, or when
/// `device` is none of those that are.
Backend choose_backend(Backend wanted, int device);

/// "cpu" or "cuda".
const char* name_of(Backend backend);

}  // namespace vdbcarve
