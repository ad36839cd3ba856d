// SPDX-License-Identifier: Apache-2.0
// Noise that is the same on every machine.
#pragma once

#include <cstdint>
#include <random>

#include "vdbcarve/geometry.h"

namespace vdbcarve::synth {

/// Uniform in -1..1, the same on every standard library.
class Dice {
  public:
    explicit Dice(uint64_t seed) : engine_(seed) {}
    double operator()() { return static_cast<double>(engine_() >> 11) * 0x1p-52 - 1.0; }

  private:
    std::mt19937_64 engine_;
};

/// 0..1.
double hash_noise(int64_t x, int64_t y, int64_t z);

/// Smooth value noise in 0..1, lattice spacing 1.
double noise(const Vec3d& p);

/// Noise of mean 0 and standard deviation about 1 over the plane, smooth over `length` pixels.
double wobble(int x, int y, double length, uint64_t seed);

}  // namespace vdbcarve::synth
