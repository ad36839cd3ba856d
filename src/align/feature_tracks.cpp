// SPDX-License-Identifier: Apache-2.0
#include "align/feature_tracks.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <numeric>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "image/opencv_image.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

constexpr int kMostFeatures = 3000;       ///< of a view, the strongest
constexpr double kLeastContrast = 0.012;  ///< a third of what is usual: faint texture is texture, and what it gets wrong the epipolar test sees
constexpr double kRatio = 0.8;            ///< Lowe's: the best match must be so much nearer than the next
constexpr double kEpipolar_px = 2.0;

struct Features {
    std::vector<cv::KeyPoint> points;
    cv::Mat descriptors;
    double scale = 1;  ///< pixels of the photograph to one of the picture that features were found in
};

Features features_of(const View& view, const MaskView& mask) {
    Features out;
    if (view.image_path.empty() || mask.coverage.empty()) return out;
    const Image8 photo = io::read_grey(view.image_path, view.orientation, view.camera.intrinsics, view.lens);
    if (photo.width != mask.coverage.width || photo.height != mask.coverage.height) return out;
    // Away from the contour, whose look changes with what is behind.
    cv::Mat inside;
    cv::threshold(io::wrap(mask.coverage), inside, 254, 255, cv::THRESH_BINARY);
    cv::Mat picture = io::wrap(photo.view());
    const int longest = std::max(picture.cols, picture.rows);
    if (longest > 2000) {
        out.scale = longest / 1600.0;
        cv::resize(picture, picture, {}, 1 / out.scale, 1 / out.scale, cv::INTER_AREA);
        cv::resize(inside, inside, picture.size(), 0, 0, cv::INTER_NEAREST);
    }
    cv::erode(inside, inside, cv::getStructuringElement(cv::MORPH_ELLIPSE, {9, 9}));
    cv::SIFT::create(kMostFeatures, 3, kLeastContrast)->detectAndCompute(picture, inside, out.points, out.descriptors);
    return out;
}

/// Matches that are each other's best and follow one epipolar geometry.
std::vector<std::pair<int, int>> matches_of(const Features& a, const Features& b) {
    if (a.points.size() < 8 || b.points.size() < 8) return {};
    const cv::BFMatcher matcher(cv::NORM_L2);
    std::vector<std::vector<cv::DMatch>> there, back;
    matcher.knnMatch(a.descriptors, b.descriptors, there, 2);
    matcher.knnMatch(b.descriptors, a.descriptors, back, 1);
    std::vector<std::pair<int, int>> out;
    std::vector<cv::Point2f> p, q;
    for (const auto& m : there) {
        if (m.size() < 2 || m[0].distance > kRatio * m[1].distance) continue;
        if (back[static_cast<size_t>(m[0].trainIdx)].empty() || back[static_cast<size_t>(m[0].trainIdx)][0].trainIdx != m[0].queryIdx) continue;
        out.emplace_back(m[0].queryIdx, m[0].trainIdx);
        p.push_back(a.points[static_cast<size_t>(m[0].queryIdx)].pt);
        q.push_back(b.points[static_cast<size_t>(m[0].trainIdx)].pt);
    }
    if (out.size() < 12) return {};
    std::vector<uchar> good;
    cv::findFundamentalMat(p, q, cv::FM_RANSAC, kEpipolar_px, 0.999, good);
    std::vector<std::pair<int, int>> kept;
    for (size_t k = 0; k < good.size() && k < out.size(); ++k)
        if (good[k]) kept.push_back(out[k]);
    if (kept.size() < 10) kept.clear();
    return kept;
}

}  // namespace

std::vector<FeatureTrack> find_tracks(const Views& views, const std::vector<MaskView>& masks, const std::vector<std::pair<size_t, size_t>>& pairs,
                                      Progress& progress) {
    const size_t n = views.views.size();
    std::vector<Features> features(n);
    tbb::parallel_for(size_t{0}, n, [&](size_t i) {
        progress.check();
        try {
            features[i] = features_of(views.views[i], masks[i]);
        } catch (const cv::Exception& e) {
            throw InputError(views.views[i].image_path.string() + ": no features can be found in it: " + e.what() + ". Remedy: --no-features");
        }
    });
    std::vector<std::vector<std::pair<int, int>>> matches(pairs.size());
    tbb::parallel_for(size_t{0}, pairs.size(), [&](size_t k) {
        progress.check();
        matches[k] = matches_of(features[pairs[k].first], features[pairs[k].second]);
    });
    // Chained by union of what matches.
    std::vector<size_t> first(n + 1, 0);
    for (size_t i = 0; i < n; ++i) first[i + 1] = first[i] + features[i].points.size();
    std::vector<size_t> parent(first[n]);
    std::iota(parent.begin(), parent.end(), size_t{0});
    const auto root = [&](size_t x) {
        while (parent[x] != x) x = parent[x] = parent[parent[x]];
        return x;
    };
    for (size_t k = 0; k < pairs.size(); ++k)
        for (const auto& [a, b] : matches[k]) {
            const size_t x = root(first[pairs[k].first] + static_cast<size_t>(a)), y = root(first[pairs[k].second] + static_cast<size_t>(b));
            parent[std::max(x, y)] = std::min(x, y);
        }
    std::vector<FeatureTrack> by_root(parent.size());
    for (size_t i = 0; i < n; ++i)
        for (size_t f = 0; f < features[i].points.size(); ++f) {
            const cv::Point2f at = features[i].points[f].pt;
            // OpenCV counts from the first pixel's centre, in the smaller picture too.
            const double s = features[i].scale;
            by_root[root(first[i] + f)].sightings.push_back({static_cast<int>(i), static_cast<float>((at.x + 0.5) * s), static_cast<float>((at.y + 0.5) * s)});
        }
    std::vector<FeatureTrack> out;
    for (FeatureTrack& t : by_root) {
        if (t.sightings.size() < 2) continue;
        bool twice = false;
        for (size_t k = 1; k < t.sightings.size(); ++k) twice |= t.sightings[k].view == t.sightings[k - 1].view;
        if (!twice) out.push_back(std::move(t));
    }
    return out;
}

}  // namespace vdbcarve
