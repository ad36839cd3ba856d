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
using kernel::FairRay;
using kernel::kFairBand_vox;
using openvdb::Coord;

namespace {

/// A line counts as met this little above its target, so that the last bit needs no round of its own.
constexpr float kSlack_vox = 0.02f;
/// The contour is kept where the surface is at most so far from it.
constexpr float kNearContour_vox = 0.3f;
/// Lines this far inside the contour, in pixels, must meet the surface; those nearer to it, down to a pixel outside, keep the contour.
constexpr float kMust_px = -0.5f;
/// As deep as that is covered.
constexpr float kCovered_vox = -0.1f;
/// Rounds after which a cell is put back to the hull's values.
constexpr int kPatience = 40;
/// What is as near to the surface as this becomes part of it when it is lowered; farther away it would hang in the air.
constexpr float kBeside_vox = 1.f;
/// No bridge reaches farther; how deep it is.
constexpr int kLongestBridge_vox = 48;
constexpr float kBridgeDepth_vox = -0.5f;
constexpr int kReach_samples = 4;

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

SightLines::SightLines(Level& level, const Level* coarse, const openvdb::math::Transform& finest, const std::vector<FairView>& views, int scale,
                       Progress& progress)
    : level_(level), coarse_(coarse) {
    const double voxel = finest.voxelSize()[0] * (1 << level.shift);
    const Vec3d origin = first_voxel(finest, level.shift);
    scale_ = std::max(scale, 1);
    if (scale == 0)
        for (const double px = pixels_per_voxel(level, origin, voxel, views); 2 * scale_ <= px;) scale_ *= 2;
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
std::vector<Line> SightLines::each_sample(const Visit& visit) const {
    struct Row {
        uint32_t view;
        int y;
    };
    std::vector<Row> rows;
    for (size_t u = 0; u < fields_.size(); ++u)
        for (int y = 0; y < (fields_[u].silhouette.empty() ? 0 : fields_[u].silhouette.height); ++y) rows.push_back({static_cast<uint32_t>(u), y});
    constexpr size_t kRows = 16;
    std::vector<std::vector<Line>> found((rows.size() + kRows - 1) / kRows);
    tbb::parallel_for(size_t{0}, found.size(), [&](size_t c) {
        for (size_t n = c * kRows; n < std::min(rows.size(), (c + 1) * kRows); ++n)
            for (int x = 0; x < fields_[rows[n].view].silhouette.width; ++x) visit(rows[n].view, x, rows[n].y, found[c]);
    });
    std::vector<Line> out;
    for (const auto& part : found) out.insert(out.end(), part.begin(), part.end());
    return out;
}

size_t SightLines::inside_samples() const {
    std::atomic<size_t> count{0};
    tbb::parallel_for(size_t{0}, fields_.size(), [&](size_t u) {
        const SampledField& s = fields_[u].silhouette;
        size_t here = 0;
        for (int y = 0; y < (s.empty() ? 0 : s.height); ++y)
            for (int x = 0; x < s.width; ++x) here += sample(s, x, y) <= kMust_px && !says_nothing(fields_[u], s.x0 + x, s.y0 + y);
        count += here;
    });
    return count;
}

void SightLines::add(std::vector<Line>& out, const FairRay& ray, float target) const {
    Line line{ray, target + kSlack_vox, 0, 0, false, true};
    if (line.target >= kFairBand_vox) return;  // the hull is not there either
    deep_span(level_.view(level_.hull), ray, line.target, line.first, line.last);
    out.push_back(line);
}

void SightLines::find_rim() {
    const FairField hull = level_.view(level_.hull);
    rim_ = each_sample([&](uint32_t u, int i, int j, std::vector<Line>& out) {
        const SampledField& s = fields_[u].silhouette;
        const float d = sample(s, i, j);
        const int x = s.x0 + i, y = s.y0 + j;
        FairRay ray;
        if (d <= -1.f || d >= 1.f || says_nothing(fields_[u], x, y) || !line_of_sight(eyes_[u], hull, x, y, ray)) return;
        const float least = least_on(hull, ray, -kFairBand_vox);
        // Never more than the mask says: with misses allowed, the hull reaches beyond some.
        add(out, ray, kernel::max_f(least, d * ray.sample_vox));
        if (d <= kMust_px) out.push_back({ray, kCovered_vox, 0, ray.last, true, false});
    });
}

void SightLines::cover_by_balls(float safe_vox) {
    // A leaf that lies inside holds a ball of four voxels. Whatever the camera's skew, what it covers of the picture holds a disc of its size at its depth.
    constexpr double kRadius = 4;
    const FairField f = level_.view(level_.field);
    std::vector<std::array<double, 3>> balls;
    level_.each_place([&](size_t p, int x, int y, int z) {
        const int32_t n = level_.leaf_at[p];
        if (n == kernel::kOutsideTile) return;
        if (n >= 0) {
            float most = -kFairBand_vox;
            for (size_t q = 0; q < kLeafVoxels; ++q) most = kernel::max_f(most, f.values[static_cast<size_t>(n) * kLeafVoxels + q]);
            if (most > safe_vox) return;
        }
        balls.push_back({8.0 * x + 3.5, 8.0 * y + 3.5, 8.0 * z + 3.5});
    });
    covered_.resize(fields_.size());
    tbb::parallel_for(size_t{0}, fields_.size(), [&](size_t u) {
        const SampledField& s = fields_[u].silhouette;
        const FairEye& e = eyes_[u];
        std::vector<uint8_t>& out = covered_[u];
        out.assign(s.empty() ? 0 : static_cast<size_t>(s.width) * static_cast<size_t>(s.height), 0);
        if (out.empty()) return;
        for (const auto& ball : balls) {
            double q[3] = {0, 0, 0};
            for (size_t a = 0; a < 3; ++a)
                for (size_t c = 0; c < 3; ++c) q[a] += e.axes[c][a] * (ball[c] - e.centre[c]);
            if (!e.orthographic && q[2] <= 2 * kRadius) continue;
            const double size = e.orthographic ? 1 / e.inverse_voxel : 1 / q[2];  // of a voxel, without the focal length
            const double cx = size * (e.fx * q[0] + e.skew * q[1]) + e.cx - s.x0 - 0.5, cy = size * e.fy * q[1] + e.cy - s.y0 - 0.5;
            // Half a voxel less: samples of a line lie half a voxel apart.
            const double radius = std::min(e.fx, e.fy) / (1 + std::fabs(e.skew) / e.fx) * size * (kRadius - 0.5);
            for (int y = std::max(0, static_cast<int>(std::ceil(cy - radius))); y <= std::min(s.height - 1, static_cast<int>(std::floor(cy + radius))); ++y) {
                const double half = std::sqrt(std::max(0.0, radius * radius - (y - cy) * (y - cy)));
                const int first = std::max(0, static_cast<int>(std::ceil(cx - half))), last = std::min(s.width - 1, static_cast<int>(std::floor(cx + half)));
                if (first <= last)
                    std::memset(out.data() + static_cast<size_t>(y) * static_cast<size_t>(s.width) + static_cast<size_t>(first), 1,
                                static_cast<size_t>(last - first + 1));
            }
        }
    });
}

void SightLines::find_near(float safe_vox) {
    find_least(level_, level_.field);
    cover_by_balls(kernel::min_f(safe_vox, -1.f));
    const FairField f = level_.view(level_.field);
    near_ = each_sample([&](uint32_t u, int i, int j, std::vector<Line>& out) {
        const SampledField& s = fields_[u].silhouette;
        const int x = s.x0 + i, y = s.y0 + j;
        FairRay ray;
        if (sample(s, i, j) > -1.f || covered_[u][static_cast<size_t>(j) * static_cast<size_t>(s.width) + static_cast<size_t>(i)] ||
            says_nothing(fields_[u], x, y) || !line_of_sight(eyes_[u], f, x, y, ray))
            return;
        const float deep = -ray.sample_vox;
        if (!reaches(f, ray, 0, ray.last, kernel::min_f(safe_vox, deep))) out.push_back({ray, deep, 0, ray.last, true, false});
    });
}

template <class Lowering>
void SightLines::lower_around(const Open& open, bool to_the_hull, const Lowering& lower) const {
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
    const FairCell c = sample_cell(open.line->ray, open.place.sample);
    const float fall = kernel::max_f(value_in(f, f.leaf(c.i, c.j, c.k), c) - open.line->target, 0.f);
    for (int i = -kernel::kDentReach; i <= kernel::kDentReach + 1; ++i)
        for (int j = -kernel::kDentReach; j <= kernel::kDentReach + 1; ++j)
            for (int k = -kernel::kDentReach; k <= kernel::kDentReach + 1; ++k) {
                const bool corner = ((i | j | k) & ~1) == 0;
                const float share = kernel::dent(static_cast<float>(i) - c.a, static_cast<float>(j) - c.b, static_cast<float>(k) - c.c);
                if (share <= 0.f && !corner) continue;
                const int64_t at = f.place(c.i + i, c.j + j, c.k + k);
                if (at < 0) continue;
                const float now = f.values[at], floor = hull.values[at];
                const float wanted = to_the_hull ? (corner ? floor : now) : kernel::max_f(floor, now - share * fall - (corner ? 0.01f : 0.f));
                if (wanted < now) lower(at, wanted);
            }
}

SightLines::Round SightLines::look(const std::vector<Line*>& lines, float grows_from) const {
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull), coarse = coarse_ ? coarse_->view(coarse_->field) : FairField{};
    constexpr size_t kLines = 256;
    std::vector<Round> parts((lines.size() + kLines - 1) / kLines);
    tbb::parallel_for(size_t{0}, parts.size(), [&](size_t p) {
        Round& part = parts[p];
        for (size_t n = p * kLines; n < std::min(lines.size(), (p + 1) * kLines); ++n) {
            Line& line = *lines[n];
            if (reaches(f, line.ray, line.first, line.last, line.target)) continue;
            if (!line.settled) {  // what the hull allows is asked of the few that need it
                line.settled = true;
                line.target = kernel::max_f(least_on(hull, line.ray, line.target), line.target) + kSlack_vox;
                deep_span(hull, line.ray, line.target, line.first, line.last);
                if (line.target >= kFairBand_vox || reaches(f, line.ray, line.first, line.last, line.target)) continue;
            }
            const kernel::NearestPlace place = nearest_place(f, hull, coarse, line.ray, line.first, line.last, line.target);
            if (place.sample < 0 || (!line.must && place.value > kNearContour_vox)) continue;
            part.open.push_back(&line);
            (place.value < grows_from ? part.beside : part.alone).push_back({&line, place});
        }
    });
    Round out;
    const auto join = [&parts](auto& into, auto Round::*member) {
        for (const Round& part : parts) into.insert(into.end(), (part.*member).begin(), (part.*member).end());
    };
    join(out.open, &Round::open);
    join(out.beside, &Round::beside);
    join(out.alone, &Round::alone);
    return out;
}

bool SightLines::grow(const std::vector<Open>& open, bool to_the_hull) {
    constexpr size_t kFew = 4096;
    if (open.size() < kFew) {
        std::vector<Lower> all;
        for (const Open& o : open) lower_around(o, to_the_hull, [&](int64_t at, float value) { all.push_back({at, value}); });
        return apply(all);
    }
    // Each is reckoned from the field as it was; where two meet the lower counts, so no order matters.
    std::vector<float>& next = level_.scratch;
    next = level_.field.of;
    tbb::parallel_for(tbb::blocked_range<size_t>(0, open.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n)
            lower_around(open[n], to_the_hull, [&](int64_t at, float value) {
                const std::atomic_ref<float> cell(next[static_cast<size_t>(at)]);
                float now = cell.load(std::memory_order_relaxed);
                while (value < now && !cell.compare_exchange_weak(now, value, std::memory_order_relaxed)) {
                }
            });
    });
    level_.field.of.swap(next);
    find_least(level_, level_.field);
    return true;
}

bool SightLines::apply(const std::vector<Lower>& lower) {
    const FairField f = level_.view(level_.field);
    bool changed = false;
    for (const Lower& l : lower) {
        float& v = level_.field.of[static_cast<size_t>(l.at)];
        if (!(l.value < v)) continue;
        v = l.value;
        changed = true;
        // The leaf's cells have it, and at its lower borders the cells of leaves before it.
        const Coord o = level_.origin[static_cast<size_t>(l.at) / kLeafVoxels];
        const int q = static_cast<int>(static_cast<size_t>(l.at) % kLeafVoxels);
        for (int n = 0; n < 8; ++n) {
            if ((n & 4 && q >> 6) || (n & 2 && (q >> 3 & 7)) || (n & 1 && (q & 7))) continue;
            const int32_t leaf = f.leaf(o.x() - (n & 4 ? 8 : 0), o.y() - (n & 2 ? 8 : 0), o.z() - (n & 1 ? 8 : 0));
            if (leaf < 0) continue;
            float& least = level_.field.least[static_cast<size_t>(leaf)];
            least = kernel::min_f(least, v);
        }
    }
    return changed;
}

bool SightLines::bridge(const Coord& from) {
    const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
    std::unordered_map<Coord, Coord> came_from{{from, from}};
    std::deque<Coord> open{from};
    std::vector<Lower> path;
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
                        const int64_t at = f.place(back.x(), back.y(), back.z());
                        path.push_back({at, kernel::max_f(hull.values[at], kBridgeDepth_vox)});
                        if (back == from) break;
                    }
                    break;
                }
                if (p < 0 || hull.values[p] > -0.2f) continue;
                came_from[d] = c;
                open.push_back(d);
            }
    }
    return apply(path);
}

bool SightLines::reach_alone(const std::vector<Open>& alone) {
    bool changed = false;
    for (const Open& open : alone) {
        const FairField f = level_.view(level_.field), hull = level_.view(level_.hull);
        const FairCell c = sample_cell(open.line->ray, open.place.sample);
        if (value_in(f, f.leaf(c.i, c.j, c.k), c) <= open.line->target) continue;  // by one before
        Coord deepest(c.i, c.j, c.k);
        for (int n = 1; n < 8; ++n) {
            const Coord corner(c.i + (n >> 2), c.j + (n >> 1 & 1), c.k + (n & 1));
            if (hull.at(corner.x(), corner.y(), corner.z()) < hull.at(deepest.x(), deepest.y(), deepest.z())) deepest = corner;
        }
        if (f.place(deepest.x(), deepest.y(), deepest.z()) >= 0) changed |= bridge(deepest);
        std::vector<Lower> lower;
        lower_around(open, true, [&](int64_t at, float value) { lower.push_back({at, value}); });
        changed |= apply(lower);
    }
    return changed;
}

void SightLines::repair(int rounds, bool anywhere, std::optional<size_t> half) {
    std::vector<Line*> open;
    for (std::vector<Line>* lines : {&rim_, &near_})
        for (size_t n = half.value_or(0); n < lines->size(); n += half ? 2 : 1) open.push_back(&(*lines)[n]);
    find_least(level_, level_.field);
    for (int round = 0; round < rounds && !open.empty(); ++round) {
        Round found = look(open, anywhere ? kBeside_vox : kFairBand_vox - 1e-3f);
        open.swap(found.open);
        // Growing from the surface comes first; what has nothing near waits until that ends.
        if (!grow(found.beside, round >= kPatience) && !(anywhere && reach_alone(found.alone))) break;
    }
    open_ = static_cast<size_t>(std::count_if(open.begin(), open.end(), [](const Line* line) { return line->must; }));
}

}  // namespace vdbcarve::fairing
