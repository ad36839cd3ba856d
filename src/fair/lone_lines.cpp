// SPDX-License-Identifier: Apache-2.0
#include "fair/lone_lines.h"

#include <algorithm>
#include <deque>
#include <unordered_map>

namespace vdbcarve::fairing {

using kernel::FairCell;
using kernel::FairField;
using openvdb::Coord;

namespace {

constexpr float kBridgeDepth_vox = -0.5f;
/// Wide enough for the eight voxels around a place.
constexpr float kAlone_vox = 2.f;

class Bridges {
  public:
    explicit Bridges(Level& level) : level_(level), falls_(level.leaves()) {}

    void reach(const LoneLine& lone) {
        const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
        const FairCell c = sample_cell(lone.line.ray, lone.at.place.sample);
        if (value_in(f, f.leaf(c.i, c.j, c.k), c) <= lone.at.target) return;  // by one before
        Coord deepest(c.i, c.j, c.k);
        for (int n = 1; n < 8; ++n) {
            const Coord corner(c.i + (n >> 2), c.j + (n >> 1 & 1), c.k + (n & 1));
            if (hull.at(corner.x(), corner.y(), corner.z()) < hull.at(deepest.x(), deepest.y(), deepest.z())) deepest = corner;
        }
        if (f.place(deepest.x(), deepest.y(), deepest.z()) >= 0) bridge(deepest);
        const kernel::FairPull pull = kernel::pull_of(f, lone.line, lone.at, kAlone_vox, true);
        for (int n = 0; n < pull.columns(); ++n) kernel::lower_column(f, pull, n, [this](int64_t at, float by) { lower(static_cast<size_t>(at), by); });
    }
    std::vector<size_t> fell() const {
        std::vector<size_t> out;
        for (size_t n = 0; n < falls_.size(); ++n)
            if (falls_[n]) out.push_back(n);
        return out;
    }

  private:
    void lower(size_t at, float by) {
        float& v = level_.field.of[at];
        const float now = kernel::fallen(v, by, level_.hull.of[at]);
        if (now < v) falls_[at / kLeafVoxels] = 1;
        v = now;
    }
    void bridge(const Coord& from) {
        const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
        std::unordered_map<Coord, Coord> came_from{{from, from}};
        std::deque<Coord> open{from};
        std::vector<int64_t> path;
        while (!open.empty() && path.empty()) {
            const Coord c = open.front();
            open.pop_front();
            for (const int axis : {0, 1, 2})
                for (const int step : {-1, 1}) {
                    Coord d = c;
                    d[axis] += step;
                    if (!path.empty() || came_from.count(d) || (d - from).asVec3i().lengthSqr() > kLongestBridge_vox * kLongestBridge_vox) continue;
                    const int64_t p = f.place(d.x(), d.y(), d.z());
                    if (p == kernel::kInsideTile || (p >= 0 && f.values[p] < 0.f)) {
                        for (Coord back = c;; back = came_from[back]) {
                            path.push_back(f.place(back.x(), back.y(), back.z()));
                            if (back == from) break;
                        }
                        break;
                    }
                    if (p < 0 || hull.values[p] > -0.2f) continue;
                    came_from[d] = c;
                    open.push_back(d);
                }
        }
        for (const int64_t at : path) lower(static_cast<size_t>(at), kernel::max_f(0.f, level_.field.of[static_cast<size_t>(at)] - kBridgeDepth_vox));
    }

    Level& level_;
    std::vector<uint8_t> falls_;  ///< by leaf
};

}  // namespace

std::vector<size_t> reach_alone(Level& level, std::vector<LoneLine> lines) {
    // No two lines are of one sample.
    std::sort(lines.begin(), lines.end(),
              [](const LoneLine& a, const LoneLine& b) { return a.line.view != b.line.view ? a.line.view < b.line.view : a.line.sample < b.line.sample; });
    Bridges bridges(level);
    for (const LoneLine& lone : lines) bridges.reach(lone);
    return bridges.fell();
}

}  // namespace vdbcarve::fairing
