// SPDX-License-Identifier: Apache-2.0
// Compiled once an instruction set with VDBCARVE_ISA set to its name. Plain loops over arrays that the compiler
// turns into vectors; only the gathers are spelled out. No templates or inline functions of other headers, which
// the linker might share with code for lesser machines.
#include "base/vector_loops.h"

#include <cstring>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#include "vdbcarve/kernel/distance.h"
#include "vdbcarve/kernel/fair_motion.h"
#include "vdbcarve/kernel/filter.h"
#include "vdbcarve/kernel/level_set.h"
#include "vdbcarve/kernel/stereo.h"

namespace vdbcarve {
namespace {

using namespace kernel;

/// Pairs of neighbouring samples, the first in the low half.
inline void gather_pairs(const int16_t* samples, const int* at, int32_t* out) {
#if defined(__AVX512F__)
    for (int n = 0; n < kCellVoxels; n += 16)
        _mm512_storeu_si512(out + n, _mm512_mask_i32gather_epi32(_mm512_setzero_si512(), 0xffff, _mm512_loadu_si512(at + n), samples, 2));
#elif defined(__AVX2__)
    for (int n = 0; n < kCellVoxels; n += 8)
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + n),
                            _mm256_i32gather_epi32(reinterpret_cast<const int*>(samples), _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at + n)), 2));
#else
    for (int n = 0; n < kCellVoxels; ++n) std::memcpy(out + n, samples + at[n], sizeof(int32_t));
#endif
}

/// True when all values have reached the band.
bool raise_cell(const CarveView& view, const LeafToCamera& leaf, int cell, float band, float* __restrict values) {
    alignas(64) float z[kCellVoxels], mx[kCellVoxels], my[kCellVoxels], a[kCellVoxels], b[kCellVoxels];
    alignas(64) int32_t at[kCellVoxels], top[kCellVoxels], bottom[kCellVoxels];
    const CarveView c = view;  // a copy: nothing the loops write can change it
    const float i0 = static_cast<float>(cell >> 2 & 1) * 4.f, j0 = static_cast<float>(cell >> 1 & 1) * 4.f, k0 = static_cast<float>(cell & 1) * 4.f;
    for (int n = 0; n < kCellVoxels; ++n) {
        const Vec3 p = voxel_in_camera(leaf, i0 + static_cast<float>(n >> 4), j0 + static_cast<float>(n >> 2 & 3), k0 + static_cast<float>(n & 3));
        const Projected q = project(c, p);
        const PatchPlace place = patch_place(c.silhouette, q.u, q.v);
        z[n] = p.z;
        mx[n] = q.mx;
        my[n] = q.my;
        at[n] = place.at;
        a[n] = place.a;
        b[n] = place.b;
    }
    gather_pairs(c.silhouette.samples, at, top);
    gather_pairs(c.silhouette.samples + c.silhouette.width, at, bottom);
    int below = 0;
    for (int n = 0; n < kCellVoxels; ++n) {
        const Patch patch{static_cast<float>(static_cast<int32_t>(static_cast<uint32_t>(top[n]) << 16) >> 16),
                          static_cast<float>(top[n] >> 16),
                          static_cast<float>(static_cast<int32_t>(static_cast<uint32_t>(bottom[n]) << 16) >> 16),
                          static_cast<float>(bottom[n] >> 16),
                          a[n],
                          b[n]};
        const float v = patch_value(c, patch, mx[n], my[n], z[n], band);
        const float most = max_f(values[n], v);
        values[n] = most;
        below |= most < band;
    }
    return !below;
}

CellAnswers raise_leaf(const CarveView& view, const int origin[3], unsigned alive, float ball_radius, float band, float* values) {
    const LeafToCamera leaf = leaf_to_camera(view, origin[0], origin[1], origin[2]);
    const CarveView c = view;
    CellProbe probes[kLeafCells];
    for (int cell = 0; cell < kLeafCells; ++cell) {
        const Vec3 centre = voxel_in_camera(leaf, static_cast<float>(cell >> 2 & 1) * 4.f + 1.5f, static_cast<float>(cell >> 1 & 1) * 4.f + 1.5f,
                                            static_cast<float>(cell & 1) * 4.f + 1.5f);
        probes[cell] = cell_probe(c, centre, ball_radius, band);
    }
    CellAnswers out{0, 0, 0};
    for (int cell = 0; cell < kLeafCells; ++cell) {
        if (!(alive >> cell & 1)) continue;
        const NodeAnswer answer = cell_answer(view.silhouette, probes[cell]);
        if (answer == NodeAnswer::Out) {
            out.out |= 1u << cell;
        } else if (answer == NodeAnswer::Mixed) {  // In: never the largest value within the band
            out.mixed |= 1u << cell;
            if (raise_cell(view, leaf, cell, band, values + cell * kCellVoxels)) out.full |= 1u << cell;
        }
    }
    return out;
}

// ------------------------------------------------------------------------------------ distance

constexpr int kPad = 4;   // around the window, so that pieces of contour are drawn without asking where the window ends
constexpr int kRun = 64;  // pixels that are looked at together

inline int least(int a, int b) { return b < a ? b : a; }

/// out = min over |d| <= steps of source[d * step] + (64 d)^2 for kRun pixels; at most `before` and `after` steps exist
/// on either side.
void lower_envelope(const int32_t* source, int64_t step, int before, int after, int steps, int32_t* __restrict out) {
    int32_t best[kRun];
    for (int n = 0; n < kRun; ++n) best[n] = source[n];
    for (int d = 1; d <= steps; ++d) {
        const int32_t add = d * d * (kSubpixel * kSubpixel);
        if (d <= before) {
            const int32_t* s = source - d * step;
            for (int n = 0; n < kRun; ++n) best[n] = best[n] < s[n] + add ? best[n] : s[n] + add;
        }
        if (d <= after) {
            const int32_t* s = source + d * step;
            for (int n = 0; n < kRun; ++n) best[n] = best[n] < s[n] + add ? best[n] : s[n] + add;
        }
        if ((d & 3) == 0) {
            int32_t worst = 0;
            for (int n = 0; n < kRun; ++n) worst = best[n] > worst ? best[n] : worst;
            if (worst <= add) break;
        }
    }
    for (int n = 0; n < kRun; ++n) out[n] = out[n] < best[n] ? out[n] : best[n];
}

/// Calls change(x) where the mask changes side between a[x] and b[x]: eight pixels at a time, by their top bits.
template <class Change>
inline void for_each_change(const uint8_t* a, const uint8_t* b, int count, const Change& change) {
    constexpr uint64_t kTop = 0x8080808080808080ull;
    int x = 0;
    for (; x + 8 <= count; x += 8) {
        uint64_t p, q;
        std::memcpy(&p, a + x, 8);
        std::memcpy(&q, b + x, 8);
        uint64_t differ = (p ^ q) & kTop;
        while (differ) {
            change(x + (__builtin_ctzll(differ) >> 3));
            differ &= differ - 1;
        }
    }
    for (; x < count; ++x)
        if ((a[x] ^ b[x]) & 0x80) change(x);
}

void window_distance(const WindowDistance& job) {
    // Reads better whole: a kernel whose sweeps share the rows that they leave in the scratch.
    const int width = job.width, height = job.height, reach = job.reach;
    const int steps = reach / kSubpixel + 1;
    const int32_t cap = reach * reach;
    // Rows are padded to whole runs on the right and by kPad on all sides.
    const int64_t pitch = (width + kRun - 1) / kRun * kRun + 2 * kPad;
    const int64_t plane = pitch * (height + 2 * kPad);
    int32_t* const best = job.scratch;       // squared distance
    int32_t* const vertical = best + plane;  // along columns, to crossings on vertical edges
    int32_t* const horizontal = vertical + plane;
    int32_t* const row_least = horizontal + plane;  // of both, per run of a row
    const int runs = static_cast<int>((pitch - 2 * kPad) / kRun);
    const int64_t run_plane = static_cast<int64_t>(runs) * height;
    int32_t* const column_least = row_least + run_plane;
    for (int64_t n = 0; n < plane; ++n) best[n] = cap;
    for (int64_t n = 0; n < 2 * plane; ++n) vertical[n] = reach;
    const int64_t first = kPad * pitch + kPad;

    for (int y = 1; y < height; ++y) {
        const uint8_t *above = job.coverage + (y - 1) * job.stride, *here = above + job.stride;
        int32_t *d_above = vertical + first + (y - 1) * pitch, *d_here = d_above + pitch;
        for (int x = 0; x < width; ++x) d_here[x] = d_above[x] + kSubpixel < reach ? d_above[x] + kSubpixel : reach;
        for_each_change(above, here, width, [&](int x) {
            const int t = crossing(above[x], here[x]);
            d_above[x] = least(d_above[x], t);
            d_here[x] = least(kSubpixel - t, reach);
        });
    }
    for (int y = height - 2; y >= 0; --y) {
        int32_t* here = vertical + first + y * pitch;
        const int32_t* below = here + pitch;
        for (int x = 0; x < width; ++x) here[x] = here[x] < below[x] + kSubpixel ? here[x] : below[x] + kSubpixel;
    }
    for (int y = 0; y < height; ++y) {
        const uint8_t* m = job.coverage + y * job.stride;
        int32_t* d = horizontal + first + y * pitch;
        int from = 0, left = -(1 << 28);  // position, 1/64 px, of the crossing to the left
        const auto fill = [&](int to, int left_at, int right_at) {
            for (int x = from; x < to; ++x) {
                const int l = kSubpixel * x - left_at, r = right_at - kSubpixel * x;
                const int both = l < r ? l : r;
                d[x] = both < reach ? both : reach;
            }
            from = to;
        };
        for_each_change(m, m + 1, width - 1, [&](int x) {
            const int at = kSubpixel * x + crossing(m[x], m[x + 1]);
            fill(x + 1, left, at);
            left = at;
        });
        if (left >= 0) fill(width, left, 1 << 28);
    }
    for (int y = 0; y < height; ++y)
        for (int run = 0; run < runs; ++run) {
            int32_t *v = vertical + first + y * pitch + run * kRun, *h = horizontal + first + y * pitch + run * kRun;
            int32_t v_least = reach, h_least = reach;
            for (int n = 0; n < kRun; ++n) {
                v_least = v[n] < v_least ? v[n] : v_least;
                h_least = h[n] < h_least ? h[n] : h_least;
                v[n] = v[n] * v[n];
                h[n] = h[n] * h[n];
            }
            row_least[y * runs + run] = v_least;
            column_least[y * runs + run] = h_least;
        }
    const int across = steps / kRun + 1;
    // One row at a time with as many empty pixels on either side as a look across may reach.
    int32_t* const row = column_least + run_plane;
    for (int n = 0; n < 2 * steps + runs * kRun; ++n) row[n] = cap;
    for (int y = 0; y < height; ++y) {
        std::memcpy(row + steps, vertical + first + y * pitch, sizeof(int32_t) * static_cast<size_t>(runs * kRun));
        for (int run = 0; run < runs; ++run) {
            int32_t* out = best + first + y * pitch + run * kRun;
            bool near = false;
            for (int r = run - across; r <= run + across; ++r) near = near || (r >= 0 && r < runs && row_least[y * runs + r] < reach);
            if (near) lower_envelope(row + steps + run * kRun, 1, steps, steps, steps, out);
            near = false;
            const int y0 = y - steps > 0 ? y - steps : 0, y1 = y + steps < height - 1 ? y + steps : height - 1;
            for (int r = y0; r <= y1 && !near; ++r) near = column_least[r * runs + run] < reach;
            if (near) lower_envelope(horizontal + first + y * pitch + run * kRun, pitch, y, height - 1 - y, steps, out);
        }
    }

    // Straight pieces of contour, near them.
    for (int y = 0; y + 1 < height; ++y) {
        const uint8_t *m0 = job.coverage + y * job.stride, *m1 = m0 + job.stride;
        const auto draw = [&](int x) {
            const ContourPieces pieces = contour_pieces(m0[x], m0[x + 1], m1[x + 1], m1[x]);
            for (int p = 0; p < pieces.count; ++p) {
                const Segment s = make_segment(pieces.ax[p], pieces.ay[p], pieces.bx[p], pieces.by[p]);
                int32_t* corner = best + first + (y - kRefine_px) * pitch + x - kRefine_px;
                for (int r = 0; r < 2 * kRefine_px + 2; ++r) {
                    int32_t* line = corner + r * pitch;
                    const float py = static_cast<float>((r - kRefine_px) * kSubpixel);
                    for (int n = 0; n < 2 * kRefine_px + 2; ++n) {
                        const int32_t d2 = segment_distance2(s, static_cast<float>((n - kRefine_px) * kSubpixel), py);
                        line[n] = line[n] < d2 ? line[n] : d2;
                    }
                }
            }
        };
        // A cell has contour where its four corners are not all on one side.
        constexpr uint64_t kTop = 0x8080808080808080ull;
        int x = 0;
        for (; x + 9 <= width; x += 8) {
            uint64_t a, b, c, d;
            std::memcpy(&a, m0 + x, 8);
            std::memcpy(&b, m0 + x + 1, 8);
            std::memcpy(&c, m1 + x, 8);
            std::memcpy(&d, m1 + x + 1, 8);
            uint64_t differ = ((a ^ b) | (a ^ c) | (a ^ d)) & kTop;
            while (differ) {
                draw(x + (__builtin_ctzll(differ) >> 3));
                differ &= differ - 1;
            }
        }
        for (; x + 1 < width; ++x)
            if (((m0[x] ^ m0[x + 1]) | (m0[x] ^ m1[x]) | (m0[x] ^ m1[x + 1])) & 0x80) draw(x);
    }

    for (int y = 0; y < height; ++y) {
        const uint8_t* m = job.coverage + y * job.stride;
        const int32_t* d2 = best + first + y * pitch;
        int16_t* out = job.out + static_cast<int64_t>(y) * width;
        const int offset = job.offset, clamp = job.clamp;
        for (int x = 0; x < width; ++x) {
            const int32_t d = root_of(d2[x]);
            int32_t s = (m[x] >= 128 ? -d : d) - offset;
            s = s < clamp ? s : clamp;
            s = s > -clamp ? s : -clamp;
            out[x] = static_cast<int16_t>(s);
        }
    }
}

// ------------------------------------------------------------------------------------ level set

// Slices of 8 rows are gone through as they lie in the halo, the two voxels between rows included.
constexpr int kSlice = 78;

inline void copy_rows(const float* slice, float* out) {
    for (int row = 0; row < 8; ++row) std::memcpy(out + row * 8, slice + row * 10, 8 * sizeof(float));
}

void measure_leaf(const float* halo, float band_vox, float* out) {
    for (int i = 0; i < 8; ++i) {
        const float* h = halo + (i + 1) * 100 + 11;
        float slice[80];
        for (int n = 0; n < kSlice; ++n) {
            const float here = h[n];
            const float x = opposite(here, h[n - 100], h[n + 100]), y = opposite(here, h[n - 10], h[n + 10]), z = opposite(here, h[n - 1], h[n + 1]);
            const float d =
                plane_distance(here, slope(here, h[n - 100], h[n + 100], x), slope(here, h[n - 10], h[n + 10], y), slope(here, h[n - 1], h[n + 1], z));
            slice[n] = max_f(max_f(x, y), z) < 0.f ? band_vox : -min_f(d, band_vox);
        }
        copy_rows(slice, out + i * 64);
    }
}

int redistance_leaf(const float* halo, float band_vox, float* out) {
    int changed = 0;
    for (int i = 0; i < 8; ++i) {
        const float* h = halo + (i + 1) * 100 + 11;
        float slice[80];
        for (int n = 0; n < kSlice; ++n) {
            const float x = min_f(std::fabs(h[n - 100]), std::fabs(h[n + 100]));
            const float y = min_f(std::fabs(h[n - 10]), std::fabs(h[n + 10]));
            const float z = min_f(std::fabs(h[n - 1]), std::fabs(h[n + 1]));
            const float solved = min_f(eikonal(x, y, z), band_vox);
            slice[n] = h[n] < 0.f ? h[n] : min_f(solved, h[n]);
        }
        copy_rows(slice, out + i * 64);
        for (int row = 0; row < 8; ++row)
            for (int k = 0; k < 8; ++k) changed |= out[i * 64 + row * 8 + k] != h[row * 10 + k];
    }
    return changed;
}

/// kernel::blurred of values that are `stride` apart, for `count` places in a row.
inline void blur_along(const float* __restrict from, int stride, const float weight[5], int count, float* __restrict to) {
    const float w[5] = {weight[0], weight[1], weight[2], weight[3], weight[4]};
    for (int q = 0; q < count; ++q) to[q] = blurred(w, [from, stride, q](int n) { return from[q + n * stride]; });
}

void blur_leaf(const float* halo, const float weight[5], float* out) {
    constexpr int S = 16;
    static_assert(S == 8 + 2 * kFairReach);
    alignas(64) float x[8 * S * S], y[8 * 8 * S];
    for (int i = 0; i < 8; ++i) blur_along(halo + (i + 4) * S * S, S * S, weight, S * S, x + i * S * S);
    for (int i = 0; i < 8; ++i) blur_along(x + i * S * S + 4 * S, S, weight, 8 * S, y + i * 8 * S);
    for (int row = 0; row < 64; ++row) blur_along(y + row * S + 4, 1, weight, 8, out + row * 8);
}

void straighten_leaf(const float* halo, const float* hull, float* out) {
    for (int row = 0; row < 64; ++row) {
        const float* h = halo + ((row >> 3) + 1) * 100 + ((row & 7) + 1) * 10 + 1;
        float* to = out + row * 8;
        for (int k = 0; k < 8; ++k) to[k] = straightened([h, k](int a, int b, int c) { return h[a * 100 + b * 10 + c + k]; }, hull[row * 8 + k]);
    }
}

/// Eight voxels in a row along z.
typedef float Lanes __attribute__((vector_size(32)));

inline Lanes load(const float* from) {
    Lanes out;
    std::memcpy(&out, from, sizeof out);
    return out;
}

constexpr int halo_step(int i, int j, int k) { return (i * kFilterHalo + j) * kFilterHalo + k; }

/// The 5^3 filter with its normals, which are made for the voxels around first.
template <class Out>
void edge_preserving_leaf(const FilterPass& pass, const float* first, float band_vox, const Out& out) {
    float x[kFilterHaloVoxels], y[kFilterHaloVoxels], z[kFilterHaloVoxels];
    const int r = pass.width, side = 8 + 2 * r;
    for (int i = 0; i < side; ++i)
        for (int j = 0; j < side; ++j)
            for (int k = 0; k < side; k += 8) {
                const int at = halo_step(i - r, j - r, (k + 8 > side ? side - 8 : k) - r);
                const BandNormal<Lanes> n = band_normal<Lanes>([&](int di, int dj, int dk) { return load(first + at + halo_step(di, dj, dk)); });
                const int to = at + halo_step(kMostFilterWidth, kMostFilterWidth, kMostFilterWidth);
                std::memcpy(x + to, &n.x, sizeof n.x);
                std::memcpy(y + to, &n.y, sizeof n.y);
                std::memcpy(z + to, &n.z, sizeof n.z);
            }
    for (int row = 0; row < 64; ++row) {
        const int here = halo_step(row >> 3, row & 7, 0), to = here + halo_step(kMostFilterWidth, kMostFilterWidth, kMostFilterWidth);
        out(row, edge_preserving<Lanes>([&](int i, int j, int k) { return load(first + here + halo_step(i, j, k)); },
                                        [&](int i, int j, int k) {
                                            const int at = to + halo_step(i, j, k);
                                            return BandNormal<Lanes>{load(x + at), load(y + at), load(z + at)};
                                        },
                                        r, band_vox));
    }
}

void filter_leaf(const FilterPass& pass, const float* halo, float band_vox, float* result) {
    const float* first = halo + halo_step(kMostFilterWidth, kMostFilterWidth, kMostFilterWidth);
    const auto out = [result](int row, const Lanes& v) { std::memcpy(result + 8 * row, &v, sizeof v); };
    const auto rows = [&](const auto& work) {
        for (int row = 0; row < 64; ++row) {
            const float* here = first + halo_step(row >> 3, row & 7, 0);
            out(row, work([here](int i, int j, int k) { return load(here + halo_step(i, j, k)); }));
        }
    };
    const auto lines = [&](const auto& work) {
        const int step = halo_step(pass.axis == 0, pass.axis == 1, pass.axis == 2);
        for (int row = 0; row < 64; ++row) {
            const float* here = first + halo_step(row >> 3, row & 7, 0);
            out(row, work([here, step](int n) { return load(here + n * step); }));
        }
    };
    switch (pass.kind) {
        case FilterPass::Median:
            if (pass.width == 1) rows([](const auto& at) { return median_around<1, Lanes>(at); });
            else rows([](const auto& at) { return median_around<2, Lanes>(at); });
            break;
        case FilterPass::MeanCurvature:
            rows([](const auto& at) { return mean_curvature_step<Lanes>(at); });
            break;
        case FilterPass::MeanOfSix:
            rows([](const auto& at) { return mean_of_six<Lanes>(at); });
            break;
        case FilterPass::Box:
            lines([&](const auto& line) { return box_along<Lanes>(line, pass.width); });
            break;
        case FilterPass::Least:
            lines([&](const auto& line) { return least_along<Lanes>(line, pass.width); });
            break;
        case FilterPass::EdgePreserving:
            edge_preserving_leaf(pass, first, band_vox, out);
            break;
    }
}

void first_planes(const StereoReference& reference, int y, StereoBest* planes) {
    for (int x = 0; x < reference.image.width; ++x) planes[y * reference.image.width + x] = first_plane(reference, x, y);
}

void better_planes(const StereoReference& reference, int y, int pass, int color, StereoBest* planes) {
    for (int x = (y + color) & 1; x < reference.image.width; x += 2) planes[y * reference.image.width + x] = better_plane(reference, planes, x, y, pass);
}

void likelihoods(const StereoReference& reference, const StereoTrustRule& rule, int y, const StereoBest* planes, float* out) {
    for (int x = 0; x < reference.image.width; ++x) {
        const int n = y * reference.image.width + x;
        out[n] = likelihood(reference, planes[n], rule, x, y);
    }
}

}  // namespace

#define VDBCARVE_STRING2(x) #x
#define VDBCARVE_STRING(x) VDBCARVE_STRING2(x)
#define VDBCARVE_JOIN2(a, b) a##b
#define VDBCARVE_JOIN(a, b) VDBCARVE_JOIN2(a, b)

const VectorLoops& VDBCARVE_JOIN(vector_loops_, VDBCARVE_ISA)();
const VectorLoops& VDBCARVE_JOIN(vector_loops_, VDBCARVE_ISA)() {
    static constexpr VectorLoops kLoops{VDBCARVE_STRING(VDBCARVE_ISA),
                                        raise_leaf,
                                        window_distance,
                                        measure_leaf,
                                        redistance_leaf,
                                        blur_leaf,
                                        straighten_leaf,
                                        filter_leaf,
                                        first_planes,
                                        better_planes,
                                        likelihoods};
    return kLoops;
}

}  // namespace vdbcarve
