// SPDX-License-Identifier: Apache-2.0
// Whether a run may go on with what it doubts, and what it says where cameras and masks do not fit.
#pragma once

#include <string>
#include <vector>

#include "pipeline/values.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::pipeline {

/// Cameras that may be wrong are not carved with, unless that is wanted: then it is a warning. Throws UndeterminedError.
void accept_or_refuse(const std::vector<std::string>& why, const std::string& what, bool accept, Progress& progress);

/// Options that do nothing without others.
void warn_of_idle_options(const ReconstructOptions& options, Progress& progress);

/// The `check` command that finds out why cameras and masks contradict each other.
std::string ask_check(const ReconstructOptions& options, const Shoot& shoot);

/// Runs work; a contradiction that it ends in gets that advice.
template <class Work>
auto with_advice(const ReconstructOptions& options, const Shoot& shoot, const Work& work) {
    try {
        return work();
    } catch (const ContradictionError& e) {
        throw ContradictionError(std::string(e.what()) + "; " + ask_check(options, shoot));
    }
}

}  // namespace vdbcarve::pipeline
