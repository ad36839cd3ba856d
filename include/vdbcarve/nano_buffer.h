// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>

namespace vdbcarve {

/// A NanoVDB grid in host memory, as it lies in a .nvdb file.
struct NanoBuffer {
    struct Free {
        void operator()(uint8_t* p) const { std::free(p); }
    };
    std::unique_ptr<uint8_t[], Free> data;  ///< aligned as NanoVDB wants it
    size_t size = 0;
};

}  // namespace vdbcarve
