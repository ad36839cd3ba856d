// SPDX-License-Identifier: Apache-2.0
// Stage `carve`: the raw hull, whole, extended from an earlier one, or in bricks.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Carve {
    static constexpr const char* kName = "carve";
    static constexpr bool kNamesItself = true;
    using Result = Hull;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const std::optional<KeptGrid>& kept;
    Plan plan{};  ///< not looked at where the hull is there

    Key key() const;
    /// Whether the hull is there, whole where later stages want it so.
    bool is_there(Run& run) const;
    Hull run(Run& run);
    size_t warnings_before() const { return plan.warnings_before; }
    void save(Slot& slot, Hull& made) const;
    Hull load(const Slot& slot) const;
    void report(const Hull& hull, nlohmann::json& report) const { report["grid"] = hull.grid; }

    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    size_t added_views_ = 0;
    bool known_whole_ = false;

  private:
    Hull carve_whole(Run& run);
    Hull carve_bricks(Run& run);
    /// What the fields in memory, or those made batch after batch, say about the grid or one brick of it.
    CarveResult carve_part(const std::optional<IndexBox>& brick, Run& run);
    CarveResult extend(const FieldSource& source, Run& run);
    friend struct CarveBrick;
};

}  // namespace vdbcarve::pipeline
