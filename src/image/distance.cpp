// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/distance.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "image/field_plan.h"
#include "vdbcarve/error.h"
#include "vdbcarve/kernel/distance.h"
#include "base/vector_loops.h"

namespace vdbcarve {

kernel::FieldView SampledField::view() const {
    constexpr float kFar = 1e30f;
    const auto edge = [&](int side, int at) { return cut[side] ? static_cast<float>(at) : (side < 2 ? -kFar : kFar); };
    return {samples.empty() ? nullptr : samples.data(),
            width,
            height,
            static_cast<float>(x0),
            static_cast<float>(y0),
            reach,
            blocks.data(),
            blocks_per_row,
            edge(0, x0),
            edge(1, y0),
            edge(2, x0 + width),
            edge(3, y0 + height)};
}

float SampledField::at(int x, int y) const {
    x = std::clamp(x - x0, 0, width - 1);
    y = std::clamp(y - y0, 0, height - 1);
    return static_cast<float>(samples[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)]) / kernel::kFieldUnits;
}

namespace {

using kernel::kBlock_px;

struct Box {
    int x0 = INT32_MAX, y0 = INT32_MAX, x1 = -1, y1 = -1;  ///< inclusive
    bool empty() const { return x1 < x0; }
};

Box object_box(ImageView<uint8_t> m) {
    Box box;
    for (int y = 0; y < m.height; ++y) {
        const uint8_t* row = m.data + static_cast<size_t>(y) * static_cast<size_t>(m.width);
        int first = 0, last = m.width - 1;
        while (first < m.width && !kernel::is_object(row[first])) ++first;
        if (first == m.width) continue;
        while (!kernel::is_object(row[last])) --last;
        box.x0 = std::min(box.x0, first);
        box.x1 = std::max(box.x1, last);
        if (box.y0 == INT32_MAX) box.y0 = y;
        box.y1 = y;
    }
    return box;
}

/// Distance, in blocks, to the nearest block that has `side` (row-major flags), that many blocks at most kFarBlocks:
/// between the blocks' nearest edges, so that neighbours are 0 apart. Exact, rounded down to 1/8 block, in pixels.
std::vector<int> block_distances(const std::vector<char>& side, int columns, int rows) {
    constexpr int kFarBlocks = 1 << 12;
    const auto at = [&](int x, int y) { return static_cast<size_t>(y) * static_cast<size_t>(columns) + static_cast<size_t>(x); };
    std::vector<int> along(side.size());
    for (int x = 0; x < columns; ++x) {
        int d = kFarBlocks;
        for (int y = 0; y < rows; ++y) along[at(x, y)] = d = side[at(x, y)] ? 0 : std::min(d + 1, kFarBlocks);
        d = kFarBlocks;
        for (int y = rows - 1; y >= 0; --y) along[at(x, y)] = d = std::min(along[at(x, y)], d + 1);
    }
    const auto gap = [](int blocks) { return std::max(blocks - 1, 0) * kBlock_px; };
    std::vector<int> out(side.size());
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < columns; ++x) {
            int64_t best = INT64_MAX;
            for (int d = 0; d < columns; ++d) {
                const int64_t across = gap(d);
                if (across * across >= best) break;
                for (const int n : {x - d, x + d}) {
                    if (n < 0 || n >= columns || along[at(n, y)] >= kFarBlocks) continue;
                    const int64_t down = gap(along[at(n, y)]);
                    best = std::min(best, across * across + down * down);
                }
            }
            out[at(x, y)] = best == INT64_MAX ? INT16_MAX : static_cast<int>(std::sqrt(static_cast<double>(best)));
        }
    return out;
}

/// FieldView::blocks of a window: the contour is at most a pixel from a centre on either side of it.
void fill_blocks(SampledField& field, ImageView<uint8_t> m, double offset) {
    const int columns = (field.width + kBlock_px - 1) / kBlock_px, rows = (field.height + kBlock_px - 1) / kBlock_px;
    std::vector<char> object(static_cast<size_t>(columns) * static_cast<size_t>(rows)), background(object.size());
    for (int y = 0; y < field.height; ++y) {
        const uint8_t* row = m.data + static_cast<size_t>(field.y0 + y) * static_cast<size_t>(m.width) + field.x0;
        for (int bx = 0; bx < columns; ++bx) {
            bool any = false, all = true;
            for (int x = bx * kBlock_px; x < std::min((bx + 1) * kBlock_px, field.width); ++x) {
                any |= kernel::is_object(row[x]);
                all &= kernel::is_object(row[x]);
            }
            const size_t at = static_cast<size_t>(y / kBlock_px) * static_cast<size_t>(columns) + static_cast<size_t>(bx);
            object[at] = static_cast<char>(object[at] | any);
            background[at] = static_cast<char>(background[at] | !all);
        }
    }
    const std::vector<int> to_object = block_distances(object, columns, rows), to_background = block_distances(background, columns, rows);
    field.blocks_per_row = columns;
    field.blocks.resize(object.size());
    for (size_t b = 0; b < object.size(); ++b) {
        const bool inside = !background[b];
        field.blocks[b] = static_cast<int16_t>(object[b] && background[b] ? 0 : kernel::block_bound(inside ? to_background[b] : to_object[b], inside, offset));
    }
}

/// Signed distance over a window of a mask.
SampledField window_field(ImageView<uint8_t> m, const FieldWindow& window, double reach, double offset) {
    SampledField out = field_header(m.width, m.height, window, reach);
    const FieldLengths lengths = field_lengths(reach, offset);
    out.samples.resize(static_cast<size_t>(out.width) * static_cast<size_t>(out.height));
    std::vector<int32_t> scratch(window_scratch(out.width, out.height));
    vector_loops().window_distance({m.data + static_cast<size_t>(out.y0) * static_cast<size_t>(m.width) + out.x0, m.width, out.width, out.height, lengths.reach,
                                    lengths.offset, lengths.clamp, out.samples.data(), scratch.data()});
    fill_blocks(out, m, offset);
    return out;
}

/// Samples of `scale` x `scale` pixels; the last ones of a row or column may hold fewer.
Image8 coarser(ImageView<uint8_t> m, int scale, bool largest) {
    Image8 out((m.width + scale - 1) / scale, (m.height + scale - 1) / scale);
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            int sum = 0, most = 0, n = 0;
            for (int v = y * scale; v < std::min((y + 1) * scale, m.height); ++v)
                for (int u = x * scale; u < std::min((x + 1) * scale, m.width); ++u, ++n) {
                    sum += m.at(u, v);
                    most = std::max<int>(most, m.at(u, v));
                }
            out.at(x, y) = static_cast<uint8_t>(largest ? most : (sum + n / 2) / n);
        }
    return out;
}

DistanceField field_of(const MaskView& mask, const DistanceOptions& options) {
    DistanceField out;
    out.scale = options.scale;
    out.mask_width = mask.coverage.width;
    out.mask_height = mask.coverage.height;
    Image8 held, ignore_held;
    ImageView<uint8_t> coverage = mask.coverage, ignore = mask.ignore;
    if (options.scale > 1) {
        coverage = held = coarser(mask.coverage, options.scale, options.conservative);
        if (!ignore.empty()) ignore = ignore_held = coarser(mask.ignore, options.scale, true);
    }
    check_mask_size(out.mask_width, out.mask_height, options.scale);
    const double offset = field_offset(options), reach = field_reach(options);
    Image8 unknown_as_object;
    if (!ignore.empty()) {
        unknown_as_object = Image8(coverage.width, coverage.height);
        Image8 seen = unknown_as_object;
        for (size_t p = 0; p < coverage.pixels(); ++p) {
            const bool ignored = ignore.data[p] != 0;
            unknown_as_object.data[p] = ignored ? 255 : coverage.data[p];
            seen.data[p] = ignored ? 0 : 255;
        }
        coverage = unknown_as_object;
        out.ignored = window_field(seen, {0, 0, seen.width, seen.height}, reach, 0);
    }
    const Box box = object_box(coverage);
    if (box.empty()) {
        out.silhouette = window_field(coverage, {0, 0, 2, 2}, reach, 0);
        return out;
    }
    out.object_box[0] = box.x0;
    out.object_box[1] = box.y0;
    out.object_box[2] = box.x1;
    out.object_box[3] = box.y1;
    out.silhouette = window_field(coverage, window_around(out.object_box, coverage.width, coverage.height, reach, offset), reach, offset);
    return out;
}

}  // namespace

double field_offset(const DistanceOptions& options) { return options.silhouette_offset_px / options.scale; }
double field_reach(const DistanceOptions& options) { return std::min(options.reach_samples, kernel::kMaxReach_px - std::fabs(field_offset(options))); }

FieldLengths field_lengths(double reach, double offset) {
    return {static_cast<int>((reach + std::fabs(offset)) * kernel::kSubpixel), static_cast<int>(std::lround(offset * kernel::kSubpixel)),
            static_cast<int>(reach * kernel::kSubpixel)};
}

FieldWindow window_around(const int box[4], int width, int height, double reach, double offset) {
    const int margin = static_cast<int>(std::ceil(reach + std::max(offset, 0.0))) + 2;
    return {std::max(0, box[0] - margin), std::max(0, box[1] - margin), std::min(width, box[2] + 1 + margin), std::min(height, box[3] + 1 + margin)};
}

SampledField field_header(int width, int height, const FieldWindow& w, double reach) {
    SampledField out;
    out.x0 = w.x0;
    out.y0 = w.y0;
    out.width = w.x1 - w.x0;
    out.height = w.y1 - w.y0;
    out.reach = static_cast<float>(reach);
    out.cut[0] = w.x0 > 0;
    out.cut[1] = w.y0 > 0;
    out.cut[2] = w.x1 < width;
    out.cut[3] = w.y1 < height;
    return out;
}

void check_distance(const DistanceOptions& options) {
    if (options.scale < 1) throw UsageError("distance: a field-scale of " + std::to_string(options.scale) + " px, must be >= 1");
    if (!(options.reach_samples >= 4 && options.reach_samples <= kernel::kMaxReach_px))
        throw UsageError("distance: a reach of " + std::to_string(options.reach_samples) + " samples, must be 4.." + std::to_string(kernel::kMaxReach_px));
    if (!(std::fabs(options.silhouette_offset_px) <= kernel::kMaxReach_px / 2 * options.scale))
        throw UsageError("distance: a silhouette offset of " + std::to_string(options.silhouette_offset_px) + " px, at most " +
                         std::to_string(kernel::kMaxReach_px / 2 * options.scale));
}

void check_mask_size(int mask_width, int mask_height, int scale) {
    if ((mask_width + scale - 1) / scale < 2 || (mask_height + scale - 1) / scale < 2)
        throw UsageError("a mask of " + std::to_string(mask_width) + " x " + std::to_string(mask_height) + " pixels has no contour" +
                         (scale > 1 ? " at field-scale " + std::to_string(scale) : "") + "; 2 x 2 is the least");
}

size_t planned_field_bytes(const MaskView& mask, const DistanceOptions& options) {
    if (mask.coverage.empty()) return 0;
    const int width = (mask.coverage.width + options.scale - 1) / options.scale, height = (mask.coverage.height + options.scale - 1) / options.scale;
    const auto bytes = [](int w, int h) { return static_cast<size_t>(w) * static_cast<size_t>(h) * sizeof(int16_t); };
    if (!mask.ignore.empty()) return 2 * bytes(width, height);
    Box box = object_box(mask.coverage);
    if (box.empty()) return bytes(2, 2);
    const int samples[4] = {box.x0 / options.scale, box.y0 / options.scale, box.x1 / options.scale, box.y1 / options.scale};
    const FieldWindow w = window_around(samples, width, height, options.reach_samples, field_offset(options));
    return bytes(w.x1 - w.x0, w.y1 - w.y0);
}

ImageF signed_distance(ImageView<uint8_t> m, int reach_px) {
    if (reach_px < 4 || reach_px > kernel::kMaxReach_px)
        throw UsageError("distance: a reach of " + std::to_string(reach_px) + " px, must be 4.." + std::to_string(kernel::kMaxReach_px));
    check_mask_size(m.width, m.height, 1);
    const SampledField field = window_field(m, {0, 0, m.width, m.height}, reach_px, 0);
    ImageF out(m.width, m.height);
    for (size_t i = 0; i < out.data.size(); ++i) out.data[i] = static_cast<float>(field.samples[i]) / kernel::kFieldUnits;
    return out;
}

std::vector<DistanceField> distance_fields(const std::vector<MaskView>& masks, const DistanceOptions& options, Progress& progress) {
    check_distance(options);
    std::vector<DistanceField> out(masks.size());
    progress.begin("distance", masks.size());
    tbb::parallel_for(size_t{0}, masks.size(), [&](size_t i) {
        if (!masks[i].coverage.empty()) out[i] = field_of(masks[i], options);
        progress.step();
    });
    return out;
}

}  // namespace vdbcarve
