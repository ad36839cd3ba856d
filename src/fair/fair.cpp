// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/fair.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <string>

#include "fair/fair_level.h"
#include "fair/sight_lines.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

using namespace fairing;

namespace {

/// The longest side has about so many voxels where the motion happens: large moves are cheap where voxels are large.
constexpr double kCoarsest_vox = 128;
/// How a level moves: steps of such a width, between which lines of sight pull back what lies so many voxels along them.
struct Motion {
    double width_vox;
    bool stiff;
    float along_vox;
};
/// Area shrinks; then ridges where lines pulled go; then what repairs left is spread.
constexpr Motion kShrink{1.5, false, 2.45f}, kFair{1.5, true, 2.45f}, kSpread{1.2, true, 3.f};
constexpr int kFinerSteps = 3, kFairSteps = 12, kSpreadSteps = 3;
constexpr int kRoundsBetween = 2, kRoundsAtTheEnd = 100;
/// All lines of the inside are asked every so many steps; between, those that were not this deep.
constexpr int kAskAll = 20;
constexpr float kSafe_vox = -2.f;
/// A piece with less than this share of the largest hangs in the air because of how the surface moved.
constexpr double kLeastPiece = 1e-3;

void steps(Level& level, SightLines& lines, int count, const Motion& motion, Progress& progress) {
    for (int n = 1; n <= count; ++n) {
        progress.check();
        move(level, motion.width_vox, motion.stiff);
        if (n % kAskAll == 0) lines.find_near(kSafe_vox, false);
        lines.repair(kRoundsBetween, motion.along_vox, false, static_cast<size_t>(n));
        progress.step();
    }
}

/// Distances become true, pieces in the air go, and what those covered grows from the others.
size_t tidy(Level& level, SightLines& lines) {
    const size_t dropped = drop_pieces(level, kLeastPiece);
    make_distances(level, level.field.of);
    level.for_leaves([&](size_t n) {
        for (size_t at = n * kLeafVoxels; at < (n + 1) * kLeafVoxels; ++at) level.field.of[at] = kernel::max_f(level.field.of[at], level.hull.of[at]);
    });
    lines.find_near(0.f, true);
    lines.repair(kRoundsAtTheEnd, kSpread.along_vox, true);
    return dropped;
}

}  // namespace

FairResult fair(const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress) {
    if (!(options.fairness >= 0 && options.fairness <= 0.5)) throw UsageError("--fairness: " + std::to_string(options.fairness) + ", must be within 0..0.5");
    std::vector<Level> hulls{level_of(hull)};
    find_least(hulls[0], hulls[0].hull);
    FairResult out;
    const double voxel_volume = std::pow(hull.voxelSize()[0], 3);
    out.hull_volume = voxel_volume * hulls[0].volume_vox(hulls[0].hull);
    if (options.fairness == 0) {
        out.surface = hull.deepCopy();
        out.volume = out.hull_volume;
        return out;
    }
    double longest = 8.0 * *std::max_element(hulls[0].size.begin(), hulls[0].size.end()) - 16;
    for (; longest > std::sqrt(2.0) * kCoarsest_vox; longest /= 2) hulls.push_back(coarser(hulls.back(), longest / 2 <= std::sqrt(2.0) * kCoarsest_vox));
    const auto first_steps = static_cast<int>(std::lround(std::pow(options.fairness * longest / kShrink.width_vox, 2)));
    progress.begin("fair", static_cast<size_t>(first_steps) + kFairSteps + (hulls.size() - 1) * kFinerSteps + hulls.size() * (kSpreadSteps + 1));

    Level level = hulls.back(), coarse;
    level.field = level.hull;
    for (size_t at = hulls.size(); at-- > 0;) {
        const auto start = std::chrono::steady_clock::now();
        const bool is_first = out.level_seconds.empty();
        const Level* below = is_first ? nullptr : &coarse;
        auto lines = std::make_unique<SightLines>(level, below, hull.transform(), views, 0, at == 0, progress);
        lines->find_near(kSafe_vox, false);
        steps(level, *lines, is_first ? first_steps : kFinerSteps, kShrink, progress);
        if (is_first) steps(level, *lines, kFairSteps, kFair, progress);
        steps(level, *lines, kSpreadSteps, kSpread, progress);
        out.pieces_dropped = tidy(level, *lines);
        progress.step();
        if (at == 0) {
            if (lines->scale() > 1) {  // in the end every pixel is asked
                lines = std::make_unique<SightLines>(level, below, hull.transform(), views, 1, true, progress);
                lines->find_near(0.f, true);
                lines->repair(kRoundsAtTheEnd, kSpread.along_vox, true);
            }
            out.uncovered = lines->open();
            out.lines_of_sight = lines->inside_samples();
        } else {
            lines.reset();
            Level finer = carried_over(hulls[at - 1], level);
            coarse = std::move(level);
            level = std::move(finer);
        }
        hulls.pop_back();
        out.level_seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
    out.surface = grid_of(level, hull);
    out.volume = voxel_volume * level.volume_vox(level.field);
    return out;
}

}  // namespace vdbcarve
