// SPDX-License-Identifier: Apache-2.0
// The lines of sight that the fair surface must meet, on one level of its pyramid.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fair/fair_engine.h"
#include "fair/fair_level.h"
#include "fair/lone_lines.h"

namespace vdbcarve::fairing {

/// The functions are FairEngine's.
class SightLines {
  public:
    /// `coarse`: the coarser level, for where to grow to when nothing is near; or null. All borrowed.
    SightLines(Level& level, const Level* coarse, const SightPlan& plan, Progress& progress);

    void find_near(float safe_vox, bool all);
    void repair(const Repair& how);
    size_t inside_samples() const;
    size_t open() const { return open_; }

  private:
    using Lines = std::array<std::vector<kernel::FairLine>, kernel::kFairShares>;
    /// visit(view, i0, j0, there, lines) for squares of kFairSquare samples; `there` is passed on along a row of them.
    template <class Visit>
    Lines each_square(const Visit& visit) const;
    void ask_square(uint32_t view, int i, int j, int side, const kernel::FairAsk& ask, int& there, Lines& out) const;
    void find_rim();
    struct Open {
        kernel::FairLine* line;
        kernel::FairOpen at;
    };
    struct Round {
        std::vector<Open> beside, alone;  ///< those that have surface near, and the others
    };
    Round look(const std::vector<kernel::FairLine*>& lines, float grows_from) const;
    /// Whether anything changed; so does reach().
    bool grow(const std::vector<Open>& open, float along_vox, bool to_the_hull);
    bool reach(const std::vector<Open>& alone);

    Level& level_;
    const Level* coarse_;
    const SightPlan& plan_;
    std::vector<DistanceField> fields_;
    std::vector<kernel::FairMask> masks_;
    Lines rim_, near_;
    std::vector<float> fall_;     ///< by voxel; 0 but while grow() works
    std::vector<uint8_t> falls_;  ///< by leaf: whether something in it is to fall
    size_t open_ = 0;
};

}  // namespace vdbcarve::fairing
