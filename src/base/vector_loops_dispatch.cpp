// SPDX-License-Identifier: Apache-2.0
#include <cstdlib>
#include <string>

#include "vdbcarve/error.h"
#include "base/vector_loops.h"

namespace vdbcarve {

const VectorLoops& vector_loops_generic();
#if defined(VDBCARVE_X86_SETS)
const VectorLoops& vector_loops_avx2();
const VectorLoops& vector_loops_avx512();
#endif

std::vector<const VectorLoops*> all_vector_loops() {
    std::vector<const VectorLoops*> out{&vector_loops_generic()};
#if defined(VDBCARVE_X86_SETS)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2")) out.push_back(&vector_loops_avx2());
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512cd"))
        out.push_back(&vector_loops_avx512());
#endif
    return out;
}

const VectorLoops& vector_loops() {
    static const VectorLoops& chosen = [&]() -> const VectorLoops& {
        const std::vector<const VectorLoops*> all = all_vector_loops();
        const char* asked = std::getenv("VDBCARVE_SIMD");
        if (!asked || !*asked) return *all.back();
        std::string names;
        for (const VectorLoops* loops : all) {
            if (std::string(asked) == loops->name) return *loops;
            names += std::string(names.empty() ? "" : ", ") + loops->name;
        }
        throw UsageError(std::string("VDBCARVE_SIMD is '") + asked + "'; this machine has " + names);
    }();
    return chosen;
}

}  // namespace vdbcarve
