// SPDX-License-Identifier: Apache-2.0
// Errors carry the exit code that a command line should end with; messages say what, where and what to do.
#pragma once

#include <stdexcept>
#include <string>

namespace vdbcarve {

enum class ExitCode : int {
    Done = 0,
    Usage = 2,          ///< a wrong option or value
    Input = 3,          ///< a file, mask or camera that cannot be used
    Contradiction = 4,  ///< the data contradict each other
    Undetermined = 5,   ///< the data do not determine the answer
    Output = 6,         ///< a result could not be written
    Backend = 7,        ///< the demanded backend is not available
    Interrupted = 130
};

class Error : public std::runtime_error {
  public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const noexcept { return code_; }

  private:
    ExitCode code_;
};

struct UsageError : Error {
    explicit UsageError(const std::string& m) : Error(ExitCode::Usage, m) {}
};
struct InputError : Error {
    explicit InputError(const std::string& m) : Error(ExitCode::Input, m) {}
};
struct ContradictionError : Error {
    explicit ContradictionError(const std::string& m) : Error(ExitCode::Contradiction, m) {}
};
struct UndeterminedError : Error {
    explicit UndeterminedError(const std::string& m) : Error(ExitCode::Undetermined, m) {}
};
struct OutputError : Error {
    explicit OutputError(const std::string& m) : Error(ExitCode::Output, m) {}
};
struct BackendError : Error {
    explicit BackendError(const std::string& m) : Error(ExitCode::Backend, m) {}
};
struct Interrupted : Error {
    Interrupted() : Error(ExitCode::Interrupted, "interrupted") {}
};

}  // namespace vdbcarve
