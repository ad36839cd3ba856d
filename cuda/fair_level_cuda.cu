// SPDX-License-Identifier: Apache-2.0
// The pyramid: which leaves a level has, and what they begin with.
#include <cub/device/device_scan.cuh>

#include <climits>
#include <utility>

#include "fair_leaves.cuh"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kThreads = 256;
/// Outside tiles know of nothing farther away, leaves.
constexpr int kMostFree = 64;

/// A thread a leaf of the grid: the box that holds all, leaf coordinates.
__global__ void find_box(TopologyView topology, const uint32_t* keys, uint32_t count, int* box) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const int3 o = topology.leaf_origin(keys[n]);
    const int at[3] = {o.x >> 3, o.y >> 3, o.z >> 3};
    for (int a = 0; a < 3; ++a) {
        atomicMin(box + a, at[a]);
        atomicMax(box + 3 + a, at[a]);
    }
}

/// A thread a place: whether the grid has a leaf there, or lies inside.
__global__ void find_places(TopologyView topology, FairField f, int64_t places, int32_t* leaf_at) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places) return;
    const int3 o = first_voxel(f, p);
    const int block = topology.block_of(o.x, o.y, o.z);
    if (block < 0) return;
    const int offset = TopologyView::offset_of(o.x, o.y, o.z);
    if (topology.leaf_number(block, offset) >= 0) leaf_at[p] = 0;
    else if (topology.is_inside(block, offset)) leaf_at[p] = kInsideTile;
}

__global__ void mark_leaves(const int32_t* leaf_at, int64_t places, int32_t* marks, uint8_t* near) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places) return;
    marks[p] = leaf_at[p] >= 0;
    near[p] = is_outside(leaf_at[p]) ? kMostFree : 0;
}

__global__ void number_places(int32_t* leaf_at, int64_t places, const int32_t* first, int32_t* place_of) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places || leaf_at[p] < 0) return;
    leaf_at[p] = first[p];
    place_of[first[p]] = static_cast<int32_t>(p);
}

/// Largest of the differences along the axes to what is not outside, one axis after the other. The last one's answers are the tiles'.
__global__ void spread_near(FairField f, int64_t places, int axis, const uint8_t* from, uint8_t* to, int32_t* leaf_at) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places) return;
    const int3 l = leaf_at_place(f, p);
    const int at = (axis == 0 ? l.x : axis == 1 ? l.y : l.z) - f.lo[axis], size = f.size[axis];
    const int64_t step = axis == 0 ? static_cast<int64_t>(f.size[1]) * f.size[2] : axis == 1 ? f.size[2] : 1;
    int best = from[p];
    for (int d = 1; d < best; ++d) {
        if (at - d >= 0) best = min(best, max(d, static_cast<int>(from[p - d * step])));
        if (at + d < size) best = min(best, max(d, static_cast<int>(from[p + d * step])));
    }
    if (leaf_at) {
        if (is_outside(leaf_at[p])) leaf_at[p] = outside_tile(best);
    } else {
        to[p] = static_cast<uint8_t>(best);
    }
}

/// A block of threads a leaf of the grid.
__global__ void __launch_bounds__(kLeafVoxels)
    load_hull(const Grid::Leaf* leaves, TopologyView topology, FairField f, const int32_t* place_of, float voxel, float* out) {
    const int3 o = first_voxel(f, place_of[blockIdx.x]);
    const int64_t source = topology.leaf_number(topology.block_of(o.x, o.y, o.z), TopologyView::offset_of(o.x, o.y, o.z));
    out[static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x] =
        clamp_f(leaves[source].data()->mValues[threadIdx.x] / voxel, -kFairBand_vox, kFairBand_vox);
}

__device__ int64_t place_in(const FairField& f, int x, int y, int z) {
    return (static_cast<int64_t>(x - f.lo[0]) * f.size[1] + (y - f.lo[1])) * f.size[2] + (z - f.lo[2]);
}

/// A thread a finer leaf and one of the 27 coarse ones around: the band is as many voxels wide, so it is twice as wide, and leaves around are needed, too.
__global__ void mark_coarser(FairField fine, const int32_t* place_of, int64_t count, FairField coarse, int32_t* leaf_at) {
    const int64_t n = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const int3 l = leaf_at_place(fine, place_of[n / 27]);
    const int a = static_cast<int>(n % 27);
    leaf_at[place_in(coarse, (l.x >> 1) + a / 9 - 1, (l.y >> 1) + a / 3 % 3 - 1, (l.z >> 1) + a % 3 - 1)] = 0;
}

__global__ void mark_inside(FairField fine, FairField coarse, int64_t places, bool whole, int32_t* leaf_at) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places || leaf_at[p] >= 0) return;
    const int3 l = leaf_at_place(coarse, p);
    if (fine.leaf(16 * l.x, 16 * l.y, 16 * l.z) == kInsideTile) leaf_at[p] = whole ? 0 : kInsideTile;
}

__global__ void __launch_bounds__(kLeafVoxels) take_means(FairField fine, FairField coarse, const int32_t* place_of, float* out) {
    const int3 o = first_voxel(coarse, place_of[blockIdx.x]);
    const int q = threadIdx.x, i = 2 * (o.x + (q >> 6)), j = 2 * (o.y + (q >> 3 & 7)), k = 2 * (o.z + (q & 7));
    float sum = 0;
    for (int c = 0; c < 8; ++c) sum += fine.at(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1));
    out[static_cast<size_t>(blockIdx.x) * kLeafVoxels + q] = coarser_hull(sum);
}

/// A thread a place of the finer level: what of its inside the coarse field needs.
__global__ void find_carried(FairField fine, FairField coarse, int64_t places, int32_t* leaf_at) {
    const int64_t p = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
    if (p >= places) return;
    if (fine.leaf_at[p] != kInsideTile) {
        leaf_at[p] = fine.leaf_at[p] >= 0 ? 0 : kOutsideTile;
        return;
    }
    const int3 l = leaf_at_place(fine, p);
    leaf_at[p] = carried_tile(coarse, l.x, l.y, l.z);
}

__global__ void __launch_bounds__(kLeafVoxels)
    carry(FairField out, const int32_t* place_of, FairField fine_hull, FairField coarse_hull, FairField coarse, float* to_hull, float* to_field) {
    const int3 o = first_voxel(out, place_of[blockIdx.x]);
    const int q = threadIdx.x, i = o.x + (q >> 6), j = o.y + (q >> 3 & 7), k = o.z + (q & 7);
    const size_t at = static_cast<size_t>(blockIdx.x) * kLeafVoxels + q;
    const float h = fine_hull.at(i, j, k);
    to_hull[at] = h;
    to_field[at] = carried_value(h, coarse_hull, coarse, i, j, k);
}

template <class T>
void copy(DeviceBuffer<T>& to, const DeviceBuffer<T>& from, size_t count, const Stream& stream) {
    VDBCARVE_CUDA(cudaMemcpyAsync(to.ensure(count), from.data(), count * sizeof(T), cudaMemcpyDeviceToDevice, stream.get()));
}

}  // namespace

uint32_t FairStage::sum_before(const int32_t* counts, int32_t* first, size_t n, const Stream& stream) {
    size_t bytes = 0;
    VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(nullptr, bytes, counts, first, static_cast<int>(n + 1), stream.get()));
    scan_.ensure(bytes);
    VDBCARVE_CUDA(cub::DeviceScan::ExclusiveSum(scan_.data(), bytes, counts, first, static_cast<int>(n + 1), stream.get()));
    int* sum = host_box_.ensure(6);
    stream.to_host(sum, first + n, 1);
    stream.wait();
    return static_cast<uint32_t>(sum[0]);
}

void FairStage::cover(FairLevel& level, const std::array<int, 3>& lo, const std::array<int, 3>& size, const Stream& stream) {
    level.lo = lo;
    level.size = size;
    const size_t places = level.places();
    if (places > static_cast<size_t>(INT_MAX) / 2) throw BackendError("fair: the lattice is too large for the device. Remedy: --backend cpu");
    VDBCARVE_CUDA(cudaMemsetAsync(level.leaf_at.ensure(places), 0xff, places * sizeof(int32_t), stream.get()));  // kOutsideTile
}

void FairStage::number_leaves(FairLevel& level, const Stream& stream) {
    const cudaStream_t s = stream.get();
    const auto places = static_cast<int64_t>(level.places());
    const unsigned blocks = blocks_for(level.places(), kThreads);
    int32_t *marks = counts_.ensure(level.places() + 1), *first = first_.ensure(level.places() + 1), *leaf_at = level.leaf_at.data();
    uint8_t *near = near_.ensure(level.places()), *nearer = nearer_.ensure(level.places());
    stream.zero(marks + places, 1);
    mark_leaves<<<blocks, kThreads, 0, s>>>(leaf_at, places, marks, near);
    VDBCARVE_LAUNCHED();
    const FairField f = level.view(level.hull);
    for (int axis = 0; axis < 3; ++axis) {
        spread_near<<<blocks, kThreads, 0, s>>>(f, places, axis, near, nearer, axis == 2 ? leaf_at : nullptr);
        VDBCARVE_LAUNCHED();
        std::swap(near, nearer);
    }
    level.leaves = sum_before(marks, first, level.places(), stream);
    number_places<<<blocks, kThreads, 0, s>>>(leaf_at, places, first, level.place_of.ensure(level.leaves));
    VDBCARVE_LAUNCHED();
}

bool FairStage::take(const Grid& hull, const Topology& topology, float voxel, const Stream& stream, StageTimes& times) {
    const uint32_t count = hull.leaf_count();
    coarsest_ = true;
    depth_ = 1;
    if (hulls_.empty()) hulls_.emplace_back();
    if (count == 0) return false;
    const cudaStream_t s = stream.get();
    FairLevel& level = hulls_.front();
    const TopologyView view = topology.view();
    times.measure("fair: levels", stream, [&] {
        int* box = host_box_.ensure(6);
        for (int a = 0; a < 3; ++a) {
            box[a] = INT_MAX;
            box[3 + a] = INT_MIN;
        }
        stream.to_device(box_.ensure(6), box, 6);
        find_box<<<blocks_for(count, kThreads), kThreads, 0, s>>>(view, hull.keys(), count, box_.data());
        VDBCARVE_LAUNCHED();
        stream.to_host(box, box_.data(), 6);
        stream.wait();
        std::array<int, 3> lo{}, size{};
        for (size_t a = 0; a < 3; ++a) {
            lo[a] = box[a] - 1;
            size[a] = box[3 + a] + 1 - lo[a] + 1;
        }
        cover(level, lo, size, stream);
        find_places<<<blocks_for(level.places(), kThreads), kThreads, 0, s>>>(view, level.view(level.hull), static_cast<int64_t>(level.places()),
                                                                              level.leaf_at.data());
        VDBCARVE_LAUNCHED();
        number_leaves(level, stream);
        level.hull.of.ensure(level.voxels());
        load_hull<<<level.leaves, kLeafVoxels, 0, s>>>(hull.leaves(), view, level.view(level.hull), level.place_of.data(), voxel, level.hull.of.data());
        VDBCARVE_LAUNCHED();
        find_least(level, level.hull, stream);
    });
    return true;
}

void FairStage::coarsen(bool whole, const Stream& stream, StageTimes& times) {
    if (hulls_.size() == depth_) hulls_.emplace_back();
    const FairLevel& fine = hulls_[depth_ - 1];
    FairLevel& out = hulls_[depth_++];
    const cudaStream_t s = stream.get();
    std::array<int, 3> lo{}, size{};
    for (size_t a = 0; a < 3; ++a) {
        lo[a] = (fine.lo[a] >> 1) - 1;
        size[a] = ((fine.lo[a] + fine.size[a] - 1) >> 1) + 1 - lo[a] + 1;
    }
    times.measure("fair: levels", stream, [&] {
        cover(out, lo, size, stream);
        const size_t around = 27 * static_cast<size_t>(fine.leaves);
        const FairField from = fine.view(fine.hull);
        mark_coarser<<<blocks_for(around, kThreads), kThreads, 0, s>>>(from, fine.place_of.data(), static_cast<int64_t>(around), out.view(out.hull),
                                                                       out.leaf_at.data());
        VDBCARVE_LAUNCHED();
        mark_inside<<<blocks_for(out.places(), kThreads), kThreads, 0, s>>>(from, out.view(out.hull), static_cast<int64_t>(out.places()), whole,
                                                                            out.leaf_at.data());
        VDBCARVE_LAUNCHED();
        number_leaves(out, stream);
        out.hull.of.ensure(out.voxels());
        take_means<<<out.leaves, kLeafVoxels, 0, s>>>(from, out.view(out.hull), out.place_of.data(), out.hull.of.data());
        VDBCARVE_LAUNCHED();
        make_distances(out, out.hull.of.data(), nullptr, stream);
        find_least(out, out.hull, stream);
    });
}

void FairStage::begin(const Stream& stream, StageTimes& times) {
    const FairLevel& hull = hulls_[--depth_];
    times.measure("fair: levels", stream, [&] {
        level_.lo = hull.lo;
        level_.size = hull.size;
        level_.leaves = hull.leaves;
        copy(level_.leaf_at, hull.leaf_at, hull.places(), stream);
        copy(level_.place_of, hull.place_of, hull.leaves, stream);
        for (FairLevel::Values* v : {&level_.hull, &level_.field}) {
            copy(v->of, hull.hull.of, hull.voxels(), stream);
            copy(v->least, hull.hull.least, hull.leaves, stream);
        }
    });
}

void FairStage::refine(const Stream& stream, StageTimes& times) {
    const FairLevel& fine = hulls_[--depth_];
    FairLevel& out = coarse_;  // what was the coarser level is not needed any more
    const cudaStream_t s = stream.get();
    times.measure("fair: levels", stream, [&] {
        cover(out, fine.lo, fine.size, stream);
        const FairField hull = fine.view(fine.hull), coarse = level_.view(level_.field), coarse_hull = level_.view(level_.hull);
        find_carried<<<blocks_for(out.places(), kThreads), kThreads, 0, s>>>(hull, coarse, static_cast<int64_t>(out.places()), out.leaf_at.data());
        VDBCARVE_LAUNCHED();
        number_leaves(out, stream);
        out.hull.of.ensure(out.voxels());
        out.field.of.ensure(out.voxels());
        out.field.least.ensure(out.leaves);
        carry<<<out.leaves, kLeafVoxels, 0, s>>>(out.view(out.hull), out.place_of.data(), hull, coarse_hull, coarse, out.hull.of.data(), out.field.of.data());
        VDBCARVE_LAUNCHED();
        find_least(out, out.hull, stream);
    });
    std::swap(level_, coarse_);
    coarsest_ = false;
}

size_t FairStage::bytes() const {
    size_t sum = level_.bytes() + coarse_.bytes() + scratch_.bytes() + more_scratch_.bytes() + counts_.bytes() + first_.bytes() + list_.bytes() +
                 parent_.bytes() + near_.bytes() + nearer_.bytes() + scan_.bytes() + sizes_.bytes() + active_.bytes();
    for (const FairLevel& level : hulls_) sum += level.bytes();
    return sum;
}

}  // namespace vdbcarve::cuda
