// SPDX-License-Identifier: Apache-2.0
// Tests that need a device: without one they are skipped and say why, or fail where VDBCARVE_REQUIRE_GPU=1.
#pragma once

#include <gtest/gtest.h>
#include <openvdb/openvdb.h>

#include <cstdlib>
#include <string>

#include "vdbcarve/backend.h"
#include "vdbcarve/progress.h"

namespace vdbcarve::test {

class Gpu : public testing::Test {
  protected:
    static void SetUpTestSuite() { openvdb::initialize(); }
    void SetUp() override { need_gpu(); }
    static void need_gpu() {
        const std::string why = why_no_cuda();
        if (why.empty()) return;
        const char* required = std::getenv("VDBCARVE_REQUIRE_GPU");
        if (required && std::string(required) == "1") FAIL() << why;
        GTEST_SKIP() << why;
    }
    Progress quiet_;
};

}  // namespace vdbcarve::test
