// SPDX-License-Identifier: Apache-2.0
#include "surface/floor.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "image/opencv_image.h"
#include "base/angles.h"
#include "base/statistics.h"
#include "base/text.h"

#include <opencv2/imgproc.hpp>

namespace vdbcarve {
namespace {

constexpr int kSide = 64;       ///< samples across the piece of table that is looked at
constexpr double kReach = 1.3;  ///< half its side, in radii of the object about its axis
constexpr int kPhoto_px = 800;  ///< longer side of the photographs it is looked at in
constexpr double kWidestPair_deg = 35, kNarrowestPair_deg = 4;
constexpr size_t kLeastShared = 150;  ///< samples that both views of a pair see beside the object
constexpr size_t kLeastPairs = 3;
constexpr double kLikeness = 0.3, kAhead = 0.1;  ///< a plane stands out when its likeness is more than the first, and the next best is so far behind
constexpr int kSteps = 90;

struct Picture {
    cv::Mat grey;      ///< float, without its slow changes
    cv::Mat outside;   ///< 255 beside the object, with a margin
    double scale = 0;  ///< of the photograph
};

/// What a view sees of a plane: values, and where it sees any.
struct Sight {
    std::vector<float> value;
    std::vector<uint8_t> seen;
};

/// Correlation of what both see; NaN where that is too little.
double likeness(const Sight& a, const Sight& b) {
    double n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
    for (size_t i = 0; i < a.value.size(); ++i) {
        if (!a.seen[i] || !b.seen[i]) continue;
        const double x = a.value[i], y = b.value[i];
        ++n, sa += x, sb += y, saa += x * x, sbb += y * y, sab += x * y;
    }
    if (n < static_cast<double>(kLeastShared)) return std::nan("");
    const double va = saa - sa * sa / n, vb = sbb - sb * sb / n, flat = n * 0.5;  // half a grey level of noise is no pattern
    if (va < flat || vb < flat) return 0;
    return (sab - sa * sb / n) / std::sqrt(va * vb);
}

/// Of what lies inside the hull.
Box3d box_of_inside(const openvdb::FloatGrid& hull) {
    Box3d box;
    for (auto leaf = hull.tree().cbeginLeaf(); leaf; ++leaf)
        for (auto v = leaf->cbeginValueOn(); v; ++v)
            if (*v < 0) {
                const openvdb::Vec3d x = hull.indexToWorld(v.getCoord());
                box.extend(Vec3d(x.x(), x.y(), x.z()));
            }
    return box;
}

/// A photograph, small and without its slow changes, and what of it is beside the object.
Picture picture_of(const Image8& photo, const MaskView& mask) {
    Picture p;
    p.scale = std::min(1.0, static_cast<double>(kPhoto_px) / std::max(photo.width, photo.height));
    cv::Mat grey = io::wrap(photo.view()), small, slow, object;
    if (photo.channels > 1) cv::cvtColor(io::wrap(photo.view()), grey, photo.channels == 4 ? cv::COLOR_RGBA2GRAY : cv::COLOR_RGB2GRAY);
    cv::resize(grey, small, cv::Size(), p.scale, p.scale, cv::INTER_AREA);
    small.convertTo(p.grey, CV_32F);
    cv::blur(p.grey, slow, cv::Size(61, 61));
    p.grey -= slow;
    cv::GaussianBlur(p.grey, p.grey, cv::Size(), 1.0);
    cv::resize(io::wrap(mask.coverage), object, small.size(), 0, 0, cv::INTER_AREA);
    cv::dilate(object, object, cv::getStructuringElement(cv::MORPH_ELLIPSE, {7, 7}));
    p.outside = object < 8;
    return p;
}

/// Views beside each other, whose pictures compare.
std::vector<std::pair<size_t, size_t>> neighbours(const std::vector<Camera>& cameras, const std::vector<Picture>& pictures, const Vec3d& middle,
                                                  const Vec3d& up) {
    const std::vector<double> azimuth = azimuths_rad(cameras, middle, up);
    std::vector<std::pair<size_t, size_t>> pairs;
    for (size_t i = 0; i < cameras.size(); ++i)
        for (size_t j = i + 1; j < cameras.size(); ++j) {
            const double apart = std::fabs(std::remainder(azimuth[i] - azimuth[j], 2 * std::numbers::pi)) / kRadians;
            if (pictures[i].scale > 0 && pictures[j].scale > 0 && apart < kWidestPair_deg && apart > kNarrowestPair_deg) pairs.emplace_back(i, j);
        }
    return pairs;
}

}  // namespace

std::optional<Floor> find_table(const openvdb::FloatGrid& hull, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks,
                                const std::function<Image8(size_t)>& photo_of, const Vec3d& up, Progress& progress) {
    // The object's axis, radius and height.
    const Box3d box = box_of_inside(hull);
    if (box.isEmpty()) return std::nullopt;
    const Vec3d middle = box.center(), side = up.unitOrthogonal(), across = up.cross(side);
    const Vec3d half = 0.5 * box.sizes();
    const double half_height = half.dot(up.cwiseAbs()), radius = std::max(half.dot(side.cwiseAbs()), half.dot(across.cwiseAbs()));
    const double lowest = middle.dot(up) - half_height, height = 2 * half_height;

    std::vector<Picture> pictures(cameras.size());
    progress.begin("floor", cameras.size());
    tbb::parallel_for(size_t{0}, cameras.size(), [&](size_t i) {
        progress.step();
        if (masks[i].coverage.empty() || cameras[i].intrinsics.orthographic) return;
        const Image8 photo = photo_of(i);
        if (!photo.empty()) pictures[i] = picture_of(photo, masks[i]);
    });

    const std::vector<std::pair<size_t, size_t>> pairs = neighbours(cameras, pictures, middle, up);
    if (pairs.size() < kLeastPairs) return std::nullopt;

    const auto sight_of = [&](size_t view, double at) {
        Sight out{std::vector<float>(kSide * kSide), std::vector<uint8_t>(kSide * kSide)};
        const Picture& p = pictures[view];
        const Vec3d centre = middle + (at - middle.dot(up)) * up;
        if (p.scale <= 0 || (cameras[view].centre_world() - centre).dot(up) < 0.02 * radius) return out;  // it looks from below, or along it
        for (int r = 0; r < kSide; ++r)
            for (int c = 0; c < kSide; ++c) {
                const double u = (2 * (c + 0.5) / kSide - 1) * kReach * radius, v = (2 * (r + 0.5) / kSide - 1) * kReach * radius;
                const auto pixel = cameras[view].project(centre + u * side + v * across);
                if (!pixel) continue;
                const double x = pixel->x() * p.scale - 0.5, y = pixel->y() * p.scale - 0.5;
                const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
                if (x0 < 0 || y0 < 0 || x0 + 1 >= p.grey.cols || y0 + 1 >= p.grey.rows || !p.outside.at<uint8_t>(y0, x0)) continue;
                const auto fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
                const float *a = p.grey.ptr<float>(y0) + x0, *b = p.grey.ptr<float>(y0 + 1) + x0;
                const auto n = static_cast<size_t>(r * kSide + c);
                out.value[n] = (1 - fy) * ((1 - fx) * a[0] + fx * a[1]) + fy * ((1 - fx) * b[0] + fx * b[1]);
                out.seen[n] = 1;
            }
        return out;
    };
    const auto score = [&](double at) {
        std::vector<Sight> sights;
        for (size_t i = 0; i < cameras.size(); ++i) sights.push_back(sight_of(i, at));
        std::vector<double> all;
        for (const auto& [i, j] : pairs)
            if (const double l = likeness(sights[i], sights[j]); !std::isnan(l)) all.push_back(l);
        return all.size() < kLeastPairs ? 0.0 : median(all);
    };
    const double from = lowest - 0.3 * height, step = 1.2 * height / kSteps;
    std::vector<double> scores(kSteps + 1);
    tbb::parallel_for(0, kSteps + 1, [&](int s) { scores[static_cast<size_t>(s)] = score(from + s * step); });
    const auto best = static_cast<int>(std::max_element(scores.begin(), scores.end()) - scores.begin());
    Floor out;
    for (int s = 0; s <= kSteps; ++s)
        if (std::abs(s - best) > 6) out.next_best = std::max(out.next_best, scores[static_cast<size_t>(s)]);
    // To a thousandth of the height.
    const int finer = static_cast<int>(std::ceil(2 * step / (1e-3 * height)));
    std::vector<double> fine(static_cast<size_t>(finer) + 1);
    const double first = from + (best - 1) * step;
    tbb::parallel_for(0, finer + 1, [&](int s) { fine[static_cast<size_t>(s)] = score(first + 2 * step * s / finer); });
    const auto peak = static_cast<int>(std::max_element(fine.begin(), fine.end()) - fine.begin());
    out.height = first + 2 * step * peak / finer;
    out.likeness = fine[static_cast<size_t>(peak)];
    progress.detail(text_of("floor: %.5g, likeness %.3f, elsewhere %.3f, from %zu pairs of views", out.height, out.likeness, out.next_best, pairs.size()));
    if (out.likeness < kLikeness || out.likeness < out.next_best + kAhead) return std::nullopt;
    return out;
}

}  // namespace vdbcarve
