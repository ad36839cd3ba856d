// SPDX-License-Identifier: Apache-2.0
// Fields along a line of sight, read by a whole warp: each lane reads one of 32 samples ahead, and the search goes through them as if it had read them one by
// one. The search is the header's, so what it finds is, too; it waits for memory once instead of 32 times.
#pragma once

#include "vdbcarve/kernel/fair.h"

namespace vdbcarve::cuda {

/// Which 32 samples the lanes hold. All lanes ask for the same sample.
struct FairWindow {
    static constexpr int kLanes = 32, kNowhere = -(1 << 30);
    int from = kNowhere;

    __device__ bool holds(int n) const { return n >= from && n < from + kLanes; }
    /// Searches that go backwards leave a window at its beginning.
    __device__ void move_to(int n) { from = n < from ? n - (kLanes - 1) : n; }
    __device__ int mine() const { return from + static_cast<int>(threadIdx.x) % kLanes; }
    template <class T>
    __device__ T of(T value, int n) const {
        return __shfl_sync(0xffffffffu, value, n - from);
    }
};

/// kernel::FairLook
struct FairWarpLook {
    const kernel::FairField& field;
    const kernel::FairRay& ray;
    FairWindow window = {};
    int32_t lane_number = 0;
    float lane_least = 0.f, lane_value = 0.f;
    bool has_values = false;

    __device__ int32_t number(int n, const kernel::FairCell&) {
        ensure(n);
        return window.of(lane_number, n);
    }
    __device__ float least(int n, int32_t) {
        ensure(n);
        return window.of(lane_least, n);
    }
    __device__ float value(int n, int32_t, const kernel::FairCell&) {
        ensure(n);
        if (!has_values) {
            has_values = true;
            lane_value = lane_number < 0 ? kernel::FairField::tile(lane_number) : kernel::value_in(field, lane_number, kernel::sample_cell(ray, window.mine()));
        }
        return window.of(lane_value, n);
    }

  private:
    __device__ void ensure(int n) {
        if (window.holds(n)) return;
        window.move_to(n);
        has_values = false;
        lane_number = kernel::kOutsideTile;
        if (window.mine() >= 0 && window.mine() <= ray.last) {
            const kernel::FairCell c = kernel::sample_cell(ray, window.mine());
            lane_number = field.leaf(c.i, c.j, c.k);
        }
        lane_least = field.least_in(lane_number);
    }
};

/// kernel::FairCoarserLook
struct FairWarpCoarserLook {
    const kernel::FairField& coarser;
    const kernel::FairRay& ray;
    FairWindow window = {};
    float lane_value = 0.f;

    __device__ float value(int n) {
        if (!window.holds(n)) {
            window.move_to(n);
            lane_value = kernel::FairCoarserLook{coarser, ray}.value(window.mine());
        }
        return window.of(lane_value, n);
    }
};

struct FairByWarp {
    using Look = FairWarpLook;
    using CoarserLook = FairWarpCoarserLook;
};

}  // namespace vdbcarve::cuda
