// SPDX-License-Identifier: Apache-2.0
// The one macro that lets the same arithmetic compile for the CPU and for CUDA.
//
// Everything under kernel/ includes the standard library and this file only, and is compiled with
// -ffp-contract=off (host) and --fmad=false (device): without a fused multiply-add every +, -, *, /
// and sqrt is correctly rounded on both, so both give the same bits.
#pragma once

#if defined(__CUDACC__)
#define VDBCARVE_HD __host__ __device__ inline
#elif defined(VDBCARVE_ISA)
// Compiled once an instruction set (src/base/vector_loops.cpp): internal linkage keeps the linker from handing code
// made for AVX-512 to callers on a machine without it.
#define VDBCARVE_HD static inline
#else
#define VDBCARVE_HD inline
#endif
