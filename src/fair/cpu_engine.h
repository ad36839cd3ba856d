// SPDX-License-Identifier: Apache-2.0
// The fair surface on the CPU.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "fair/evidence.h"
#include "fair/fair_engine.h"
#include "fair/fair_level.h"
#include "fair/sight_lines.h"

namespace vdbcarve::fairing {

class CpuEngine final : public FairEngine {
  public:
    /// `hull` is borrowed, and `evidence`, which may be null.
    CpuEngine(const openvdb::FloatGrid& hull, const FairEvidence* evidence);

    /// Like begin(), on the finest level, with a field.
    void begin(const openvdb::FloatGrid& surface);

    const LeafLattice& lattice() const override { return hulls_.empty() || level_.leaves() ? level_ : hulls_.back(); }
    double hull_volume_vox() override { return hulls_.front().volume_vox(hulls_.front().hull); }
    void coarsen(bool whole) override;
    void begin() override;
    void refine() override;
    void aim(const SightPlan& plan, Progress& progress) override;
    void find_near(float safe_vox, bool all) override { lines_->find_near(safe_vox, all); }
    void repair(const Repair& how) override { lines_->repair(how); }
    size_t open() const override { return lines_->open(); }
    size_t inside_samples() const override { return lines_->inside_samples(); }
    void move(const kernel::FairBlur& blur, bool stiff) override { fairing::move(level_, blur, stiff); }
    void ease(float far_vox) override;
    bool led() const override { return evidence_.has_value(); }
    void follow(float share) override { evidence_->follow(level_, share); }
    size_t drop_pieces(double share) override { return fairing::drop_pieces(level_, share); }
    void make_distances() override;
    double volume_vox() override { return level_.volume_vox(level_.field); }
    openvdb::FloatGrid::Ptr surface() override { return grid_of(level_, hull_); }

  private:
    const openvdb::FloatGrid& hull_;
    std::vector<Level> hulls_;  ///< finer than the level at hand, once there is one
    Level level_, coarse_;
    std::unique_ptr<SightLines> lines_;
    std::optional<Evidence> evidence_;
};

}  // namespace vdbcarve::fairing
