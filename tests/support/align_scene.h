// SPDX-License-Identifier: Apache-2.0
// Orbits around objects without symmetry, whose true cameras are known.
#pragma once

#include "vdbcarve/synthetic.h"

namespace vdbcarve::test {

/// Seven ellipsoids and a plate, no symmetry, within about 1 of the origin.
std::vector<Solid> lump(uint64_t seed);

/// Two stacked ellipsoids of revolution about z.
std::vector<Solid> round_object();

/// 36 views of a lump, 640 x 480, f 1300: angles off by up to 5 degrees, aim by 1.2 % of the distance, roll by 2 degrees. No photographs.
SyntheticSpec hand_held_orbit(uint64_t seed);

/// Fewer and smaller of them: 480 x 360.
SyntheticSpec small_orbit(uint64_t seed, int views);

/// The same views as an aligner gets them: no poses; focal lengths times `focal_factor`, or none for 0.
Views without_cameras(const Views& views, double focal_factor);

}  // namespace vdbcarve::test
