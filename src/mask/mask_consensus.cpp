// SPDX-License-Identifier: Apache-2.0
#include "mask/mask_consensus.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "surface/coarse_hull.h"
#include "image/opencv_image.h"
#include "base/statistics.h"
#include "base/text.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/kernel/distance.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {
namespace {

/// The longer side of what is object, pixels.
double size_of(ImageView<uint8_t> coverage) {
    int x0 = coverage.width, x1 = -1, y0 = coverage.height, y1 = -1;
    for (int y = 0; y < coverage.height; ++y)
        for (int x = 0; x < coverage.width; ++x)
            if (coverage.at(x, y) >= 128) x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
    return x1 < 0 ? 0 : std::max(x1 - x0, y1 - y0) + 1;
}

/// Median angle from a camera to the farther one of its two neighbours, seen from the middle of what they look at.
double step_between(const std::vector<Camera>& cameras, const Vec3d& middle) {
    std::vector<double> steps;
    for (const Camera& a : cameras) {
        std::array<double, 2> nearest{std::numbers::pi / 2, std::numbers::pi / 2};
        for (const Camera& b : cameras) {
            if (&a == &b) continue;
            const double apart = std::acos(std::clamp((a.centre_world() - middle).normalized().dot((b.centre_world() - middle).normalized()), -1.0, 1.0));
            if (apart < 1e-3 || apart >= nearest[1]) continue;
            nearest[1] = apart;
            std::sort(nearest.begin(), nearest.end());
        }
        steps.push_back(nearest[1]);
    }
    return median(steps);
}

}  // namespace

std::vector<Consensus> consensus_of(const std::vector<std::string>& names, const std::vector<Camera>& cameras, const std::vector<MaskView>& trusted,
                                    const std::vector<MaskView>& asked, int max_misses, Progress& progress) {
    std::vector<Camera> seeing;
    std::vector<double> sizes;
    for (size_t i = 0; i < trusted.size(); ++i) {
        if (trusted[i].coverage.empty()) continue;
        seeing.push_back(cameras[i]);
        sizes.push_back(size_of(trusted[i].coverage));
    }
    const double size_px = std::max(1.0, median(sizes));
    const Mesh hull = extract_mesh(*coarse_hull(names, cameras, trusted, 96, 0.6, progress, max_misses), {}, progress);
    Box3d box;
    for (const auto& v : hull.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    // Without one view the hull bulges between its neighbours, the more the farther they are apart: a round object of radius R by R (1 / cos(half their angle)
    // - 1).
    const double gap_rad = std::min(0.5 * (max_misses + 1) * step_between(seeing, box.center()), 1.2);
    const double deep = 0.03 + 0.75 * (1 / std::cos(gap_rad) - 1), far = 0.03;
    std::vector<Consensus> out(asked.size());
    tbb::parallel_for(size_t{0}, asked.size(), [&](size_t i) {
        if (asked[i].coverage.empty()) return;
        Consensus& c = out[i];
        c.factor = std::min(1.0, 250 / size_px);
        const Camera camera = scaled(cameras[i], c.factor);
        const int width = camera.intrinsics.width_px, height = camera.intrinsics.height_px;
        c.hull = silhouette_of(hull, camera);
        const Image8 mask = io::downscale(asked[i].coverage, width, height);
        const Image8 ignore = asked[i].ignore.empty() ? Image8() : io::downscale(asked[i].ignore, width, height);
        const int reach = static_cast<int>(std::ceil(std::max(deep, far) * c.factor * size_px)) + 2;
        const ImageF to_mask = signed_distance(mask, std::min(reach, kernel::kMaxReach_px)),
                     to_hull = signed_distance(c.hull, std::min(reach, kernel::kMaxReach_px));
        c.carved = c.extra = Image8(width, height);
        // An object that is small in the picture counts as one of 250 pixels.
        const double weight = std::pow(250 / (c.factor * size_px), 2);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                if (!ignore.empty() && ignore.at(x, y)) continue;
                if (c.hull.at(x, y) && to_mask.at(x, y) > deep * c.factor * size_px) c.carved.at(x, y) = 255, c.carved_px += weight;
                if (mask.at(x, y) >= 128 && to_hull.at(x, y) > far * c.factor * size_px) c.extra.at(x, y) = 255, c.extra_px += weight;
            }
    });
    return out;
}

std::vector<size_t> find_broken_masks(const std::vector<std::string>& names, const std::vector<Camera>& cameras, std::vector<MaskView> masks,
                                      Progress& progress) {
    std::vector<size_t> broken;
    const auto asked = static_cast<size_t>(std::count_if(masks.begin(), masks.end(), [](const MaskView& m) { return !m.coverage.empty(); }));
    if (asked < 8) return broken;  // too few to outvote anybody
    while (4 * (broken.size() + 1) <= asked) {
        const int misses = asked >= 16 ? 2 : 1;
        std::vector<Consensus> said;
        try {
            Progress quiet;
            said = consensus_of(names, cameras, masks, masks, misses, quiet);
        } catch (const Interrupted&) {
            throw;
        } catch (const Error&) {
            break;  // there is no hull to compare with: carving says why
        }
        progress.check();
        const auto weight = [](const Consensus& c) { return std::max(c.carved_px, c.extra_px); };
        const auto worst = static_cast<size_t>(
            std::max_element(said.begin(), said.end(), [&](const Consensus& a, const Consensus& b) { return weight(a) < weight(b); }) - said.begin());
        if (!said[worst].broken()) break;
        masks[worst] = {};
        broken.push_back(worst);
    }
    std::sort(broken.begin(), broken.end());
    return broken;
}

std::vector<std::string> repair_masks(const std::vector<std::string>& names, const std::vector<Camera>& cameras, std::vector<Mask>& masks,
                                      const std::vector<size_t>& broken, const std::function<Image8(size_t)>& photo_of, Progress& progress) {
    std::vector<MaskView> trusted(masks.size()), asked(masks.size());
    for (size_t i = 0; i < masks.size(); ++i) (std::count(broken.begin(), broken.end(), i) ? asked : trusted)[i] = view_of(masks[i]);
    const std::vector<Consensus> said = consensus_of(names, cameras, trusted, asked, 0, progress);
    std::vector<std::string> out(broken.size());
    tbb::parallel_for(size_t{0}, broken.size(), [&](size_t b) {
        const size_t i = broken[b];
        Mask& mask = masks[i];
        const Consensus& c = said[i];
        const int width = mask.coverage.width, height = mask.coverage.height;
        const auto at_full_size = [&](const Image8& small) {
            cv::Mat full;
            cv::resize(io::wrap(small.view()), full, {width, height}, 0, 0, cv::INTER_LINEAR);
            return cv::Mat(full >= 128);
        };
        const double size_px = size_of(c.hull) / c.factor, margin_px = 0.02 * size_px;
        const cv::Mat hull = at_full_size(c.hull), own = io::wrap(mask.coverage.view()) >= 128;
        cv::Mat to_hull, in_own;
        cv::distanceTransform(hull == 0, to_hull, cv::DIST_L2, cv::DIST_MASK_PRECISE);
        cv::distanceTransform(own, in_own, cv::DIST_L2, cv::DIST_MASK_PRECISE);
        // Where mask and hull disagree by more than hulls bulge, with some room around: what is farther away stays as it is.
        cv::Mat contested = at_full_size(c.carved) | at_full_size(c.extra);
        const int room = std::max(2, static_cast<int>(std::lround((1 / c.factor) + 0.1 * size_px)));
        cv::dilate(contested, contested, cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * room + 1, 2 * room + 1}));
        const Image8 photo = photo_of(i);
        if (photo.channels >= 3) {
            Image8 seed(width, height);
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x) {
                    const bool in_hull = hull.at<uint8_t>(y, x) != 0, mine = own.at<uint8_t>(y, x) != 0;
                    uint8_t& s = seed.at(x, y);
                    if (to_hull.at<float>(y, x) > static_cast<float>(margin_px)) s = 0;
                    else if (in_hull && mine && in_own.at<float>(y, x) > static_cast<float>(margin_px)) s = 255;
                    else s = in_hull ? 160 : 96;
                }
            const Mask cut = grabcut_mask(photo, seed, {}, {});
            size_t changed = 0;
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x) {
                    if (!contested.at<uint8_t>(y, x)) continue;
                    changed += (mask.coverage.at(x, y) >= 128) != (cut.coverage.at(x, y) >= 128);
                    mask.coverage.at(x, y) = cut.coverage.at(x, y);
                }
            out[b] = text_of("%s (%zu pixels by its photograph)", names[i].c_str(), changed);
            return;
        }
        if (mask.ignore.empty()) mask.ignore = Image8(width, height);
        size_t ignored = 0;
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                if (!contested.at<uint8_t>(y, x)) continue;
                if (to_hull.at<float>(y, x) > static_cast<float>(margin_px)) {
                    mask.coverage.at(x, y) = 0;
                } else if ((hull.at<uint8_t>(y, x) != 0) != (mask.coverage.at(x, y) >= 128)) {
                    mask.ignore.at(x, y) = 255;
                    ++ignored;
                }
            }
        out[b] = text_of("%s (%zu pixels ignored)", names[i].c_str(), ignored);
    });
    return out;
}

}  // namespace vdbcarve
