// SPDX-License-Identifier: Apache-2.0
#include "base/memory.h"

#include <malloc.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <string>

namespace vdbcarve {
namespace {

size_t status_bytes(const char* key) {
    std::ifstream in("/proc/self/status");
    for (std::string line; std::getline(in, line);)
        if (line.rfind(key, 0) == 0) return static_cast<size_t>(std::stoull(line.substr(line.find(':') + 1))) * 1024;
    return 0;
}

}  // namespace

size_t peak_memory_bytes() {
    if (const size_t mark = status_bytes("VmHWM")) return mark;
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    return static_cast<size_t>(usage.ru_maxrss) * 1024;
}

void release_memory() { malloc_trim(0); }

bool reset_peak_memory() {
    release_memory();  // so that the mark shows what is held
    std::ofstream out("/proc/self/clear_refs");
    out << "5" << std::flush;
    return static_cast<bool>(out);
}

size_t resident_memory_bytes() { return status_bytes("VmRSS"); }

size_t machine_memory_bytes() {
    size_t bytes = static_cast<size_t>(sysconf(_SC_PHYS_PAGES)) * static_cast<size_t>(sysconf(_SC_PAGE_SIZE));
    for (const char* file : {"/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"}) {
        std::ifstream in(file);
        size_t limit = 0;
        if (in >> limit && limit > 0) bytes = std::min(bytes, limit);
    }
    return bytes;
}

}  // namespace vdbcarve
