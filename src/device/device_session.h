// SPDX-License-Identifier: Apache-2.0
// Where a run's stages are worked: chosen once, and left for the CPU when the device fails and was not demanded.
#pragma once

#include <optional>
#include <string>

#include "vdbcarve/backend.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"
#include "vdbcarve/progress.h"

namespace vdbcarve {

class DeviceSession {
  public:
    /// Throws like choose_backend(). Warns when a device is named and there is none. The device itself is opened by the first run().
    DeviceSession(Backend wanted, int device, Progress& progress);

    /// Where work is done now: Cuda until the device is left.
    Backend backend() const { return backend_; }
    /// No other backend will do.
    bool demanded() const { return wanted_ == Backend::Cuda; }
    /// Null: not opened yet, or left.
    Device* device() { return device_ ? &*device_ : nullptr; }

    /// Calls work(Device&) and returns true; or returns false, and the caller does it on the CPU, with the same result: where the backend is the CPU, and where
    /// the device fails, for want of memory most likely. A failure says so and leaves the device; where the device was demanded it is thrown on.
    template <class Work>
    bool run(const char* what, const Work& work) {
        if (backend_ != Backend::Cuda) return false;
        try {
            if (!device_) device_.emplace(number_);
            work(*device_);
            used_last_ = Backend::Cuda;
            return true;
        } catch (const BackendError& e) {
            if (demanded()) throw;
            leave(std::string(what) + ": " + e.what());
            return false;
        }
    }

    /// Gives the device's memory back and goes on on the CPU, for good; `why` is noted.
    void leave(const std::string& why);

    /// Where the stage's work was done: Cuda when any run() since begin_stage() succeeded and the device was not left since.
    Backend used_last() const { return used_last_; }
    void begin_stage() { used_last_ = Backend::Cpu; }

  private:
    Backend wanted_, backend_, used_last_ = Backend::Cpu;
    int number_;
    Progress& progress_;
    std::optional<Device> device_;
};

}  // namespace vdbcarve
