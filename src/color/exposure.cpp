// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/exposure.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>

#include "base/statistics.h"

namespace vdbcarve {
namespace {

/// One channel's logarithms, place by place, of those places that two views or more show.
struct Logs {
    std::vector<uint32_t> first;  ///< entry of each place, and one past the last
    std::vector<uint32_t> view;
    std::vector<double> value, weight;
};

Logs logs_of(const Observations& o, int channel) {
    Logs out;
    for (size_t p = 0; p < o.places(); ++p) {
        const Observation* row = o.table.data() + p * o.views;
        size_t seen = 0;
        for (size_t v = 0; v < o.views; ++v) seen += row[v].weight > 0;
        if (seen < 2) continue;
        out.first.push_back(static_cast<uint32_t>(out.view.size()));
        for (size_t v = 0; v < o.views; ++v) {
            if (!(row[v].weight > 0)) continue;
            const kernel::Rgb& c = row[v].color;
            const double value = channel == 0 ? c.r : channel == 1 ? c.g : channel == 2 ? c.b : kernel::luminance(c);
            out.view.push_back(static_cast<uint32_t>(v));
            out.value.push_back(std::log(std::max(value, 1e-6)));
            out.weight.push_back(1.0);
        }
    }
    out.first.push_back(static_cast<uint32_t>(out.view.size()));
    return out;
}

/// |ln colour + ln gain - the place's mean| of every entry.
std::vector<double> residuals(const Logs& l, const Eigen::VectorXd& x) {
    std::vector<double> out(l.view.size());
    for (size_t p = 0; p + 1 < l.first.size(); ++p) {
        double sum = 0, weight = 0;
        for (uint32_t e = l.first[p]; e < l.first[p + 1]; ++e) {
            sum += l.weight[e] * (l.value[e] + x[l.view[e]]);
            weight += l.weight[e];
        }
        for (uint32_t e = l.first[p]; e < l.first[p + 1]; ++e) out[e] = std::abs(l.value[e] + x[l.view[e]] - sum / weight);
    }
    return out;
}

Eigen::VectorXd solve(Logs& l, size_t views, const ExposureOptions& options) {
    const auto n = static_cast<Eigen::Index>(views);
    Eigen::VectorXd x = Eigen::VectorXd::Zero(n);
    // Places in fixed chunks, whose sums are added in order: the same bits for any number of threads.
    constexpr size_t kChunk = 512;
    const size_t places = l.first.size() - 1, chunks = (places + kChunk - 1) / kChunk;
    std::vector<Eigen::MatrixXd> a(chunks);
    std::vector<Eigen::VectorXd> b(chunks);
    for (int iteration = 0; iteration < options.iterations; ++iteration) {
        tbb::parallel_for(size_t{0}, chunks, [&](size_t chunk) {
            a[chunk] = Eigen::MatrixXd::Zero(n, n);
            b[chunk] = Eigen::VectorXd::Zero(n);
            for (size_t p = chunk * kChunk; p < std::min(places, (chunk + 1) * kChunk); ++p) {
                double total = 0, mean = 0;
                for (uint32_t e = l.first[p]; e < l.first[p + 1]; ++e) {
                    total += l.weight[e];
                    mean += l.weight[e] * l.value[e];
                }
                mean /= total;
                for (uint32_t e = l.first[p]; e < l.first[p + 1]; ++e) {
                    const auto i = static_cast<Eigen::Index>(l.view[e]);
                    a[chunk](i, i) += l.weight[e];
                    b[chunk][i] -= l.weight[e] * (l.value[e] - mean);
                    for (uint32_t f = l.first[p]; f < l.first[p + 1]; ++f)
                        a[chunk](i, static_cast<Eigen::Index>(l.view[f])) -= l.weight[e] * l.weight[f] / total;
                }
            }
        });
        Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
        Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
        for (size_t chunk = 0; chunk < chunks; ++chunk) {
            matrix += a[chunk];
            right += b[chunk];
        }
        const double prior = options.noise * options.noise / (options.spread * options.spread);
        matrix.diagonal().array() += prior;
        const Eigen::VectorXd next = matrix.ldlt().solve(right);
        const double moved = (next - x).cwiseAbs().maxCoeff();
        x = next;
        const std::vector<double> r = residuals(l, x);
        const double sigma = std::max(1.4826 * median(r), 1e-4), bend = 1.345 * sigma;
        for (size_t e = 0; e < r.size(); ++e) l.weight[e] = r[e] > bend ? bend / r[e] : 1.0;
        if (iteration > 2 && moved < 1e-5) break;
    }
    return x;
}

}  // namespace

Exposure estimate_exposure(const Observations& o, const ExposureOptions& options) {
    Exposure out;
    const std::vector<std::array<double, 3>> ones(o.views, {1, 1, 1});
    out.gains = ones;
    out.places.assign(o.views, 0);
    for (int channel = options.per_channel ? 0 : 3; channel < (options.per_channel ? 3 : 4); ++channel) {
        Logs logs = logs_of(o, channel);
        if (logs.view.empty()) continue;
        const bool first = channel == 0 || channel == 3;
        if (first) {
            for (uint32_t v : logs.view) ++out.places[v];
            out.disagreement_before = median(residuals(logs, Eigen::VectorXd::Zero(static_cast<Eigen::Index>(o.views))));
        }
        const Eigen::VectorXd x = solve(logs, o.views, options);
        if (first) {
            std::fill(logs.weight.begin(), logs.weight.end(), 1.0);
            out.disagreement = median(residuals(logs, x));
        }
        double mean = 0;
        size_t used = 0;
        for (size_t v = 0; v < o.views; ++v)
            if (out.places[v]) {
                mean += x[static_cast<Eigen::Index>(v)];
                ++used;
            }
        mean /= static_cast<double>(used);
        for (size_t v = 0; v < o.views; ++v) {
            if (!out.places[v]) continue;
            const double gain = std::exp(x[static_cast<Eigen::Index>(v)] - mean);
            if (channel == 3) out.gains[v] = {gain, gain, gain};
            else out.gains[v][static_cast<size_t>(channel)] = gain;
        }
    }
    // Where what differs is not exposure (a wrong shape, a lamp that stays), gains would only add to it.
    if (out.disagreement >= out.disagreement_before) {
        out.gains = ones;
        out.disagreement = out.disagreement_before;
    }
    return out;
}

}  // namespace vdbcarve
