// SPDX-License-Identifier: Apache-2.0
// The lines of sight that the fair surface must meet, on one level of its pyramid.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "fair/fair_level.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::fairing {

class SightLines {
  public:
    /// `scale`: pixels a side of what counts as a pixel here; 0: about as large as a voxel. `exact`: where that is a pixel, all lines are
    /// asked in the end, else every second. `coarse`: the coarser level, for where to grow to when nothing is
    /// near; or null. All borrowed.
    SightLines(Level& level, const Level* coarse, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale, bool exact,
               Progress& progress);

    /// Lines of the inside that meet the field not at least `safe` voxels deep are asked again by repair(). `all`: else of every second.
    void find_near(float safe_vox, bool all);
    /// Lowers the field until all lines that are known meet it, growing on from where it is; at most so many rounds. A line that pulls pulls what lies so many
    /// voxels along it. `anywhere`: what does not grow from the surface is bridged to it, or stands alone. `share`: every fourth line only, of which there are
    /// four choices: enough between steps of motion.
    void repair(int rounds, float along_vox, bool anywhere, std::optional<size_t> share = {});

    /// Samples at least half a one inside a contour and not ignored.
    size_t inside_samples() const;
    size_t open() const { return open_; }  ///< lines that the last repair() left
    int scale() const { return scale_; }

  private:
    static constexpr size_t kShares = 4;
    using Lines = std::array<std::vector<kernel::FairLine>, kShares>;  ///< by where the sample lies in its square of 2 x 2
    /// visit(view, i0, j0, there, lines) for squares of kSquare samples; `there` is passed on along a row of them.
    template <class Visit>
    Lines each_square(const Visit& visit) const;
    template <class Visit>
    void each_sample_of(uint32_t view, int i0, int j0, int side, const Visit& visit) const;
    void ask_square(uint32_t view, int i, int j, int side, float safe_vox, bool all, int& there, Lines& out) const;
    void find_rim();
    bool says_nothing(const DistanceField& field, int x, int y) const { return !field.ignored.empty() && field.ignored.at(x, y) > -0.5f; }
    /// A line that does not meet the field, and where it would soonest.
    struct Open {
        kernel::FairLine* line;
        kernel::FairOpen at;
    };
    struct Round {
        std::vector<Open> beside, alone;  ///< those that have surface near, and the others
    };
    Round look(const std::vector<kernel::FairLine*>& lines, float grows_from) const;
    /// Whether anything changed; so do bridge() and reach_alone() say.
    bool grow(const std::vector<Open>& open, float along_vox, bool to_the_hull);
    bool lower(const std::vector<int64_t>& voxels, float to_vox);
    /// Takes off what grow() found.
    bool fall();
    /// A thin piece of the hull from a voxel to the nearest surface; where there is no way inside the hull, the voxel stands alone.
    bool bridge(const openvdb::Coord& from);
    bool reach_alone(const std::vector<Open>& alone);

    Level& level_;
    const Level* coarse_;
    int scale_ = 1;
    bool exact_ = true;
    std::vector<DistanceField> fields_;
    std::vector<kernel::FairEye> eyes_;
    Lines rim_, near_;
    std::vector<float> fall_;     ///< by voxel; 0 but while grow() works
    std::vector<uint8_t> falls_;  ///< by leaf: whether something in it is to fall
    size_t open_ = 0;
};

}  // namespace vdbcarve::fairing
