// SPDX-License-Identifier: Apache-2.0
// Every call of the CUDA runtime goes through VDBCARVE_CUDA; VDBCARVE_LAUNCHED (stream.h) follows every launch.
#pragma once

#include <cuda_runtime_api.h>

#include <string>

#include "vdbcarve/error.h"

namespace vdbcarve::cuda {

[[noreturn]] inline void fail(cudaError_t error, const char* call, const char* file, int line) {
    (void)cudaGetLastError();  // or the next launch would be blamed for it
    const std::string full(file);
    const std::string where = full.substr(full.rfind('/') + 1) + ":" + std::to_string(line);
    const std::string remedy =
        error == cudaErrorMemoryAllocation ? ". Remedy: fewer voxels (--resolution), coarser fields (--field-scale), or --backend cpu" : "";
    throw BackendError("CUDA: " + std::string(cudaGetErrorString(error)) + " (" + where + ": " + call + ")" + remedy);
}

inline void check(cudaError_t error, const char* call, const char* file, int line) {
    if (error != cudaSuccess) fail(error, call, file, line);
}

}  // namespace vdbcarve::cuda

#define VDBCARVE_CUDA(call) ::vdbcarve::cuda::check((call), #call, __FILE__, __LINE__)
