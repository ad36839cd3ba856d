// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/caps.h"

#include <openvdb/tools/Interpolation.h>
#include <openvdb/tree/LeafManager.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "surface/filter_plan.h"
#include "volume/inside_tiles.h"
#include "surface/redistance.h"
#include "base/statistics.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

using Leaf = openvdb::FloatTree::LeafNodeType;
using openvdb::Coord;

/// The object's middle: that of its leaves.
Vec3d middle_of(const openvdb::FloatGrid& surface, double& radius) {
    openvdb::CoordBBox box;
    surface.tree().evalLeafBoundingBox(box);
    const openvdb::Vec3d lo = surface.indexToWorld(box.min().asVec3d()), hi = surface.indexToWorld(box.max().asVec3d());
    radius = 0.5 * (hi - lo).length();
    const openvdb::Vec3d c = 0.5 * (lo + hi);
    return {c.x(), c.y(), c.z()};
}

struct Range {
    double low = std::numeric_limits<double>::infinity(), high = -std::numeric_limits<double>::infinity();
    bool any() const { return low <= high; }
};

/// Heights at which a line of sight is within half a voxel of the inside.
Range heights_inside(const openvdb::FloatGrid& surface, const Camera::Ray& ray, const Vec3d& axis, const Vec3d& middle, double radius) {
    using Sampler = openvdb::tools::GridSampler<openvdb::FloatGrid::ConstAccessor, openvdb::tools::BoxSampler>;
    openvdb::FloatGrid::ConstAccessor access = surface.getConstAccessor();
    const Sampler sampler(access, surface.transform());
    const double voxel = surface.voxelSize()[0], along = (middle - ray.origin).dot(ray.direction);
    Range out;
    for (double t = along - radius; t < along + radius; t += 0.5 * voxel) {
        const Vec3d x = ray.origin + t * ray.direction;
        if (sampler.wsSample(openvdb::Vec3d(x.x(), x.y(), x.z())) > 0.5 * voxel) continue;
        out.low = std::min(out.low, x.dot(axis));
        out.high = std::max(out.high, x.dot(axis));
    }
    return out;
}

}  // namespace

Vec3d orbit_axis(const std::vector<Camera>& cameras) {
    Vec3d mean = Vec3d::Zero(), forward = Vec3d::Zero();
    for (const Camera& c : cameras) {
        mean += c.centre_world() / static_cast<double>(cameras.size());
        forward += c.forward_world();
    }
    Mat3d spread = Mat3d::Zero();
    for (const Camera& c : cameras) {
        const Vec3d d = c.centre_world() - mean;
        spread += d * d.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Mat3d> solver(spread);
    Vec3d axis = solver.eigenvectors().col(0);
    if (axis.dot(forward) > 0) axis = -axis;
    return axis;
}

Vec3d up_direction(const std::string& up, const std::vector<Camera>& cameras) {
    if (up.empty()) return orbit_axis(cameras);
    return (up.front() == '-' ? -1.0 : 1.0) * Vec3d::Unit(up.back() - 'x');
}

SeenExtent seen_extent(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras, const std::vector<MaskView>& masks, const Vec3d& axis) {
    double radius = 0;
    const Vec3d middle = middle_of(surface, radius);
    std::vector<Range> tops(cameras.size()), bottoms(cameras.size());
    tbb::parallel_for(size_t{0}, cameras.size(), [&](size_t v) {
        const auto& mask = masks[v].coverage;
        if (mask.empty()) return;
        const auto a = cameras[v].project(middle - 1e-3 * radius * axis), b = cameras[v].project(middle + 1e-3 * radius * axis);
        if (!a || !b || (*b - *a).norm() == 0) return;
        const Vec2d up = (*b - *a).normalized();
        struct End {
            double height = -std::numeric_limits<double>::infinity();
            int x = 0, y = 0;
        } ends[2];
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x) {
                if (mask.at(x, y) < 128) continue;
                const double h = x * up.x() + y * up.y();
                if (h > ends[0].height) ends[0] = {h, x, y};
                if (-h > ends[1].height) ends[1] = {-h, x, y};
            }
        for (int e = 0; e < 2; ++e) {
            const End& end = ends[e];
            if (!std::isfinite(end.height) || end.x == 0 || end.y == 0 || end.x == mask.width - 1 || end.y == mask.height - 1) continue;  // cut by the frame
            (e == 0 ? tops : bottoms)[v] = heights_inside(surface, cameras[v].ray(Vec2d(end.x + 0.5, end.y + 0.5)), axis, middle, radius);
        }
    });
    SeenExtent out;
    for (size_t v = 0; v < cameras.size(); ++v) {
        if (tops[v].any() && (!out.top_seen || tops[v].low > out.highest)) {
            out.top_seen = true;
            out.highest = tops[v].low;
        }
        if (bottoms[v].any() && (!out.bottom_seen || bottoms[v].high < out.lowest)) {
            out.bottom_seen = true;
            out.lowest = bottoms[v].high;
        }
    }
    return out;
}

Extrapolation mark_extrapolated(Mesh& mesh, const std::vector<Camera>& cameras, const SeenExtent& seen, const Vec3d& axis, double tolerance) {
    const auto normals = mesh.normals.empty() ? vertex_normals(mesh) : mesh.normals;
    const auto point = [&](size_t v) { return Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
    enum : uint8_t { kSeen, kCapped, kUnseen };
    std::vector<uint8_t> kind(mesh.vertices.size(), kSeen);
    std::vector<Vec3d> centres, forwards;
    for (const Camera& c : cameras) {
        centres.push_back(c.centre_world());
        forwards.push_back(c.forward_world());
    }
    tbb::parallel_for(tbb::blocked_range<size_t>(0, mesh.vertices.size(), 4096), [&](const tbb::blocked_range<size_t>& range) {
        for (size_t v = range.begin(); v < range.end(); ++v) {
            const Vec3d x = point(v), n(normals[v][0], normals[v][1], normals[v][2]);
            const double h = x.dot(axis);
            if ((seen.top_seen && h > seen.highest + tolerance) || (seen.bottom_seen && h < seen.lowest - tolerance)) {
                kind[v] = kCapped;
                continue;
            }
            bool faced = false;
            for (size_t c = 0; c < cameras.size() && !faced; ++c) {
                const Intrinsics& k = cameras[c].intrinsics;
                if (!((k.orthographic ? Vec3d(-forwards[c]) : Vec3d(centres[c] - x)).dot(n) > 0)) continue;
                const auto p = cameras[c].project(x);
                faced = p && p->x() >= 0 && p->y() >= 0 && p->x() <= k.width_px && p->y() <= k.height_px;
            }
            if (!faced) kind[v] = kUnseen;
        }
    });
    Extrapolation out;
    mesh.extrapolated.resize(mesh.vertices.size());
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
        mesh.extrapolated[v] = kind[v] != kSeen;
        const double h = point(v).dot(axis);
        if (seen.top_seen) out.top_beyond = std::max(out.top_beyond, h - seen.highest);
        if (seen.bottom_seen) out.bottom_beyond = std::max(out.bottom_beyond, seen.lowest - h);
    }
    double all = 0;
    for (const auto& t : mesh.triangles) {
        const Vec3d a = point(t[0]);
        const double third = (point(t[1]) - a).cross(point(t[2]) - a).norm() / 3;
        for (uint32_t v : t) {
            all += third;
            if (kind[v] == kCapped) out.capped_share += third;
            if (kind[v] == kUnseen) out.unseen_share += third;
        }
    }
    if (all > 0) {
        out.capped_share /= all;
        out.unseen_share /= all;
    }
    return out;
}

namespace {

/// Tiles inside become leaves, or tiles outside, block by block of a leaf's size, as `judge` says of a block's origin.
enum class Block { Stays, Opened, Outside };
template <class Judge>
void open_inside_tiles(openvdb::FloatGrid& surface, const Judge& judge) {
    struct Tile {
        Coord origin;
        int side;
    };
    std::vector<Tile> tiles;
    for_inside_tiles(surface.tree(), [&](const Coord& origin, int side) { tiles.push_back({origin, side}); });
    for (const Tile& t : tiles)
        for (int i = 0; i < t.side; i += 8)
            for (int j = 0; j < t.side; j += 8)
                for (int k = 0; k < t.side; k += 8) {
                    const Coord c = t.origin.offsetBy(i, j, k);
                    const Block block = judge(c);
                    if (block == Block::Outside) surface.tree().addTile(1, c, surface.background(), false);
                    else if (block == Block::Opened) surface.tree().touchLeaf(c);
                }
}

}  // namespace

double slope_of_views(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras, const Vec3d& up, double height) {
    std::vector<double> slopes;
    double radius = 0;
    const Vec3d middle = middle_of(surface, radius);
    for (const Camera& c : cameras) {
        const Vec3d from = c.centre_world() - middle;
        const double above = c.centre_world().dot(up) - height, beside = (from - from.dot(up) * up).norm();
        if (above > 0) slopes.push_back(above / std::max(beside, 1e-9));
    }
    return percentile(slopes, 1.0 / 3);
}

openvdb::FloatGrid::Ptr clear_floor(openvdb::FloatGrid::Ptr surface, const Vec3d& up, double height, double clear, double slope, Progress& progress) {
    // Reads better whole: everything counts in the same layers and columns of the grid.
    int axis = 0;
    if (up.cwiseAbs().maxCoeff(&axis) < 1 - 1e-9) throw InputError("the floor can be cleared along an axis of the world only");
    const int u = (axis + 1) % 3, v = (axis + 2) % 3, upwards = up[axis] > 0 ? 1 : -1;
    const double voxel = surface->voxelSize()[0];
    const float band = surface->background();
    // The first layer whose centres are above the floor, and not just on it, where a sign is an accident.
    openvdb::Vec3d at(0.0);
    at[axis] = height * up[axis];
    const double exact = surface->worldToIndex(at)[axis];
    const int lowest = static_cast<int>(upwards > 0 ? std::ceil(exact + 0.05) : std::floor(exact - 0.05));
    const openvdb::CoordBBox box = surface->evalActiveVoxelBoundingBox();
    const int width = box.dim()[u] + 2, depth = box.dim()[v] + 2;
    const auto coord = [&](int i, int j, int layers) {
        Coord c;
        c[u] = box.min()[u] - 1 + i;
        c[v] = box.min()[v] - 1 + j;
        c[axis] = lowest + upwards * layers;
        return c;
    };
    // How many layers stand on the floor without a gap; more than can be of a mound is all the same.
    const int most = static_cast<int>(std::ceil((clear + slope * 0.5 * std::max(width, depth) * voxel) / voxel)) + 2;
    cv::Mat standing(depth, width, CV_32S), foot(depth, width, CV_8U);
    tbb::parallel_for(0, depth, [&](int j) {
        openvdb::FloatGrid::ConstAccessor values = surface->getConstAccessor();
        for (int i = 0; i < width; ++i) {
            int n = 0;
            while (n <= most && values.getValue(coord(i, j, n)) < 0) ++n;
            standing.at<int>(j, i) = n;
            foot.at<uint8_t>(j, i) = n > 0 ? 255 : 0;
        }
    });
    cv::Mat from_border;
    cv::distanceTransform(foot, from_border, cv::DIST_L2, cv::DIST_MASK_PRECISE);
    // From the borders inwards.
    cv::Mat gone = cv::Mat::zeros(depth, width, CV_8U);
    std::vector<std::pair<int, int>> front;
    const auto flat = [&](int i, int j) {
        return foot.at<uint8_t>(j, i) && standing.at<int>(j, i) * voxel <= clear + slope * (from_border.at<float>(j, i) + 1) * voxel;
    };
    const auto take = [&](int i, int j) {
        if (i < 0 || j < 0 || i >= width || j >= depth || gone.at<uint8_t>(j, i) || !flat(i, j)) return;
        gone.at<uint8_t>(j, i) = 255;
        front.emplace_back(i, j);
    };
    for (int j = 0; j < depth; ++j)
        for (int i = 0; i < width; ++i)
            if (from_border.at<float>(j, i) > 0 && from_border.at<float>(j, i) < 1.5F) take(i, j);
    while (!front.empty()) {
        const auto [i, j] = front.back();
        front.pop_back();
        for (const auto& [di, dj] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) take(i + di, j + dj);
    }
    if (cv::countNonZero(gone) == 0) return surface;
    // How far within what goes, voxels, within a voxel or so of its border; smoothed, for columns are a staircase. Where nothing stands it makes no difference.
    cv::Mat goes;
    cv::Mat(gone | (foot == 0)).convertTo(goes, CV_32F, 1 / 255.0);
    constexpr double kSmooth_vox = 1.2;
    cv::GaussianBlur(goes, goes, {}, kSmooth_vox, kSmooth_vox, cv::BORDER_REPLICATE);
    const double slope_of_blur = std::sqrt(2 * std::numbers::pi) * kSmooth_vox;
    open_inside_tiles(*surface, [&](const Coord& c) { return (c[axis] - lowest) * upwards < most + 8 ? Block::Opened : Block::Stays; });
    const int half_width = half_width_of(*surface);
    openvdb::tree::LeafManager<openvdb::FloatTree>(surface->tree()).foreach ([&](Leaf& leaf, size_t) {
        for (openvdb::Index n = 0; n < Leaf::SIZE; ++n) {
            const Coord c = leaf.offsetToGlobalCoord(n);
            const int i = c[u] - box.min()[u] + 1, j = c[v] - box.min()[v] + 1;
            if (i < 0 || j < 0 || i >= width || j >= depth) continue;
            const double share = goes.at<float>(j, i), inside = share > 0.98 ? 1e9 : share < 0.02 ? -1e9 : (share - 0.5) * slope_of_blur;
            // Above what stands here, or next to here, is whatever hangs over it.
            int top = standing.at<int>(j, i);
            for (const auto& [di, dj] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}})
                if (i + di >= 0 && j + dj >= 0 && i + di < width && j + dj < depth && gone.at<uint8_t>(j + dj, i + di))
                    top = std::max(top, standing.at<int>(j + dj, i + di));
            const double below = top + 0.5 - (c[axis] - lowest) * upwards;
            const double cut = std::clamp(std::min(inside, below) * voxel, -static_cast<double>(band), static_cast<double>(band));
            leaf.setValueOnly(n, std::max(leaf.getValue(n), static_cast<float>(cut)));
        }
    });
    try {
        return redistance(std::move(surface), half_width, nullptr, progress);
    } catch (const InputError&) {
        throw InputError("all of the object lies flat on the floor at " + std::to_string(height) +
                         ". Remedy: --floor-clear 0, another --floor HEIGHT, or check --up");
    }
}

openvdb::FloatGrid::Ptr cut_flat(openvdb::FloatGrid::Ptr surface, const Vec3d& up, double height, Progress& progress) {
    const double voxel = surface->voxelSize()[0];
    const int half_width = half_width_of(*surface);
    const float band = surface->background();
    /// Signed distance of a voxel to the half-space below the plane, positive there.
    const auto below = [&](const openvdb::Vec3d& index) {
        const openvdb::Vec3d x = surface->indexToWorld(index);
        return height - (x.x() * up.x() + x.y() * up.y() + x.z() * up.z());
    };
    const double corner = 0.5 * std::sqrt(3.0) * 8 * voxel;
    open_inside_tiles(*surface, [&](const Coord& c) {
        const double d = below(c.asVec3d() + openvdb::Vec3d(3.5));
        return d > band + corner ? Block::Outside : d > -band - corner ? Block::Opened : Block::Stays;
    });
    openvdb::tree::LeafManager<openvdb::FloatTree>(surface->tree()).foreach ([&](Leaf& leaf, size_t) {
        for (openvdb::Index at = 0; at < Leaf::SIZE; ++at) {
            const auto cut =
                static_cast<float>(std::clamp(below(leaf.offsetToGlobalCoord(at).asVec3d()), -static_cast<double>(band), static_cast<double>(band)));
            leaf.setValueOnly(at, std::max(leaf.getValue(at), cut));
        }
    });
    try {
        return redistance(std::move(surface), half_width, nullptr, progress);
    } catch (const InputError&) {
        throw InputError("nothing of the object lies above the plane at " + std::to_string(height) +
                         " along its up axis, by which it is cut. Remedy: check --up; leave --floor or --base flat away, or \"floor\" in the camera file");
    }
}

}  // namespace vdbcarve
