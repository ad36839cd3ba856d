// SPDX-License-Identifier: Apache-2.0
#include "fair/sight_lines.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <deque>
#include <unordered_map>

namespace vdbcarve::fairing {

using kernel::FairCell;
using kernel::FairEye;
using kernel::FairField;
using kernel::FairLine;
using kernel::FairOpen;
using kernel::FairRay;
using kernel::kFairBand_vox;
using openvdb::Coord;

namespace {

/// Rounds after which a cell is put back to the hull's values.
constexpr int kPatience = 40;
/// What is as near to the surface as this becomes part of it when it is lowered; farther away it would hang in the air.
constexpr float kBeside_vox = 1.f;
/// No bridge reaches farther; how deep it is.
constexpr int kLongestBridge_vox = 48;
constexpr float kBridgeDepth_vox = -0.5f;
constexpr int kReach_samples = 4;
/// Wide enough for the eight voxels around a place.
constexpr float kAlone_vox = 2.f;
/// Side of the squares of samples that are asked at once.
constexpr int kSquare = 4;

float sample(const SampledField& f, int x, int y) {
    return static_cast<float>(f.samples[static_cast<size_t>(y) * static_cast<size_t>(f.width) + static_cast<size_t>(x)]) / kernel::kFieldUnits;
}

/// Centre of voxel (0, 0, 0) of a level, world.
Vec3d first_voxel(const openvdb::math::Transform& finest, int shift) {
    const openvdb::Vec3d first = finest.indexToWorld(openvdb::Vec3d(0.5 * ((1 << shift) - 1)));
    return {first.x(), first.y(), first.z()};
}

FairEye eye_of(const Camera& camera, int scale, const Vec3d& origin, double voxel) {
    const Intrinsics& k = camera.intrinsics;
    FairEye e{};
    e.fx = k.fx / scale;
    e.fy = k.fy / scale;
    e.skew = k.skew / scale;
    e.cx = k.cx / scale;
    e.cy = k.cy / scale;
    e.inverse_fx = 1 / e.fx;
    e.inverse_fy = 1 / e.fy;
    e.inverse_voxel = 1 / voxel;
    e.orthographic = k.orthographic;
    const Vec3d centre = (camera.centre_world() - origin) / voxel;
    const Mat3d world_from_camera = camera.camera_from_world.rotation.transpose();
    for (int a = 0; a < 3; ++a) {
        e.centre[a] = centre[a];
        for (int b = 0; b < 3; ++b) e.axes[a][b] = world_from_camera(a, b);
    }
    return e;
}

/// Pixels across a voxel in the middle of the lattice, median over views.
double pixels_per_voxel(const Level& level, const Vec3d& origin, double voxel, const std::vector<FairView>& views) {
    Vec3d middle;
    for (size_t a = 0; a < 3; ++a) middle[static_cast<int>(a)] = 8 * (level.lo[a] + 0.5 * level.size[a]);
    middle = origin + voxel * middle;
    std::vector<double> px;
    for (const FairView& v : views) {
        const Intrinsics& k = v.camera.intrinsics;
        const double depth = k.orthographic ? 1.0 : (v.camera.camera_from_world * middle).z();
        px.push_back(voxel * std::max(k.fx, k.fy) / std::max(depth, voxel));
    }
    std::nth_element(px.begin(), px.begin() + static_cast<long>(px.size() / 2), px.end());
    return px[px.size() / 2];
}

}  // namespace

SightLines::SightLines(Level& level, const Level* coarse, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale, bool exact,
                       Progress& progress)
    : level_(level), coarse_(coarse) {
    const double voxel = finest.voxelSize()[0] * (1 << level.shift);
    const Vec3d origin = first_voxel(finest, level.shift);
    scale_ = std::max(scale, 1);
    if (scale == 0)
        for (const double px = pixels_per_voxel(level, origin, voxel, views); 2 * scale_ <= px;) scale_ *= 2;
    exact_ = exact && scale_ == 1;
    std::vector<MaskView> masks;
    for (const FairView& v : views) {
        masks.push_back(v.mask);
        eyes_.push_back(eye_of(v.camera, scale_, origin, voxel));
    }
    DistanceOptions options;
    options.scale = scale_;
    options.reach_samples = kReach_samples;
    fields_ = distance_fields(masks, options, progress);
    find_rim();
}

template <class Visit>
SightLines::Lines SightLines::each_square(const Visit& visit) const {
    struct Row {
        uint32_t view;
        int y;
    };
    std::vector<Row> rows;
    for (size_t u = 0; u < fields_.size(); ++u)
        for (int y = 0; y < (fields_[u].silhouette.empty() ? 0 : fields_[u].silhouette.height); y += kSquare) rows.push_back({static_cast<uint32_t>(u), y});
    constexpr size_t kRows = 4;
    std::vector<Lines> found((rows.size() + kRows - 1) / kRows);
    tbb::parallel_for(size_t{0}, found.size(), [&](size_t c) {
        for (size_t n = c * kRows; n < std::min(rows.size(), (c + 1) * kRows); ++n) {
            int there = 0;
            for (int x = 0; x < fields_[rows[n].view].silhouette.width; x += kSquare) visit(rows[n].view, x, rows[n].y, there, found[c]);
        }
    });
    Lines out;
    for (size_t n = 0; n < kShares; ++n)
        for (const Lines& part : found) out[n].insert(out[n].end(), part[n].begin(), part[n].end());
    return out;
}

/// visit(i, j, distance) for samples that say something.
template <class Visit>
void SightLines::each_sample_of(uint32_t view, int i0, int j0, int side, const Visit& visit) const {
    const SampledField& s = fields_[view].silhouette;
    for (int j = j0; j < std::min(j0 + side, s.height); ++j)
        for (int i = i0; i < std::min(i0 + side, s.width); ++i)
            if (!says_nothing(fields_[view], s.x0 + i, s.y0 + j)) visit(i, j, sample(s, i, j));
}

size_t SightLines::inside_samples() const {
    std::atomic<size_t> count{0};
    tbb::parallel_for(size_t{0}, fields_.size(), [&](size_t u) {
        const SampledField& s = fields_[u].silhouette;
        size_t here = 0;
        if (!s.empty())
            each_sample_of(static_cast<uint32_t>(u), 0, 0, std::max(s.width, s.height),
                           [&here](int, int, float inside) { here += inside <= kernel::kFairMust_samples; });
        count += here;
    });
    return count;
}

namespace {

/// Which fourth of the lines a sample's belongs to; 0 and 1 are the colours of a chessboard of which 2 and 3 are the other.
size_t share_of(int i, int j) { return static_cast<size_t>(((i + j) & 1) << 1 | (i & 1)); }

void add(std::array<std::vector<FairLine>, 4>& out, const SampledField& s, uint32_t view, int i, int j, FairLine& line) {
    line.view = view;
    line.sample = static_cast<uint32_t>(j * s.width + i);
    out[share_of(i, j)].push_back(line);
}

}  // namespace

void SightLines::find_rim() {
    const FairField hull = level_.view(level_.hull);
    rim_ = each_square([&](uint32_t u, int i0, int j0, int&, Lines& out) {
        const SampledField& s = fields_[u].silhouette;
        each_sample_of(u, i0, j0, kSquare, [&](int i, int j, float inside) {
            FairLine line;
            if (std::fabs(inside) < 1.f && (exact_ || share_of(i, j) < 2) && kernel::rim_line(eyes_[u], hull, s.x0 + i, s.y0 + j, inside, line))
                add(out, s, u, i, j, line);
        });
    });
}

void SightLines::ask_square(uint32_t u, int i0, int j0, int side, float safe_vox, bool all, int& there, Lines& out) const {
    const SampledField& s = fields_[u].silhouette;
    const FairField f = level_.view(level_.field);
    bool asks = false;
    each_sample_of(u, i0, j0, side, [&asks](int, int, float inside) { asks |= inside <= -1.f; });
    if (!asks || (side > 1 && kernel::covers_square(eyes_[u], f, s.x0 + i0, s.y0 + j0, side, there))) return;
    if (side > 1) {
        for (int n = 0; n < 4; ++n) ask_square(u, i0 + (n & 1) * side / 2, j0 + (n >> 1) * side / 2, side / 2, safe_vox, all, there, out);
        return;
    }
    if (!(all && exact_) && share_of(i0, j0) >= (exact_ ? 1 : 2)) return;
    const int x = s.x0 + i0, y = s.y0 + j0;
    FairLine line;
    // Where all are asked most are deep enough, and where is known from the one before.
    if (all && line_of_sight(eyes_[u], f, x + 0.5, y + 0.5, line.ray) && kernel::is_deep(f, line.ray, kernel::min_f(safe_vox, -line.ray.sample_vox), there))
        return;
    if (kernel::near_line(eyes_[u], f, x, y, safe_vox, line)) add(out, s, u, i0, j0, line);
}

void SightLines::find_near(float safe_vox, bool all) {
    find_least(level_, level_.field);
    near_ = each_square([&](uint32_t u, int i0, int j0, int& there, Lines& out) { ask_square(u, i0, j0, kSquare, safe_vox, all, there, out); });
}

SightLines::Round SightLines::look(const std::vector<FairLine*>& lines, float grows_from) const {
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull), coarse = coarse_ ? coarse_->view(coarse_->field) : FairField{};
    constexpr size_t kLines = 256;
    std::vector<Round> parts((lines.size() + kLines - 1) / kLines);
    tbb::parallel_for(size_t{0}, parts.size(), [&](size_t p) {
        for (size_t n = p * kLines; n < std::min(lines.size(), (p + 1) * kLines); ++n) {
            const FairOpen open = kernel::look_along(f, hull, coarse, *lines[n]);
            if (open.place.sample >= 0) (open.place.value < grows_from ? parts[p].beside : parts[p].alone).push_back({lines[n], open});
        }
    });
    Round out;
    for (const Round& part : parts) {
        out.beside.insert(out.beside.end(), part.beside.begin(), part.beside.end());
        out.alone.insert(out.alone.end(), part.alone.begin(), part.alone.end());
    }
    return out;
}

bool SightLines::grow(const std::vector<Open>& open, float along_vox, bool to_the_hull) {
    // Each is reckoned from the field as it was, and where two meet the larger fall counts, so no order matters.
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
    fall_.resize(level_.field.of.size());
    falls_.resize(level_.leaves());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, open.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n)
            kernel::lower_around(f, hull, *open[n].line, open[n].at, along_vox, to_the_hull, [&](int64_t at, float by) {
                const std::atomic_ref<float> cell(fall_[static_cast<size_t>(at)]);
                float now = cell.load(std::memory_order_relaxed);
                while (by > now && !cell.compare_exchange_weak(now, by, std::memory_order_relaxed)) {
                }
                const std::atomic_ref<uint8_t> leaf(falls_[static_cast<size_t>(at) / kLeafVoxels]);
                if (!leaf.load(std::memory_order_relaxed)) leaf.store(1, std::memory_order_relaxed);
            });
    });
    return fall();
}

bool SightLines::fall() {
    std::vector<size_t> leaves;
    for (size_t n = 0; n < falls_.size(); ++n)
        if (falls_[n]) leaves.push_back(n);
    std::atomic<bool> changed{false};
    Level::for_each_of(leaves.size(), [&](size_t l) {
        bool here = false;
        for (size_t at = leaves[l] * kLeafVoxels; at < (leaves[l] + 1) * kLeafVoxels; ++at) {
            float& v = level_.field.of[at];
            const float lower = kernel::max_f(v - fall_[at], level_.hull.of[at]);
            fall_[at] = 0.f;
            here |= lower < v;
            v = kernel::min_f(v, lower);
        }
        falls_[leaves[l]] = 0;
        if (here) changed.store(true, std::memory_order_relaxed);
    });
    if (changed) update_least(level_, level_.field, leaves);
    return changed;
}

bool SightLines::lower(const std::vector<int64_t>& voxels, float to_vox) {
    fall_.resize(level_.field.of.size());
    falls_.resize(level_.leaves());
    for (const int64_t at : voxels) {
        fall_[static_cast<size_t>(at)] = kernel::max_f(0.f, level_.field.of[static_cast<size_t>(at)] - to_vox);
        falls_[static_cast<size_t>(at) / kLeafVoxels] = 1;
    }
    return fall();
}

bool SightLines::bridge(const Coord& from) {
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
    return lower(path, kBridgeDepth_vox);
}

bool SightLines::reach_alone(const std::vector<Open>& alone) {
    bool changed = false;
    for (const Open& open : alone) {
        const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
        const FairCell c = sample_cell(open.line->ray, open.at.place.sample);
        if (value_in(f, f.leaf(c.i, c.j, c.k), c) <= open.at.target) continue;  // by one before
        Coord deepest(c.i, c.j, c.k);
        for (int n = 1; n < 8; ++n) {
            const Coord corner(c.i + (n >> 2), c.j + (n >> 1 & 1), c.k + (n & 1));
            if (hull.at(corner.x(), corner.y(), corner.z()) < hull.at(deepest.x(), deepest.y(), deepest.z())) deepest = corner;
        }
        if (f.place(deepest.x(), deepest.y(), deepest.z()) >= 0) changed |= bridge(deepest);
        changed |= grow({open}, kAlone_vox, true);
    }
    return changed;
}

void SightLines::repair(int rounds, float along_vox, bool anywhere, std::optional<size_t> share) {
    std::vector<FairLine*> open;
    for (Lines* lines : {&rim_, &near_})
        for (size_t n = 0; n < kShares; ++n)
            if (!share || *share % (exact_ ? kShares : kShares / 2) == n)
                for (FairLine& line : (*lines)[n]) open.push_back(&line);
    find_least(level_, level_.field);
    for (int round = 0; round < rounds && !open.empty(); ++round) {
        const Round found = look(open, anywhere ? kBeside_vox : kFairBand_vox - 1e-3f);
        open.clear();
        for (const auto* part : {&found.beside, &found.alone})
            for (const Open& o : *part) open.push_back(o.line);
        // Growing from the surface comes first; what has nothing near waits until that ends.
        if (!grow(found.beside, along_vox, round >= kPatience) && !(anywhere && reach_alone(found.alone))) break;
    }
    open_ = static_cast<size_t>(std::count_if(open.begin(), open.end(), [](const FairLine* line) { return line->must < kFairBand_vox; }));
}

}  // namespace vdbcarve::fairing
