// SPDX-License-Identifier: Apache-2.0
// One context for progress, notes, warnings and cancelling, handed to every stage.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "vdbcarve/error.h"

namespace vdbcarve {

class Progress {
  public:
    /// Called with the stage's name and the share done, from any thread, one call at a time.
    std::function<void(const std::string& stage, double share)> on_progress;
    /// Called with a sentence for the log.
    std::function<void(const std::string& note)> on_note;
    /// Called with what only somebody who looks for a fault wants to read.
    std::function<void(const std::string& detail)> on_detail;
    /// Called with a sentence that the user ought to see; also kept in warnings().
    std::function<void(const std::string& warning)> on_warning;

    void begin(const std::string& stage, size_t steps) {
        std::lock_guard lock(mutex_);
        stage_ = stage;
        steps_ = steps ? steps : 1;
        done_ = 0;
        last_permille_ = -1;
    }
    /// One more of the steps is done. Throws Interrupted when cancel() was called.
    void step(size_t count = 1) {
        check();
        const size_t done = done_.fetch_add(count) + count;
        if (!on_progress) return;
        const int permille = static_cast<int>(1000 * done / steps_);
        if (permille == last_permille_.load(std::memory_order_relaxed)) return;
        std::lock_guard lock(mutex_);
        last_permille_ = permille;
        on_progress(stage_, static_cast<double>(done) / static_cast<double>(steps_));
    }
    void note(const std::string& text) {
        std::lock_guard lock(mutex_);
        if (on_note) on_note(text);
    }
    void detail(const std::string& text) {
        std::lock_guard lock(mutex_);
        if (on_detail) on_detail(text);
    }
    void warn(const std::string& text) {
        std::lock_guard lock(mutex_);
        warnings_.push_back(text);
        if (on_warning) on_warning(text);
    }
    std::vector<std::string> warnings() const {
        std::lock_guard lock(mutex_);
        return warnings_;
    }
    /// Safe to call from a signal handler.
    void cancel() noexcept { cancelled_.store(true, std::memory_order_relaxed); }
    void check() const {
        if (cancelled_.load(std::memory_order_relaxed)) throw Interrupted();
    }

  private:
    mutable std::mutex mutex_;
    std::string stage_;
    std::vector<std::string> warnings_;
    std::atomic<size_t> done_{0};
    size_t steps_ = 1;
    std::atomic<int> last_permille_{-1};
    std::atomic<bool> cancelled_{false};
};

}  // namespace vdbcarve
