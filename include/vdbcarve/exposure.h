// SPDX-License-Identifier: Apache-2.0
// How photographs were exposed against each other, from what they show of the same places.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "vdbcarve/kernel/rgb.h"

namespace vdbcarve {

using kernel::Observation;

/// What every view shows of a sample of places: entry place * views + view, weight 0 where it shows nothing. Linear light.
struct Observations {
    size_t views = 0;
    std::vector<Observation> table;
    size_t places() const { return views ? table.size() / views : 0; }
};

struct ExposureOptions {
    bool per_channel = false;  ///< a gain for each of R, G, B (white balance), else one for all
    double noise = 0.1;        ///< standard deviation of ln(colour) between views of a place: shading, pose, texture
    double spread = 0.3;       ///< standard deviation expected of ln(gain)
    int iterations = 12;       ///< of reweighting
};

struct Exposure {
    std::vector<std::array<double, 3>> gains;  ///< linear light times gain is comparable; geometric mean 1
    std::vector<size_t> places;                ///< places used of each view; gain 1 where 0
    double disagreement_before = 0;            ///< median |ln colour - its place's mean|, before
    double disagreement = 0;                   ///< and with the gains
};

/// Gains that make the views agree: least squares over ln(gain) + ln(colour) - (the place's own), each place's own eliminated, with
/// Huber's weights (1.345 sigma) and a prior of ln(gain) = 0: Brown and Lowe 2007, eq. 29, in logarithms. n x n normal equations. Gains that do not lower the
/// disagreement are not taken: all are 1 then.
/// Deterministic. Time: iterations x places x (views that see one)^2.
Exposure estimate_exposure(const Observations& observations, const ExposureOptions& options);

}  // namespace vdbcarve
