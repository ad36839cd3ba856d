// SPDX-License-Identifier: Apache-2.0
// Streams, events, named ranges for the profiler, and time by stage.
#pragma once

#include <nvtx3/nvToolsExt.h>

#include <string>
#include <utility>
#include <vector>

#include "cuda_check.h"

namespace vdbcarve::cuda {

class Stream {
  public:
    Stream() { VDBCARVE_CUDA(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking)); }
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;
    ~Stream() { cudaStreamDestroy(stream_); }
    cudaStream_t get() const { return stream_; }
    void wait() const { VDBCARVE_CUDA(cudaStreamSynchronize(stream_)); }

    template <class T>
    void to_device(T* to, const T* from, size_t count) const {
        VDBCARVE_CUDA(cudaMemcpyAsync(to, from, count * sizeof(T), cudaMemcpyHostToDevice, stream_));
    }
    template <class T>
    void to_host(T* to, const T* from, size_t count) const {
        VDBCARVE_CUDA(cudaMemcpyAsync(to, from, count * sizeof(T), cudaMemcpyDeviceToHost, stream_));
    }
    template <class T>
    void zero(T* what, size_t count) const {
        VDBCARVE_CUDA(cudaMemsetAsync(what, 0, count * sizeof(T), stream_));
    }

  private:
    cudaStream_t stream_{};
};

class Event {
  public:
    Event() { VDBCARVE_CUDA(cudaEventCreate(&event_)); }
    Event(Event&& other) noexcept : event_(std::exchange(other.event_, nullptr)) {}
    Event& operator=(Event&&) = delete;
    ~Event() {
        if (event_) cudaEventDestroy(event_);
    }
    cudaEvent_t get() const { return event_; }
    void record(const Stream& stream) const { VDBCARVE_CUDA(cudaEventRecord(event_, stream.get())); }
    void wait() const { VDBCARVE_CUDA(cudaEventSynchronize(event_)); }
    float milliseconds_since(const Event& before) const {
        VDBCARVE_CUDA(cudaEventSynchronize(event_));
        float ms = 0;
        VDBCARVE_CUDA(cudaEventElapsedTime(&ms, before.event_, event_));
        return ms;
    }

  private:
    cudaEvent_t event_{};
};

/// Blocks of so many threads that `count` of them need.
inline unsigned blocks_for(size_t count, unsigned threads) { return static_cast<unsigned>((count + threads - 1) / threads); }

/// A named stretch of work: a range in the profiler, and device time in a list.
class StageTimes {
  public:
    struct Stage {
        std::string name;
        Event begin, end;
    };
    void clear() { stages_.clear(); }
    /// Runs `work`, whose launches are timed together. The times are read later: nothing waits here.
    template <class Work>
    void measure(const char* name, const Stream& stream, const Work& work) {
        const Range range(name);
        Stage stage{name, Event(), Event()};
        stage.begin.record(stream);
        work();
        stage.end.record(stream);
        if (stages_.size() < kMost) stages_.push_back(std::move(stage));  // who never clears them does not want them
    }
    /// Milliseconds of every stage, in order; equal names are summed. Waits for the device.
    std::vector<std::pair<std::string, double>> milliseconds() const {
        std::vector<std::pair<std::string, double>> out;
        for (const Stage& s : stages_) {
            const double ms = s.end.milliseconds_since(s.begin);
            bool known = false;
            for (auto& [name, sum] : out)
                if (name == s.name) {
                    sum += ms;
                    known = true;
                }
            if (!known) out.emplace_back(s.name, ms);
        }
        return out;
    }

  private:
    static constexpr size_t kMost = 10000;
    struct Range {
        explicit Range(const char* name) { nvtxRangePushA(name); }
        Range(const Range&) = delete;
        Range& operator=(const Range&) = delete;
        ~Range() { nvtxRangePop(); }
    };
    std::vector<Stage> stages_;
};

/// To be called right after a launch: errors of its configuration, with the place.
#define VDBCARVE_LAUNCHED() VDBCARVE_CUDA(cudaGetLastError())

}  // namespace vdbcarve::cuda
