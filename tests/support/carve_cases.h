// SPDX-License-Identifier: Apache-2.0
// The scenes and options that every way of carving must agree on.
#pragma once

#include "support/scenes.h"

namespace vdbcarve::test {

struct CarveCase {
    std::string name;
    std::function<Shoot()> make;
    std::function<void(CarveOptions&)> change;
    int resolution = 48;
};

inline void PrintTo(const CarveCase& c, std::ostream* out) { *out << c.name; }

const std::vector<CarveCase>& carve_cases();

}  // namespace vdbcarve::test
