// SPDX-License-Identifier: Apache-2.0
// Stage `floor`: the height of the table that the object stands on.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct FindFloor {
    static constexpr const char* kName = "floor";
    using Result = FloorFound;

    const Shoot& shoot;
    const Silhouettes& masks;
    const FloorOptions& options;
    double min_seen;

    /// Throws where nobody says which way is up.
    bool idle() const;
    FloorFound passed() const { return {options.height, "given", {}, {}}; }
    Key key() const;
    FloorFound run(Run& run);
    void save(Slot& slot, const FloorFound& made) const;
    FloorFound load(const Slot& slot) const;
    void say(const FloorFound& made, Progress& progress) const;
    void report(const FloorFound& made, nlohmann::json& report) const;
};

}  // namespace vdbcarve::pipeline
