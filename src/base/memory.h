// SPDX-License-Identifier: Apache-2.0
// What the process holds, and what it may hold.
#pragma once

#include <cstddef>

namespace vdbcarve {

/// High-water mark of the process's resident memory since the last reset.
size_t peak_memory_bytes();
/// Starts the mark anew where the kernel allows it (Linux). False: it goes on from before.
bool reset_peak_memory();
/// Gives freed memory back to the system.
void release_memory();
/// Resident now.
size_t resident_memory_bytes();
/// Memory of the machine, or of the container's limit.
size_t machine_memory_bytes();

}  // namespace vdbcarve
