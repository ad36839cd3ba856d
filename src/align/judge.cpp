// SPDX-License-Identifier: Apache-2.0
#include "align/judge.h"

#include <algorithm>
#include <cmath>

#include "base/statistics.h"

namespace vdbcarve {

std::vector<AlignedView> Judge::views_of(const OrbitModel& model, const CoherencePass& pass) {
    const std::vector<ContourPoint> points = s_.contour(pass.scale, pass.points, 21, 0, Silhouettes::Which::All);
    const std::vector<Touch> touches = touches_of(s_, model, points, pass);
    const std::vector<CoherenceView>& views = s_.at_scale(pass.scale);
    const std::vector<OrbitCamera> cameras = model.cameras();
    const size_t n = s_.count();
    std::vector<AlignedView> out(n);
    std::vector<std::vector<double>> residuals(n);
    std::vector<double> dissents(n, 0);
    for (size_t p = 0; p < points.size(); ++p) {
        const double r = touches[p].residual_px;
        if (std::isnan(r)) continue;
        residuals[static_cast<size_t>(points[p].view)].push_back(std::max(0.0, r));
        if (r <= -pass.margin_px && pass.misses == 0) continue;
        // Whose silhouettes keep the line of sight out of the hull.
        for (const Support& x : supports_of(views, cameras, points[p], touches[p], 1e9, 8))
            if (x.distance_px > dissent_limit_px()) dissents[static_cast<size_t>(x.view)] += 1;
    }
    for (size_t i = 0; i < n; ++i) {
        AlignedView& v = out[i];
        v.name = given_.views[i].name;
        v.bad = s_.bad(i);
        v.azimuth_deg = std::remainder(model.azimuth(i) / kRadians, 360);
        if (residuals[i].empty()) continue;
        double sum = 0;
        size_t near = 0;
        for (double r : residuals[i]) sum += r * r, near += r < 0.5;
        v.residual_px = std::sqrt(sum / static_cast<double>(residuals[i].size()));
        v.residual_p95_px = percentile(residuals[i], 0.95);
        v.coherent = static_cast<double>(near) / static_cast<double>(residuals[i].size());
        v.dissent = dissents[i] / static_cast<double>(points.size());
    }
    return out;
}

std::vector<size_t> Judge::contradicting(const std::vector<AlignedView>& views, const std::vector<size_t>& known, bool robust) const {
    std::vector<double> own, dissent;
    for (size_t i : s_.seen()) own.push_back(views[i].residual_px), dissent.push_back(views[i].dissent);
    // Real masks stray by a pixel here and there; that is what trimming points is for.
    const double own_limit = std::max({2.0, s_.size_px() / 200, 5 * median(own)}), dissent_limit = std::clamp(5 * median(dissent), 0.008, robust ? 0.02 : 1.0);
    std::vector<std::pair<double, size_t>> worst;
    for (size_t i : s_.seen())
        if (!std::count(known.begin(), known.end(), i) && (views[i].residual_px > own_limit || views[i].dissent > dissent_limit))
            worst.push_back({std::max(views[i].residual_px / own_limit, views[i].dissent / dissent_limit), i});
    std::sort(worst.rbegin(), worst.rend());
    for (const auto& [how, i] : worst)
        aligner_.trace("contradicts: %zu own %.2f (limit %.2f) dissent %.4f (limit %.4f)", i, views[i].residual_px, own_limit, views[i].dissent, dissent_limit);
    std::vector<size_t> out = known;
    for (const auto& [how, i] : worst)
        if (how >= 0.3 * worst.front().first && out.size() < s_.seen().size() / 4) out.push_back(i);
    std::sort(out.begin(), out.end());
    return out;
}

}  // namespace vdbcarve
