// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/distance.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <string>

#include "vdbcarve/error.h"
#include "vdbcarve/kernel/distance.h"

namespace vdbcarve {
namespace {

using namespace kernel;

/// Distance in 1/64 px along the second axis from every lattice point to the nearest crossing in its line,
/// stored line by line: `lines` lines of `length` points, value(line, at) read through the accessor.
template <class Value>
std::vector<int32_t> line_distances(int lines, int length, const Value& value) {
    std::vector<int32_t> out(static_cast<size_t>(lines) * static_cast<size_t>(length), kNoSite);
    for (int line = 0; line < lines; ++line) {
        int32_t* d = out.data() + static_cast<size_t>(line) * static_cast<size_t>(length);
        bool any = false;
        int32_t run = kNoSite;
        uint8_t before = value(line, 0);
        d[0] = kNoSite;
        for (int at = 1; at < length; ++at) {
            const uint8_t here = value(line, at);
            if (run < kNoSite) run += kSubpixel;
            if (is_object(before) != is_object(here)) {
                const int t = crossing(before, here);
                run = kSubpixel - t;
                d[at - 1] = std::min(d[at - 1], t);
                any = true;
            }
            d[at] = run;
            before = here;
        }
        if (!any) continue;
        for (int at = length - 2; at >= 0; --at)
            if (d[at + 1] < kNoSite) d[at] = std::min(d[at], d[at + 1] + kSubpixel);
    }
    return out;
}

/// Lower envelope across lines: for every point of the first axis, min over lines of (64 (x - line))^2 + d^2.
/// Takes the smaller of that and what `squared(x, y)` already holds.
template <class Get, class Put>
void across_lines(const std::vector<int32_t>& d, int lines, int length, const Get& get, const Put& put) {
    const int64_t unit2 = static_cast<int64_t>(kSubpixel) * kSubpixel;
    std::vector<int> site(static_cast<size_t>(lines));
    std::vector<int64_t> start(static_cast<size_t>(lines)), height2(static_cast<size_t>(lines));
    for (int at = 0; at < length; ++at) {
        int top = -1;
        for (int line = 0; line < lines; ++line) {
            const int32_t g = d[static_cast<size_t>(line) * static_cast<size_t>(length) + static_cast<size_t>(at)];
            if (g >= kNoSite) continue;
            const int64_t g2 = static_cast<int64_t>(g) * g;
            int64_t from = 0;
            while (top >= 0) {
                const auto t = static_cast<size_t>(top);
                from = parabola_switch(site[t], height2[t], line, g2) + 1;
                if (from > start[t]) break;
                --top;
            }
            if (top < 0) from = 0;
            if (from < lines) {
                ++top;
                site[static_cast<size_t>(top)] = line;
                height2[static_cast<size_t>(top)] = g2;
                start[static_cast<size_t>(top)] = from;
            }
        }
        if (top < 0) continue;
        for (int x = lines - 1; x >= 0; --x) {
            while (start[static_cast<size_t>(top)] > x) --top;
            const int64_t dx = x - site[static_cast<size_t>(top)];
            const int64_t squared = unit2 * dx * dx + height2[static_cast<size_t>(top)];
            if (squared < get(x, at)) put(x, at, squared);
        }
    }
}

}  // namespace

ImageF signed_distance(ImageView<uint8_t> m) {
    if (m.width < 2 || m.height < 2)
        throw UsageError("a mask of " + std::to_string(m.width) + " x " + std::to_string(m.height) + " pixels has no contour; 2 x 2 is the least");
    const int width = m.width, height = m.height;
    constexpr int64_t kFar = INT64_MAX;
    std::vector<int64_t> squared(m.pixels(), kFar);
    const auto index = [&](int x, int y) { return static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x); };
    // Crossings on vertical edges: lines are columns.
    across_lines(line_distances(width, height, [&](int x, int y) { return m.at(x, y); }), width, height,
                 [&](int x, int y) { return squared[index(x, y)]; }, [&](int x, int y, int64_t v) { squared[index(x, y)] = v; });
    // Crossings on horizontal edges: lines are rows.
    across_lines(line_distances(height, width, [&](int y, int x) { return m.at(x, y); }), height, width,
                 [&](int y, int x) { return squared[index(x, y)]; }, [&](int y, int x, int64_t v) { squared[index(x, y)] = v; });

    ImageF out(width, height);
    const auto none = static_cast<float>(width + height);
    for (size_t i = 0; i < squared.size(); ++i)
        out.data[i] = squared[i] == kFar ? none : static_cast<float>(std::sqrt(static_cast<double>(squared[i])) / kSubpixel);

    for (int y = 0; y + 1 < height; ++y)
        for (int x = 0; x + 1 < width; ++x) {
            const ContourPieces pieces = contour_pieces(m.at(x, y), m.at(x + 1, y), m.at(x + 1, y + 1), m.at(x, y + 1));
            for (int p = 0; p < pieces.count; ++p) {
                for (int py = std::max(0, y - kRefine_px); py <= std::min(height - 1, y + 1 + kRefine_px); ++py)
                    for (int px = std::max(0, x - kRefine_px); px <= std::min(width - 1, x + 1 + kRefine_px); ++px) {
                        const double d2 = segment_distance2_px((px - x) * kSubpixel, (py - y) * kSubpixel, pieces.ax[p], pieces.ay[p],
                                                               pieces.bx[p], pieces.by[p]);
                        float& d = out.at(px, py);
                        if (d2 < static_cast<double>(d) * d) d = static_cast<float>(std::sqrt(d2));
                    }
            }
        }
    for (size_t i = 0; i < out.data.size(); ++i)
        if (is_object(m.data[i])) out.data[i] = -out.data[i];
    return out;
}

std::vector<DistanceField> distance_fields(const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress) {
    std::vector<DistanceField> out(masks.size());
    progress.begin("distance", masks.size());
    tbb::parallel_for(size_t{0}, masks.size(), [&](size_t i) {
        const MaskView& mask = masks[i];
        if (mask.coverage.empty()) {
            progress.step();
            return;
        }
        if (mask.ignore.empty()) {
            out[i].silhouette = signed_distance(mask.coverage);
        } else {
            Image8 unknown_as_object(mask.coverage.width, mask.coverage.height), seen = unknown_as_object;
            for (size_t p = 0; p < mask.coverage.pixels(); ++p) {
                const bool ignored = mask.ignore.data[p] != 0;
                unknown_as_object.data[p] = ignored ? 255 : mask.coverage.data[p];
                seen.data[p] = ignored ? 0 : 255;
            }
            out[i].silhouette = signed_distance(unknown_as_object);
            out[i].ignored = signed_distance(seen);
        }
        if (options.silhouette_offset_px != 0)
            for (float& s : out[i].silhouette.data) s -= static_cast<float>(options.silhouette_offset_px);
        progress.step();
    });
    return out;
}

}  // namespace vdbcarve
