// SPDX-License-Identifier: Apache-2.0
// Where the fair surface is worked on. fair.cpp says what is done in which order; an engine does it, here or on a device, with the same bits.
#pragma once

#include <openvdb/openvdb.h>

#include <memory>
#include <optional>
#include <vector>

#include "fair/sight_plan.h"
#include "vdbcarve/fair.h"

namespace vdbcarve::fairing {

/// Rounds after which a cell is put back to the hull's values.
inline constexpr int kPatience = 40;
/// What is as near to the surface as this becomes part of it when it is lowered; farther away it would hang in the air.
inline constexpr float kBeside_vox = 1.f;

/// How lines are repaired.
struct Repair {
    int rounds;                   ///< at most
    float along_vox;              ///< a line that pulls pulls what lies so many voxels along it
    bool anywhere;                ///< what does not grow from the surface is bridged to it, or stands alone
    std::optional<size_t> share;  ///< every fourth line only, of which there are four choices: enough between steps of motion

    /// Lines whose nearest place is below this grow from the surface.
    float grows_from() const { return anywhere ? kBeside_vox : kernel::kFairBand_vox - 1e-3f; }
    bool takes(size_t fourth, bool exact) const { return !share || *share % (exact ? kernel::kFairShares : kernel::kFairShares / 2) == fourth; }
};

/// Hulls from fine to coarse, and the level at hand, whose field moves. Made with the finest hull.
class FairEngine {
  public:
    FairEngine() = default;
    FairEngine(const FairEngine&) = delete;
    FairEngine& operator=(const FairEngine&) = delete;
    virtual ~FairEngine() = default;

    /// Of the level at hand, or of the coarsest hull before there is one.
    virtual const LeafLattice& lattice() const = 0;
    virtual double hull_volume_vox() = 0;
    /// A hull on voxels twice as wide. `whole`: with leaves all over the inside.
    virtual void coarsen(bool whole) = 0;
    /// The level at hand is the coarsest hull, and its field the hull's.
    virtual void begin() = 0;
    /// The level at hand is the next finer one, its field carried over.
    virtual void refine() = 0;

    /// Lines of sight for the level at hand. `plan` is borrowed until the next.
    virtual void aim(const SightPlan& plan, Progress& progress) = 0;
    /// Lines of the inside that meet the field not at least so deep are asked again by repair(). `all`: else of every second.
    virtual void find_near(float safe_vox, bool all) = 0;
    /// Lowers the field until all lines that are known meet it, growing on from where it is.
    virtual void repair(const Repair& how) = 0;
    /// Lines that the last repair() with all shares left.
    virtual size_t open() const = 0;
    /// Samples at least half a one inside a contour and not ignored.
    virtual size_t inside_samples() const = 0;

    /// One step of motion: a Gaussian blur of the clipped distances, then kernel::straightened. `stiff`: what the blur takes away is blurred, too, and put
    /// back: ridges go, and what is smooth stays where it is (motion by how curvature changes instead of by curvature).
    virtual void move(const kernel::FairBlur& blur, bool stiff) = 0;
    /// kernel::eased(), everywhere.
    virtual void ease(float far_vox) = 0;
    /// Whether depths lead the surface.
    virtual bool led() const { return false; }
    /// Moves the field so much of the way to where they see the surface, by how sure they are, and not below the hull.
    virtual void follow(float /*share*/) {}
    /// Takes away what hangs in the air: pieces of the inside with fewer voxels than `share` of the largest. Returns how many.
    virtual size_t drop_pieces(double share) = 0;
    /// Distances become true, and stay above the hull.
    virtual void make_distances() = 0;

    virtual double volume_vox() = 0;
    /// The field as a level set on the hull's lattice, in world units.
    virtual openvdb::FloatGrid::Ptr surface() = 0;
};

/// Throws like fair().
void check_fair(const FairOptions& options);
FairResult fair_by(FairEngine& engine, const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress);

}  // namespace vdbcarve::fairing
