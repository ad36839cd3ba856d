// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/render.h"

#include <tbb/blocked_range2d.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <numbers>

#include "color/color_plan.h"
#include "image/image_io.h"
#include "mesh/marching_cubes.h"
#include "volume/nanovdb_bytes.h"
#include "render/render_plan.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"
#include "vdbcarve/raster.h"

namespace vdbcarve {

using kernel::Rgb;
using kernel::Vec3;

namespace {

constexpr double kRadians = std::numbers::pi / 180;
constexpr int kMostPixels = 32768;  ///< of a side

Vec3 vec3(const Vec3d& v) { return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())}; }
Rgb rgb(const std::array<double, 3>& c) { return {static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])}; }

void check_options(const RenderOptions& o, const Camera& camera) {
    const Intrinsics& k = camera.intrinsics;
    if (k.width_px < 1 || k.height_px < 1 || k.width_px > kMostPixels || k.height_px > kMostPixels)
        throw UsageError("render: pictures have 1 to " + std::to_string(kMostPixels) + " pixels a side, not " + std::to_string(k.width_px) + " x " +
                         std::to_string(k.height_px));
    if (o.samples < 1 || o.samples > 16) throw UsageError("render: samples is " + std::to_string(o.samples) + ", must be 1..16");
    if (o.ambient_rays < 0 || o.ambient_rays > 256) throw UsageError("render: ambient rays are " + std::to_string(o.ambient_rays) + ", must be 0..256");
    if (!(o.ambient_reach > 0) || !std::isfinite(o.iso)) throw UsageError("render: the ambient reach must be > 0, and iso a number");
    if (o.style == RenderStyle::Slice && !(o.slice.normal.norm() > 0)) throw UsageError("render: the slice's plane has no direction");
}

/// Halton's sequence: even without a pattern.
double halton(int n, int base) {
    double out = 0, digit = 1;
    for (; n > 0; n /= base) out += (digit /= base) * (n % base);
    return out;
}

}  // namespace

RenderFrame::RenderFrame(const openvdb::CoordBBox& leaves, const Vec3d& first_world, double size) : voxel_size(size) {
    if (leaves.empty()) throw UsageError("render: the volume is empty");
    base = color_base(leaves);
    origin_world = first_world + voxel_size * Vec3d(base.i, base.j, base.k);
    const int b[3] = {base.i, base.j, base.k};
    for (int a = 0; a < 3; ++a) {
        box.lo[a] = static_cast<float>(leaves.min()[a] - b[a]);
        box.hi[a] = static_cast<float>(leaves.max()[a] - b[a] + 1);
    }
}

const std::vector<uint8_t>& srgb_table() {
    static const std::vector<uint8_t> table = [] {
        std::vector<uint8_t> out(kernel::kSrgbSteps);
        for (size_t i = 0; i < out.size(); ++i) out[i] = srgb8_from_linear(static_cast<double>(i) / (kernel::kSrgbSteps - 1));
        return out;
    }();
    return table;
}

std::vector<Vec3> ambient_directions(int rays) {
    std::vector<Vec3> out;
    const int count = kernel::kAmbientSets * rays;
    for (int set = 0; set < kernel::kAmbientSets; ++set)
        for (int r = 0; r < rays; ++r) {
            // Sets interleave, so that each is even by itself and all together are.
            const int n = r * kernel::kAmbientSets + (set * 7) % kernel::kAmbientSets;
            const double height2 = (n + 0.5) / count, turn = 2 * std::numbers::pi * halton(n + 1, 2), radius = std::sqrt(height2);
            out.push_back(vec3(Vec3d(radius * std::cos(turn), radius * std::sin(turn), std::sqrt(1 - height2))));
        }
    return out;
}

kernel::Lights lights_of(const Camera& camera, const Vec3d& up_world) {
    const Mat3d world_from_camera = camera.camera_from_world.rotation.transpose();
    const Vec3d up = up_world.norm() > 0 ? Vec3d(up_world.normalized()) : Vec3d(-world_from_camera.col(1));
    return {vec3(world_from_camera * Vec3d(-0.45, -0.65, -0.61).normalized()), vec3(world_from_camera * Vec3d(0.75, -0.1, -0.65).normalized()), vec3(up)};
}

kernel::RenderRule render_rule(const RenderFrame& frame, const Camera& camera, const RenderOptions& o) {
    check_options(o, camera);
    const Intrinsics& k = camera.intrinsics;
    kernel::RenderRule rule{};
    rule.style = static_cast<int>(o.style);
    rule.width = k.width_px;
    rule.height = k.height_px;
    rule.samples = o.samples;
    rule.orthographic = k.orthographic;
    // Points of the image plane: (x, y, 1) = inverse(K) (u, v, 1).
    const Mat3d world_from_camera = camera.camera_from_world.rotation.transpose();
    const Vec3d du(1 / k.fx, 0, 0), dv(-k.skew / (k.fx * k.fy), 1 / k.fy, 0), at_zero(-(k.cx - k.skew * k.cy / k.fy) / k.fx, -k.cy / k.fy, 1);
    const auto set = [](double* to, const Vec3d& v) {
        for (int a = 0; a < 3; ++a) to[a] = v[a];
    };
    const Vec3d eye = (camera.centre_world() - frame.origin_world) / frame.voxel_size;
    if (k.orthographic) {
        set(rule.origin, eye + world_from_camera * Vec3d(at_zero.x(), at_zero.y(), 0) / frame.voxel_size);
        set(rule.corner, world_from_camera.col(2));
        set(rule.du, world_from_camera * du / frame.voxel_size);
        set(rule.dv, world_from_camera * dv / frame.voxel_size);
    } else {
        set(rule.origin, eye);
        set(rule.corner, world_from_camera * at_zero);
        set(rule.du, world_from_camera * du);
        set(rule.dv, world_from_camera * dv);
    }
    rule.iso_vox = static_cast<float>(o.iso / frame.voxel_size);
    rule.lights = lights_of(camera, o.up);
    rule.ambient_rays = o.style == RenderStyle::Surface ? o.ambient_rays : 0;
    float side = 0;
    for (int a = 0; a < 3; ++a) side = std::max(side, frame.box.hi[a] - frame.box.lo[a]);
    rule.ambient_reach_vox = static_cast<float>(o.ambient_reach * side);
    rule.use_color = o.color;
    rule.plain = rgb(o.plain);
    const Vec3d normal = o.slice.normal.norm() > 0 ? Vec3d(o.slice.normal.normalized()) : Vec3d::UnitZ();
    const double offset = o.slice.offset / std::max(o.slice.normal.norm(), 1e-300);
    for (int a = 0; a < 3; ++a) rule.plane[a] = static_cast<float>(normal[a]);
    rule.plane[3] = static_cast<float>((normal.dot(frame.origin_world) - offset) / frame.voxel_size);
    rule.line_vox = 0.6f;
    rule.thickness_vox = 0.12f * side;
    if (o.style == RenderStyle::XRay) {  // ink that stands out
        const bool dark_behind = o.background && (*o.background)[0] + (*o.background)[1] + (*o.background)[2] < 3 * 128;
        rule.plain = dark_behind ? Rgb{0.9f, 0.9f, 0.9f} : Rgb{0.01f, 0.02f, 0.03f};
    }
    rule.opaque = o.background.has_value();
    if (o.background)
        rule.background = {static_cast<float>(linear_from_srgb((*o.background)[0] / 255.0)), static_cast<float>(linear_from_srgb((*o.background)[1] / 255.0)),
                           static_cast<float>(linear_from_srgb((*o.background)[2] / 255.0))};
    return rule;
}

// ------------------------------------------------------------------------------------ volumes

namespace {

RenderFrame frame_of(const openvdb::FloatGrid& surface) {
    if (surface.getGridClass() != openvdb::GRID_LEVEL_SET) throw UsageError("render: grid '" + surface.getName() + "' is no level set");
    const kernel::LatticeFrame lattice = lattice_frame(surface.transform());
    return RenderFrame(leaf_box(surface), Vec3d(lattice.first[0], lattice.first[1], lattice.first[2]), lattice.voxel_size);
}

}  // namespace

Box3d box_of_inside(const openvdb::FloatGrid& surface) {
    const RenderFrame f = frame_of(surface);
    openvdb::CoordBBox inside;
    for (auto leaf = surface.tree().cbeginLeaf(); leaf; ++leaf)
        for (auto v = leaf->cbeginValueOn(); v; ++v)
            if (*v < 0) inside.expand(v.getCoord());
    if (inside.empty()) throw UsageError("render: the volume has no inside");
    Box3d out;
    for (const openvdb::Coord& c : {inside.min(), inside.max()})
        out.extend(Vec3d(f.origin_world + f.voxel_size * Vec3d(c[0] - f.base.i, c[1] - f.base.j, c[2] - f.base.k)));
    return out;
}

struct RenderVolume::Parts {
    RenderFrame frame;
    Box3d bounds;
    NanoBuffer grid, color;
    std::vector<uint64_t> near, solid;
    kernel::RenderVolume view{};
};

RenderVolume::RenderVolume(const openvdb::FloatGrid& surface, const openvdb::Vec3SGrid* color) : parts_(std::make_unique<Parts>()) {
    Parts& p = *parts_;
    p.frame = frame_of(surface);
    p.bounds = box_of_inside(surface);
    const RenderFrame& f = p.frame;
    if (color) p.color = to_nanovdb(*color);
    p.grid = to_nanovdb(surface, false);
    const auto* grid = reinterpret_cast<const nanovdb::NanoGrid<float>*>(p.grid.data.get());
    const float near = kernel::kNearSurface_vox * static_cast<float>(f.voxel_size);
    p.near = sight_walls(*grid, near);
    p.solid = sight_walls(*grid, 0.f);
    p.view = {{grid, p.near.data(), near, f.base},
              {grid, p.solid.data(), 0.f, f.base},
              f.box,
              reinterpret_cast<const nanovdb::NanoGrid<nanovdb::Vec3f>*>(p.color.data.get()),
              static_cast<float>(f.voxel_size)};
}

RenderVolume::~RenderVolume() = default;
RenderVolume::RenderVolume(RenderVolume&&) noexcept = default;
const Box3d& RenderVolume::bounds_world() const { return parts_->bounds; }

Image8 render(RenderVolume& volume, const Camera& camera, const RenderOptions& options) {
    RenderVolume::Parts& p = *volume.parts_;
    kernel::RenderRule rule = render_rule(p.frame, camera, options);
    const std::vector<Vec3> ambient = ambient_directions(rule.ambient_rays);
    rule.ambient = ambient.data();
    rule.srgb = srgb_table().data();
    Image8 out(rule.width, rule.height, 4);
    constexpr int kTile = 16;
    kernel::with_style(rule.style, [&](auto style) {
        tbb::parallel_for(tbb::blocked_range2d<int>(0, rule.height, kTile, 0, rule.width, kTile), [&](const tbb::blocked_range2d<int>& range) {
            for (int y = range.rows().begin(); y < range.rows().end(); ++y)
                for (int x = range.cols().begin(); x < range.cols().end(); ++x) {
                    const uint32_t pixel = kernel::render_pixel<decltype(style)::value>(p.view, rule, x, y);
                    for (int c = 0; c < 4; ++c) out.at(x, y, c) = static_cast<uint8_t>(pixel >> (8 * c));
                }
        });
    });
    return out;
}

// ------------------------------------------------------------------------------------ meshes

Image8 render(const Mesh& mesh, const Camera& camera, const RenderOptions& options) {
    if (options.style != RenderStyle::Surface) throw UsageError("render: a mesh has no voxels, no thickness and no sections; those are of volumes");
    RenderFrame world;  // rays are those of the world itself
    kernel::RenderRule rule = render_rule(world, camera, options);
    rule.srgb = srgb_table().data();
    const int s = options.samples;
    const Camera fine = scaled(camera, s);
    const Raster seen = rasterize(mesh, fine);
    std::vector<Vec3d> normals(mesh.vertices.size(), Vec3d::Zero());
    const auto at = [&](uint32_t v) { return Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
    for (const auto& t : mesh.triangles) {
        const Vec3d n = (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0]));  // twice its area long: large faces count more
        for (const uint32_t v : t) normals[v] += n;
    }
    Image8 out(rule.width, rule.height, 4);
    tbb::parallel_for(0, rule.height, [&](int y) {
        for (int x = 0; x < rule.width; ++x) {
            kernel::Shade sum;
            for (int sy = 0; sy < s; ++sy)
                for (int sx = 0; sx < s; ++sx) {
                    const int u = x * s + sx, v = y * s + sy;
                    if (u >= seen.face.width || v >= seen.face.height || seen.face.at(u, v) == UINT32_MAX) continue;
                    const auto& t = mesh.triangles[seen.face.at(u, v)];
                    const Camera::Ray ray = fine.ray(Vec2d(u + 0.5, v + 0.5));
                    // Weights of the corners where the ray meets the face's plane.
                    const Vec3d a = at(t[0]), e1 = at(t[1]) - a, e2 = at(t[2]) - a, n = e1.cross(e2);
                    const double area2 = n.squaredNorm(), slope = n.dot(ray.direction);
                    if (area2 == 0 || slope == 0) continue;
                    const Vec3d p = ray.origin + n.dot(a - ray.origin) / slope * ray.direction - a;
                    const double w1 = std::clamp(p.cross(e2).dot(n) / area2, 0.0, 1.0), w2 = std::clamp(e1.cross(p).dot(n) / area2, 0.0, 1.0),
                                 w0 = std::max(0.0, 1 - w1 - w2);
                    Vec3d normal = w0 * normals[t[0]].normalized() + w1 * normals[t[1]].normalized() + w2 * normals[t[2]].normalized();
                    if (!(normal.norm() > 0)) normal = n;
                    Rgb color = rule.plain;
                    if (options.color && !mesh.colors.empty()) {
                        const auto c = [&](size_t i) {
                            return static_cast<float>(w0 * mesh.colors[t[0]][i] + w1 * mesh.colors[t[1]][i] + w2 * mesh.colors[t[2]][i]);
                        };
                        color = {c(0), c(1), c(2)};
                    }
                    sum.color = kernel::plus(sum.color, 1.f, kernel::lit(color, vec3(normal.normalized()), vec3(-ray.direction), rule.lights, 1.f));
                    sum.alpha += 1.f;
                }
            const uint32_t pixel = kernel::pixel_of(rule, sum, static_cast<float>(s * s));
            for (int c = 0; c < 4; ++c) out.at(x, y, c) = static_cast<uint8_t>(pixel >> (8 * c));
        }
    });
    return out;
}

// ------------------------------------------------------------------------------------ cameras

Camera orbit_camera(const Box3d& box, const Vec3d& up_world, const OrbitView& view) {
    if (!(view.fov_deg >= 0 && view.fov_deg < 170))
        throw UsageError("render: the field of view is " + std::to_string(view.fov_deg) + " degrees, must be 0 (orthographic) to 170");
    const Vec3d up = up_world.normalized();
    const Vec3d first = std::fabs(up.x()) > 0.9 ? Vec3d::UnitY() : Vec3d::UnitX(), x = (first - first.dot(up) * up).normalized(), y = up.cross(x);
    const double a = view.azimuth_deg * kRadians, e = view.elevation_deg * kRadians;
    const Vec3d level = std::cos(a) * x + std::sin(a) * y, towards = std::cos(e) * level + std::sin(e) * up;
    Camera out;
    // Over the pole `up` is no help: what is up then is where the camera came from.
    Mat3d& r = out.camera_from_world.rotation;
    r.row(2) = -towards.transpose();
    r.row(1) = (std::sin(e) * level - std::cos(e) * up).transpose();
    r.row(0) = Vec3d(r.row(1).transpose()).cross(Vec3d(r.row(2).transpose())).transpose();
    Intrinsics& k = out.intrinsics;
    k.width_px = view.width_px;
    k.height_px = view.height_px;
    k.cx = 0.5 * view.width_px;
    k.cy = 0.5 * view.height_px;
    k.orthographic = view.fov_deg == 0;
    const double side = std::min(view.width_px, view.height_px);
    if (!k.orthographic) k.fx = k.fy = 0.5 * side / std::tan(0.5 * view.fov_deg * kRadians);
    // Every corner has to be in the picture, with a margin.
    constexpr double kFill = 0.94;
    double distance = box.diagonal().norm(), spread = 0;
    const int turns = view.whole_turn ? 72 : 1;
    for (int turn = 0; turn < turns; ++turn) {
        const Mat3d turned = Eigen::AngleAxisd(2 * std::numbers::pi * turn / turns, up).toRotationMatrix();
        for (int corner = 0; corner < 8; ++corner) {
            const Vec3d p = r * (turned * (box.corner(static_cast<Box3d::CornerType>(corner)) - box.center()));
            const double right = 2 * std::fabs(p.x()) / (kFill * view.width_px), below = 2 * std::fabs(p.y()) / (kFill * view.height_px);
            spread = std::max({spread, right, below});
            if (!k.orthographic) distance = std::max({distance, k.fx * right - p.z(), k.fy * below - p.z()});
        }
    }
    if (k.orthographic) k.fx = k.fy = 1 / std::max(spread, 1e-300);
    out.camera_from_world.translation = -(r * (box.center() + distance * towards));
    return out;
}

Camera slice_camera(const Box3d& box, const Vec3d& axis_world, const Vec3d& up_world, int longest_px) {
    const Vec3d axis = axis_world.normalized();
    Vec3d up = up_world - up_world.dot(axis) * axis;
    if (up.norm() < 1e-6) up = std::fabs(axis.y()) > 0.9 ? Vec3d::UnitZ() : Vec3d(Vec3d::UnitY() - axis.y() * axis);
    Camera out;
    Mat3d& r = out.camera_from_world.rotation;
    r.row(2) = -axis.transpose();
    r.row(1) = -up.normalized().transpose();
    r.row(0) = Vec3d(r.row(1).transpose()).cross(Vec3d(r.row(2).transpose())).transpose();
    // The box as the camera sees it.
    Vec3d half = Vec3d::Zero();
    for (int corner = 0; corner < 8; ++corner) half = half.cwiseMax(Vec3d(r * (box.corner(static_cast<Box3d::CornerType>(corner)) - box.center())).cwiseAbs());
    constexpr double kMargin = 1.06;
    const double pixels = longest_px / (2 * kMargin * std::max(half.x(), half.y()));
    Intrinsics& k = out.intrinsics;
    k.orthographic = true;
    k.width_px = std::max(16, static_cast<int>(std::lround(2 * kMargin * half.x() * pixels)));
    k.height_px = std::max(16, static_cast<int>(std::lround(2 * kMargin * half.y() * pixels)));
    k.cx = 0.5 * k.width_px;
    k.cy = 0.5 * k.height_px;
    k.fx = k.fy = pixels;
    out.camera_from_world.translation = -(r * (box.center() + 2 * box.diagonal().norm() * axis));
    return out;
}

// ------------------------------------------------------------------------------------ sheets

Image8 beside_photo(ImageView<uint8_t> photo, ImageView<uint8_t> picture) {
    Image8 out(2 * picture.width, picture.height, 3, 255);
    const Image8 small = photo.empty() ? Image8() : io::downscale(photo, picture.width, picture.height);
    for (int y = 0; y < picture.height; ++y)
        for (int x = 0; x < picture.width; ++x) {
            const int alpha = picture.channels == 4 ? picture.at(x, y, 3) : 255;
            for (int c = 0; c < 3; ++c) {
                out.at(x, y, c) = small.empty() ? 0 : small.at(x, y, small.channels >= 3 ? c : 0);
                out.at(picture.width + x, y, c) =
                    static_cast<uint8_t>((picture.at(x, y, picture.channels >= 3 ? c : 0) * alpha + 255 * (255 - alpha) + 127) / 255);
            }
        }
    return out;
}

Image8 sheet_of(const std::vector<Image8>& pictures, const std::vector<std::string>& names, int columns) {
    if (pictures.empty()) throw UsageError("render: no picture for a sheet");
    constexpr int kGap = 8, kText = 22;
    const int n = static_cast<int>(pictures.size()), across = std::clamp(columns, 1, n), down = (n + across - 1) / across;
    int width = 0, height = 0;
    for (const Image8& p : pictures) width = std::max(width, p.width), height = std::max(height, p.height);
    Image8 out(across * (width + kGap) + kGap, down * (height + kGap + kText) + kGap, 3, 255);
    for (int i = 0; i < n; ++i) {
        const Image8& p = pictures[static_cast<size_t>(i)];
        const int x0 = kGap + (i % across) * (width + kGap), y0 = kGap + (i / across) * (height + kGap + kText);
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x) {
                const int alpha = p.channels == 4 ? p.at(x, y, 3) : 255;
                for (int c = 0; c < 3; ++c)
                    out.at(x0 + x, y0 + y, c) = static_cast<uint8_t>((p.at(x, y, p.channels >= 3 ? c : 0) * alpha + 255 * (255 - alpha) + 127) / 255);
            }
        if (static_cast<size_t>(i) < names.size()) io::write_text(out, x0, y0 + height + kText - 6, width, names[static_cast<size_t>(i)]);
    }
    return out;
}

}  // namespace vdbcarve
