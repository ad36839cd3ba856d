// SPDX-License-Identifier: Apache-2.0
// One run in one OUT folder, and the one way in which all stages are run: whether the result is there already, notes, warnings, time, memory, report, events.
#pragma once

#include <chrono>
#include <concepts>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "device/device_session.h"
#include "pipeline/key.h"
#include "pipeline/out_folder.h"
#include "pipeline/store.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/result.h"

namespace vdbcarve::pipeline {

/// A stage is a struct with its inputs and options, and
///   static constexpr const char* kName;      its file's name in stages/, its timer, its entry in the report, its folder in OUT/stages
///   using Result = …;
///   Result run(Run&);                        does the work
/// and, where they mean something for it,
///   void report(const Result&, json&) const; what the report says of it, whether made or found
///   void say(const Result&, Progress&) const; what the log says of it, whether made or found
///   void prepare(Run&);                      before anything else of it is asked
///   bool idle() const; Result passed();      there is nothing to do
/// A stage whose result is kept in OUT/stages has besides
///   Key key() const;                         everything that the result depends on
///   void save(Slot&, const Result&) const;   payload files and note
///   Result load(const Slot&) const;          throws where something is missing: then the stage is run again
///   static constexpr bool kReadBack = true;  the next stage gets what load() reads, also just after run(): files round values
///   static constexpr bool kNamesItself = true;  run() and load() set the result's key themselves
///   size_t warnings_before() const;          warnings since then belong to it, too
template <class S>
concept KeptStage = requires(const S& stage, const Slot& slot) {
    stage.key();
    stage.load(slot);
};

class Run {
  public:
    Run(const ReconstructOptions& options, Progress& progress);

    /// Runs a stage, or finds its result.
    template <class S>
    typename S::Result operator()(S stage);

    /// The same within another stage, of which it is a part: without an entry of its own. `found`: whether it was there already.
    template <class S>
    typename S::Result part(S stage, bool* found = nullptr) {
        const bool before = std::exchange(reused_, false);
        typename S::Result result = keep(stage);
        if (found) *found = reused_;
        reused_ = before;
        return result;
    }

    /// The result of a stage that is done already. None where it is not there, or is damaged; `warnings`: what it warned of.
    template <KeptStage S>
    std::optional<typename S::Result> find(const S& stage, const std::string& key, std::vector<std::string>* warnings = nullptr);

    /// Runs the whole job. Where it ends in an error, OUT/stages/failure.json says which, for whoever looks into it later.
    template <class Work>
    Reconstruction guarded(const Work& work) {
        try {
            return work();
        } catch (const Error& e) {
            leave_failure(e);
            throw;
        }
    }

    /// Makes OUT, or takes it over; locks it. `folder`: where the photographs are. A dry run writes nothing.
    void open(const std::filesystem::path& folder);
    bool is_open() const { return store_.has_value(); }
    /// OUT is not what it was taken for: a new one goes again. For a scene that turns out to be none.
    void forget_new_output();
    /// The cameras that the run goes on with: should it fail, they are nowhere else.
    void keep_cameras(const Views& views) const;

    const ReconstructOptions& options() const { return o_; }
    const std::filesystem::path& out() const { return o_.run.output; }
    bool dry() const { return o_.run.dry_run; }
    bool had_result() const { return had_result_; }  ///< OUT holds a finished result of an earlier run, which stays until this one is done
    Progress& progress() { return progress_; }
    Store& store() { return *store_; }
    DeviceSession& device() { return device_; }
    bool on_gpu() const { return device_.backend() == Backend::Cuda; }
    /// Bytes that may be resident.
    double memory_limit() const;
    /// The stage found what it would have made.
    void say_reused() { reused_ = true; }

    /// report.json of what was done so far; written by stages' report() and by publishing, read by nobody in the program.
    nlohmann::json& report() { return report_; }
    /// The finished report; `folder`: see open().
    nlohmann::json finished_report(const Views& views) const;
    /// Warnings of this run since `before` of them.
    std::vector<std::string> warnings_since(size_t before) const;
    void forget_failure() const;

    /// Grids that lie on the device as they are here.
    bool is_on_device(const openvdb::FloatGrid::Ptr& grid) const { return grid && on_device_.lock() == grid; }
    void set_on_device(const openvdb::FloatGrid::Ptr& grid) { on_device_ = grid; }
    void forget_device_grid() { on_device_.reset(); }

  private:
    class Entry;
    template <class S>
    typename S::Result keep(S& stage);
    /// Results carry the key that they were made under, for the keys of what is made from them.
    template <class S, class Result>
    static void name(Result& result, const std::string& key) {
        if constexpr (
            requires { result.key; } && !requires { S::kNamesItself; })
            result.key = key;
    }
    void leave_failure(const Error& e) const;
    nlohmann::json scene_json() const;
    void mark_as_ours() const;

    const ReconstructOptions o_;
    Progress& progress_;
    size_t warnings_at_start_;  ///< one context may serve several jobs
    DeviceSession device_;
    std::optional<Store> store_;
    OutLock lock_;
    std::filesystem::path folder_;
    bool had_result_ = false, fresh_output_ = false, reused_ = false;
    nlohmann::json report_ = nlohmann::json::object();
    std::string stage_name_ = "options";
    size_t peak_bytes_ = 0;
    std::weak_ptr<openvdb::FloatGrid> on_device_;
};

/// Times a stage and, when it is done, enters it into the report and tells whoever listens.
class Run::Entry {
  public:
    Entry(Run& run, const char* name);
    void done();

  private:
    Run& run_;
    const char* name_;
    std::chrono::steady_clock::time_point start_;
};

template <class S>
typename S::Result Run::operator()(S stage) {
    Entry entry(*this, S::kName);
    typename S::Result result = keep(stage);
    if constexpr (requires { stage.say(result, progress_); }) stage.say(result, progress_);
    if constexpr (requires { stage.report(result, report_); }) stage.report(result, report_);
    entry.done();
    return result;
}

template <KeptStage S>
std::optional<typename S::Result> Run::find(const S& stage, const std::string& key, std::vector<std::string>* warnings) {
    std::optional<typename S::Result> found;
    const std::optional<Slot> slot = store_ ? store_->find(S::kName, key) : std::nullopt;
    if (!slot) return found;
    try {
        found.emplace(stage.load(*slot));
    } catch (const nlohmann::json::exception&) {
        return found;  // as good as not there
    } catch (const InputError&) {
        return found;
    }
    if (warnings) *warnings = slot->warnings;
    return found;
}

template <class S>
typename S::Result Run::keep(S& stage) {
    if constexpr (requires { stage.prepare(*this); }) stage.prepare(*this);
    if constexpr (requires { stage.idle(); })
        if (stage.idle()) return stage.passed();
    if constexpr (KeptStage<S>) {
        const std::string key = stage.key().hex();
        if (!store_) {
            typename S::Result made = stage.run(*this);
            name<S>(made, key);
            return made;
        }
        std::vector<std::string> warnings;
        if (auto found = find(stage, key, &warnings)) {
            for (const std::string& warning : warnings) progress_.warn(warning);
            say_reused();
            name<S>(*found, key);
            return std::move(*found);
        }
        size_t before = progress_.warnings().size();
        if constexpr (requires { stage.warnings_before(); }) before = stage.warnings_before();
        typename S::Result made = stage.run(*this);
        Slot slot = store_->begin(S::kName, key);
        stage.save(slot, made);
        slot.warnings = warnings_since(before);
        store_->commit(slot);
        if constexpr (requires { S::kReadBack; }) made = stage.load(slot);
        name<S>(made, key);
        return made;
    } else {
        return stage.run(*this);
    }
}

}  // namespace vdbcarve::pipeline
