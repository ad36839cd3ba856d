// SPDX-License-Identifier: Apache-2.0
#include "distance_cuda.h"

#include <algorithm>
#include <climits>

#include "vdbcarve/kernel/carve.h"
#include "vdbcarve/kernel/distance.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

struct CoarseJob {
    const uint8_t* from;
    uint8_t* to;
    int width, height, coarse_width, coarse_height, scale;
    bool largest;
};

struct IgnoreJob {
    const uint8_t *coverage, *ignore;
    uint8_t *unknown_as_object, *seen;
    int count;
};

struct BoxJob {
    const uint8_t* image;
    int width, height;
};

struct WindowJob {
    const uint8_t* mask;  ///< first pixel of the window
    int stride;
    int width, height;
    int reach, offset, clamp;
    double block_offset;
    int16_t *samples, *blocks, *vertical, *horizontal;
    int32_t *best, *along;  ///< along: three per block
    /// Tiles of 32 x 8 samples: a row of flags for distances along columns that are in reach, a row for those along rows, and so on.
    uint8_t* near;
    int tiles_across;
    int columns, rows;  ///< of blocks
};

__device__ bool object_at(const WindowJob& job, int x, int y) { return is_object(job.mask[static_cast<size_t>(y) * job.stride + x]); }

__global__ void coarser(const CoarseJob* jobs) {
    const CoarseJob job = jobs[blockIdx.z];
    const int x = blockIdx.x * blockDim.x + threadIdx.x, y = blockIdx.y;
    if (x >= job.coarse_width || y >= job.coarse_height) return;
    int sum = 0, most = 0, n = 0;
    for (int v = y * job.scale; v < min((y + 1) * job.scale, job.height); ++v)
        for (int u = x * job.scale; u < min((x + 1) * job.scale, job.width); ++u, ++n) {
            const int value = job.from[static_cast<size_t>(v) * job.width + u];
            sum += value;
            most = max(most, value);
        }
    job.to[static_cast<size_t>(y) * job.coarse_width + x] = static_cast<uint8_t>(job.largest ? most : (sum + n / 2) / n);
}

__global__ void set_ignored(const IgnoreJob* jobs) {
    const IgnoreJob job = jobs[blockIdx.z];
    for (int p = blockIdx.x * blockDim.x + threadIdx.x; p < job.count; p += gridDim.x * blockDim.x) {
        const bool ignored = job.ignore[p] != 0;
        job.unknown_as_object[p] = ignored ? 255 : job.coverage[p];
        job.seen[p] = ignored ? 0 : 255;
    }
}

/// Sixteen pixels a load: images start at multiples of 16 and may be read up to the next one; what lies there is left out.
__global__ void object_boxes(const BoxJob* jobs, ObjectBox* boxes) {
    const BoxJob job = jobs[blockIdx.z];
    const int count = job.width * job.height, quads = (count + 15) / 16;
    int x0 = INT_MAX, y0 = INT_MAX, x1 = -1, y1 = -1;
    for (int q = blockIdx.x * blockDim.x + threadIdx.x; q < quads; q += gridDim.x * blockDim.x) {
        const uint4 w = reinterpret_cast<const uint4*>(job.image)[q];
        const unsigned words[4] = {w.x & 0x80808080u, w.y & 0x80808080u, w.z & 0x80808080u, w.w & 0x80808080u};
        if (!(words[0] | words[1] | words[2] | words[3])) continue;
        for (int k = 0; k < 4; ++k) {
            unsigned bits = words[k];
            while (bits) {
                const int p = 16 * q + 4 * k + (__ffs(bits) - 1) / 8;
                bits &= bits - 1;
                if (p >= count) break;
                const int y = p / job.width, x = p - y * job.width;
                x0 = min(x0, x);
                y0 = min(y0, y);
                x1 = max(x1, x);
                y1 = max(y1, y);
            }
        }
    }
    for (int d = 16; d; d /= 2) {
        x0 = min(x0, __shfl_xor_sync(~0u, x0, d));
        y0 = min(y0, __shfl_xor_sync(~0u, y0, d));
        x1 = max(x1, __shfl_xor_sync(~0u, x1, d));
        y1 = max(y1, __shfl_xor_sync(~0u, y1, d));
    }
    if (threadIdx.x % 32 == 0 && x1 >= 0) {
        ObjectBox& box = boxes[blockIdx.z];
        atomicMin(&box.x0, x0);
        atomicMin(&box.y0, y0);
        atomicMax(&box.x1, x1);
        atomicMax(&box.y1, y1);
    }
}

__global__ void empty_boxes(ObjectBox* boxes, int count) {
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n < count) boxes[n] = {INT_MAX, INT_MAX, -1, -1};
}

constexpr int kRows = 32;  // of a column that one thread goes through

/// Along columns, to the nearest crossing on a vertical edge; also prepares `best`.
__global__ void vertical_distance(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int x = blockIdx.x * blockDim.x + threadIdx.x, y0 = blockIdx.y * kRows;
    if (x >= job.width || y0 >= job.height) return;
    const uint8_t* column = job.mask + x;
    const int reach = job.reach, cap = reach * reach, last = min(y0 + kRows, job.height) - 1;
    constexpr int kNone = 1 << 28;
    const auto at = [&](int y) { return column[static_cast<size_t>(y) * job.stride]; };
    // Position, in 1/64, of the last crossing above the first row.
    int above = -kNone;
    {
        uint8_t below = at(y0);
        for (int y = y0 - 1; y >= 0 && kSubpixel * (y0 - y - 1) < reach; --y) {
            const uint8_t here = at(y);
            if ((here ^ below) & 0x80) {
                above = kSubpixel * y + crossing(here, below);
                break;
            }
            below = here;
        }
    }
    int up[kRows];
    uint8_t before = at(y0);
#pragma unroll
    for (int r = 0; r < kRows; ++r) {
        const int y = y0 + r;
        if (y > last) break;
        const uint8_t here = at(y);
        if ((here ^ before) & 0x80) above = kSubpixel * (y - 1) + crossing(before, here);
        before = here;
        up[r] = kSubpixel * y - above;
    }
    int below_at = kNone;
    {
        uint8_t upper = at(last);
        for (int y = last + 1; y < job.height && kSubpixel * (y - 1 - last) < reach; ++y) {
            const uint8_t here = at(y);
            if ((here ^ upper) & 0x80) {
                below_at = kSubpixel * (y - 1) + crossing(upper, here);
                break;
            }
            upper = here;
        }
    }
    uint8_t under = at(last);
    unsigned in_reach = 0;  // of each 8 rows
#pragma unroll
    for (int r = kRows - 1; r >= 0; --r) {
        const int y = y0 + r;
        if (y > last) continue;
        const uint8_t here = at(y);
        if ((here ^ under) & 0x80) below_at = kSubpixel * y + crossing(here, under);
        under = here;
        const int d = min(min(up[r], below_at - kSubpixel * y), reach);
        if (d < reach) in_reach |= 1u << (r / 8);
        job.vertical[static_cast<size_t>(y) * job.width + x] = static_cast<int16_t>(d);
        job.best[static_cast<size_t>(y) * job.width + x] = cap;
    }
    for (int n = 0; n < kRows / 8; ++n)
        if (in_reach >> n & 1) job.near[(y0 / 8 + n) * 2 * job.tiles_across + x / 32] = 1;
}

/// Along rows, to the nearest crossing on a horizontal edge. A warp takes 32 pixels and looks up changes of side as bits.
__global__ void horizontal_distance(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int lane = threadIdx.x % 32;
    const int word = blockIdx.x * (blockDim.x / 32) + threadIdx.x / 32, y = blockIdx.y;
    const int words = (job.width + 31) / 32;
    if (word >= words || y >= job.height) return;
    const uint8_t* row = job.mask + static_cast<size_t>(y) * job.stride;
    const auto changes = [&](int w) {
        const int x = 32 * w + lane;
        return __ballot_sync(~0u, x + 1 < job.width && ((row[x] ^ row[x + 1]) & 0x80));
    };
    const auto position = [&](int x) { return kSubpixel * x + crossing(row[x], row[x + 1]); };
    const int x = 32 * word + lane, steps = job.reach / kSubpixel + 1;
    constexpr int kNone = 1 << 28;
    int left = -kNone, right = kNone;
    const unsigned own = changes(word);
    const unsigned before = own & ((1u << lane) - 1), after = own & ~((1u << lane) - 1);
    if (before) left = position(32 * word + 31 - __clz(before));
    if (after) right = position(32 * word + __ffs(after) - 1);
    for (int w = word - 1; w >= 0 && 32 * (word - w) - 31 <= steps; --w) {
        const unsigned bits = changes(w);
        if (bits && left == -kNone) left = position(32 * w + 31 - __clz(bits));
        if (__all_sync(~0u, left != -kNone)) break;
    }
    for (int w = word + 1; w < words && 32 * (w - word) - 31 <= steps; ++w) {
        const unsigned bits = changes(w);
        if (bits && right == kNone) right = position(32 * w + __ffs(bits) - 1);
        if (__all_sync(~0u, right != kNone)) break;
    }
    const int d = min(min(kSubpixel * x - left, right - kSubpixel * x), job.reach);
    if (x < job.width) job.horizontal[static_cast<size_t>(y) * job.width + x] = static_cast<int16_t>(d);
    if (__any_sync(~0u, x < job.width && d < job.reach) && lane == 0) job.near[((y / 8) * 2 + 1) * job.tiles_across + word] = 1;
}

/// Straight pieces of contour, near them. A lane looks at a cell; where it has contour, the whole warp draws it.
__global__ void contour_distance(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int lane = threadIdx.x % 32, x_of_warp = blockIdx.x * blockDim.x + threadIdx.x - lane, y = blockIdx.y;
    if (x_of_warp + 1 >= job.width || y + 1 >= job.height) return;
    const uint8_t* row = job.mask + static_cast<size_t>(y) * job.stride;
    const auto corners = [&](int x) {
        const uint8_t *m0 = row + x, *m1 = m0 + job.stride;
        return make_uchar4(m0[0], m0[1], m1[1], m1[0]);
    };
    bool contour = false;
    if (x_of_warp + lane + 1 < job.width) {
        const uchar4 c = corners(x_of_warp + lane);
        contour = ((c.x ^ c.y) | (c.x ^ c.z) | (c.x ^ c.w)) & 0x80;
    }
    constexpr int kSide = 2 * kRefine_px + 2;  // 8 x 8 samples around a cell: two a lane
    static_assert(kSide == 8);
    for (unsigned rest = __ballot_sync(~0u, contour); rest; rest &= rest - 1) {
        const int x = x_of_warp + __ffs(rest) - 1;
        const uchar4 c = corners(x);
        const ContourPieces pieces = contour_pieces(c.x, c.y, c.z, c.w);
        for (int p = 0; p < pieces.count; ++p) {
            const Segment s = make_segment(pieces.ax[p], pieces.ay[p], pieces.bx[p], pieces.by[p]);
            for (int half = 0; half < 2; ++half) {
                const int n = lane % kSide - kRefine_px, r = lane / kSide + 4 * half - kRefine_px;
                if (y + r < 0 || y + r >= job.height || x + n < 0 || x + n >= job.width) continue;
                atomicMin(job.best + static_cast<size_t>(y + r) * job.width + x + n,
                          segment_distance2(s, static_cast<float>(n * kSubpixel), static_cast<float>(r * kSubpixel)));
            }
        }
    }
}

/// The smallest over all lines and columns in reach, then sign, offset and clamp.
__global__ void least_distance(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    if (static_cast<int>(blockIdx.x) * 32 >= job.width || static_cast<int>(blockIdx.y) * 8 >= job.height) return;
    const int x = blockIdx.x * 32 + threadIdx.x, y = blockIdx.y * 8 + threadIdx.y;
    const int steps = job.reach / kSubpixel + 1;
    // Most tiles see nothing within reach: along their rows no distance down a column, along their columns none along a row.
    const int flat = static_cast<int>(threadIdx.y * 32 + threadIdx.x), down_tiles = (job.height + 7) / 8;
    const int left = steps / 32 + 1, up = steps / 8 + 1;
    bool any = false;
    for (int n = flat; n < 2 * left + 1; n += 256) {
        const int tile = static_cast<int>(blockIdx.x) - left + n;
        any = any || (tile >= 0 && tile < job.tiles_across && job.near[blockIdx.y * 2 * job.tiles_across + tile]);
    }
    for (int n = flat; n < 2 * up + 1; n += 256) {
        const int tile = static_cast<int>(blockIdx.y) - up + n;
        any = any || (tile >= 0 && tile < down_tiles && job.near[(tile * 2 + 1) * job.tiles_across + blockIdx.x]);
    }
    any = __syncthreads_or(any);
    if (x >= job.width || y >= job.height) return;
    const size_t at = static_cast<size_t>(y) * job.width + x;
    const int16_t* across = job.vertical + at;
    const int16_t* down = job.horizontal + at;
    int best = job.best[at];
    if (any) {
        best = min(best, static_cast<int>(*across) * *across);
        best = min(best, static_cast<int>(*down) * *down);
    }
    for (int d = 1; any && d <= steps; ++d) {
        const int add = d * d * (kSubpixel * kSubpixel);
        if (add >= best) break;
        const auto take = [&](int v) { best = min(best, v * v + add); };
        if (x - d >= 0) take(across[-d]);
        if (x + d < job.width) take(across[d]);
        if (y - d >= 0) take(down[-static_cast<ptrdiff_t>(d) * job.width]);
        if (y + d < job.height) take(down[static_cast<ptrdiff_t>(d) * job.width]);
    }
    const int32_t d = root_of(best);
    int32_t s = (object_at(job, x, y) ? -d : d) - job.offset;
    s = s < job.clamp ? s : job.clamp;
    s = s > -job.clamp ? s : -job.clamp;
    job.samples[at] = static_cast<int16_t>(s);
}

constexpr int kFarBlocks = 1 << 12;

/// Which sides occur in a block: bit 0 object, bit 1 background.
__global__ void block_sides(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int b = blockIdx.x * blockDim.x + threadIdx.x;
    if (b >= job.columns * job.rows) return;
    const int bx = b % job.columns, by = b / job.columns;
    int sides = 0;
    for (int y = by * kBlock_px; y < min((by + 1) * kBlock_px, job.height); ++y)
        for (int x = bx * kBlock_px; x < min((bx + 1) * kBlock_px, job.width); ++x) sides |= object_at(job, x, y) ? 1 : 2;
    job.along[b] = sides;
}

/// Distances in blocks along each column to the nearest block with the side. Over the flags: [0] stays what it was
/// in its low bits, the distances are kept above them.
__global__ void block_columns(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int n = blockIdx.x * blockDim.x + threadIdx.x;
    const int bx = n / 2, side = n % 2;
    if (bx >= job.columns) return;
    int32_t* out = job.along + static_cast<size_t>(job.columns) * job.rows * (1 + side);
    int d = kFarBlocks;
    for (int y = 0; y < job.rows; ++y) {
        const int at = y * job.columns + bx;
        out[at] = d = (job.along[at] >> side & 1) ? 0 : min(d + 1, kFarBlocks);
    }
    d = kFarBlocks;
    for (int y = job.rows - 1; y >= 0; --y) {
        const int at = y * job.columns + bx;
        out[at] = d = min(out[at], d + 1);
    }
}

__device__ int gap_px(int blocks) { return max(blocks - 1, 0) * kBlock_px; }

__global__ void block_bounds(const WindowJob* jobs) {
    const WindowJob job = jobs[blockIdx.z];
    const int b = blockIdx.x * blockDim.x + threadIdx.x;
    const int count = job.columns * job.rows;
    if (b >= count) return;
    const int x = b % job.columns, row = b - x;
    const int sides = job.along[b];
    if (sides == 3) {
        job.blocks[b] = 0;
        return;
    }
    const bool inside = sides == 1;
    const int32_t* along = job.along + static_cast<size_t>(count) * (inside ? 2 : 1) + row;  // to the other side
    long long best = LLONG_MAX;
    for (int d = 0; d < job.columns; ++d) {
        const long long across = gap_px(d);
        if (across * across >= best) break;
        for (int s = -1; s <= 1; s += 2) {
            const int n = x + s * d;
            if (n < 0 || n >= job.columns || along[n] >= kFarBlocks) continue;
            const long long down = gap_px(along[n]);
            best = min(best, across * across + down * down);
        }
    }
    const int distance = best == LLONG_MAX ? INT16_MAX : static_cast<int>(sqrt(static_cast<double>(best)));
    job.blocks[b] = static_cast<int16_t>(block_bound(distance, inside, job.block_offset));
}

/// How many pieces of `size` samples cover `count`.
int pieces_of(int count, int size) { return static_cast<int>(blocks_for(static_cast<size_t>(count), static_cast<unsigned>(size))); }

}  // namespace

void DistanceStage::begin_upload(const std::vector<HostMask>& masks, size_t bytes) {
    masks_.ensure(bytes);
    geometry_.clear();
    coverage_at_.clear();
    ignore_at_.clear();
    size_t at = 0;
    for (const HostMask& m : masks) {
        geometry_.push_back({m.width, m.height, m.ignore != nullptr});
        coverage_at_.push_back(at);
        at += padded(m);
        ignore_at_.push_back(at);
        if (m.ignore) at += padded(m);
    }
}

std::vector<ObjectBox> DistanceStage::prepare(int scale, bool conservative, const Stream& stream) {
    const size_t n = geometry_.size();
    if (n == 0) return {};
    stream.wait();  // jobs made before may still be on their way from host memory
    const auto up = [](size_t bytes) { return (bytes + 15) / 16 * 16; };
    // Where prepared images lie: coarse coverage, coarse ignore, then coverage with ignored as object, and what is seen.
    size_t bytes = 0;
    std::vector<size_t> coarse_at(n), coarse_ignore_at(n), marked_at(n), seen_at(n);
    std::vector<int> width(n), height(n);
    for (size_t i = 0; i < n; ++i) {
        width[i] = (geometry_[i].width + scale - 1) / scale;
        height[i] = (geometry_[i].height + scale - 1) / scale;
        const size_t size = up(static_cast<size_t>(width[i]) * static_cast<size_t>(height[i]));
        const auto take = [&](bool wanted) {
            const size_t at = bytes;
            if (wanted) bytes += size;
            return at;
        };
        coarse_at[i] = take(scale > 1);
        coarse_ignore_at[i] = take(scale > 1 && geometry_[i].ignores);
        marked_at[i] = take(geometry_[i].ignores);
        seen_at[i] = take(geometry_[i].ignores);
    }
    uint8_t* prepared = prepared_.ensure(bytes);
    if (bytes) stream.zero(prepared, bytes);

    std::vector<CoarseJob> coarse;
    std::vector<IgnoreJob> ignored;
    std::vector<BoxJob> boxes;
    silhouettes_.assign(n, {});
    seen_.assign(n, {});
    int most_width = 0, most_height = 0;
    for (size_t i = 0; i < n; ++i) {
        const Geometry& g = geometry_[i];
        most_width = std::max(most_width, width[i]);
        most_height = std::max(most_height, height[i]);
        const uint8_t *coverage = masks_.data() + coverage_at_[i], *ignore = masks_.data() + ignore_at_[i];
        if (scale > 1) {
            coarse.push_back({coverage, prepared + coarse_at[i], g.width, g.height, width[i], height[i], scale, conservative});
            coverage = prepared + coarse_at[i];
            if (g.ignores) {
                coarse.push_back({ignore, prepared + coarse_ignore_at[i], g.width, g.height, width[i], height[i], scale, true});
                ignore = prepared + coarse_ignore_at[i];
            }
        }
        if (g.ignores) {
            ignored.push_back({coverage, ignore, prepared + marked_at[i], prepared + seen_at[i], width[i] * height[i]});
            coverage = prepared + marked_at[i];
            seen_[i] = {prepared + seen_at[i], width[i], height[i]};
        }
        silhouettes_[i] = {coverage, width[i], height[i]};
        boxes.push_back({coverage, width[i], height[i]});
    }
    const size_t coarse_bytes = coarse.size() * sizeof(CoarseJob), ignored_bytes = ignored.size() * sizeof(IgnoreJob),
                 box_bytes = boxes.size() * sizeof(BoxJob);
    uint8_t* host = host_jobs_.ensure(coarse_bytes + ignored_bytes + box_bytes);
    std::copy_n(reinterpret_cast<const uint8_t*>(coarse.data()), coarse_bytes, host);
    std::copy_n(reinterpret_cast<const uint8_t*>(ignored.data()), ignored_bytes, host + coarse_bytes);
    std::copy_n(reinterpret_cast<const uint8_t*>(boxes.data()), box_bytes, host + coarse_bytes + ignored_bytes);
    uint8_t* jobs = jobs_.ensure(coarse_bytes + ignored_bytes + box_bytes);
    stream.to_device(jobs, host, coarse_bytes + ignored_bytes + box_bytes);
    const cudaStream_t s = stream.get();
    if (!coarse.empty()) {
        coarser<<<dim3(pieces_of(most_width, 128), most_height, coarse.size()), 128, 0, s>>>(reinterpret_cast<const CoarseJob*>(jobs));
        VDBCARVE_LAUNCHED();
    }
    if (!ignored.empty()) {
        set_ignored<<<dim3(64, 1, ignored.size()), 256, 0, s>>>(reinterpret_cast<const IgnoreJob*>(jobs + coarse_bytes));
        VDBCARVE_LAUNCHED();
    }
    ObjectBox* found = boxes_.ensure(n);
    empty_boxes<<<pieces_of(static_cast<int>(n), 128), 128, 0, s>>>(found, static_cast<int>(n));
    VDBCARVE_LAUNCHED();
    object_boxes<<<dim3(std::clamp(most_width * most_height / 16384, 1, 256), 1, n), 256, 0, s>>>(
        reinterpret_cast<const BoxJob*>(jobs + coarse_bytes + ignored_bytes), found);
    VDBCARVE_LAUNCHED();
    stream.to_host(host_boxes_.ensure(n), found, n);
    stream.wait();
    return {host_boxes_.data(), host_boxes_.data() + n};
}

std::vector<DeviceField> DistanceStage::make(const std::vector<FieldJob>& jobs, const Stream& stream) {
    if (jobs.empty()) return {};
    stream.wait();  // the host's list of jobs is written anew
    size_t samples = 0, blocks = 0, tiles = 0;
    // The last rows of flags of a thread's 32 rows may lie beyond the window.
    const auto tiles_of = [](const WindowJob& w) {
        return static_cast<size_t>(w.tiles_across) * 2 * static_cast<size_t>(pieces_of(w.height, kRows)) * (kRows / 8);
    };
    int most_width = 0, most_height = 0, most_columns = 0, most_blocks = 0;
    std::vector<DeviceField> out(jobs.size());
    std::vector<WindowJob> windows(jobs.size());
    const auto even = [](size_t count) { return (count + 7) / 8 * 8; };  // fields start at multiples of 16 bytes
    for (size_t j = 0; j < jobs.size(); ++j) {
        const FieldJob& job = jobs[j];
        const DeviceImage& image = (job.of_ignored ? seen_ : silhouettes_)[static_cast<size_t>(job.view)];
        WindowJob& w = windows[j];
        w = {image.data + static_cast<size_t>(job.y0) * static_cast<size_t>(image.width) + job.x0,
             image.width,
             job.width,
             job.height,
             job.reach,
             job.offset,
             job.clamp,
             job.block_offset,
             nullptr,
             nullptr,
             nullptr,
             nullptr,
             nullptr,
             nullptr,
             nullptr,
             pieces_of(job.width, 32),
             pieces_of(job.width, kBlock_px),
             pieces_of(job.height, kBlock_px)};
        out[j].sample_count = static_cast<size_t>(job.width) * static_cast<size_t>(job.height);
        out[j].block_count = static_cast<size_t>(w.columns) * static_cast<size_t>(w.rows);
        out[j].blocks_per_row = w.columns;
        samples += even(out[j].sample_count);
        blocks += even(out[j].block_count);
        tiles += tiles_of(w);
        most_width = std::max(most_width, job.width);
        most_height = std::max(most_height, job.height);
        most_columns = std::max(most_columns, w.columns);
        most_blocks = std::max(most_blocks, w.columns * w.rows);
    }
    samples_.ensure(samples);
    vertical_.ensure(samples);
    horizontal_.ensure(samples);
    best_.ensure(samples);
    blocks_.ensure(blocks);
    block_scratch_.ensure(3 * blocks);
    near_.ensure(tiles);
    stream.zero(near_.data(), tiles);
    size_t sample_at = 0, block_at = 0, tile_at = 0;
    for (size_t j = 0; j < jobs.size(); ++j) {
        WindowJob& w = windows[j];
        out[j].samples = w.samples = samples_.data() + sample_at;
        w.vertical = vertical_.data() + sample_at;
        w.horizontal = horizontal_.data() + sample_at;
        w.best = best_.data() + sample_at;
        out[j].blocks = w.blocks = blocks_.data() + block_at;
        w.along = block_scratch_.data() + 3 * block_at;
        w.near = near_.data() + tile_at;
        tile_at += tiles_of(w);
        sample_at += even(out[j].sample_count);
        block_at += even(out[j].block_count);
    }
    const size_t bytes = windows.size() * sizeof(WindowJob);
    uint8_t* host = host_jobs_.ensure(bytes);
    std::copy_n(reinterpret_cast<const uint8_t*>(windows.data()), bytes, host);
    stream.to_device(jobs_.ensure(bytes), host, bytes);
    const auto* device = reinterpret_cast<const WindowJob*>(jobs_.data());
    const unsigned n = static_cast<unsigned>(jobs.size());
    const cudaStream_t s = stream.get();
    vertical_distance<<<dim3(pieces_of(most_width, 128), pieces_of(most_height, kRows), n), 128, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    horizontal_distance<<<dim3(pieces_of(pieces_of(most_width, 32), 4), most_height, n), 128, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    contour_distance<<<dim3(pieces_of(most_width, 128), most_height, n), 128, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    least_distance<<<dim3(pieces_of(most_width, 32), pieces_of(most_height, 8), n), dim3(32, 8), 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    block_sides<<<dim3(pieces_of(most_blocks, 128), 1, n), 128, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    block_columns<<<dim3(pieces_of(2 * most_columns, 64), 1, n), 64, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    block_bounds<<<dim3(pieces_of(most_blocks, 128), 1, n), 128, 0, s>>>(device);
    VDBCARVE_LAUNCHED();
    return out;
}

size_t DistanceStage::bytes() const {
    return masks_.bytes() + prepared_.bytes() + samples_.bytes() + blocks_.bytes() + vertical_.bytes() + horizontal_.bytes() + best_.bytes() +
           block_scratch_.bytes();
}

}  // namespace vdbcarve::cuda
