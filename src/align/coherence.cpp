// SPDX-License-Identifier: Apache-2.0
#include "align/coherence.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

namespace vdbcarve {
namespace {

constexpr float kSaysNothing = -1e9f;

/// Signed distance in pixels of the photograph, and on demand its gradient. Beyond the field's window the way to it is added.
class Lookup {
  public:
    explicit Lookup(const CoherenceView& view)
        : field_(view.field->silhouette.view()),
          scale_(static_cast<float>(view.field->scale)),
          inverse_scale_(1 / scale_),
          unit_(scale_ / kernel::kFieldUnits),
          width_(static_cast<float>(view.width_px)),
          height_(static_cast<float>(view.height_px)) {
        for (int s = 0; s < 4; ++s) open_[s] = view.open[s];
        any_open_ = open_[0] || open_[1] || open_[2] || open_[3];
    }
    bool silent(float u, float v) const {
        return any_open_ && ((open_[0] && u < 0) || (open_[1] && v < 0) || (open_[2] && u > width_) || (open_[3] && v > height_));
    }
    float distance(float u, float v) const {
        if (silent(u, v)) return kSaysNothing;
        const float us = u * inverse_scale_, vs = v * inverse_scale_;
        float out = kernel::interpolate(kernel::fetch_patch(field_, us, vs)) * unit_;
        const float dx = beyond(us - field_.x0, static_cast<float>(field_.width)), dy = beyond(vs - field_.y0, static_cast<float>(field_.height));
        if (dx != 0 || dy != 0) out += scale_ * std::sqrt(dx * dx + dy * dy);
        return out;
    }
    float distance(float u, float v, float gradient[2]) const {
        gradient[0] = gradient[1] = 0;
        if (silent(u, v)) return kSaysNothing;
        const float us = u * inverse_scale_, vs = v * inverse_scale_;
        const kernel::Patch p = kernel::fetch_patch(field_, us, vs);
        float out = kernel::interpolate(p) * unit_;
        const float dx = beyond(us - field_.x0, static_cast<float>(field_.width)), dy = beyond(vs - field_.y0, static_cast<float>(field_.height));
        const float to_px = 1.f / kernel::kFieldUnits;
        if (dx == 0) gradient[0] = ((1 - p.b) * (p.s10 - p.s00) + p.b * (p.s11 - p.s01)) * to_px;
        if (dy == 0) gradient[1] = ((1 - p.a) * (p.s01 - p.s00) + p.a * (p.s11 - p.s10)) * to_px;
        if (dx != 0 || dy != 0) {
            const float d = std::sqrt(dx * dx + dy * dy);
            out += scale_ * d;
            gradient[0] += dx / d;
            gradient[1] += dy / d;
        }
        return out;
    }

  private:
    /// How far a coordinate lies outside the sample centres, with its sign.
    static float beyond(float x, float size) { return x < 0.5f ? x - 0.5f : x > size - 0.5f ? x - (size - 0.5f) : 0.f; }

    kernel::FieldView field_;
    float scale_, inverse_scale_, unit_, width_, height_;
    bool open_[4], any_open_;
};

/// A line of sight in another view: image position = (o + t d), homogeneous.
struct Trace {
    float ox, oy, oz, dx, dy, dz;
    const Lookup* lookup;

    float distance(float t) const {
        const float z = oz + t * dz;
        if (z < 1e-3f) return kSaysNothing;
        const float w = 1 / z;
        return lookup->distance((ox + t * dx) * w, (oy + t * dy) * w);
    }
    /// And how far in the image points within `half` of t are from it.
    float distance(float t, float half, float& moves) const {
        moves = 0;
        const float z = oz + t * dz, nearest = z - half * std::fabs(dz);
        if (nearest < 1e-3f) return kSaysNothing;
        const float w = 1 / z, u = (ox + t * dx) * w, v = (oy + t * dy) * w;
        const float mx = dx - u * dz, my = dy - v * dz;
        moves = half * std::sqrt(mx * mx + my * my) / nearest;
        return lookup->distance(u, v);
    }
    /// And its derivative along the line.
    float distance_and_slope(float t, float& slope) const {
        slope = 0;
        const float z = oz + t * dz;
        if (z < 1e-3f) return kSaysNothing;
        const float w = 1 / z, u = (ox + t * dx) * w, v = (oy + t * dy) * w;
        float gradient[2];
        const float out = lookup->distance(u, v, gradient);
        slope = (gradient[0] * (dx - u * dz) + gradient[1] * (dy - v * dz)) * w;
        return out;
    }
};

/// Finds the touch on one line of sight.
class LineSearch {
  public:
    std::vector<Trace> traces;  ///< in the order of views
    float resolution = 1;       ///< pixels: intervals in which no point moves farther are not halved again
    float enough = 0;           ///< pixels: the search ends below
    int misses = 0;             ///< so many of the largest distances do not count

    Touch run(float middle, float half_length, const Touch* before) {
        Touch out;
        if (traces.empty()) {
            out.residual_px = std::numeric_limits<double>::quiet_NaN();
            return out;
        }
        best_ = std::numeric_limits<float>::infinity();
        at_ = middle;
        order_.resize(traces.size());
        for (size_t k = 0; k < order_.size(); ++k) order_[k] = static_cast<int>(k);
        if (before && before->depth > 0) ask(static_cast<float>(before->depth));
        if (best_ > enough) {
            // Branch and bound: a distance changes by no more than its point moves in the image. Silhouettes that are inside throughout an interval
            // need not be asked in its halves.
            constexpr int kFirst = 16;
            const float half = half_length / kFirst;
            intervals_.clear();
            lists_.assign(order_.begin(), order_.end());
            for (int s = 0; s < kFirst; ++s)
                intervals_.push_back({middle - half_length + (2 * static_cast<float>(s) + 1) * half, half, 0, static_cast<int>(order_.size())});
            for (size_t next = 0; next < intervals_.size() && best_ > enough; ++next) halve(intervals_[next]);
            polish(half / 16);
        }
        out.depth = at_;
        out.residual_px = best_;
        if (best_ <= kSaysNothing) out.residual_px = std::numeric_limits<double>::quiet_NaN();
        return out;
    }

  private:
    struct Interval {
        float middle, half;
        int first, count;  ///< of lists_: the silhouettes that matter in it
    };

    /// Takes t where the largest distance there is less than what was found before. What decides against it is asked first next time.
    void ask(float t) {
        float most = -std::numeric_limits<float>::infinity();
        int against = 0;
        for (size_t k = 0; k < order_.size(); ++k) {
            const float s = traces[static_cast<size_t>(order_[k])].distance(t);
            if (s >= best_) {
                std::swap(order_[k], order_[k / 2]);
                if (++against > misses) return;
                continue;
            }
            most = std::max(most, s);
        }
        best_ = against == misses ? most : largest_but(misses, t);
        at_ = t;
    }

    /// The largest distance but for so many larger ones.
    float largest_but(int left_out, float t) {
        values_.resize(traces.size());
        for (size_t k = 0; k < traces.size(); ++k) values_[k] = traces[k].distance(t);
        const auto nth = values_.begin() + std::min<long>(left_out, static_cast<long>(values_.size()) - 1);
        std::nth_element(values_.begin(), nth, values_.end(), std::greater<>());
        return static_cast<float>(*nth);
    }

    /// Rules an interval out, or leaves its halves to be looked at.
    void halve(const Interval i) {
        const auto begin = static_cast<size_t>(i.first);
        float farthest = 0;
        int against = 0, above = 0;
        const size_t list = lists_.size();
        for (size_t k = begin; k < begin + static_cast<size_t>(i.count); ++k) {
            float moves;
            const int which = lists_[k];
            const float s = traces[static_cast<size_t>(which)].distance(i.middle, i.half, moves);
            above += s >= best_;
            if (s - moves >= best_) {
                std::swap(lists_[k], lists_[begin + (k - begin) / 2]);
                if (++against > misses) {
                    lists_.resize(list);
                    return;
                }
            }
            farthest = std::max(farthest, moves);
            if (s + moves > enough) lists_.push_back(which);
        }
        if (above <= misses) ask(i.middle);  // with those left out above
        if (farthest < resolution || intervals_.size() > 4000) return;
        const int count = static_cast<int>(lists_.size() - list);
        intervals_.push_back({i.middle - 0.5f * i.half, 0.5f * i.half, static_cast<int>(list), count});
        intervals_.push_back({i.middle + 0.5f * i.half, 0.5f * i.half, static_cast<int>(list), count});
    }

    /// By tangents, of those silhouettes that may come to be the farthest.
    void polish(float reach) {
        constexpr double kNear_px = 4;
        std::vector<int>& near = lists_;
        near.clear();
        const double top = misses > 0 ? largest_but(misses, at_) : best_;
        values_.resize(traces.size());
        for (size_t k = 0; k < traces.size(); ++k) values_[k] = traces[k].distance(at_);
        for (size_t k = 0; k < traces.size(); ++k)
            if (values_[k] > top - kNear_px * resolution && values_[k] <= top) near.push_back(static_cast<int>(k));
        if (near.empty()) return;
        slopes_.resize(near.size());
        for (int pass = 0; pass < 4 && best_ > enough; ++pass) {
            for (size_t k = 0; k < near.size(); ++k) {
                float slope;
                values_[k] = traces[static_cast<size_t>(near[k])].distance_and_slope(at_, slope);
                slopes_[k] = slope;
            }
            const float before = best_;
            ask(at_ + static_cast<float>(minimax(values_.data(), slopes_.data(), near.size(), reach).t));
            reach *= best_ < before ? 0.5f : 0.2f;
        }
    }

    float best_ = 0, at_ = 0;
    std::vector<int> order_, lists_;
    std::vector<Interval> intervals_;
    std::vector<double> values_, slopes_;
};

Mat3d intrinsics_of(const OrbitCamera& c) {
    Mat3d k = Mat3d::Identity();
    k(0, 0) = c.fx;
    k(1, 1) = c.fx * c.aspect;
    k(0, 2) = c.cx;
    k(1, 2) = c.cy;
    return k;
}

/// In camera coordinates, at depth 1.
Vec3d sight(const OrbitCamera& c, const ContourPoint& p) { return {(p.x_px - c.cx) / c.fx, (p.y_px - c.cy) / (c.fx * c.aspect), 1}; }

bool constrains(const CoherenceView& view) { return view.field && view.field->shows_object(); }

}  // namespace

double distance_px(const kernel::FieldView& field, int scale, double x_px, double y_px) {
    return kernel::interpolate(kernel::fetch_patch(field, static_cast<float>(x_px / scale), static_cast<float>(y_px / scale))) * scale / kernel::kFieldUnits;
}

void find_open_sides(const MaskView& mask, CoherenceView& view) {
    const ImageView<uint8_t>& m = mask.coverage;
    for (bool& side : view.open) side = false;
    for (int x = 0; x < m.width; ++x) {
        view.open[1] |= kernel::is_object(m.at(x, 0));
        view.open[3] |= kernel::is_object(m.at(x, m.height - 1));
    }
    for (int y = 0; y < m.height; ++y) {
        view.open[0] |= kernel::is_object(m.at(0, y));
        view.open[2] |= kernel::is_object(m.at(m.width - 1, y));
    }
}

std::vector<ContourPoint> contour_of(const CoherenceView& view, int index) {
    std::vector<ContourPoint> all;
    if (!constrains(view)) return all;
    const SampledField& f = view.field->silhouette;
    const SampledField& ignored = view.field->ignored;
    const auto scale = static_cast<float>(view.field->scale);
    // The contour does not stop at the frame: where it is cut, the border is no contour.
    const float margin = 2 * scale;
    const auto add = [&](float x, float y, int sample_x, int sample_y) {
        if ((view.open[0] && x < margin) || (view.open[1] && y < margin) || (view.open[2] && x > static_cast<float>(view.width_px) - margin) ||
            (view.open[3] && y > static_cast<float>(view.height_px) - margin))
            return;
        if (!ignored.empty() && ignored.at(sample_x, sample_y) > -2) return;
        all.push_back({index, x, y});
    };
    for (int y = 0; y < f.height; ++y)
        for (int x = 0; x < f.width; ++x) {
            const int16_t* s = f.samples.data() + static_cast<size_t>(y) * static_cast<size_t>(f.width) + x;
            const float px = (static_cast<float>(f.x0 + x) + 0.5f) * scale, py = (static_cast<float>(f.y0 + y) + 0.5f) * scale;
            if (x + 1 < f.width && (s[0] <= 0) != (s[1] <= 0))
                add(px + scale * static_cast<float>(s[0]) / static_cast<float>(s[0] - s[1]), py, f.x0 + x, f.y0 + y);
            if (y + 1 < f.height && (s[0] <= 0) != (s[f.width] <= 0))
                add(px, py + scale * static_cast<float>(s[0]) / static_cast<float>(s[0] - s[f.width]), f.x0 + x, f.y0 + y);
        }
    return all;
}

std::vector<Touch> find_touches(const std::vector<CoherenceView>& views, const std::vector<OrbitCamera>& cameras, const std::vector<ContourPoint>& points,
                                const SearchOptions& options, const std::vector<Touch>& before) {
    const size_t n = views.size();
    std::vector<Lookup> lookups;
    std::vector<size_t> asked;
    std::vector<Mat3d> image_from_world(n);
    lookups.reserve(n);
    for (size_t k = 0; k < n; ++k) {
        if (!constrains(views[k])) continue;
        lookups.emplace_back(views[k]);
        asked.push_back(k);
        image_from_world[k] = intrinsics_of(cameras[k]) * cameras[k].camera_from_world;
    }
    std::vector<Touch> out(points.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, points.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
        LineSearch search;
        search.resolution = static_cast<float>(options.resolution_px);
        search.enough = -static_cast<float>(options.margin_px);
        search.misses = options.misses;
        for (size_t p = range.begin(); p != range.end(); ++p) {
            const auto own = static_cast<size_t>(points[p].view);
            const OrbitCamera& camera = cameras[own];
            const Vec3d along = camera.camera_from_world.transpose() * sight(camera, points[p]);
            search.traces.clear();
            for (size_t a = 0; a < asked.size(); ++a) {
                const size_t k = asked[a];
                if (k == own) continue;
                const Vec3d o = image_from_world[k] * (camera.centre - cameras[k].centre), d = image_from_world[k] * along;
                search.traces.push_back({static_cast<float>(o.x()), static_cast<float>(o.y()), static_cast<float>(o.z()), static_cast<float>(d.x()),
                                         static_cast<float>(d.y()), static_cast<float>(d.z()), &lookups[a]});
            }
            const double length = along.norm();
            const double middle = -camera.centre.dot(along) / (length * length);
            out[p] = search.run(static_cast<float>(middle), static_cast<float>(options.ball_radius / length), before.empty() ? nullptr : &before[p]);
        }
    });
    return out;
}

Vec3d touch_position(const OrbitCamera& camera, const ContourPoint& point, double depth) {
    return camera.centre + depth * (camera.camera_from_world.transpose() * sight(camera, point));
}

std::vector<Support> supports_of(const std::vector<CoherenceView>& views, const std::vector<OrbitCamera>& cameras, const ContourPoint& point,
                                 const Touch& touch, double reach_px, size_t most, int misses) {
    const OrbitCamera& own = cameras[static_cast<size_t>(point.view)];
    const Vec3d m = sight(own, point), along = own.camera_from_world.transpose() * m;
    const Vec3d position = own.centre + touch.depth * along;
    struct Image {
        float distance_px;
        size_t view;
        double u, v;
        Vec3d in_camera;
    };
    std::vector<Image> images;
    for (size_t k = 0; k < views.size(); ++k) {
        if (static_cast<int>(k) == point.view || !constrains(views[k])) continue;
        const OrbitCamera& c = cameras[k];
        const Vec3d x = c.camera_from_world * (position - c.centre);
        if (x.z() < 1e-3) continue;
        const double u = c.fx * x.x() / x.z() + c.cx, v = c.fx * c.aspect * x.y() / x.z() + c.cy;
        const float distance_px = Lookup(views[k]).distance(static_cast<float>(u), static_cast<float>(v));
        if (distance_px > kSaysNothing) images.push_back({distance_px, k, u, v, x});
    }
    // The farthest first, those that do not count left out.
    const size_t left_out = std::min(static_cast<size_t>(misses), images.empty() ? 0 : images.size() - 1), wanted = std::min(images.size(), left_out + most);
    std::partial_sort(images.begin(), images.begin() + static_cast<long>(wanted), images.end(),
                      [](const Image& a, const Image& b) { return a.distance_px != b.distance_px ? a.distance_px > b.distance_px : a.view < b.view; });
    std::vector<Support> out;
    for (size_t i = left_out; i < wanted && images[i].distance_px >= images[left_out].distance_px - reach_px; ++i) {
        const auto& [distance_px, k, u, v, x] = images[i];
        const OrbitCamera& c = cameras[k];
        float g[2];
        Support s;
        s.view = static_cast<int>(k);
        s.distance_px = distance_px;
        Lookup(views[k]).distance(static_cast<float>(u), static_cast<float>(v), g);
        // Image position by a step of the point in the camera's frame.
        const Vec3d by_x(g[0] * c.fx / x.z(), g[1] * c.fx * c.aspect / x.z(), -(g[0] * (u - c.cx) + g[1] * (v - c.cy)) / x.z());
        const Vec3d by_world = c.camera_from_world.transpose() * by_x, turn = x.cross(by_x);  // R <- exp(w) R moves x by w cross x
        s.slope = by_world.dot(along);
        // The line of sight moves with its own camera: position = c + t R^T m.
        const Vec3d in_own = own.camera_from_world * by_world, own_turn = in_own.cross(touch.depth * m);  // R <- exp(w) R moves t R^T m by R^T (t m cross w)
        for (int a = 0; a < 3; ++a) {
            s.by_view[kTurn + a] = turn[a];
            s.by_view[kCentre + a] = -by_world[a];
            s.by_own[kTurn + a] = own_turn[a];
            s.by_own[kCentre + a] = by_world[a];
        }
        s.by_view[kLnFocal] = g[0] * (u - c.cx) + g[1] * (v - c.cy);
        s.by_view[kCentreX] = g[0];
        s.by_view[kCentreY] = g[1];
        s.by_own[kLnFocal] = -touch.depth * (in_own.x() * m.x() + in_own.y() * m.y());
        s.by_own[kCentreX] = -touch.depth * in_own.x() / own.fx;
        s.by_own[kCentreY] = -touch.depth * in_own.y() / (own.fx * own.aspect);
        out.push_back(s);
    }
    return out;
}

Minimax minimax(const double* values, const double* slopes, size_t count, double reach) {
    Minimax out;
    size_t top = 0;
    for (size_t k = 1; k < count; ++k)
        if (values[k] > values[top]) top = k;
    // Down the upper envelope, which is convex, from one line to the next.
    size_t other = count;
    for (size_t turns = 0; turns < count; ++turns) {
        const double down = slopes[top] > 0 ? -1 : 1, steep = slopes[top] * down;
        double nearest = down * reach;
        other = count;
        for (size_t k = 0; k < count; ++k) {
            const double rises = slopes[k] * down - steep;
            if (k == top || rises <= 1e-12) continue;
            const double gap = (values[top] + slopes[top] * out.t) - (values[k] + slopes[k] * out.t);
            const double crossing = out.t + down * std::max(gap, 0.0) / rises;
            if ((crossing - nearest) * down < 0) nearest = crossing, other = k;
        }
        out.t = nearest;
        if (other == count || slopes[other] * down >= 0) break;
        top = other;
    }
    out.first = out.second = top;
    if (other < count && slopes[top] * slopes[other] < 0) {
        out.second = other;
        out.share = slopes[other] / (slopes[other] - slopes[top]);
    }
    return out;
}

}  // namespace vdbcarve
