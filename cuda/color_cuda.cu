// SPDX-License-Identifier: Apache-2.0
#include "color_cuda.h"

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>
#include <cub/device/device_select.cuh>
#include <thrust/iterator/counting_iterator.h>

#include "vdbcarve/kernel/color_fill.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;
using Nano = nanovdb::NanoGrid<float>;

constexpr unsigned kAll = ~0u;
constexpr unsigned kThreads = 256;

/// Reads the grid, quickly within one leaf.
struct LeafReader {
    nanovdb::DefaultReadAccessor<float> accessor;
    const Grid::Leaf& leaf;
    nanovdb::Coord origin;

    __device__ LeafReader(const Nano* grid, const Grid::Leaf& l) : accessor(grid->getAccessor()), leaf(l), origin(l.origin()) {}
    __device__ float operator()(int i, int j, int k) const {
        if (((i ^ origin[0]) | (j ^ origin[1]) | (k ^ origin[2])) & ~7) return accessor.getValue(nanovdb::Coord(i, j, k));
        return leaf.data()->mValues[(i & 7) << 6 | (j & 7) << 3 | (k & 7)];
    }
};

__global__ void __launch_bounds__(kLeafVoxels) mark_contour(const Nano* grid, const Grid::Leaf* leaves, uint32_t* words, uint32_t* counts) {
    __shared__ unsigned sum;
    const uint32_t n = blockIdx.x;
    const int t = threadIdx.x;
    if (t == 0) sum = 0;
    __syncthreads();
    const LeafReader value(grid, leaves[n]);
    const nanovdb::Coord o = value.origin;
    const bool in = is_contour(value, leaves[n].data()->mValues[t], o[0] + (t >> 6), o[1] + (t >> 3 & 7), o[2] + (t & 7));
    const unsigned word = __ballot_sync(kAll, in);
    if (t % 32 == 0) {
        words[16 * n + t / 32] = word;
        atomicAdd(&sum, __popc(word));
    }
    __syncthreads();
    if (t == 0) counts[n] = sum;
}

__global__ void __launch_bounds__(kLeafVoxels) list_contour(const uint32_t* words, const uint32_t* first, uint32_t* contour) {
    const uint32_t n = blockIdx.x;
    const int t = threadIdx.x;
    const unsigned word = words[16 * n + t / 32], bit = 1u << (t % 32);
    if (!(word & bit)) return;
    uint32_t at = first[n] + __popc(word & (bit - 1));
    for (int w = 0; w < t / 32; ++w) at += __popc(words[16 * n + w]);
    contour[at] = n * kLeafVoxels + t;
}

__global__ void make_points(const Nano* grid, const Grid::Leaf* leaves, const uint32_t* contour, uint32_t count, float voxel, NormalRule rule, ColorBase base,
                            SurfacePoint* points) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const Grid::Leaf& leaf = leaves[contour[n] / kLeafVoxels];
    const int t = static_cast<int>(contour[n] % kLeafVoxels);
    const LeafReader value(grid, leaf);
    points[n] =
        surface_point(value, leaf.data()->mValues[t], voxel, value.origin[0] + (t >> 6), value.origin[1] + (t >> 3 & 7), value.origin[2] + (t & 7), rule, base);
}

__global__ void __launch_bounds__(128) observe_places(SightGrid sight, const SurfacePoint* points, const uint32_t* places, uint32_t count,
                                                      const ColorView* views, uint32_t view_count, ColorRule rule, Observation* out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count * view_count) return;
    SightCells cells(sight);
    out[n] = observe(cells, views[n % view_count], points[places[n / view_count]], rule);
}

__global__ void __launch_bounds__(128) find(SightGrid sight, const SurfacePoint* points, uint32_t count, const ColorView* views, int first, int last,
                                            ColorRule rule, Candidate* candidates, uint8_t* counts) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    SightCells cells(sight);
    counts[n] = static_cast<uint8_t>(
        kernel::find_views(cells, views, first, last, rule, points[n], candidates + static_cast<size_t>(n) * kept_candidates(rule), counts[n]));
}

__global__ void decide_points(const SurfacePoint* points, uint32_t count, const ColorView* views, ColorRule rule, const Candidate* candidates,
                              const uint8_t* counts, Rgb* colors, uint8_t* blended, float* confidence, uint32_t* voxels_of_view, uint32_t* colored) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const Candidate* found = candidates + static_cast<size_t>(n) * kept_candidates(rule);
    const PointColor c = decide_color(views, rule, points[n], found, counts[n]);
    colors[n] = c.color;
    blended[n] = static_cast<uint8_t>(c.views);
    confidence[n] = c.confidence;
    if (counts[n]) {
        atomicAdd(voxels_of_view + found[0].view, 1u);
        atomicAdd(colored, 1u);
    }
}

// ------------------------------------------------------------------------------------ filling

__global__ void make_keys(const Grid::Leaf* leaves, const uint32_t* contour, uint32_t count, ColorBase base, uint64_t* keys, uint32_t* numbers) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const nanovdb::Coord o = leaves[contour[n] / kLeafVoxels].origin();
    const int t = static_cast<int>(contour[n] % kLeafVoxels);
    keys[n] = morton_of_voxel(o[0] + (t >> 6) - base.i, o[1] + (t >> 3 & 7) - base.j, o[2] + (t & 7) - base.k);
    numbers[n] = n;
}

__global__ void gather_cells(const uint32_t* order, uint32_t count, const Rgb* from, const uint8_t* blended, Rgb* colors, uint8_t* known) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    colors[n] = from[order[n]];
    known[n] = blended[order[n]] != 0;
}

__global__ void scatter_cells(const uint32_t* order, uint32_t count, const Rgb* colors, Rgb* to) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n < count) to[order[n]] = colors[n];
}

__global__ void mark_heads(const uint64_t* keys, uint32_t count, int32_t* heads) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n < count) heads[n] = n == 0 || keys[n] >> 3 != keys[n - 1] >> 3;
}

/// `parents` holds how many heads there are up to each cell, itself included: its parent's number and one.
__global__ void list_parents(const uint64_t* keys, uint32_t count, int32_t* parents, uint64_t* parent_keys, int32_t* first) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const int32_t p = parents[n] - 1;
    if (n == 0 || keys[n] >> 3 != keys[n - 1] >> 3) {
        parent_keys[p] = keys[n] >> 3;
        first[p] = static_cast<int32_t>(n);
    }
    if (n + 1 == count) first[p + 1] = static_cast<int32_t>(count);
}

__global__ void color_parents(const Rgb* colors, const uint8_t* known, const int32_t* first, uint32_t count, Rgb* parent_colors, uint8_t* parent_known,
                              uint32_t* unknown) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    Rgb c{0.f, 0.f, 0.f};
    const bool is_known = parent_color(colors, known, first[n], first[n + 1], c);
    parent_colors[n] = c;
    parent_known[n] = is_known;
    if (!is_known) atomicAdd(unknown, 1u);
}

__global__ void mark_unknown(const uint8_t* known, uint32_t count, uint8_t* flags) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n < count) flags[n] = !known[n];
}

/// Unknown cells start from their parent's colour; where their neighbours are.
__global__ void begin_level(const uint64_t* keys, uint32_t count, const uint32_t* cells, uint32_t cell_count, const int32_t* parents, const Rgb* parent_colors,
                            Rgb* colors, int32_t* neighbours) {
    const size_t at = static_cast<size_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (at >= static_cast<size_t>(cell_count) * kFillNeighbours) return;
    const auto c = static_cast<uint32_t>(at % cell_count), n = static_cast<uint32_t>(at / cell_count);
    const uint32_t cell = cells[c];
    neighbours[at] = fill_neighbour(keys, static_cast<int32_t>(count), static_cast<int32_t>(cell), static_cast<int>(n));
    if (n == 0) colors[cell] = parent_colors[parents[cell] - 1];
}

__global__ void sweep(const uint32_t* cells, uint32_t cell_count, const int32_t* neighbours, const Rgb* from, Rgb* to) {
    const uint32_t c = blockIdx.x * blockDim.x + threadIdx.x;
    if (c >= cell_count) return;
    Relaxation relaxation(from[cells[c]]);
    for (int n = 0; n < kFillNeighbours; ++n) {
        const int32_t at = neighbours[static_cast<size_t>(n) * cell_count + c];
        if (at >= 0) relaxation.add(from[at], n);
    }
    to[cells[c]] = relaxation.value();
}

// ------------------------------------------------------------------------------------ spreading

__global__ void place_contour(const uint32_t* contour, uint32_t count, const Rgb* colors, Rgb* leaf_colors, uint8_t* layers) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    leaf_colors[contour[n]] = colors[n];
    layers[contour[n]] = 0;
}

/// One layer. Others may be given theirs, this pass's, at the same time: that is not the one asked for.
__global__ void __launch_bounds__(kLeafVoxels) spread_layer(const Grid::Leaf* leaves, const int32_t* neighbours, float deepest, float least_weight, int pass,
                                                            Rgb* colors, uint8_t* layers, uint8_t* waiting) {
    const uint32_t n = blockIdx.x;
    if (pass > 1 && !waiting[n]) return;
    const int t = threadIdx.x;
    const Grid::Leaf& leaf = leaves[n];
    const float here = leaf.data()->mValues[t];
    const size_t own = static_cast<size_t>(n) * kLeafVoxels + t;
    const bool todo = layers[own] == kNoLayer && leaf.valueMask().isOn(t) && here > deepest;
    bool left = todo;
    if (todo) {
        const auto neighbour = [&](int face, float& value, Rgb& c) {
            const int shift = face / 2 == 0 ? 6 : face / 2 == 1 ? 3 : 0, to = (t >> shift & 7) + (face % 2 ? 1 : -1);
            int64_t other = n;
            if (to & ~7) other = neighbours[6 * n + face];
            if (other < 0) return false;
            const int there = (t & ~(7 << shift)) | (to & 7) << shift;
            if (layers[other * kLeafVoxels + there] != pass - 1) return false;
            value = leaves[other].data()->mValues[there];
            c = colors[other * kLeafVoxels + there];
            return true;
        };
        Rgb out;
        if (spread_color(here, least_weight, neighbour, out)) {
            colors[own] = out;
            layers[own] = static_cast<uint8_t>(pass);
            left = false;
        }
    }
    const bool any = __syncthreads_or(left);
    if (t == 0) waiting[n] = any;
}

}  // namespace

struct ColorStage::Parts {
    DeviceBuffer<uint32_t> words, leaf_counts, leaf_first, contour, places, voxels_of_view, colored;
    DeviceBuffer<float> weights, confidence, linear8, linear16;
    DeviceBuffer<SurfacePoint> points;
    DeviceBuffer<ColorView> views, all_views;
    DeviceBuffer<Observation> observations;
    DeviceBuffer<Candidate> candidates;
    DeviceBuffer<uint8_t> counts, blended, scratch;
    DeviceBuffer<Rgb> colors, leaf_colors;
    DeviceBuffer<uint8_t> layers, waiting;
    DeviceBuffer<int32_t> neighbours;
    PinnedBuffer<uint32_t> host;
    DeviceBuffer<uint64_t> walls;
    SightGrid sight{};
    uint32_t contour_count = 0;
    int views_found = 0;

    struct Level {
        DeviceBuffer<uint64_t> keys;
        DeviceBuffer<Rgb> colors, other;
        DeviceBuffer<uint8_t> known;
        DeviceBuffer<int32_t> first, parent;
        uint32_t count = 0, unknown = 0;
        size_t bytes() const { return keys.bytes() + colors.bytes() + other.bytes() + known.bytes() + first.bytes() + parent.bytes(); }
    };
    std::vector<Level> levels;
    DeviceBuffer<uint64_t> unsorted;
    DeviceBuffer<uint32_t> numbers, order, cells;
    DeviceBuffer<uint8_t> flags;
    DeviceBuffer<int32_t> cell_neighbours;

    uint8_t* scratch_for(size_t bytes) { return scratch.ensure(bytes); }
};

ColorStage::ColorStage() : parts_(std::make_unique<Parts>()) {}
ColorStage::~ColorStage() = default;

uint32_t ColorStage::find_contour(const Grid& surface, const ColorBase& base, int normal_radius_vox, const std::vector<float>& weights, const Stream& stream,
                                  StageTimes& times) {
    Parts& p = *parts_;
    const uint32_t n = surface.leaf_count();
    const cudaStream_t s = stream.get();
    p.words.ensure(16 * static_cast<size_t>(n));
    uint32_t* counts = p.leaf_counts.ensure(n + 1);
    uint32_t* first = p.leaf_first.ensure(n + 1);
    uint32_t* host = p.host.ensure(4);
    size_t scratch = 0;
    VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(nullptr, scratch, counts, first, static_cast<int>(n + 1), s));
    p.scratch_for(scratch);
    if (!weights.empty()) stream.to_device(p.weights.ensure(weights.size()), weights.data(), weights.size());
    times.measure("color: contour", stream, [&] {
        stream.zero(counts + n, 1);
        mark_contour<<<n, kLeafVoxels, 0, s>>>(surface.grid(), surface.leaves(), p.words.data(), counts);
        VDBCARVE_LAUNCHED();
        VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(p.scratch.data(), scratch, counts, first, static_cast<int>(n + 1), s));
        stream.to_host(host, first + n, 1);
        stream.wait();
        p.contour_count = host[0];
        if (p.contour_count == 0) return;
        list_contour<<<n, kLeafVoxels, 0, s>>>(p.words.data(), first, p.contour.ensure(p.contour_count));
        VDBCARVE_LAUNCHED();
        const float threshold = kSightBlock_vox * static_cast<float>(surface.spec().voxel_size);
        uint64_t* walls = p.walls.ensure(static_cast<size_t>(n) * kWallWords);
        build_walls(surface, threshold, walls, stream);
        p.sight = {surface.grid(), walls, threshold, base};
        make_points<<<blocks_for(p.contour_count, kThreads), kThreads, 0, s>>>(surface.grid(), surface.leaves(), p.contour.data(), p.contour_count,
                                                                               static_cast<float>(surface.spec().voxel_size),
                                                                               {normal_radius_vox, p.weights.data()}, base, p.points.ensure(p.contour_count));
        VDBCARVE_LAUNCHED();
    });
    p.views_found = 0;
    return p.contour_count;
}

const float* ColorStage::linear(bool wide, const std::vector<float>& table, const Stream& stream) {
    DeviceBuffer<float>& buffer = wide ? parts_->linear16 : parts_->linear8;
    if (!buffer.data()) {
        stream.to_device(buffer.ensure(table.size()), table.data(), table.size());
        stream.wait();
    }
    return buffer.data();
}

void ColorStage::observe(const std::vector<ColorView>& views, const ColorRule& rule, const std::vector<uint32_t>& places, std::vector<Observation>& out,
                         const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const size_t count = places.size() * views.size();
    stream.to_device(p.views.ensure(views.size()), views.data(), views.size());
    stream.to_device(p.places.ensure(places.size()), places.data(), places.size());
    p.observations.ensure(count);
    times.measure("color: exposure", stream, [&] {
        observe_places<<<blocks_for(count, 128), 128, 0, stream.get()>>>(p.sight, p.points.data(), p.places.data(), static_cast<uint32_t>(places.size()),
                                                                         p.views.data(), static_cast<uint32_t>(views.size()), rule, p.observations.data());
        VDBCARVE_LAUNCHED();
    });
    out.resize(count);
    stream.to_host(out.data(), p.observations.data(), count);
    stream.wait();
}

void ColorStage::find_views(const std::vector<ColorView>& views, int first, const ColorRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    stream.to_device(p.views.ensure(views.size()), views.data(), views.size());
    stream.wait();  // the caller's memory
    p.candidates.ensure(static_cast<size_t>(p.contour_count) * static_cast<size_t>(kept_candidates(rule)));
    p.counts.ensure(p.contour_count);
    times.measure("color: views", stream, [&] {
        if (p.views_found++ == 0) stream.zero(p.counts.data(), p.contour_count);
        find<<<blocks_for(p.contour_count, 128), 128, 0, stream.get()>>>(p.sight, p.points.data(), p.contour_count, p.views.data(), first,
                                                                         first + static_cast<int>(views.size()), rule, p.candidates.data(), p.counts.data());
        VDBCARVE_LAUNCHED();
    });
}

uint32_t ColorStage::decide(const std::vector<ColorView>& views, const ColorRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    stream.to_device(p.all_views.ensure(views.size()), views.data(), views.size());
    p.voxels_of_view.ensure(views.size());
    p.colored.ensure(1);
    p.colors.ensure(p.contour_count);
    p.blended.ensure(p.contour_count);
    p.confidence.ensure(p.contour_count);
    times.measure("color: views", stream, [&] {
        stream.zero(p.voxels_of_view.data(), views.size());
        stream.zero(p.colored.data(), 1);
        decide_points<<<blocks_for(p.contour_count, kThreads), kThreads, 0, stream.get()>>>(
            p.points.data(), p.contour_count, p.all_views.data(), rule, p.candidates.data(), p.counts.data(), p.colors.data(), p.blended.data(),
            p.confidence.data(), p.voxels_of_view.data(), p.colored.data());
        VDBCARVE_LAUNCHED();
        stream.to_host(p.host.data(), p.colored.data(), 1);
    });
    stream.wait();
    return p.host[0];
}

void ColorStage::fill(const Grid& surface, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const cudaStream_t s = stream.get();
    const uint32_t n = p.contour_count, colored = p.host[0];
    if (colored == 0 || colored == n) return;
    p.levels.resize(kMortonBits + 2);
    uint32_t* host = p.host.data();
    times.measure("color: fill", stream, [&] {
        size_t scratch = 0, more = 0;
        p.unsorted.ensure(n);
        p.numbers.ensure(n);
        p.order.ensure(n);
        Parts::Level& base = p.levels[0];
        base.count = n;
        base.unknown = n - colored;
        base.keys.ensure(n);
        VDBCARVE_CUDA(cub::DeviceRadixSort::SortPairs(nullptr, scratch, p.unsorted.data(), base.keys.data(), p.numbers.data(), p.order.data(),
                                                      static_cast<int>(n), 0, 3 * kMortonBits, s));
        p.flags.ensure(n);
        p.cells.ensure(base.unknown);
        p.cell_neighbours.ensure(static_cast<size_t>(base.unknown) * kFillNeighbours);  // coarser levels have fewer
        const thrust::counting_iterator<uint32_t> numbers(0);
        VDBCARVE_CUDA(cub::DeviceSelect::Flagged(nullptr, more, numbers, p.flags.data(), p.cells.data(), p.colored.data(), static_cast<int>(n), s));
        scratch = std::max(scratch, more);
        VDBCARVE_CUDA(cub::DeviceScan::InclusiveSum(nullptr, more, base.parent.ensure(n), base.parent.data(), static_cast<int>(n), s));
        scratch = std::max(scratch, more);
        p.scratch_for(scratch);
        make_keys<<<blocks_for(n, kThreads), kThreads, 0, s>>>(surface.leaves(), p.contour.data(), n, p.sight.base, p.unsorted.data(), p.numbers.data());
        VDBCARVE_LAUNCHED();
        VDBCARVE_CUDA(cub::DeviceRadixSort::SortPairs(p.scratch.data(), scratch, p.unsorted.data(), base.keys.data(), p.numbers.data(), p.order.data(),
                                                      static_cast<int>(n), 0, 3 * kMortonBits, s));
        gather_cells<<<blocks_for(n, kThreads), kThreads, 0, s>>>(p.order.data(), n, p.colors.data(), p.blended.data(), base.colors.ensure(n),
                                                                  base.known.ensure(n));
        VDBCARVE_LAUNCHED();
        size_t top = 0;
        for (; p.levels[top].unknown; ++top) {
            Parts::Level &fine = p.levels[top], &coarse = p.levels[top + 1];
            const unsigned blocks = blocks_for(fine.count, kThreads);
            mark_heads<<<blocks, kThreads, 0, s>>>(fine.keys.data(), fine.count, fine.parent.ensure(fine.count));
            VDBCARVE_LAUNCHED();
            VDBCARVE_CUDA(cub::DeviceScan::InclusiveSum(p.scratch.data(), scratch, fine.parent.data(), fine.parent.data(), static_cast<int>(fine.count), s));
            list_parents<<<blocks, kThreads, 0, s>>>(fine.keys.data(), fine.count, fine.parent.data(), coarse.keys.ensure(fine.count),
                                                     coarse.first.ensure(static_cast<size_t>(fine.count) + 1));
            VDBCARVE_LAUNCHED();
            VDBCARVE_CUDA(cudaMemcpyAsync(host + 1, fine.parent.data() + fine.count - 1, sizeof(uint32_t), cudaMemcpyDeviceToHost, s));
            stream.wait();
            coarse.count = host[1];
            stream.zero(p.colored.data(), 1);
            color_parents<<<blocks_for(coarse.count, kThreads), kThreads, 0, s>>>(fine.colors.data(), fine.known.data(), coarse.first.data(), coarse.count,
                                                                                  coarse.colors.ensure(fine.count), coarse.known.ensure(fine.count),
                                                                                  p.colored.data());
            VDBCARVE_LAUNCHED();
            stream.to_host(host + 2, p.colored.data(), 1);
            stream.wait();
            coarse.unknown = host[2];
        }
        for (size_t l = top; l-- > 0;) {
            Parts::Level &level = p.levels[l], &coarse = p.levels[l + 1];
            mark_unknown<<<blocks_for(level.count, kThreads), kThreads, 0, s>>>(level.known.data(), level.count, p.flags.data());
            VDBCARVE_LAUNCHED();
            VDBCARVE_CUDA(cub::DeviceSelect::Flagged(p.scratch.data(), scratch, numbers, p.flags.data(), p.cells.data(), p.colored.data(),
                                                     static_cast<int>(level.count), s));
            const size_t links = static_cast<size_t>(level.unknown) * kFillNeighbours;
            begin_level<<<blocks_for(links, kThreads), kThreads, 0, s>>>(level.keys.data(), level.count, p.cells.data(), level.unknown, level.parent.data(),
                                                                         coarse.colors.data(), level.colors.data(), p.cell_neighbours.data());
            VDBCARVE_LAUNCHED();
            VDBCARVE_CUDA(cudaMemcpyAsync(level.other.ensure(level.count), level.colors.data(), level.count * sizeof(Rgb), cudaMemcpyDeviceToDevice, s));
            static_assert(kFillSweeps % 2 == 0, "the last sweep must end where the first began");
            Rgb *from = level.colors.data(), *to = level.other.data();
            for (int i = 0; i < kFillSweeps; ++i) {
                sweep<<<blocks_for(level.unknown, kThreads), kThreads, 0, s>>>(p.cells.data(), level.unknown, p.cell_neighbours.data(), from, to);
                VDBCARVE_LAUNCHED();
                std::swap(from, to);
            }
        }
        scatter_cells<<<blocks_for(n, kThreads), kThreads, 0, s>>>(p.order.data(), n, base.colors.data(), p.colors.data());
        VDBCARVE_LAUNCHED();
    });
}

void ColorStage::spread(const Grid& surface, const Topology& topology, int depth_vox, int passes, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const cudaStream_t s = stream.get();
    const uint32_t n = surface.leaf_count();
    const size_t voxels = static_cast<size_t>(n) * kLeafVoxels;
    p.leaf_colors.ensure(voxels);
    p.layers.ensure(voxels);
    p.waiting.ensure(n);
    p.neighbours.ensure(6 * static_cast<size_t>(n));
    const auto voxel = static_cast<float>(surface.spec().voxel_size);
    times.measure("color: spread", stream, [&] {
        stream.zero(p.leaf_colors.data(), voxels);
        VDBCARVE_CUDA(cudaMemsetAsync(p.layers.data(), kNoLayer, voxels, s));
        find_neighbours(topology, surface, p.neighbours.data(), stream);
        place_contour<<<blocks_for(p.contour_count, kThreads), kThreads, 0, s>>>(p.contour.data(), p.contour_count, p.colors.data(), p.leaf_colors.data(),
                                                                                 p.layers.data());
        VDBCARVE_LAUNCHED();
        for (int pass = 1; pass <= passes; ++pass) {
            spread_layer<<<n, kLeafVoxels, 0, s>>>(surface.leaves(), p.neighbours.data(), -static_cast<float>(depth_vox) * voxel, kLeastSpread_vox * voxel,
                                                   pass, p.leaf_colors.data(), p.layers.data(), p.waiting.data());
            VDBCARVE_LAUNCHED();
        }
    });
}

uint32_t ColorStage::contour_count() const { return parts_->contour_count; }
const uint32_t* ColorStage::contour() const { return parts_->contour.data(); }
const uint8_t* ColorStage::views_blended() const { return parts_->blended.data(); }
const float* ColorStage::confidence() const { return parts_->confidence.data(); }
const uint32_t* ColorStage::voxels_of_view() const { return parts_->voxels_of_view.data(); }
const Rgb* ColorStage::leaf_colors() const { return parts_->leaf_colors.data(); }
const uint8_t* ColorStage::layers() const { return parts_->layers.data(); }
size_t ColorStage::bytes() const {
    const Parts& p = *parts_;
    size_t sum = p.words.bytes() + p.walls.bytes() + p.leaf_counts.bytes() + p.leaf_first.bytes() + p.contour.bytes() + p.points.bytes() +
                 p.observations.bytes() + p.candidates.bytes() + p.counts.bytes() + p.blended.bytes() + p.confidence.bytes() + p.colors.bytes() +
                 p.leaf_colors.bytes() + p.layers.bytes() + p.neighbours.bytes() + p.scratch.bytes() + p.unsorted.bytes() + p.numbers.bytes() +
                 p.order.bytes() + p.cells.bytes() + p.flags.bytes() + p.cell_neighbours.bytes();
    for (const Parts::Level& level : p.levels) sum += level.bytes();
    return sum;
}

}  // namespace vdbcarve::cuda
