// SPDX-License-Identifier: Apache-2.0
// Stage `stereo`: what silhouettes cannot see, from the photographs' depths.
#pragma once

#include "pipeline/run.h"
#include "pipeline/values.h"

namespace vdbcarve::pipeline {

struct Stereo {
    static constexpr const char* kName = "stereo";
    using Result = Surface;

    const ReconstructOptions& options;
    const Shoot& shoot;
    const Silhouettes& masks;
    const GridFacts& grid;
    Surface surface;

    void prepare(Run& run);
    bool idle() const { return idle_; }
    Surface passed() { return std::move(surface); }
    Key key() const;
    Surface run(Run& run);
    void save(Slot& slot, Surface& made) const;
    Surface load(const Slot& slot) const;
    void report(const Surface& made, nlohmann::json& report) const;
    void say(const Surface& made, Progress& progress) const;
    /// False: --stereo auto, and too few depths; the surface of before goes on.
    static bool is_used(const StereoSettings& settings, const Surface& made);

    /// Of the object's pixels, what --stereo auto wants to have a depth that other views agree with.
    static constexpr double kLeastTrusted = 0.2;
    // What prepare() and run() leave for save(), load() and report(). Public, so that a stage is an aggregate.
    StereoOptions stereo_{};
    bool idle_ = false;
    StereoResult result_{};
    openvdb::FloatGrid::Ptr hull_{};

  private:
    /// Photographs and depths of all views are in memory at once. Throws InputError with the scale that fits.
    void check_memory(Run& run) const;
    std::vector<std::string> map_names() const;
    static nlohmann::json summary(const StereoResult& result, const std::vector<ColorInput>& inputs);
};

}  // namespace vdbcarve::pipeline
