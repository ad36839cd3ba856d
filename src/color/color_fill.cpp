// SPDX-License-Identifier: Apache-2.0
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>

#include "color/color_plan.h"
#include "vdbcarve/kernel/color_fill.h"

namespace vdbcarve {
namespace {

using kernel::Rgb;

/// Cells of one size, sorted.
struct Level {
    std::vector<uint64_t> keys;
    std::vector<Rgb> colors;
    std::vector<uint8_t> known;
    std::vector<int32_t> first;   ///< first child on the finer level, and one past the last
    std::vector<int32_t> parent;  ///< on the coarser level
    size_t unknown = 0;
};

template <class Work>
void for_all(size_t count, const Work& work) {
    for_ranges(count, 1024, [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n) work(n);
    });
}

Level coarser(Level& fine) {
    Level out;
    fine.parent.resize(fine.keys.size());
    for (size_t n = 0; n < fine.keys.size(); ++n) {
        const uint64_t key = fine.keys[n] >> 3;
        if (out.keys.empty() || out.keys.back() != key) {
            out.keys.push_back(key);
            out.first.push_back(static_cast<int32_t>(n));
        }
        fine.parent[n] = static_cast<int32_t>(out.keys.size()) - 1;
    }
    out.first.push_back(static_cast<int32_t>(fine.keys.size()));
    out.colors.resize(out.keys.size());
    out.known.resize(out.keys.size());
    for_all(out.keys.size(),
            [&](size_t n) { out.known[n] = kernel::parent_color(fine.colors.data(), fine.known.data(), out.first[n], out.first[n + 1], out.colors[n]); });
    out.unknown = static_cast<size_t>(std::count(out.known.begin(), out.known.end(), uint8_t{0}));
    return out;
}

void relax(Level& level, const Level& coarse) {
    std::vector<int32_t> cells;
    for (size_t n = 0; n < level.keys.size(); ++n)
        if (!level.known[n]) cells.push_back(static_cast<int32_t>(n));
    const auto count = static_cast<int32_t>(level.keys.size());
    // Of 26 places about nine are taken: lists of those, in chunks that threads make by themselves.
    struct Link {
        int32_t cell;
        int32_t place;
    };
    constexpr size_t kChunk = 4096;
    const size_t chunks = (cells.size() + kChunk - 1) / kChunk;
    std::vector<std::vector<Link>> links(chunks);
    std::vector<std::vector<uint32_t>> ends(chunks);
    std::vector<Rgb> next(cells.size());
    const auto for_chunks = [&](const auto& work) {
        tbb::parallel_for(size_t{0}, chunks, [&](size_t chunk) { work(chunk, chunk * kChunk, std::min(cells.size(), (chunk + 1) * kChunk)); });
    };
    for_chunks([&](size_t chunk, size_t first, size_t last) {
        for (size_t c = first; c < last; ++c) {
            const auto n = static_cast<size_t>(cells[c]);
            level.colors[n] = coarse.colors[static_cast<size_t>(level.parent[n])];
            for (int d = 0; d < kernel::kFillNeighbours; ++d)
                if (const int32_t at = kernel::fill_neighbour(level.keys.data(), count, cells[c], d); at >= 0) links[chunk].push_back({at, d});
            ends[chunk].push_back(static_cast<uint32_t>(links[chunk].size()));
        }
    });
    for (int sweep = 0; sweep < kernel::kFillSweeps; ++sweep) {
        for_chunks([&](size_t chunk, size_t first, size_t last) {
            const Link* link = links[chunk].data();
            for (size_t c = first; c < last; ++c) {
                kernel::Relaxation relaxation(level.colors[static_cast<size_t>(cells[c])]);
                for (const Link* end = links[chunk].data() + ends[chunk][c - first]; link < end; ++link)
                    relaxation.add(level.colors[static_cast<size_t>(link->cell)], link->place);
                next[c] = relaxation.value();
            }
        });
        for_chunks([&](size_t, size_t first, size_t last) {
            for (size_t c = first; c < last; ++c) level.colors[static_cast<size_t>(cells[c])] = next[c];
        });
    }
}

}  // namespace

void fill_colors(const std::vector<uint64_t>& keys, const std::vector<uint8_t>& known, std::vector<Rgb>& colors) {
    std::vector<Level> levels(1);
    levels[0].unknown = static_cast<size_t>(std::count(known.begin(), known.end(), uint8_t{0}));
    if (levels[0].unknown == 0 || levels[0].unknown == keys.size()) return;
    std::vector<std::pair<uint64_t, uint32_t>> order(keys.size());
    for_all(keys.size(), [&](size_t n) { order[n] = {keys[n], static_cast<uint32_t>(n)}; });
    tbb::parallel_sort(order.begin(), order.end());
    levels[0].keys.resize(keys.size());
    levels[0].colors.resize(keys.size());
    levels[0].known.resize(keys.size());
    for_all(keys.size(), [&](size_t n) {
        levels[0].keys[n] = order[n].first;
        levels[0].colors[n] = colors[order[n].second];
        levels[0].known[n] = known[order[n].second];
    });
    while (levels.back().unknown) {
        Level next = coarser(levels.back());
        levels.push_back(std::move(next));
    }
    for (size_t l = levels.size() - 1; l-- > 0;) relax(levels[l], levels[l + 1]);
    for_all(keys.size(), [&](size_t n) { colors[order[n].second] = levels[0].colors[n]; });
}

}  // namespace vdbcarve
