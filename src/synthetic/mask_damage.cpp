// SPDX-License-Identifier: Apache-2.0
#include "synthetic/mask_damage.h"

#include <algorithm>
#include <cmath>

#include "synthetic/noise.h"
#include "vdbcarve/distance.h"

namespace vdbcarve::synth {

void damage(Image8& mask, const MaskDamage& d, bool holes_here, uint64_t seed) {
    const auto reach = static_cast<int>(std::ceil(4 * d.noise_px + std::abs(d.dilate_px) + 2));
    if (d.noise_px > 0 || d.dilate_px != 0) {
        const ImageF s = signed_distance(mask, std::clamp(reach + 2, 8, kernel::kMaxReach_px));
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x) {
                const float at = s.at(x, y);
                if (std::fabs(at) > static_cast<float>(reach)) continue;
                const double moved = at - d.dilate_px - (d.noise_px > 0 ? d.noise_px * wobble(x, y, d.correlation_px, seed) : 0);
                mask.at(x, y) = static_cast<uint8_t>(std::lround(255 * std::clamp(0.5 - moved, 0.0, 1.0)));
            }
    }
    if (!holes_here) return;
    Dice dice(seed);
    const ImageF s = signed_distance(mask, std::min(kernel::kMaxReach_px, static_cast<int>(4 * d.radius_px) + 8));
    const auto disc = [&](bool hole, const auto& suits) {
        for (int attempt = 0; attempt < 10000; ++attempt) {
            const int cx = static_cast<int>((0.5 + 0.5 * dice()) * (mask.width - 1)), cy = static_cast<int>((0.5 + 0.5 * dice()) * (mask.height - 1));
            if (!suits(s.at(cx, cy))) continue;
            const int r = static_cast<int>(d.radius_px) + 2;
            for (int y = std::max(0, cy - r); y <= std::min(mask.height - 1, cy + r); ++y)
                for (int x = std::max(0, cx - r); x <= std::min(mask.width - 1, cx + r); ++x) {
                    const double in = std::clamp(d.radius_px - std::hypot(x - cx, y - cy) + 0.5, 0.0, 1.0);
                    const double old = mask.at(x, y) / 255.0;
                    mask.at(x, y) = static_cast<uint8_t>(std::lround(255 * (hole ? std::min(old, 1 - in) : std::max(old, in))));
                }
            return;
        }
    };
    for (int i = 0; i < d.holes; ++i) disc(true, [&](float v) { return v < -1.2 * d.radius_px; });
    for (int i = 0; i < d.blobs; ++i) disc(false, [&](float v) { return std::fabs(v) < 0.5 * d.radius_px; });
}

}  // namespace vdbcarve::synth
