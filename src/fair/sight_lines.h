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

/// One pixel's line of sight: between its samples `first` and `last` the field must fall to `target` somewhere.
struct Line {
    kernel::FairRay ray;
    float target;
    int32_t first, last;
    bool must;     ///< covered, wherever; else: only where the surface is near, it keeps the hull's contour
    bool settled;  ///< what the hull allows is part of target, first and last
};

class SightLines {
  public:
    /// `scale`: pixels a side of what counts as a pixel here; 0: about as large as a voxel. `coarse`: the coarser level, for where to grow to when nothing is
    /// near; or null. All borrowed.
    SightLines(Level& level, const Level* coarse, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale, Progress& progress);

    /// Lines of the inside that meet the field not at least `safe` voxels deep are asked again by repair().
    void find_near(float safe_vox);
    /// Lowers the field until all lines that are known meet it, growing on from where it is; at most so many rounds. `anywhere`: what does not grow from the
    /// surface is bridged to it, or stands alone. `half`: every second line only, from the first or the second on: enough
    /// between steps of motion.
    void repair(int rounds, bool anywhere, std::optional<size_t> half = {});

    /// Samples at least half a one inside a contour and not ignored.
    size_t inside_samples() const;
    size_t open() const { return open_; }  ///< lines that the last repair() left
    int scale() const { return scale_; }

  private:
    template <class Visit>
    std::vector<Line> each_sample(const Visit& visit) const;
    void find_rim();
    void cover_by_balls(float safe_vox);
    /// A line that keeps the contour.
    void add(std::vector<Line>& out, const kernel::FairRay& ray, float target) const;
    bool says_nothing(const DistanceField& field, int x, int y) const { return !field.ignored.empty() && field.ignored.at(x, y) > -0.5f; }
    /// A value that is to become lower.
    struct Lower {
        int64_t at;
        float value;
    };
    /// A line that does not meet the field, and where it would soonest.
    struct Open {
        const Line* line;
        kernel::NearestPlace place;
    };
    struct Round {
        std::vector<Line*> open;
        std::vector<Open> beside, alone;  ///< of these, those that have surface near, and the others
    };
    Round look(const std::vector<Line*>& lines, float grows_from) const;
    /// Calls lower(place, value) for what must change so that a line meets the field.
    template <class Lowering>
    void lower_around(const Open& open, bool to_the_hull, const Lowering& lower) const;
    /// Whether anything changed; so do apply(), bridge() and reach_alone() say.
    bool grow(const std::vector<Open>& open, bool to_the_hull);
    bool apply(const std::vector<Lower>& lower);
    /// A thin piece of the hull from a voxel to the nearest surface; where there is no way inside the hull, the voxel stands alone.
    bool bridge(const openvdb::Coord& from);
    bool reach_alone(const std::vector<Open>& alone);

    Level& level_;
    const Level* coarse_;
    int scale_ = 1;
    std::vector<DistanceField> fields_;
    std::vector<kernel::FairEye> eyes_;
    std::vector<Line> rim_, near_;
    std::vector<std::vector<uint8_t>> covered_;  ///< by view, samples of the field's window that need not be asked
    size_t open_ = 0;
};

}  // namespace vdbcarve::fairing
