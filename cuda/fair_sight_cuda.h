// SPDX-License-Identifier: Apache-2.0
// The lines of sight of the fair surface on the device: src/fair/sight_lines.cpp's, found in no order, with the same answers.
#pragma once

#include <functional>
#include <vector>

#include "fair_cuda.h"
#include "vdbcarve/kernel/fair_mask.h"

namespace vdbcarve::cuda {

/// A view: its distances lie on the device.
struct FairView {
    kernel::FairMask mask;
    kernel::FairEye eye;
};

/// A line that does not meet the field, and where it would soonest.
struct FairOpenLine {
    kernel::FairLine* line;
    kernel::FairOpen at;
};
struct FairLoneLine {
    kernel::FairLine line;
    kernel::FairOpen at;
};
/// A square of samples by its corner, or a sample.
struct FairSquare {
    uint32_t view, at;
};
/// What a round counts, on the device.
struct FairCounts {
    uint32_t unmet;         ///< lines that are not met where they last were: those that the first round looks along
    uint32_t open, alone;   ///< lines; of these, those with nothing near
    uint32_t falls, stale;  ///< leaves: with voxels that are to fall; whose Values::least is to be found
    uint32_t changed;       ///< whether a voxel fell
};

/// FairEngine (src/fair/fair_engine.h) says what the functions do.
class FairSight {
  public:
    /// For the stage's level at hand.
    void aim(const std::vector<FairView>& views, bool exact, const FairStage& stage, const Stream& stream, StageTimes& times);
    void find_near(float safe_vox, bool all, FairStage& stage, const Stream& stream, StageTimes& times);

    struct Repair {
        int rounds;
        float along_vox, grows_from;
        int patience;
        bool takes[kernel::kFairShares];
        bool anywhere;
    };
    /// Reaches lines that have nothing near, and says whether that changed anything.
    using ReachAlone = std::function<bool(const std::vector<FairLoneLine>&)>;
    /// Waits for the device where `how.anywhere`, round by round.
    void repair(const Repair& how, const ReachAlone& reach_alone, FairStage& stage, const Stream& stream, StageTimes& times);
    /// Lines that must be met and were not in the last repair() that waited.
    size_t open() const { return open_; }
    /// Waits for the device.
    size_t inside_samples(const Stream& stream);

    /// Values of some leaves of the level at hand, hull and field, home; and the field's back. Both wait for the device.
    void fetch_leaves(const std::vector<uint32_t>& leaves, float* hull, float* field, const FairStage& stage, const Stream& stream);
    void replace_leaves(const std::vector<uint32_t>& leaves, const float* field, FairStage& stage, const Stream& stream);

    size_t bytes() const;

  private:
    /// What kernels append to, in no order; what finds no room is counted only.
    struct Squares {
        DeviceBuffer<FairSquare> items;
        uint32_t count = 0;
    };
    /// By kernel::share_of; each share has room for `room` of them.
    struct Lines {
        DeviceBuffer<kernel::FairLine> items;
        uint32_t room = 0, counts[kernel::kFairShares] = {};
    };

    /// Calls launch(appender) again with more room where there was too little. Wait for the device.
    template <class Launch>
    void fill(Squares& list, const Stream& stream, const Launch& launch);
    template <class Launch>
    void fill(Lines& lines, const Stream& stream, const Launch& launch);
    void find_rim(const FairStage& stage, const Stream& stream);
    uint32_t lines_of(const Repair& how) const;
    void look(int round, const Repair& how, const FairStage& stage, const Stream& stream);
    void fall(FairCounts* counts, FairStage& stage, const Stream& stream);
    void find_stale_leasts(FairCounts* counts, FairStage& stage, const Stream& stream);
    std::vector<FairLoneLine> alone(int round, uint32_t count, float grows_from, const Stream& stream);

    bool exact_ = true;
    unsigned views_ = 0;
    size_t most_samples_ = 0, most_squares_ = 0, samples_ = 0;  ///< of the largest window, and of all
    DeviceBuffer<FairView> view_;
    Squares squares_, quarters_, rim_samples_;
    Lines rim_, near_;
    DeviceBuffer<uint32_t> appended_;
    PinnedBuffer<uint32_t> host_appended_;
    DeviceBuffer<kernel::FairLine*> unmet_;
    DeviceBuffer<FairOpenLine> open_lines_[2];
    DeviceBuffer<FairLoneLine> lone_;
    DeviceBuffer<FairCounts> counts_, spare_counts_;  ///< by round; and for what the host reached
    PinnedBuffer<FairCounts> host_counts_;
    DeviceBuffer<float> fall_;              ///< by voxel; 0 but while a round works
    DeviceBuffer<uint32_t> falls_, stale_;  ///< by leaf: whether it is in the list
    DeviceBuffer<uint32_t> falls_list_, stale_list_;
    DeviceBuffer<unsigned long long> sum_;
    PinnedBuffer<unsigned long long> host_sum_;
    DeviceBuffer<uint32_t> some_;  ///< leaves that go home, or come back
    DeviceBuffer<float> some_values_;
    size_t open_ = 0;
};

}  // namespace vdbcarve::cuda
