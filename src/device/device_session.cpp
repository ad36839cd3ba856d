// SPDX-License-Identifier: Apache-2.0
#include "device/device_session.h"

namespace vdbcarve {

DeviceSession::DeviceSession(Backend wanted, int device, Progress& progress)
    : wanted_(wanted), backend_(choose_backend(wanted, device)), number_(device), progress_(progress) {
    if (wanted == Backend::Auto && backend_ == Backend::Cpu && device != 0)
        progress_.warn("--device " + std::to_string(device) + " means nothing here: " + why_no_cuda());
}

void DeviceSession::leave(const std::string& why) {
    progress_.note(why + "; going on on the CPU, with the same result");
    device_.reset();
    backend_ = used_last_ = Backend::Cpu;
}

}  // namespace vdbcarve
