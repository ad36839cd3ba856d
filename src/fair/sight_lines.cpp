// SPDX-License-Identifier: Apache-2.0
#include "fair/sight_lines.h"

#include <algorithm>
#include <atomic>

namespace vdbcarve::fairing {

using kernel::FairAsk;
using kernel::FairField;
using kernel::FairLine;
using kernel::FairMask;
using kernel::FairOpen;
using kernel::kFairSquare;

SightLines::SightLines(Level& level, const Level* coarse, const SightPlan& plan, Progress& progress)
    : level_(level), coarse_(coarse), plan_(plan), fields_(distance_fields(plan.masks, plan.fields, progress)) {
    for (const DistanceField& f : fields_) masks_.push_back(mask_of(f, f.silhouette.samples.data(), f.ignored.samples.data()));
    find_rim();
}

template <class Visit>
SightLines::Lines SightLines::each_square(const Visit& visit) const {
    struct Row {
        uint32_t view;
        int y;
    };
    std::vector<Row> rows;
    for (size_t u = 0; u < masks_.size(); ++u)
        for (int y = 0; y < masks_[u].height; y += kFairSquare) rows.push_back({static_cast<uint32_t>(u), y});
    constexpr size_t kRows = 4;
    std::vector<Lines> found((rows.size() + kRows - 1) / kRows);
    tbb::parallel_for(size_t{0}, found.size(), [&](size_t c) {
        for (size_t n = c * kRows; n < std::min(rows.size(), (c + 1) * kRows); ++n) {
            int there = 0;
            for (int x = 0; x < masks_[rows[n].view].width; x += kFairSquare) visit(rows[n].view, x, rows[n].y, there, found[c]);
        }
    });
    Lines out;
    for (size_t n = 0; n < out.size(); ++n)
        for (const Lines& part : found) out[n].insert(out[n].end(), part[n].begin(), part[n].end());
    return out;
}

size_t SightLines::inside_samples() const {
    std::atomic<size_t> count{0};
    tbb::parallel_for(size_t{0}, masks_.size(), [&](size_t u) {
        size_t here = 0;
        for (int j = 0; j < masks_[u].height; ++j)
            for (int i = 0; i < masks_[u].width; ++i) here += masks_[u].counts(i, j);
        count += here;
    });
    return count;
}

namespace {

void add(std::array<std::vector<FairLine>, kernel::kFairShares>& out, const FairMask& m, uint32_t view, int i, int j, FairLine& line) {
    line.view = view;
    line.sample = static_cast<uint32_t>(j * m.width + i);
    out[static_cast<size_t>(kernel::share_of(i, j))].push_back(line);
}

}  // namespace

void SightLines::find_rim() {
    const FairField hull = level_.view(level_.hull);
    const FairAsk ask{0.f, true, plan_.exact};
    rim_ = each_square([&](uint32_t u, int i0, int j0, int&, Lines& out) {
        const FairMask& m = masks_[u];
        for (int j = j0; j < std::min(j0 + kFairSquare, m.height); ++j)
            for (int i = i0; i < std::min(i0 + kFairSquare, m.width); ++i) {
                FairLine line;
                if (kernel::rim_line_of(m, plan_.eyes[u], hull, ask, i, j, line)) add(out, m, u, i, j, line);
            }
    });
}

void SightLines::ask_square(uint32_t u, int i0, int j0, int side, const FairAsk& ask, int& there, Lines& out) const {
    const FairMask& m = masks_[u];
    const FairField f = level_.view(level_.field);
    if (!kernel::opens_square(m, plan_.eyes[u], f, i0, j0, side, there)) return;
    if (side > 1) {
        for (int n = 0; n < 4; ++n) ask_square(u, i0 + (n & 1) * side / 2, j0 + (n >> 1) * side / 2, side / 2, ask, there, out);
        return;
    }
    FairLine line;
    if (kernel::near_line_of(m, plan_.eyes[u], f, ask, i0, j0, there, line)) add(out, m, u, i0, j0, line);
}

void SightLines::find_near(float safe_vox, bool all) {
    find_least(level_, level_.field);
    const FairAsk ask{safe_vox, all, plan_.exact};
    near_ = each_square([&](uint32_t u, int i0, int j0, int& there, Lines& out) { ask_square(u, i0, j0, kFairSquare, ask, there, out); });
}

SightLines::Round SightLines::look(const std::vector<FairLine*>& lines, float grows_from) const {
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull), coarse = coarse_ ? coarse_->view(coarse_->field) : FairField{};
    constexpr size_t kLines = 256;
    std::vector<Round> parts((lines.size() + kLines - 1) / kLines);
    tbb::parallel_for(size_t{0}, parts.size(), [&](size_t p) {
        for (size_t n = p * kLines; n < std::min(lines.size(), (p + 1) * kLines); ++n) {
            if (kernel::still_met(f, *lines[n])) continue;
            const FairOpen open = kernel::look_along(f, hull, coarse, *lines[n]);
            if (open.place.sample >= 0) (open.place.value < grows_from ? parts[p].beside : parts[p].alone).push_back({lines[n], open});
        }
    });
    Round out;
    for (const Round& part : parts) {
        out.beside.insert(out.beside.end(), part.beside.begin(), part.beside.end());
        out.alone.insert(out.alone.end(), part.alone.begin(), part.alone.end());
    }
    return out;
}

bool SightLines::grow(const std::vector<Open>& open, float along_vox, bool to_the_hull) {
    // Each is reckoned from the field as it was, and where two meet the larger fall counts, so no order matters.
    const FairField f = level_.view(level_.field);
    fall_.resize(level_.field.of.size());
    falls_.resize(level_.leaves());
    const auto lower = [this](int64_t at, float by) {
        const std::atomic_ref<float> cell(fall_[static_cast<size_t>(at)]);
        float now = cell.load(std::memory_order_relaxed);
        while (by > now && !cell.compare_exchange_weak(now, by, std::memory_order_relaxed)) {
        }
        const std::atomic_ref<uint8_t> leaf(falls_[static_cast<size_t>(at) / kLeafVoxels]);
        if (!leaf.load(std::memory_order_relaxed)) leaf.store(1, std::memory_order_relaxed);
    };
    tbb::parallel_for(tbb::blocked_range<size_t>(0, open.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n) {
            const kernel::FairPull pull = kernel::pull_of(f, *open[n].line, open[n].at, along_vox, to_the_hull);
            for (int column = 0; column < pull.columns(); ++column) kernel::lower_column(f, pull, column, lower);
        }
    });
    std::vector<size_t> leaves;
    for (size_t n = 0; n < falls_.size(); ++n)
        if (falls_[n]) leaves.push_back(n);
    std::atomic<bool> changed{false};
    Level::for_each_of(leaves.size(), [&](size_t l) {
        bool here = false;
        for (size_t at = leaves[l] * kLeafVoxels; at < (leaves[l] + 1) * kLeafVoxels; ++at) {
            float& v = level_.field.of[at];
            const float now = kernel::fallen(v, fall_[at], level_.hull.of[at]);
            fall_[at] = 0.f;
            here |= now < v;
            v = now;
        }
        falls_[leaves[l]] = 0;
        if (here) changed.store(true, std::memory_order_relaxed);
    });
    if (changed) update_least(level_, level_.field, leaves);
    return changed;
}

bool SightLines::reach(const std::vector<Open>& alone) {
    std::vector<LoneLine> lines;
    for (const Open& open : alone) lines.push_back({*open.line, open.at});
    const std::vector<size_t> fell = reach_alone(level_, std::move(lines));
    update_least(level_, level_.field, fell);
    return !fell.empty();
}

void SightLines::repair(const Repair& how) {
    std::vector<FairLine*> open;
    for (Lines* lines : {&rim_, &near_})
        for (size_t n = 0; n < lines->size(); ++n)
            if (how.takes(n, plan_.exact))
                for (FairLine& line : (*lines)[n]) open.push_back(&line);
    find_least(level_, level_.field);
    for (int round = 0; round < how.rounds && !open.empty(); ++round) {
        const Round found = look(open, how.grows_from());
        open.clear();
        for (const auto* part : {&found.beside, &found.alone})
            for (const Open& o : *part) open.push_back(o.line);
        // Growing from the surface comes first; what has nothing near waits until that ends.
        if (!grow(found.beside, how.along_vox, round >= kPatience) && !(how.anywhere && reach(found.alone))) break;
    }
    open_ = static_cast<size_t>(std::count_if(open.begin(), open.end(), [](const FairLine* line) { return line->must < kernel::kFairBand_vox; }));
}

}  // namespace vdbcarve::fairing
