// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/color_space.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace vdbcarve {

double linear_from_srgb(double srgb) { return srgb <= 0.04045 ? srgb / 12.92 : std::pow((srgb + 0.055) / 1.055, 2.4); }

double srgb_from_linear(double linear) {
    linear = std::clamp(linear, 0.0, 1.0);
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

uint8_t srgb8_from_linear(double linear) { return static_cast<uint8_t>(std::lround(255 * srgb_from_linear(linear))); }

std::array<double, 3> lab_from_linear(const std::array<double, 3>& c) {
    const double x = 0.4124564 * c[0] + 0.3575761 * c[1] + 0.1804375 * c[2];
    const double y = 0.2126729 * c[0] + 0.7151522 * c[1] + 0.0721750 * c[2];
    const double z = 0.0193339 * c[0] + 0.1191920 * c[1] + 0.9503041 * c[2];
    const auto f = [](double t) { return t > 216.0 / 24389 ? std::cbrt(t) : (24389.0 / 27 * t + 16) / 116; };
    const double fx = f(x / 0.95047), fy = f(y), fz = f(z / 1.08883);
    return {116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)};
}

double ciede2000(const std::array<double, 3>& p, const std::array<double, 3>& q) {
    constexpr double kTurn = 2 * std::numbers::pi, kDeg = std::numbers::pi / 180;
    const auto pow7 = [](double v) { return std::pow(v, 7); };
    const double mean_chroma = 0.5 * (std::hypot(p[1], p[2]) + std::hypot(q[1], q[2]));
    const double g = 0.5 * (1 - std::sqrt(pow7(mean_chroma) / (pow7(mean_chroma) + pow7(25))));
    const double a1 = (1 + g) * p[1], a2 = (1 + g) * q[1];
    const double c1 = std::hypot(a1, p[2]), c2 = std::hypot(a2, q[2]);
    const auto hue = [&](double a, double b) {
        if (a == 0 && b == 0) return 0.0;
        const double h = std::atan2(b, a);
        return h < 0 ? h + kTurn : h;
    };
    const double h1 = hue(a1, p[2]), h2 = hue(a2, q[2]);
    double dh = h2 - h1;
    if (c1 * c2 == 0) dh = 0;
    else if (dh > std::numbers::pi) dh -= kTurn;
    else if (dh < -std::numbers::pi) dh += kTurn;
    const double dl = q[0] - p[0], dc = c2 - c1, dhue = 2 * std::sqrt(c1 * c2) * std::sin(dh / 2);
    const double l = 0.5 * (p[0] + q[0]), c = 0.5 * (c1 + c2);
    double h = h1 + h2;
    if (c1 * c2 != 0) {
        if (std::abs(h1 - h2) > std::numbers::pi) h += h < kTurn ? kTurn : -kTurn;
        h /= 2;
    }
    const double t = 1 - 0.17 * std::cos(h - 30 * kDeg) + 0.24 * std::cos(2 * h) + 0.32 * std::cos(3 * h + 6 * kDeg) - 0.20 * std::cos(4 * h - 63 * kDeg);
    const double turn = 30 * kDeg * std::exp(-std::pow((h / kDeg - 275) / 25, 2));
    const double rc = 2 * std::sqrt(pow7(c) / (pow7(c) + pow7(25)));
    const double sl = 1 + 0.015 * (l - 50) * (l - 50) / std::sqrt(20 + (l - 50) * (l - 50)), sc = 1 + 0.045 * c, sh = 1 + 0.015 * c * t;
    const double x = dl / sl, y = dc / sc, z = dhue / sh;
    return std::sqrt(std::max(0.0, x * x + y * y + z * z - std::sin(2 * turn) * rc * y * z));
}

}  // namespace vdbcarve
