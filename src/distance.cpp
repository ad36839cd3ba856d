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

constexpr int64_t kFar = INT64_MAX;

/// Squared distance, in (1/64 px)^2, from every pixel centre to the nearest crossing on a vertical edge; kFar where
/// there is none. Row-major. Two passes: along columns, all columns of a row at once, then across them.
std::vector<int64_t> vertical_crossings(ImageView<uint8_t> m) {
    const auto width = static_cast<size_t>(m.width), height = static_cast<size_t>(m.height);
    std::vector<int32_t> along(width * height, kNoSite);
    for (size_t y = 1; y < height; ++y) {
        const uint8_t *above = m.data + (y - 1) * width, *here = above + width;
        int32_t *d_above = along.data() + (y - 1) * width, *d_here = d_above + width;
        for (size_t x = 0; x < width; ++x) {
            d_here[x] = std::min(d_above[x] + kSubpixel, kNoSite);
            if (is_object(above[x]) != is_object(here[x])) {
                const int t = crossing(above[x], here[x]);
                d_above[x] = std::min(d_above[x], t);
                d_here[x] = kSubpixel - t;
            }
        }
    }
    for (size_t y = height - 1; y-- > 0;) {
        const int32_t* below = along.data() + (y + 1) * width;
        int32_t* here = along.data() + y * width;
        for (size_t x = 0; x < width; ++x) here[x] = std::min(here[x], std::min(below[x] + kSubpixel, kNoSite));
    }

    // Lower envelope of the parabolas (64 (x - site))^2 + along^2 of each row.
    const int64_t unit2 = static_cast<int64_t>(kSubpixel) * kSubpixel;
    std::vector<int64_t> squared(width * height, kFar), start(width), height2(width);
    std::vector<int> site(width);
    for (size_t y = 0; y < height; ++y) {
        const int32_t* d = along.data() + y * width;
        int top = -1;
        for (int x = 0; x < m.width; ++x) {
            if (d[x] >= kNoSite) continue;
            const int64_t d2 = static_cast<int64_t>(d[x]) * d[x];
            int64_t from = 0;
            while (top >= 0) {
                const auto t = static_cast<size_t>(top);
                from = parabola_switch(site[t], height2[t], x, d2) + 1;
                if (from > start[t]) break;
                --top;
            }
            if (top < 0) from = 0;
            if (from >= m.width) continue;
            ++top;
            site[static_cast<size_t>(top)] = x;
            height2[static_cast<size_t>(top)] = d2;
            start[static_cast<size_t>(top)] = from;
        }
        if (top < 0) continue;
        int64_t* row = squared.data() + y * width;
        for (int64_t x = m.width - 1; x >= 0; --x) {
            while (start[static_cast<size_t>(top)] > x) --top;
            const int64_t dx = x - site[static_cast<size_t>(top)];
            row[x] = unit2 * dx * dx + height2[static_cast<size_t>(top)];
        }
    }
    return squared;
}

/// Rows become columns, in tiles that fit the cache.
Image8 transposed(ImageView<uint8_t> m) {
    constexpr int kTile = 32;
    Image8 out(m.height, m.width);
    for (int y0 = 0; y0 < m.height; y0 += kTile)
        for (int x0 = 0; x0 < m.width; x0 += kTile)
            for (int x = x0; x < std::min(x0 + kTile, m.width); ++x)
                for (int y = y0; y < std::min(y0 + kTile, m.height); ++y) out.at(y, x) = m.at(x, y);
    return out;
}

}  // namespace

ImageF signed_distance(ImageView<uint8_t> m) {
    if (m.width < 2 || m.height < 2)
        throw UsageError("a mask of " + std::to_string(m.width) + " x " + std::to_string(m.height) + " pixels has no contour; 2 x 2 is the least");
    const int width = m.width, height = m.height;
    // Crossings on horizontal edges are crossings on vertical edges of the transposed mask.
    const std::vector<int64_t> vertical = vertical_crossings(m);
    const std::vector<int64_t> horizontal = vertical_crossings(transposed(m));
    ImageF out(width, height);
    const auto none = static_cast<float>(width + height);
    constexpr int kTile = 32;
    for (int y0 = 0; y0 < height; y0 += kTile)
        for (int x0 = 0; x0 < width; x0 += kTile)
            for (int y = y0; y < std::min(y0 + kTile, height); ++y)
                for (int x = x0; x < std::min(x0 + kTile, width); ++x) {
                    const int64_t squared = std::min(vertical[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)],
                                                     horizontal[static_cast<size_t>(x) * static_cast<size_t>(height) + static_cast<size_t>(y)]);
                    out.at(x, y) = squared == kFar ? none : static_cast<float>(std::sqrt(static_cast<double>(squared)) / kSubpixel);
                }

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
