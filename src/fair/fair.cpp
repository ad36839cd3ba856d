// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/fair.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <string>

#include "fair/cpu_engine.h"
#include "fair/fair_engine.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fairing {

namespace {

/// The longest side has about so many voxels, 70 to 140, where the motion happens: large moves are cheap where voxels are large.
constexpr double kCoarsest_vox = 99;
/// How a level moves: steps of such a width, between which lines of sight pull back what lies so many voxels along them.
struct Motion {
    double width_vox;
    bool stiff;
    float along_vox;
    float follow;  ///< of the way to the depths, a step
    bool ends;     ///< the level: the last step does not follow the depths, so that what is left is smooth
};
/// Area shrinks; then ridges where lines pulled go; then what repairs left is spread.
constexpr Motion kShrink{1.5, false, 2.45f, 1.f, false}, kFair{1.5, true, 2.45f, 1.f, false}, kSpread{1.2, true, 3.f, 0.f, true};
/// Where depths lead, noise of theirs is spread, too: wider.
constexpr Motion kSpreadLed{1.8, true, 3.f, 0.7f, true};
constexpr int kFinerSteps = 3, kFairSteps = 20, kSpreadSteps = 3, kSpreadStepsLed = 5;
/// kernel::eased(), in between_contours_vox(): that of the hull, and as much of the stretched surface. At most such a share of the longest side, for parts are
/// less round than the whole is large; and distances are not known much farther than the band.
constexpr double kEase = 2, kMostEase = 0.01, kMostEase_vox = 2.8;
constexpr int kRoundsBetween = 2, kRoundsAtTheEnd = 1000;
/// All lines of the inside are asked every so many steps; between, those that were not this deep.
constexpr int kAskAll = 20;
constexpr float kSafe_vox = -2.f;
/// A piece with less than this share of the largest hangs in the air because of how the surface moved.
constexpr double kLeastPiece = 1e-3;

kernel::FairBlur blur_of(double width_vox) {
    double w[kernel::kFairReach + 1], sum = 0;
    for (int n = 0; n <= kernel::kFairReach; ++n) {
        w[n] = std::exp(-static_cast<double>(n * n) / (2 * width_vox * width_vox));
        sum += n ? 2 * w[n] : w[n];
    }
    kernel::FairBlur out{};
    for (int n = 0; n <= kernel::kFairReach; ++n) out.weight[n] = static_cast<float>(w[n] / sum);
    return out;
}

void steps(FairEngine& engine, int count, const Motion& motion, Progress& progress) {
    const kernel::FairBlur blur = blur_of(motion.width_vox);
    for (int n = 1; n <= count; ++n) {
        progress.check();
        engine.move(blur, motion.stiff);
        if (engine.led() && (n < count || !motion.ends)) engine.follow(motion.follow);
        if (n % kAskAll == 0) engine.find_near(kSafe_vox, false);
        engine.repair({kRoundsBetween, motion.along_vox, false, static_cast<size_t>(n)});
        progress.step();
    }
}

void repair_all(FairEngine& engine) {
    engine.find_near(0.f, true);
    engine.repair({kRoundsAtTheEnd, kSpread.along_vox, true, {}});
}

/// Distances become true, pieces in the air go, and what those covered grows from the others.
size_t tidy(FairEngine& engine) {
    const size_t dropped = engine.drop_pieces(kLeastPiece);
    engine.make_distances();
    repair_all(engine);
    return dropped;
}

double voxel_volume(const openvdb::FloatGrid& grid) { return std::pow(grid.voxelSize()[0], 3); }

/// What is left in the end.
void take(FairEngine& engine, const openvdb::FloatGrid& hull, FairResult& out) {
    out.uncovered = engine.open();
    out.lines_of_sight = engine.inside_samples();
    out.surface = engine.surface();
    out.volume = voxel_volume(hull) * engine.volume_vox();
}

}  // namespace

void check_fair(const FairOptions& options) {
    if (!(options.fairness >= 0 && options.fairness <= 0.5)) throw UsageError("--fairness: " + std::to_string(options.fairness) + ", must be within 0..0.5");
}

FairResult fair_by(FairEngine& engine, const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress) {
    FairResult out;
    out.hull_volume = voxel_volume(hull) * engine.hull_volume_vox();
    if (options.fairness == 0) {
        out.surface = hull.deepCopy();
        out.volume = out.hull_volume;
        return out;
    }
    double longest = engine.lattice().longest_vox();
    size_t levels = 1;
    // Depths carve deep, and only the coarsest level has values all over the inside when it was made from a finer one.
    for (; longest > std::sqrt(2.0) * kCoarsest_vox || (levels == 1 && engine.led()); longest /= 2, ++levels)
        engine.coarsen(longest / 2 <= std::sqrt(2.0) * kCoarsest_vox);
    const int spread_steps = engine.led() ? kSpreadStepsLed : kSpreadSteps;
    const auto first_steps = static_cast<int>(std::lround(std::pow(options.fairness * longest / kShrink.width_vox, 2)));
    progress.begin("fair", static_cast<size_t>(first_steps) + kFairSteps + (levels - 1) * kFinerSteps + levels * static_cast<size_t>(spread_steps + 1));

    engine.begin();
    for (size_t at = levels; at-- > 0;) {
        const auto start = std::chrono::steady_clock::now();
        const bool is_first = out.level_seconds.empty();
        SightPlan plan = plan_sight(engine.lattice(), hull.transform(), views, 0, at == 0);
        engine.aim(plan, progress);
        engine.find_near(kSafe_vox, false);
        steps(engine, is_first ? first_steps : kFinerSteps, kShrink, progress);
        if (is_first) steps(engine, kFairSteps, kFair, progress);
        if (!engine.led()) {  // depths know better than the hull
            const double round_vox = kEase * between_contours_vox(engine.lattice(), hull.transform(), views);
            engine.ease(static_cast<float>(std::min({round_vox, kMostEase * engine.lattice().longest_vox(), kMostEase_vox})));
        }
        steps(engine, spread_steps, engine.led() ? kSpreadLed : kSpread, progress);
        out.pieces_dropped = tidy(engine);
        progress.step();
        if (at > 0) {
            engine.refine();
        } else if (plan.scale > 1) {  // in the end every pixel is asked
            plan = plan_sight(engine.lattice(), hull.transform(), views, 1, true);
            engine.aim(plan, progress);
            repair_all(engine);
        }
        if (at == 0) take(engine, hull, out);
        out.level_seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
    return out;
}

}  // namespace fairing

FairResult cover_again(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface, const std::vector<FairView>& views, Progress& progress) {
    using namespace fairing;
    CpuEngine engine(hull, nullptr);
    FairResult out;
    out.hull_volume = voxel_volume(hull) * engine.hull_volume_vox();
    engine.begin(surface);
    const SightPlan plan = plan_sight(engine.lattice(), hull.transform(), views, 1, true);
    engine.aim(plan, progress);
    repair_all(engine);
    take(engine, hull, out);
    return out;
}

FairResult fair(const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                const FairEvidence* evidence) {
    fairing::check_fair(options);
    fairing::CpuEngine engine(hull, evidence);
    return fairing::fair_by(engine, hull, views, options, progress);
}

}  // namespace vdbcarve
