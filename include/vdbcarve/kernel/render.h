// SPDX-License-Identifier: Apache-2.0
// A picture of a level set, pixel by pixel: rays by the hierarchical DDA of kernel/ray.h, then light.
//
// Frames: positions are in voxels from a base near the surface (ColorBase), voxel centres at integers; image pixels with the first pixel's centre at
// (0.5, 0.5). Colours are linear light. Neither pow nor exp nor sine is called: both backends give the same bits.
#pragma once

#include <nanovdb/NanoVDB.h>

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "vdbcarve/kernel/color.h"
#include "vdbcarve/kernel/ray.h"

namespace vdbcarve::kernel {

enum RenderStyle : int {
    kRenderSurface = 0,  ///< the level set's zero, interpolated, with light
    kRenderVoxels = 1,   ///< voxels inside as cubes: the volume as it is, nothing interpolated (Denkowski 2013, Fig. 3)
    kRenderXRay = 2,     ///< how long a ray is inside
    kRenderSlice = 3,    ///< the section with a plane
};

/// Voxels nearer to the surface than this may hold a zero of the interpolated level set. Distances change by at most 1 a voxel, and no point is farther
/// than 0.87 from the nearest centre.
inline constexpr float kNearSurface_vox = 1.f;
inline constexpr int kAmbientSets = 16;  ///< of directions, for a 4 x 4 pattern of pixels
inline constexpr int kSrgbSteps = 4096;  ///< linear light is looked up in so many steps

/// What light does to a surface. Directions are unit vectors on the lattice.
struct Lights {
    Vec3 key, fill, up;
};

/// A level set and its colours, as a renderer sees them. Borrowed.
struct RenderVolume {
    SightGrid near;                                  ///< walls: where a zero may be
    SightGrid solid;                                 ///< walls: inside
    SightBox box;                                    ///< the leaves' cells, from the base and shifted by half a voxel, so that cells begin at integers
    const nanovdb::NanoGrid<nanovdb::Vec3f>* color;  ///< active where there is a colour; null: none
    float voxel_size;
};

/// A picture to be made. Borrowed pointers.
struct RenderRule {
    int style;
    int width, height;
    int samples;  ///< rays along a pixel's side
    int orthographic;
    double origin[3];                ///< perspective: the eye. Orthographic: of the ray through (0, 0)
    double corner[3], du[3], dv[3];  ///< perspective: direction = corner + u du + v dv. Orthographic: origin moves by du, dv, direction is corner
    double length;                   ///< of `corner` in ortho; 1 else
    float iso_vox;                   ///< the surface lies where the distance is this
    Lights lights;
    int ambient_rays;  ///< 0: no ambient occlusion
    float ambient_reach_vox;
    const Vec3* ambient;  ///< kAmbientSets x ambient_rays directions about z, cosine-weighted
    int use_color;
    Rgb plain;            ///< of what has no colour
    float plane[4];       ///< of kRenderSlice: points p with plane . (p, 1) = 0
    float line_vox;       ///< half the width of its contour line
    float thickness_vox;  ///< of kRenderXRay: so thick an object lets half of the light through
    int opaque;           ///< 1: over `background`
    Rgb background;
    const uint8_t* srgb;  ///< kSrgbSteps values
};

/// Linear light and how much of what is behind is covered.
struct Shade {
    Rgb color{};  ///< premultiplied
    float alpha = 0.f;
};

VDBCARVE_HD Rgb times(float w, const Rgb& c) { return {w * c.r, w * c.g, w * c.b}; }

/// A level set's values about the base.
class FieldReader {
  public:
    VDBCARVE_HD FieldReader(const nanovdb::NanoGrid<float>& grid, const ColorBase& base, float scale) : block_(grid), base_(base), scale_(scale) {}

    /// Trilinear; voxels.
    VDBCARVE_HD float at(float x, float y, float z) {
        const int i = floor_of(x), j = floor_of(y), k = floor_of(z);
        const float a = x - static_cast<float>(i), b = y - static_cast<float>(j), c = z - static_cast<float>(k);
        const nanovdb::Coord o(i + base_.i, j + base_.j, k + base_.k);
        const auto weight = [&](int corner) { return ((corner & 4 ? a : 1.f - a) * (corner & 2 ? b : 1.f - b)) * (corner & 1 ? c : 1.f - c); };
        float sum = 0.f;
        if ((o[0] & 7) < 7 && (o[1] & 7) < 7 && (o[2] & 7) < 7) {  // all in one leaf, or in none
            const float* values;
            const float tile = leaf_or_tile(o, values);
            const int n = (o[0] & 7) << 6 | (o[1] & 7) << 3 | (o[2] & 7);
            if (!values) return scale_ * tile;
#pragma unroll
            for (int corner = 0; corner < 8; ++corner) sum += weight(corner) * values[n + ((corner & 4) << 4) + ((corner & 2) << 2) + (corner & 1)];
        } else {
#pragma unroll 1
            for (int corner = 0; corner < 8; ++corner)
                sum += weight(corner) * voxel(nanovdb::Coord(o[0] + (corner >> 2), o[1] + (corner >> 1 & 1), o[2] + (corner & 1)));
        }
        return scale_ * sum;
    }
    /// Outward unit normal from four values around, at the corners of a tetrahedron; `otherwise` where they cancel.
    VDBCARVE_HD Vec3 normal(float x, float y, float z, const Vec3& otherwise) {
        constexpr float h = 0.7f;  // voxels along each axis
        float gx = 0.f, gy = 0.f, gz = 0.f;
#pragma unroll 1
        for (int n = 0; n < 4; ++n) {
            const float dx = n == 0 || n == 3 ? h : -h, dy = n == 1 || n == 3 ? h : -h, dz = n >= 2 ? h : -h;
            const float value = at(x + dx, y + dy, z + dz);
            gx += dx * value;
            gy += dy * value;
            gz += dz * value;
        }
        const float size2 = gx * gx + gy * gy + gz * gz;
        if (!(size2 > 0.f)) return otherwise;
        const float inverse = 1.f / std::sqrt(size2);
        return {gx * inverse, gy * inverse, gz * inverse};
    }

  private:
    /// Values of the leaf that holds a voxel; without one null, and the tile's value is returned.
    VDBCARVE_HD float leaf_or_tile(const nanovdb::Coord& c, const float*& values) {
        values = nullptr;
        block_.find(c);
        if (!block_.lower) return block_.tile;
        const auto* node = block_.lower->data();
        const uint32_t n = BlockCache<float>::Lower::CoordToOffset(c);
        if (!node->mChildMask.isOn(n)) return node->mTable[n].value;
        values = node->getChild(n)->data()->mValues;
        return 0.f;
    }
    VDBCARVE_HD float voxel(const nanovdb::Coord& c) {
        const float* values;
        const float tile = leaf_or_tile(c, values);
        return values ? values[(c[0] & 7) << 6 | (c[1] & 7) << 3 | (c[2] & 7)] : tile;
    }

    BlockCache<float> block_;
    ColorBase base_;
    float scale_;
};

/// The colour grid about the base.
class ColorGridReader {
  public:
    VDBCARVE_HD ColorGridReader(const nanovdb::NanoGrid<nanovdb::Vec3f>& grid, const ColorBase& base) : block_(grid), base_(base) {}
    /// False where the voxel has no colour. Tiles have none.
    VDBCARVE_HD bool voxel(int i, int j, int k, Rgb& out) {
        const nanovdb::Coord c(i + base_.i, j + base_.j, k + base_.k);
        block_.find(c);
        if (!block_.lower) return false;
        const auto* node = block_.lower->data();
        const uint32_t n = BlockCache<nanovdb::Vec3f>::Lower::CoordToOffset(c);
        if (!node->mChildMask.isOn(n)) return false;
        const auto* leaf = node->getChild(n)->data();
        const uint32_t at = static_cast<uint32_t>((c[0] & 7) << 6 | (c[1] & 7) << 3 | (c[2] & 7));
        if (!leaf->mValueMask.isOn(at)) return false;
        const nanovdb::Vec3f v = leaf->mValues[at];
        out = {v[0], v[1], v[2]};
        return true;
    }
    VDBCARVE_HD bool at(float x, float y, float z, Rgb& out) {
        return interpolate_color([this](int i, int j, int k, Rgb& c) { return voxel(i, j, k, c); }, static_cast<double>(x), static_cast<double>(y),
                                 static_cast<double>(z), out);
    }

  private:
    BlockCache<nanovdb::Vec3f> block_;
    ColorBase base_;
};

/// A matte surface under a key light, a weaker one from the other side and a sky; `open` is the share of the sky that is seen.
VDBCARVE_HD Rgb lit(const Rgb& color, const Vec3& normal, const Vec3& to_eye, const Lights& lights, float open) {
    const float key = max_f(0.f, dot(normal, lights.key)), fill = max_f(0.f, dot(normal, lights.fill)), sky = 0.5f + 0.5f * dot(normal, lights.up);
    const float light = (0.62f * key + 0.22f * fill) * (0.45f + 0.55f * open) + (0.16f + 0.22f * sky) * open;
    // Blinn's highlight, its exponent 32.
    Vec3 half{lights.key.x + to_eye.x, lights.key.y + to_eye.y, lights.key.z + to_eye.z};
    const float size2 = dot(half, half);
    float gloss = 0.f;
    if (size2 > 0.f) {
        const float c = max_f(0.f, dot(normal, half)) / std::sqrt(size2);
        const float c2 = c * c, c4 = c2 * c2, c8 = c4 * c4, c16 = c8 * c8;
        gloss = 0.05f * (c16 * c16) * open;
    }
    return {light * color.r + gloss, light * color.g + gloss, light * color.b + gloss};
}

/// A pixel's ray: start and unit direction, and how far from the start the box begins.
struct PixelRay {
    Vec3 start, direction;
    bool hits;
};

/// The ray through an image point, moved to where it enters the box; in double, so that it does not matter how far away the camera is.
VDBCARVE_HD PixelRay pixel_ray(const RenderRule& rule, const SightBox& box, double u, double v) {
    double o[3], d[3], size2 = 0.0;
    for (int a = 0; a < 3; ++a) {
        const double moved = u * rule.du[a] + v * rule.dv[a];
        o[a] = rule.orthographic ? rule.origin[a] + moved : rule.origin[a];
        d[a] = rule.orthographic ? rule.corner[a] : rule.corner[a] + moved;
        size2 += d[a] * d[a];
    }
    const double inverse = 1.0 / std::sqrt(size2);
    double enter = rule.orthographic ? -1e300 : 0.0, exit = 1e300;
    for (int a = 0; a < 3; ++a) {
        d[a] *= inverse;
        const double lo = static_cast<double>(box.lo[a]) - 0.5, hi = static_cast<double>(box.hi[a]) - 0.5;
        if (d[a] == 0.0) {
            if (o[a] < lo || o[a] > hi) exit = -1e300;
            continue;
        }
        double p = (lo - o[a]) / d[a], q = (hi - o[a]) / d[a];
        if (p > q) {
            const double swapped = p;
            p = q;
            q = swapped;
        }
        if (p > enter) enter = p;
        if (q < exit) exit = q;
    }
    PixelRay ray;
    ray.hits = enter <= exit;
    ray.direction = {static_cast<float>(d[0]), static_cast<float>(d[1]), static_cast<float>(d[2])};
    ray.start = {static_cast<float>(o[0] + enter * d[0]), static_cast<float>(o[1] + enter * d[1]), static_cast<float>(o[2] + enter * d[2])};
    return ray;
}

VDBCARVE_HD Vec3 along(const Vec3& start, float t, const Vec3& direction) {
    return {start.x + t * direction.x, start.y + t * direction.y, start.z + t * direction.z};
}

inline constexpr float kFarthest_vox = 1e9f;

/// First zero of the interpolated level set (less iso_vox) along the ray; false where there is none.
VDBCARVE_HD bool find_surface(FieldReader& field, SightCells& cells, const RenderVolume& volume, const PixelRay& ray, float iso_vox, Vec3& hit) {
    // The field is read at one place only: a GPU's instructions are to stay in their cache (three places: half as fast).
    CellWalk walk(volume.box, ray.start, ray.direction, kFarthest_vox);
    float t = 0.f, t0 = 0.f, v0 = -1.f, t1 = 0.f, v1 = 0.f;  // last place outside, first inside; v0 < 0: none outside yet
    int refinements = -1;                                    // still to be done; -1: the surface is not found yet
    for (;;) {
        if (refinements < 0) {
            int width = 1;
            while (walk.at <= walk.end && (width = cells.width(walk.cell)) > 0) walk.leave(width);
            if (!(walk.at <= walk.end)) return false;
            t = walk.at;
        } else {
            t = t0 + (t1 - t0) * (v0 / (v0 - v1));  // where the chord is zero
        }
        const Vec3 p = along(ray.start, t, ray.direction);
        const float value = field.at(p.x, p.y, p.z) - iso_vox;
        if (value > 0.f) t0 = t, v0 = value;
        else t1 = t, v1 = value;
        if (refinements < 0) {
            if (value > 0.f) {
                // Values are distances: no surface is nearer than so.
                walk.go(t + max_f(0.1f, min_f(0.9f * value, 1.f)));
                continue;
            }
            refinements = v0 > 0.f ? 3 : 1;
        }
        if (--refinements == 0) {
            hit = p;
            return true;
        }
    }
}

/// Share of the sky above a point that nothing hides, nearer than `reach`; cosine-weighted.
VDBCARVE_HD float openness(SightCells& solid, const RenderVolume& volume, const RenderRule& rule, const Vec3& hit, const Vec3& n, int set) {
    if (rule.ambient_rays == 0) return 1.f;
    // A frame about the normal (Duff et al. 2017).
    const float sign = n.z < 0.f ? -1.f : 1.f, a = -1.f / (sign + n.z), b = n.x * n.y * a;
    const Vec3 s{1.f + sign * n.x * n.x * a, sign * b, -sign * n.x}, t{b, sign + n.y * n.y * a, -n.y};
    const Vec3 start = along(hit, 1.7f, n);
    int open = 0;
    for (int r = 0; r < rule.ambient_rays; ++r) {
        const Vec3& l = rule.ambient[set * rule.ambient_rays + r];
        const Vec3 d{l.x * s.x + l.y * t.x + l.z * n.x, l.x * s.y + l.y * t.y + l.z * n.y, l.x * s.z + l.y * t.z + l.z * n.z};
        open += !is_blocked(solid, volume.box, start, d, rule.ambient_reach_vox);
    }
    return static_cast<float>(open) / static_cast<float>(rule.ambient_rays);
}

VDBCARVE_HD Shade shade_surface(const RenderVolume& volume, const RenderRule& rule, const PixelRay& ray, int set) {
    FieldReader field(*volume.near.grid, volume.near.base, 1.f / volume.voxel_size);
    SightCells near(volume.near);
    Vec3 hit;
    if (!find_surface(field, near, volume, ray, rule.iso_vox, hit)) return {};
    const Vec3 to_eye{-ray.direction.x, -ray.direction.y, -ray.direction.z};
    const Vec3 n = field.normal(hit.x, hit.y, hit.z, to_eye);
    Rgb color = rule.plain;
    if (rule.use_color && volume.color) ColorGridReader(*volume.color, volume.near.base).at(hit.x, hit.y, hit.z, color);
    SightCells solid(volume.solid);
    return {lit(color, n, to_eye, rule.lights, openness(solid, volume, rule, hit, n, set)), 1.f};
}

VDBCARVE_HD Shade shade_voxels(const RenderVolume& volume, const RenderRule& rule, const PixelRay& ray) {
    SightCells cells(volume.solid);
    CellWalk walk(volume.box, ray.start, ray.direction, kFarthest_vox);
    nanovdb::Coord before = walk.cell;
    while (walk.at <= walk.end) {
        const int width = cells.width(walk.cell);
        if (width > 0) {
            before = walk.cell;
            walk.leave(width);
            continue;
        }
        // The face it came through is the one that was entered last.
        int face = 0;
        float last = -1e30f;
        for (int a = 0; a < 3; ++a) {
            if (walk.along[a] == 0.f) continue;
            const float enter = (static_cast<float>(walk.along[a] > 0.f ? walk.cell[a] : walk.cell[a] + 1) - walk.from[a]) * walk.inverse[a];
            if (enter > last) last = enter, face = a;
        }
        float n[3] = {0.f, 0.f, 0.f};
        n[face] = walk.along[face] > 0.f ? -1.f : 1.f;
        Rgb color = rule.plain;
        if (rule.use_color && volume.color) ColorGridReader(*volume.color, volume.solid.base).voxel(walk.cell[0], walk.cell[1], walk.cell[2], color);
        return {lit(color, {n[0], n[1], n[2]}, {-ray.direction.x, -ray.direction.y, -ray.direction.z}, rule.lights, 1.f), 1.f};
    }
    return {};
}

VDBCARVE_HD Shade shade_xray(const RenderVolume& volume, const RenderRule& rule, const PixelRay& ray) {
    CellWalk walk(volume.box, ray.start, ray.direction, kFarthest_vox);
    const nanovdb::DefaultReadAccessor<float> accessor = volume.solid.grid->getAccessor();
    float inside = 0.f;
    while (walk.at <= walk.end) {
        const ColorBase& b = volume.solid.base;
        const nanovdb::Coord c(walk.cell[0] + b.i, walk.cell[1] + b.j, walk.cell[2] + b.k);
        const int dim = static_cast<int>(accessor.getDim(c, 0));  // 1 within leaves, else the tile's
        const float from = walk.at;
        const bool in = accessor.getValue(c) < volume.solid.threshold;
        walk.leave(dim);
        if (in) inside += min_f(walk.at, walk.end) - from;
    }
    if (!(inside > 0.f)) return {};
    // What is let through: 1 / (1 + x)^2 falls nearly as an exponential does, and is a division.
    const float x = 0.41421356f * inside / rule.thickness_vox, through = 1.f / ((1.f + x) * (1.f + x));
    return {times(1.f - through, rule.plain), 1.f - through};
}

VDBCARVE_HD Shade shade_slice(const RenderVolume& volume, const RenderRule& rule, const PixelRay& ray) {
    const Vec3 n{rule.plane[0], rule.plane[1], rule.plane[2]};
    const float slope = dot(n, ray.direction);
    if (slope == 0.f) return {};
    const Vec3 p = along(ray.start, -(dot(n, ray.start) + rule.plane[3]) / slope, ray.direction);
    const float q[3] = {p.x + 0.5f, p.y + 0.5f, p.z + 0.5f};
    for (int a = 0; a < 3; ++a)
        if (q[a] < volume.box.lo[a] || q[a] > volume.box.hi[a]) return {};
    FieldReader field(*volume.near.grid, volume.near.base, 1.f / volume.voxel_size);
    const float value = field.at(p.x, p.y, p.z) - rule.iso_vox;
    if (value < rule.line_vox && value > -rule.line_vox) return {{0.f, 0.f, 0.f}, 1.f};
    if (value > 0.f) return {};
    Rgb color = rule.plain;
    if (rule.use_color && volume.color) ColorGridReader(*volume.color, volume.near.base).at(p.x, p.y, p.z, color);
    return {color, 1.f};
}

VDBCARVE_HD uint32_t srgb8(const RenderRule& rule, float linear) {
    const float at = min_f(max_f(linear, 0.f), 1.f) * static_cast<float>(kSrgbSteps - 1) + 0.5f;
    return rule.srgb[static_cast<int>(at)];
}

/// R, G, B and alpha from the lowest byte on; sRGB, not premultiplied.
VDBCARVE_HD uint32_t pixel_of(const RenderRule& rule, const Shade& sum, float rays) {
    const float alpha = sum.alpha / rays;
    if (rule.opaque) {
        const float behind = 1.f - alpha;
        return srgb8(rule, sum.color.r / rays + behind * rule.background.r) | srgb8(rule, sum.color.g / rays + behind * rule.background.g) << 8 |
               srgb8(rule, sum.color.b / rays + behind * rule.background.b) << 16 | 0xff000000u;
    }
    if (!(sum.alpha > 0.f)) return 0;
    return srgb8(rule, sum.color.r / sum.alpha) | srgb8(rule, sum.color.g / sum.alpha) << 8 | srgb8(rule, sum.color.b / sum.alpha) << 16 |
           static_cast<uint32_t>(255.f * alpha + 0.5f) << 24;
}

/// `style` is the rule's: one known when compiling, a kernel for each.
template <int style>
VDBCARVE_HD uint32_t render_pixel(const RenderVolume& volume, const RenderRule& rule, int x, int y) {
    Shade sum;
    for (int sy = 0; sy < rule.samples; ++sy)
        for (int sx = 0; sx < rule.samples; ++sx) {
            const double step = 1.0 / rule.samples;
            const PixelRay ray = pixel_ray(rule, volume.box, x + (sx + 0.5) * step, y + (sy + 0.5) * step);
            if (!ray.hits) continue;
            // One ray a pixel: neighbours ask other directions, 4 x 4 pixels all of them. Several: every pixel asks the same, so that no pattern shows.
            const int set = rule.samples == 1 ? (x & 3) | (y & 3) << 2 : (sx + rule.samples * sy) * 5 % kAmbientSets;
            Shade s;
            if constexpr (style == kRenderSurface) s = shade_surface(volume, rule, ray, set);
            else if constexpr (style == kRenderVoxels) s = shade_voxels(volume, rule, ray);
            else if constexpr (style == kRenderXRay) s = shade_xray(volume, rule, ray);
            else s = shade_slice(volume, rule, ray);
            sum.color = plus(sum.color, 1.f, s.color);
            sum.alpha += s.alpha;
        }
    return pixel_of(rule, sum, static_cast<float>(rule.samples * rule.samples));
}

/// work(constant): the style as one known when compiling, as constant.value.
template <class Work>
void with_style(int style, const Work& work) {
    switch (style) {
        case kRenderSurface:
            work(std::integral_constant<int, kRenderSurface>());
            break;
        case kRenderVoxels:
            work(std::integral_constant<int, kRenderVoxels>());
            break;
        case kRenderXRay:
            work(std::integral_constant<int, kRenderXRay>());
            break;
        default:
            work(std::integral_constant<int, kRenderSlice>());
    }
}

}  // namespace vdbcarve::kernel
