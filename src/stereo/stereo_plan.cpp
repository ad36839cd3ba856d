// SPDX-License-Identifier: Apache-2.0
#include "stereo/stereo_plan.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/pixel_size.h"
#include "color/color_plan.h"
#include "mesh/marching_cubes.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

void check_stereo(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const StereoOptions& o) {
    if (surface.getGridClass() != openvdb::GRID_LEVEL_SET) throw InputError("stereo: grid '" + surface.getName() + "' is no level set");
    if (surface.tree().leafCount() == 0) throw InputError("stereo: the volume has no surface");
    if (o.pairs < 2 || o.pairs > kernel::kMostStereoPairs)
        throw UsageError("stereo: a view is compared with " + std::to_string(o.pairs) + " others, must be 2.." + std::to_string(kernel::kMostStereoPairs));
    if (!(o.least_angle_deg > 0) || !(o.most_angle_deg > o.least_angle_deg) || o.most_angle_deg > 90)
        throw UsageError("stereo: the angles between views are not 0 < least < most <= 90 degrees");
    if (o.scale < 0 || o.scale > kMostStereoScale)
        throw UsageError("stereo: the scale is " + std::to_string(o.scale) + ", must be 0 (by itself) or 1.." + std::to_string(kMostStereoScale));
    if (o.passes < 1 || o.passes > 30) throw UsageError("stereo: passes are " + std::to_string(o.passes) + ", must be 1..30");
    if (o.levels < 1 || o.levels > 4) throw UsageError("stereo: levels are " + std::to_string(o.levels) + ", must be 1..4");
    if (!(o.depth_share > 0 && o.depth_share <= 1)) throw UsageError("stereo: the depth is not within 0..1 of the object's size");
    const StereoTrust& t = o.trust;
    const auto within = [](double value, double least, double most, const char* what) {
        if (!(value >= least && value <= most))
            throw UsageError(std::string("stereo: ") + what + " is " + std::to_string(value) + ", must be " + std::to_string(least) + ".." +
                             std::to_string(most));
    };
    within(t.most_cost, 0, 2, "the most that a match may cost");
    within(t.least_contrast, 0, 1, "the least contrast");
    within(t.least_margin, 0, 2, "the margin to rivals");
    within(t.agreeing, 1, o.pairs, "the number of views that have to agree");
    within(t.agreement_px, 1e-3, 100, "how far apart agreeing views may be (px)");
    within(t.normal_deg, 1, 180, "the angle between agreeing normals (degrees)");
    within(t.rim_px, 0, 100, "the distance to the silhouette's rim (px)");
    within(o.truncation_vox, 0.5, 100, "the truncation (voxels)");
    within(o.reach_share, 0, 1, "how far behind a depth it is evidence (of the size)");
    within(o.coarser_weight, 0, 1, "the weight of coarser depths");
    within(o.least_weight, 1e-3, 1000, "the weight from which on depths count");
    within(o.least_piece, 0, 1, "the smallest piece (of its hull's)");
    for (const ColorInput& input : inputs) {
        const Intrinsics& k = input.camera.intrinsics;
        if (input.use && (input.mask.coverage.width != k.width_px || input.mask.coverage.height != k.height_px))
            throw InputError("stereo: view " + input.name + ": the mask has not the camera's size");
    }
}

RenderFrame stereo_frame(const openvdb::FloatGrid& surface) {
    const kernel::LatticeFrame lattice = lattice_frame(surface.transform());
    return {leaf_box(surface), Vec3d(lattice.first[0], lattice.first[1], lattice.first[2]), lattice.voxel_size};
}

double longest_side(const openvdb::FloatGrid& surface) {
    openvdb::CoordBBox inside;
    for (auto leaf = surface.tree().cbeginLeaf(); leaf; ++leaf)
        for (auto v = leaf->cbeginValueOn(); v; ++v)
            if (*v < 0) inside.expand(v.getCoord());
    return inside.empty() ? 0 : (inside.dim()[inside.maxExtent()]) * surface.voxelSize()[0];
}

kernel::StereoTrustRule trust_rule(const StereoTrust& t) {
    return {static_cast<float>(t.most_cost),    static_cast<float>(t.least_contrast * t.least_contrast),
            static_cast<float>(t.least_margin), t.agreeing,
            static_cast<float>(t.agreement_px), static_cast<float>(std::cos(t.normal_deg * std::numbers::pi / 180))};
}

namespace {

/// Luma as it is coded, mean of scale x scale pixels.
std::vector<float> grey_of_photo(const PhotoView& photo, int scale, int width, int height) {
    std::vector<float> out(static_cast<size_t>(width) * static_cast<size_t>(height));
    const int channels = photo.channels();
    const auto fill = [&](const auto& pixels, float unit) {
        tbb::parallel_for(0, height, [&](int y) {
            for (int x = 0; x < width; ++x) {
                float sum = 0;
                for (int j = y * scale; j < (y + 1) * scale; ++j)
                    for (int i = x * scale; i < (x + 1) * scale; ++i)
                        sum += channels >= 3 ? 0.299f * static_cast<float>(pixels.at(i, j, 0)) + 0.587f * static_cast<float>(pixels.at(i, j, 1)) +
                                                   0.114f * static_cast<float>(pixels.at(i, j, 2))
                                             : static_cast<float>(pixels.at(i, j, 0));
                out[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)] = sum * unit / static_cast<float>(scale * scale);
            }
        });
    };
    if (!photo.pixels8.empty()) fill(photo.pixels8, 1.f / 255);
    else fill(photo.pixels16, 1.f / 65535);
    return out;
}

Camera at_scale(Camera camera, int scale) {
    Intrinsics& k = camera.intrinsics;
    for (double* v : {&k.fx, &k.fy, &k.skew, &k.cx, &k.cy}) *v /= scale;
    k.width_px /= scale;
    k.height_px /= scale;
    return camera;
}

}  // namespace

kernel::StereoPair stereo_pair(const Camera& from, const Camera& to, int view) {
    const Intrinsics &a = from.intrinsics, &b = to.intrinsics;
    // Homogeneous camera points of the reference: rays (u, v, 1) + s e, e its fourth axis (perspective) or the third.
    Eigen::Matrix<double, 4, 3> rays = Eigen::Matrix<double, 4, 3>::Zero();
    Eigen::Vector4d e = Eigen::Vector4d::Zero();
    const Mat3d inverse = a.matrix().inverse();
    rays.topRows<2>() = inverse.topRows<2>();
    (a.orthographic ? rays(3, 2) : rays(2, 2)) = 1;
    e[a.orthographic ? 2 : 3] = 1;
    const Mat3d turn = to.camera_from_world.rotation * from.camera_from_world.rotation.transpose();
    const Vec3d shift = to.camera_from_world.translation - turn * from.camera_from_world.translation;
    Eigen::Matrix<double, 3, 4> in_camera;
    in_camera << turn, shift;
    Eigen::Matrix<double, 3, 4> projection;
    if (b.orthographic) {
        projection.topRows<2>() = b.matrix().topLeftCorner<2, 2>() * in_camera.topRows<2>();
        projection(0, 3) += b.cx;
        projection(1, 3) += b.cy;
        projection.row(2) << 0, 0, 0, 1;
    } else {
        projection = b.matrix() * in_camera;
    }
    const Mat3d m = projection * rays;
    const Vec3d t = projection * e;
    kernel::StereoPair out{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) {
            out.from_pixel[3 * r + c] = static_cast<float>(m(r, c));
            out.turn[3 * r + c] = static_cast<float>(turn(r, c));
        }
        out.along[r] = static_cast<float>(t[r]);
        out.depth[r] = static_cast<float>(Vec3d(in_camera.row(2) * rays)[r]);
    }
    out.depth[3] = static_cast<float>(in_camera.row(2).dot(e));
    out.view = view;
    return out;
}

namespace {

/// All views at one size, with the others that each is compared with.
std::vector<StereoSource> sources_of(const std::vector<ColorInput>& inputs, const std::vector<PhotoView>& photos, const std::vector<size_t>& used,
                                     const std::vector<MaskView>& present, const std::vector<DistanceField>& fields, int scale, const Vec3d& object,
                                     const StereoOptions& o) {
    std::vector<StereoSource> out(inputs.size());
    const auto rim_px = static_cast<float>(std::min(o.trust.rim_px * scale, 0.9 * kernel::kMarginReach_px)),
               mixed_px = static_cast<float>(std::min(1.0 * scale, 0.9 * kernel::kMarginReach_px));
    tbb::parallel_for(size_t{0}, used.size(), [&](size_t u) {
        const size_t v = used[u];
        StereoSource& s = out[v];
        s.camera = at_scale(inputs[v].camera, scale);
        const Intrinsics& k = s.camera.intrinsics;
        s.lens = {static_cast<float>(k.fx), static_cast<float>(k.fy), static_cast<float>(k.skew),
                  static_cast<float>(k.cx), static_cast<float>(k.cy), k.orthographic};
        s.width = k.width_px;
        s.height = k.height_px;
        s.grey = grey_of_photo(photos[v], scale, s.width, s.height);
        const ImageView<uint8_t>& mask = present[u].coverage;
        s.object.assign(s.grey.size(), 0);
        for (int y = 0; y < s.height; ++y)
            for (int x = 0; x < s.width; ++x) {
                const int i = x * scale + scale / 2, j = y * scale + scale / 2;  // of the middle
                const float margin = -fields[u].silhouette.at(i, j);
                // Pixels of the rim are partly of what lies behind: that is no texture.
                if (mask.at(i, j) < 128 || margin < mixed_px) continue;
                s.object[static_cast<size_t>(y) * static_cast<size_t>(s.width) + static_cast<size_t>(x)] = margin >= rim_px ? 2 : 1;
            }
    });
    // The nearest views that have parallax enough: surfaces look the most alike in them.
    const auto towards = [&](const Camera& c) {
        return c.intrinsics.orthographic ? Vec3d(-c.forward_world()) : Vec3d((c.centre_world() - object).normalized());
    };
    for (const size_t v : used) {
        std::vector<std::pair<double, size_t>> at_angle;
        for (const size_t w : used) {
            const double angle = std::acos(std::clamp(towards(out[v].camera).dot(towards(out[w].camera)), -1.0, 1.0)) * 180 / std::numbers::pi;
            if (w != v && angle >= o.least_angle_deg && angle <= o.most_angle_deg) at_angle.emplace_back(angle, w);
        }
        std::stable_sort(at_angle.begin(), at_angle.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
        if (at_angle.size() > static_cast<size_t>(o.pairs)) at_angle.resize(static_cast<size_t>(o.pairs));
        if (at_angle.size() < 2) continue;  // one other view cannot be checked by a third
        for (const auto& [angle, w] : at_angle) out[v].pairs.push_back(stereo_pair(out[v].camera, out[w].camera, static_cast<int>(w)));
    }
    return out;
}

}  // namespace

std::vector<StereoLevel> stereo_levels(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, int scale,
                                       const StereoOptions& o) {
    const size_t n = inputs.size();
    std::vector<Photo> loaded;
    if (photos) loaded = photos(0, n);
    std::vector<PhotoView> pictures(n);
    std::vector<MaskView> present;
    std::vector<size_t> used;
    const SampledMasks masks(inputs, 0, n);
    for (size_t v = 0; v < n; ++v) {
        pictures[v] = photos ? view_of(loaded[v]) : inputs[v].photo;
        if (!inputs[v].use || pictures[v].empty()) continue;
        check_photo("stereo", inputs[v], pictures[v]);
        used.push_back(v);
        present.push_back(masks.views()[v]);
    }
    Progress quiet;
    const std::vector<DistanceField> fields = distance_fields(present, margin_fields(), quiet);
    const Vec3d middle = middle_of(surface);
    std::vector<StereoLevel> out;
    constexpr int kLeastSide_px = 24;  ///< nearly three windows
    for (int level = 0; level < o.levels; ++level) {
        const auto small = std::find_if(used.begin(), used.end(),
                                        [&](size_t v) { return std::min(pictures[v].width(), pictures[v].height()) / (scale << level) < kLeastSide_px; });
        if (small != used.end() && level == 0)
            throw InputError("stereo: view " + inputs[*small].name + ": at 1/" + std::to_string(scale) + " of its size the photograph has " +
                             std::to_string(pictures[*small].width() / scale) + " x " + std::to_string(pictures[*small].height() / scale) +
                             " pixels, too few to compare. Remedy: " + (scale > 1 ? "a smaller --stereo-scale" : "larger photographs"));
        if (small != used.end()) break;
        out.push_back({scale << level, {}, {}});
        out.back().sources = sources_of(inputs, pictures, used, present, fields, out.back().scale, middle, o);
    }
    return out;
}

StereoPasses stereo_passes(size_t level, size_t levels, const StereoOptions& options) {
    const size_t finer = levels - 1 - level;
    const int first = finer ? (options.passes + 1) / 2 : 0;
    return {first, first + std::max(options.passes >> std::min<size_t>(finer, 30), 1)};
}

Vec3d middle_of(const openvdb::FloatGrid& surface) {
    const openvdb::CoordBBox box = leaf_box(surface);
    const openvdb::Vec3d middle = surface.indexToWorld(0.5 * (box.min().asVec3d() + box.max().asVec3d()));
    return {middle[0], middle[1], middle[2]};
}

int default_stereo_scale(const openvdb::FloatGrid& surface, const std::vector<Camera>& cameras) {
    const double pixel = pixel_size_at(cameras, middle_of(surface));
    int scale = 1;
    while (pixel > 0 && 2 * scale <= kMostStereoScale && 2 * scale * pixel <= kStereoPixel_vox * surface.voxelSize()[0]) scale *= 2;
    return scale;
}

int stereo_scale(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const StereoOptions& options) {
    if (options.scale) return options.scale;
    std::vector<Camera> cameras;
    for (const ColorInput& input : inputs)
        if (input.use) cameras.push_back(input.camera);
    return default_stereo_scale(surface, cameras);
}

size_t steps_of(const std::vector<StereoLevel>& levels) {
    size_t out = 0;
    for (const StereoLevel& level : levels)
        out += static_cast<size_t>(std::count_if(level.sources.begin(), level.sources.end(), [](const StereoSource& s) { return !s.pairs.empty(); }));
    return out;
}

void leave_to_finer(std::vector<StereoLevel>& levels) {
    // The coarsest first: what finer ones know is still whole then.
    for (size_t l = levels.size(); l-- > 1;)
        tbb::parallel_for(size_t{0}, levels[l].maps.size(), [&](size_t v) {
            std::vector<float>& coarse = levels[l].maps[v].confidence;
            const StereoSource& to = levels[l].sources[v];
            for (size_t f = 0; f < l && !coarse.empty(); ++f) {
                const std::vector<float>& fine = levels[f].maps[v].confidence;
                const StereoSource& from = levels[f].sources[v];
                if (fine.empty()) continue;
                for (int y = 0; y < from.height; ++y)
                    for (int x = 0; x < from.width; ++x) {
                        const int cx = x >> (l - f), cy = y >> (l - f);
                        if (cx < to.width && cy < to.height && fine[static_cast<size_t>(y) * static_cast<size_t>(from.width) + static_cast<size_t>(x)] > 0.f)
                            coarse[static_cast<size_t>(cy) * static_cast<size_t>(to.width) + static_cast<size_t>(cx)] = 0.f;
                    }
            }
        });
}

kernel::StereoReference stereo_reference(const std::vector<StereoSource>& sources, size_t view, double voxel_size) {
    const StereoSource& s = sources[view];
    kernel::StereoReference r{};
    r.image = {nullptr, s.width, s.height};
    r.lens = s.lens;
    r.view = static_cast<int>(view);
    r.pairs = static_cast<int>(s.pairs.size());
    for (size_t p = 0; p < s.pairs.size(); ++p) {
        const StereoSource& other = sources[static_cast<size_t>(s.pairs[p].view)];
        r.pair[p] = s.pairs[p];
        r.other[p] = {nullptr, other.width, other.height};
    }
    r.margin = static_cast<float>(2 * voxel_size);  // an exact hull would be at the search's very end
    return r;
}

kernel::HullView hull_view(const RenderFrame& frame, const StereoSource& source, double deepest_world) {
    kernel::HullView out{};
    out.rays = render_rule(frame, source.camera, RenderOptions());
    const Mat3d& r = source.camera.camera_from_world.rotation;
    for (int a = 0; a < 3; ++a) {
        out.depth[a] = frame.voxel_size * r(2, a);
        for (int b = 0; b < 3; ++b) out.normal[3 * a + b] = r(a, b);
    }
    out.depth[3] = (source.camera.camera_from_world * frame.origin_world).z();
    out.deepest = deepest_world;
    out.orthographic = source.lens.orthographic;
    return out;
}

void count_trusted(StereoResult& result) {
    tbb::parallel_for(size_t{0}, result.maps.size(), [&](size_t v) {
        const std::vector<float>& c = result.maps[v].confidence.data;
        result.views[v].trusted_pixels = static_cast<size_t>(std::count_if(c.begin(), c.end(), [](float x) { return x > 0.f; }));
    });
}

void add_milliseconds(StereoResult& result, const std::string& step, double milliseconds) {
    for (auto& [name, sum] : result.milliseconds)
        if (name == step) {
            sum += milliseconds;
            return;
        }
    result.milliseconds.emplace_back(step, milliseconds);
}

}  // namespace vdbcarve
