// SPDX-License-Identifier: Apache-2.0
#include "pipeline/run.h"

#include <algorithm>

#include "result/result_json.h"
#include "base/atomic_file.h"
#include "base/memory.h"
#include "pipeline/output_check.h"
#include "vdbcarve/config.h"
#include "vdbcarve/version.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Paths in OUT are compared: "out/" is "out".
ReconstructOptions without_trailing_slash(ReconstructOptions options) {
    fs::path& output = options.run.output;
    if (!output.has_filename() && output != output.root_path()) output = output.parent_path();
    return options;
}

}  // namespace

Run::Run(const ReconstructOptions& options, Progress& progress)
    : o_(without_trailing_slash(options)),
      progress_(progress),
      warnings_at_start_(progress.warnings().size()),
      device_(options.run.backend, options.run.device, progress) {}

void Run::open(const fs::path& folder) {
    folder_ = folder;
    if (dry()) return;
    if (is_open()) return mark_as_ours();  // a video, whose frames are the scene from here on
    const fs::path& output = out();
    if (output.empty()) throw UsageError("no folder for the result was given");
    if (fs::exists(output) && !fs::is_directory(output)) throw OutputError(output.string() + ": is a file, a folder is needed");
    fresh_output_ = !made_by_us(output);
    if (fs::is_directory(output) && !fs::is_empty(output) && fresh_output_ && !o_.run.force)
        throw OutputError(output.string() +
                          ": is not empty and was not made by vdbcarve, or its stages/ was deleted. Remedy: another -o, or --force to write into it");
    if (fresh_output_) refuse_foreign_results(output);
    make_folder(output / "stages");
    lock_ = OutLock(output);
    store_.emplace(output / "stages");
    had_result_ = fs::exists(output / "report.json");
    // Of runs that were killed.
    for (const char* place : {"", "stages", "masks", "depth", "overlays", kUnverified}) remove_left_overs(output / place);
    store_->remove_unfinished();
    fs::remove(store_->folder() / "cameras.json");
    forget_failure();
    mark_as_ours();
    // A finished result keeps its configuration until the new one is finished too.
    if (!had_result_) write_file(output / "config.toml", config_text(o_));
}

void Run::forget_new_output() {
    if (!fresh_output_) return;
    if (!had_result_) fs::remove(out() / "config.toml");
    fs::remove_all(out() / "stages");
    std::error_code others_are_in_it;
    fs::remove(out(), others_are_in_it);
}

void Run::mark_as_ours() const { write_file(out() / kMarker, dumped(json{{"made_by", "vdbcarve"}, {"scene", scene_json()}}) + "\n"); }

json Run::scene_json() const {
    json out{{"folder", fs::absolute(folder_.empty() ? o_.views.scene : folder_).string()}, {"images", o_.views.images.string()}};
    for (const fs::path& scene : o_.views.added) out["added"].push_back(fs::absolute(scene).string());
    return out;
}

void Run::keep_cameras(const Views& views) const {
    if (is_open() && views.posed) write_file(store_->folder() / "cameras.json", cameras_json(views));
}

double Run::memory_limit() const { return o_.run.memory_limit ? static_cast<double>(o_.run.memory_limit) : 0.9 * static_cast<double>(machine_memory_bytes()); }

std::vector<std::string> Run::warnings_since(size_t before) const {
    std::vector<std::string> all = progress_.warnings();
    all.erase(all.begin(), all.begin() + static_cast<long>(before));
    return all;
}

void Run::leave_failure(const Error& e) const {
    if (dry() || !is_open() || !made_by_us(out())) return;
    json failure = report_;
    failure["failure"] = {{"stage", stage_name_}, {"text", e.what()}, {"exit_code", static_cast<int>(e.code())}};
    failure["version"] = kVersion;
    failure["warnings"] = warnings_since(warnings_at_start_);
    failure["scene"] = scene_json();  // for whoever reads it elsewhere
    try {
        write_file(store_->folder() / "failure.json", dumped(failure, 1) + "\n");
        write_file(store_->folder() / "failure.toml", config_text(o_));
    } catch (const std::exception&) {
        // The error itself is what matters.
    }
}

void Run::forget_failure() const {
    for (const char* gone : {"failure.json", "failure.toml"}) fs::remove(store_->folder() / gone);
    fs::remove(out() / kUnfinishedMasks);
}

json Run::finished_report(const Views& views) const {
    json out = report_;
    out["version"] = kVersion;
    out["peak_rss_bytes"] = peak_bytes_;
    out["warnings"] = warnings_since(warnings_at_start_);
    out["scene"] = scene_json();
    out["cameras"] = {{"file", views.camera_file.string()}, {"format", views.format}, {"up", views.up}, {"units", views.units}};
    return out;
}

Run::Entry::Entry(Run& run, const char* name) : run_(run), name_(name), start_(std::chrono::steady_clock::now()) {
    run_.progress_.check();
    run_.stage_name_ = name;
    run_.reused_ = false;
    reset_peak_memory();
    run_.device_.begin_stage();
}

void Run::Entry::done() {
    const size_t peak = peak_memory_bytes();
    run_.peak_bytes_ = std::max(run_.peak_bytes_, peak);
    json entry{{"name", name_},
               {"seconds", std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count()},
               {"peak_rss_bytes", peak},
               {"backend", name_of(run_.device_.used_last())},
               {"reused", run_.reused_}};
    run_.report_["stages"].push_back(entry);
    if (run_.o_.run.on_stage) {
        entry["event"] = "stage";
        run_.o_.run.on_stage(dumped(entry));
    }
}

}  // namespace vdbcarve::pipeline
