// SPDX-License-Identifier: Apache-2.0
#include "fair_sight_cuda.h"

#include <algorithm>
#include <utility>

#include "fair_leaves.cuh"
#include "fair_warp.cuh"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kThreads = 128;
/// Blocks of kernels whose work is counted on the device.
constexpr unsigned kMostBlocks = 2048;

struct Appender {
    FairSquare* items;
    uint32_t* count;
    uint32_t room;

    __device__ void add(const FairSquare& item) const {
        const uint32_t n = atomicAdd(count, 1u);
        if (n < room) items[n] = item;
    }
};

struct LineAppender {
    FairLine* items;
    uint32_t* counts;
    uint32_t room;

    __device__ void add(const FairMask& m, uint32_t view, int i, int j, FairLine& line) const {
        const int share = share_of(i, j);
        const uint32_t n = atomicAdd(counts + share, 1u);
        if (n >= room) return;
        line.view = view;
        line.sample = static_cast<uint32_t>(j * m.width + i);
        items[static_cast<size_t>(share) * room + n] = line;
    }
};

__device__ bool first_of(uint32_t* flags, uint32_t n) { return !*static_cast<volatile uint32_t*>(flags + n) && atomicExch(flags + n, 1u) == 0; }

/// The leaves whose cells reach into a leaf.
__device__ void mark_stale(const FairField& f, int3 first, int c, uint32_t* stale, uint32_t* list, uint32_t* count) {
    const int32_t m = f.leaf(first.x - 8 * (c >> 2), first.y - 8 * (c >> 1 & 1), first.z - 8 * (c & 1));
    if (m >= 0 && first_of(stale, static_cast<uint32_t>(m))) list[atomicAdd(count, 1u)] = static_cast<uint32_t>(m);
}

/// A warp a line; `alone` counts those that nothing is near to.
__device__ void look_at(FairLine* at, const FairField& f, const FairField& hull, const FairField& coarser, float grows_from, FairOpenLine* list,
                        FairCounts* counts) {
    FairLine line = *at;
    const FairOpen open = look_along<FairByWarp>(f, hull, coarser, line);
    __syncwarp();
    if (threadIdx.x % 32 != 0) return;
    *at = line;
    if (open.place.sample < 0) return;
    list[atomicAdd(&counts->open, 1u)] = {at, open};
    if (!(open.place.value < grows_from)) atomicAdd(&counts->alone, 1u);
}
__device__ uint32_t warp_of_grid() { return (blockIdx.x * blockDim.x + threadIdx.x) / 32; }
__device__ uint32_t warps_of_grid() { return gridDim.x * blockDim.x / 32; }

/// Several lists of lines, in one launch.
struct LineRuns {
    FairLine* lines[2 * kFairShares];
    uint32_t last[2 * kFairShares];  ///< number, of all, after a list's last
    int count;
};

/// A thread a line. Most are met where they last were.
__global__ void __launch_bounds__(kThreads) list_unmet(LineRuns runs, FairField f, FairLine** unmet, FairCounts* counts) {
    uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= runs.last[runs.count - 1]) return;
    int run = 0;
    while (n >= runs.last[run]) ++run;
    if (run > 0) n -= runs.last[run - 1];
    FairLine* line = runs.lines[run] + n;
    if (!still_met(f, *line)) unmet[atomicAdd(&counts->unmet, 1u)] = line;
}

__global__ void __launch_bounds__(kThreads)
    look_first(FairLine* const* unmet, FairField f, FairField hull, FairField coarser, float grows_from, FairOpenLine* list, FairCounts* counts) {
    for (uint32_t n = warp_of_grid(); n < counts->unmet; n += warps_of_grid()) look_at(unmet[n], f, hull, coarser, grows_from, list, counts);
}

/// Those that the round before left open, unless nothing has changed since; `anyway`: the host knows better.
__global__ void __launch_bounds__(kThreads) look_again(const FairOpenLine* before, const FairCounts* counts_before, bool anyway, FairField f, FairField hull,
                                                       FairField coarser, float grows_from, FairOpenLine* list, FairCounts* counts) {
    if (!anyway && !counts_before->changed) return;
    for (uint32_t n = warp_of_grid(); n < counts_before->open; n += warps_of_grid())
        if (!still_met(f, *before[n].line)) look_at(before[n].line, f, hull, coarser, grows_from, list, counts);
}

/// A warp a line, a lane a column of voxels. Each is reckoned from the field as it was, and where two meet the larger fall counts, so no order matters.
__global__ void __launch_bounds__(kThreads) lower(const FairOpenLine* list, FairCounts* counts, FairField f, float grows_from, float along_vox,
                                                  bool to_the_hull, float* fall, uint32_t* falls, uint32_t* falls_list) {
    const uint32_t count = counts->open;
    for (uint32_t n = warp_of_grid(); n < count; n += warps_of_grid()) {
        if (!(list[n].at.place.value < grows_from)) continue;
        const FairPull pull = pull_of(f, *list[n].line, list[n].at, along_vox, to_the_hull);
        for (int column = static_cast<int>(threadIdx.x) % 32; column < pull.columns(); column += 32)
            lower_column(f, pull, column, [&](int64_t at, float by) {
                atomicMax(reinterpret_cast<int*>(fall + at), __float_as_int(by));  // no fall is negative, so their bits are in order
                const auto leaf = static_cast<uint32_t>(at / kLeafVoxels);
                if (first_of(falls, leaf)) falls_list[atomicAdd(&counts->falls, 1u)] = leaf;
            });
    }
}

/// A block of threads a leaf that is to fall.
__global__ void __launch_bounds__(kThreads) fall_leaves(FairField f, const int32_t* place_of, const float* hull, float* field, float* fall, uint32_t* falls,
                                                        const uint32_t* falls_list, uint32_t* stale, uint32_t* stale_list, FairCounts* counts) {
    const uint32_t count = counts->falls;
    for (uint32_t l = blockIdx.x; l < count; l += gridDim.x) {
        const uint32_t leaf = falls_list[l];
        bool changed = false;
        for (size_t at = static_cast<size_t>(leaf) * kLeafVoxels + threadIdx.x; at < (leaf + size_t{1}) * kLeafVoxels; at += kThreads) {
            const float v = field[at], now = fallen(v, fall[at], hull[at]);
            changed = changed || now < v;
            field[at] = now;
            fall[at] = 0.f;
        }
        if (changed) counts->changed = 1;
        if (threadIdx.x == 0) falls[leaf] = 0;
        if (threadIdx.x < 8) mark_stale(f, first_voxel(f, place_of[leaf]), static_cast<int>(threadIdx.x), stale, stale_list, &counts->stale);
    }
}

__global__ void __launch_bounds__(kLeastThreads)
    find_stale(FairField f, const int32_t* place_of, uint32_t* stale, const uint32_t* list, const FairCounts* counts, float* least) {
    const uint32_t count = counts->stale;
    for (uint32_t l = blockIdx.x; l < count; l += gridDim.x) {
        find_least_of(f, first_voxel(f, place_of[list[l]]), least + list[l]);
        if (threadIdx.x == 0) stale[list[l]] = 0;
    }
}

__global__ void count_must(const FairOpenLine* list, const FairCounts* counts, unsigned long long* sum) {
    for (uint32_t n = blockIdx.x * blockDim.x + threadIdx.x; n < counts->open; n += gridDim.x * blockDim.x)
        if (list[n].line->must < kFairBand_vox) atomicAdd(sum, 1ull);
}

__global__ void list_alone(const FairOpenLine* list, const FairCounts* counts, float grows_from, FairLoneLine* out, unsigned long long* found) {
    for (uint32_t n = blockIdx.x * blockDim.x + threadIdx.x; n < counts->open; n += gridDim.x * blockDim.x)
        if (!(list[n].at.place.value < grows_from)) out[atomicAdd(found, 1ull)] = {*list[n].line, list[n].at};
}

/// A block of threads a leaf: to `out`, hull and field; or back.
__global__ void __launch_bounds__(kLeafVoxels) gather(const uint32_t* leaves, const float* hull, const float* field, float* out) {
    const size_t from = static_cast<size_t>(leaves[blockIdx.x]) * kLeafVoxels + threadIdx.x, to = static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x;
    out[to] = hull[from];
    out[static_cast<size_t>(gridDim.x) * kLeafVoxels + to] = field[from];
}

__global__ void __launch_bounds__(kLeafVoxels) scatter(FairField f, const int32_t* place_of, const uint32_t* leaves, const float* from, float* field,
                                                       uint32_t* stale, uint32_t* stale_list, FairCounts* counts) {
    const uint32_t leaf = leaves[blockIdx.x];
    field[static_cast<size_t>(leaf) * kLeafVoxels + threadIdx.x] = from[static_cast<size_t>(blockIdx.x) * kLeafVoxels + threadIdx.x];
    if (threadIdx.x < 8) mark_stale(f, first_voxel(f, place_of[leaf]), static_cast<int>(threadIdx.x), stale, stale_list, &counts->stale);
}

__global__ void count_inside(const FairView* views, unsigned long long* sum) {
    const FairMask& m = views[blockIdx.y].mask;
    const int n = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    const int count = __syncthreads_count(n < m.width * m.height && m.counts(n % m.width, n / m.width));
    if (threadIdx.x == 0 && count) atomicAdd(sum, static_cast<unsigned long long>(count));
}

/// A thread a square of kFairSquare samples; those that must be looked into.
__global__ void __launch_bounds__(kThreads) open_squares(const FairView* views, FairField f, Appender out) {
    const FairMask& m = views[blockIdx.y].mask;
    const int across = (m.width + kFairSquare - 1) / kFairSquare, n = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (n >= across * ((m.height + kFairSquare - 1) / kFairSquare)) return;
    const int i = n % across * kFairSquare, j = n / across * kFairSquare;
    int there = 0;
    if (opens_square(m, views[blockIdx.y].eye, f, i, j, kFairSquare, there)) out.add({blockIdx.y, static_cast<uint32_t>(j * m.width + i)});
}

/// A thread a quarter of such a square.
__global__ void __launch_bounds__(kThreads) open_quarters(const FairView* views, FairField f, const FairSquare* squares, uint32_t count, Appender out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= 4 * count) return;
    constexpr int kHalf = kFairSquare / 2;
    const FairSquare s = squares[n / 4];
    const FairMask& m = views[s.view].mask;
    const int i = static_cast<int>(s.at) % m.width + static_cast<int>(n & 1) * kHalf,
              j = static_cast<int>(s.at) / m.width + static_cast<int>(n >> 1 & 1) * kHalf;
    int there = 0;
    if (i < m.width && opens_square(m, views[s.view].eye, f, i, j, kHalf, there)) out.add({s.view, static_cast<uint32_t>(j * m.width + i)});
}

/// A thread a sample of such a quarter.
__global__ void __launch_bounds__(kThreads)
    find_near_lines(const FairView* views, FairField f, FairAsk ask, const FairSquare* squares, uint32_t count, LineAppender out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= 4 * count) return;
    const FairSquare s = squares[n / 4];
    const FairMask& m = views[s.view].mask;
    const int i = static_cast<int>(s.at) % m.width + static_cast<int>(n & 1), j = static_cast<int>(s.at) / m.width + static_cast<int>(n >> 1 & 1);
    int there = 0;
    FairLine line;
    if (i < m.width && opens_square(m, views[s.view].eye, f, i, j, 1, there) && near_line_of(m, views[s.view].eye, f, ask, i, j, there, line))
        out.add(m, s.view, i, j, line);
}

__global__ void __launch_bounds__(kThreads) find_rim_samples(const FairView* views, FairAsk ask, Appender out) {
    const FairMask& m = views[blockIdx.y].mask;
    const int n = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (n < m.width * m.height && ask.rim(n % m.width, n / m.width) && m.is_rim(n % m.width, n / m.width)) out.add({blockIdx.y, static_cast<uint32_t>(n)});
}

__global__ void __launch_bounds__(kThreads)
    find_rim_lines(const FairView* views, FairField hull, FairAsk ask, const FairSquare* samples, uint32_t count, LineAppender out) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const FairSquare s = samples[n];
    const FairMask& m = views[s.view].mask;
    const int i = static_cast<int>(s.at) % m.width, j = static_cast<int>(s.at) / m.width;
    FairLine line;
    if (rim_line_of(m, views[s.view].eye, hull, ask, i, j, line)) out.add(m, s.view, i, j, line);
}

constexpr uint32_t kLeastRoom = 1 << 14;

}  // namespace

template <class Launch>
void FairSight::fill(Squares& list, const Stream& stream, const Launch& launch) {
    list.items.ensure(std::max<size_t>(kLeastRoom, samples_ / 16));
    for (;;) {
        const auto room = static_cast<uint32_t>(list.items.capacity());
        stream.zero(appended_.ensure(kFairShares), 1);
        launch(Appender{list.items.data(), appended_.data(), room});
        stream.to_host(host_appended_.ensure(kFairShares), appended_.data(), 1);
        stream.wait();
        list.count = host_appended_[0];
        if (list.count <= room) return;
        list.items.ensure(list.count + size_t{list.count} / 4);
    }
}

template <class Launch>
void FairSight::fill(Lines& lines, const Stream& stream, const Launch& launch) {
    lines.room = std::max(lines.room, static_cast<uint32_t>(std::max<size_t>(kLeastRoom, samples_ / 128)));
    for (;;) {
        lines.items.ensure(static_cast<size_t>(lines.room) * kFairShares);
        stream.zero(appended_.ensure(kFairShares), kFairShares);
        launch(LineAppender{lines.items.data(), appended_.data(), lines.room});
        stream.to_host(host_appended_.ensure(kFairShares), appended_.data(), kFairShares);
        stream.wait();
        std::copy_n(host_appended_.data(), kFairShares, lines.counts);
        const uint32_t most = *std::max_element(lines.counts, lines.counts + kFairShares);
        if (most <= lines.room) return;
        lines.room = most + most / 4;
    }
}

void FairSight::aim(const std::vector<FairView>& views, bool exact, const FairStage& stage, const Stream& stream, StageTimes& times) {
    exact_ = exact;
    views_ = static_cast<unsigned>(views.size());
    open_ = most_samples_ = most_squares_ = samples_ = 0;
    for (const FairView& v : views) {
        const auto across = static_cast<size_t>(v.mask.width), down = static_cast<size_t>(v.mask.height), samples = across * down;
        most_squares_ = std::max(most_squares_, ((across + kFairSquare - 1) / kFairSquare) * ((down + kFairSquare - 1) / kFairSquare));
        most_samples_ = std::max(most_samples_, samples);
        samples_ += samples;
    }
    const FairLevel& level = stage.level();
    times.measure("fair: lines", stream, [&] {
        stream.to_device(view_.ensure(views.size()), views.data(), views.size());
        stream.zero(fall_.ensure(level.voxels()), level.voxels());
        stream.zero(falls_.ensure(level.leaves), level.leaves);
        stream.zero(stale_.ensure(level.leaves), level.leaves);
        falls_list_.ensure(level.leaves);
        stale_list_.ensure(level.leaves);
        find_rim(stage, stream);
    });
    std::fill_n(near_.counts, kFairShares, 0);
}

void FairSight::find_rim(const FairStage& stage, const Stream& stream) {
    std::fill_n(rim_.counts, kFairShares, 0);
    if (most_samples_ == 0) return;
    const cudaStream_t s = stream.get();
    const FairAsk ask{0.f, true, exact_};
    fill(rim_samples_, stream, [&](const Appender& out) {
        find_rim_samples<<<dim3(blocks_for(most_samples_, kThreads), views_), kThreads, 0, s>>>(view_.data(), ask, out);
        VDBCARVE_LAUNCHED();
    });
    if (rim_samples_.count == 0) return;
    const FairField hull = stage.level().view(stage.level().hull);
    fill(rim_, stream, [&](const LineAppender& out) {
        find_rim_lines<<<blocks_for(rim_samples_.count, kThreads), kThreads, 0, s>>>(view_.data(), hull, ask, rim_samples_.items.data(), rim_samples_.count,
                                                                                     out);
        VDBCARVE_LAUNCHED();
    });
}

void FairSight::find_near(float safe_vox, bool all, FairStage& stage, const Stream& stream, StageTimes& times) {
    std::fill_n(near_.counts, kFairShares, 0);
    if (most_samples_ == 0) return;
    const cudaStream_t s = stream.get();
    const FairAsk ask{safe_vox, all, exact_};
    times.measure("fair: lines", stream, [&] {
        stage.find_least(stream);
        const FairField f = stage.level().view(stage.level().field);
        fill(squares_, stream, [&](const Appender& out) {
            open_squares<<<dim3(blocks_for(most_squares_, kThreads), views_), kThreads, 0, s>>>(view_.data(), f, out);
            VDBCARVE_LAUNCHED();
        });
        if (squares_.count == 0) return;
        fill(quarters_, stream, [&](const Appender& out) {
            open_quarters<<<blocks_for(size_t{4} * squares_.count, kThreads), kThreads, 0, s>>>(view_.data(), f, squares_.items.data(), squares_.count, out);
            VDBCARVE_LAUNCHED();
        });
        if (quarters_.count == 0) return;
        fill(near_, stream, [&](const LineAppender& out) {
            find_near_lines<<<blocks_for(size_t{4} * quarters_.count, kThreads), kThreads, 0, s>>>(view_.data(), f, ask, quarters_.items.data(),
                                                                                                   quarters_.count, out);
            VDBCARVE_LAUNCHED();
        });
    });
}

uint32_t FairSight::lines_of(const Repair& how) const {
    uint32_t sum = 0;
    for (const Lines* lines : {&rim_, &near_})
        for (int n = 0; n < kFairShares; ++n)
            if (how.takes[n]) sum += lines->counts[n];
    return sum;
}

void FairSight::look(int round, const Repair& how, const FairStage& stage, const Stream& stream) {
    const cudaStream_t s = stream.get();
    const FairLevel& level = stage.level();
    const FairField f = level.view(level.field), hull = level.view(level.hull),
                    coarser = stage.coarse() ? stage.coarse()->view(stage.coarse()->field) : FairField{};
    FairOpenLine *list = open_lines_[round % 2].data(), *before = open_lines_[(round + 1) % 2].data();
    FairCounts* counts = counts_.data() + round;
    const unsigned blocks = std::min(blocks_for(size_t{32} * lines_of(how), kThreads), kMostBlocks);
    if (round > 0) {
        look_again<<<blocks, kThreads, 0, s>>>(before, counts - 1, how.anywhere, f, hull, coarser, how.grows_from, list, counts);
        VDBCARVE_LAUNCHED();
        return;
    }
    LineRuns runs{};
    uint32_t all = 0;
    for (Lines* lines : {&rim_, &near_})
        for (int n = 0; n < kFairShares; ++n) {
            if (!how.takes[n] || lines->counts[n] == 0) continue;
            all += lines->counts[n];
            runs.lines[runs.count] = lines->items.data() + static_cast<size_t>(n) * lines->room;
            runs.last[runs.count++] = all;
        }
    list_unmet<<<blocks_for(all, kThreads), kThreads, 0, s>>>(runs, f, unmet_.data(), counts);
    VDBCARVE_LAUNCHED();
    look_first<<<blocks, kThreads, 0, s>>>(unmet_.data(), f, hull, coarser, how.grows_from, list, counts);
    VDBCARVE_LAUNCHED();
}

void FairSight::find_stale_leasts(FairCounts* counts, FairStage& stage, const Stream& stream) {
    FairLevel& level = stage.level();
    find_stale<<<std::min(level.leaves, kMostBlocks), kLeastThreads, 0, stream.get()>>>(level.view(level.field), level.place_of.data(), stale_.data(),
                                                                                        stale_list_.data(), counts, level.field.least.data());
    VDBCARVE_LAUNCHED();
}

void FairSight::fall(FairCounts* counts, FairStage& stage, const Stream& stream) {
    FairLevel& level = stage.level();
    fall_leaves<<<std::min(level.leaves, kMostBlocks), kThreads, 0, stream.get()>>>(level.view(level.field), level.place_of.data(), level.hull.of.data(),
                                                                                    level.field.of.data(), fall_.data(), falls_.data(), falls_list_.data(),
                                                                                    stale_.data(), stale_list_.data(), counts);
    VDBCARVE_LAUNCHED();
    find_stale_leasts(counts, stage, stream);
}

void FairSight::repair(const Repair& how, const ReachAlone& reach_alone, FairStage& stage, const Stream& stream, StageTimes& times) {
    const cudaStream_t s = stream.get();
    const uint32_t lines = lines_of(how);
    if (how.anywhere) open_ = 0;
    times.measure("fair: repair", stream, [&] {
        stage.find_least(stream);
        if (lines == 0) return;
        FairCounts* counts = counts_.ensure(static_cast<size_t>(how.rounds));
        stream.zero(counts, static_cast<size_t>(how.rounds));
        for (auto& list : open_lines_) list.ensure(lines);
        unmet_.ensure(lines);
        int round = 0;
        for (; round < how.rounds; ++round) {
            look(round, how, stage, stream);
            lower<<<std::min(blocks_for(size_t{32} * lines, kThreads), kMostBlocks), kThreads, 0, s>>>(
                open_lines_[round % 2].data(), counts + round, stage.level().view(stage.level().field), how.grows_from, how.along_vox, round >= how.patience,
                fall_.data(), falls_.data(), falls_list_.data());
            VDBCARVE_LAUNCHED();
            fall(counts + round, stage, stream);
            if (!how.anywhere) continue;
            stream.to_host(host_counts_.ensure(1), counts + round, 1);
            stream.wait();
            const FairCounts now = host_counts_[0];
            if (now.open == 0 || (!now.changed && !(now.alone && reach_alone(alone(round, now.alone, how.grows_from, stream))))) break;
        }
        if (!how.anywhere) return;
        round = std::min(round, how.rounds - 1);
        stream.zero(sum_.ensure(1), 1);
        count_must<<<std::min(blocks_for(lines, kThreads), kMostBlocks), kThreads, 0, s>>>(open_lines_[round % 2].data(), counts + round, sum_.data());
        VDBCARVE_LAUNCHED();
        stream.to_host(host_sum_.ensure(1), sum_.data(), 1);
        stream.wait();
        open_ = static_cast<size_t>(host_sum_[0]);
    });
}

std::vector<FairLoneLine> FairSight::alone(int round, uint32_t count, float grows_from, const Stream& stream) {
    stream.zero(sum_.ensure(1), 1);
    list_alone<<<std::min(blocks_for(size_t{32} * count, kThreads), kMostBlocks), kThreads, 0, stream.get()>>>(
        open_lines_[round % 2].data(), counts_.data() + round, grows_from, lone_.ensure(count), sum_.data());
    VDBCARVE_LAUNCHED();
    std::vector<FairLoneLine> out(count);
    stream.to_host(out.data(), lone_.data(), count);
    stream.wait();
    return out;
}

size_t FairSight::inside_samples(const Stream& stream) {
    if (most_samples_ == 0) return 0;
    stream.zero(sum_.ensure(1), 1);
    count_inside<<<dim3(blocks_for(most_samples_, kThreads), views_), kThreads, 0, stream.get()>>>(view_.data(), sum_.data());
    VDBCARVE_LAUNCHED();
    stream.to_host(host_sum_.ensure(1), sum_.data(), 1);
    stream.wait();
    return static_cast<size_t>(host_sum_[0]);
}

void FairSight::fetch_leaves(const std::vector<uint32_t>& leaves, float* hull, float* field, const FairStage& stage, const Stream& stream) {
    if (leaves.empty()) return;
    const size_t voxels = leaves.size() * kLeafVoxels;
    stream.to_device(some_.ensure(leaves.size()), leaves.data(), leaves.size());
    float* values = some_values_.ensure(2 * voxels);
    gather<<<static_cast<unsigned>(leaves.size()), kLeafVoxels, 0, stream.get()>>>(some_.data(), stage.level().hull.of.data(), stage.level().field.of.data(),
                                                                                   values);
    VDBCARVE_LAUNCHED();
    stream.to_host(hull, values, voxels);
    stream.to_host(field, values + voxels, voxels);
    stream.wait();
}

void FairSight::replace_leaves(const std::vector<uint32_t>& leaves, const float* field, FairStage& stage, const Stream& stream) {
    if (leaves.empty()) return;
    const size_t voxels = leaves.size() * kLeafVoxels;
    FairLevel& level = stage.level();
    stream.to_device(some_.ensure(leaves.size()), leaves.data(), leaves.size());
    stream.to_device(some_values_.ensure(voxels), field, voxels);
    stream.zero(spare_counts_.ensure(1), 1);
    scatter<<<static_cast<unsigned>(leaves.size()), kLeafVoxels, 0, stream.get()>>>(level.view(level.field), level.place_of.data(), some_.data(),
                                                                                    some_values_.data(), level.field.of.data(), stale_.data(),
                                                                                    stale_list_.data(), spare_counts_.data());
    VDBCARVE_LAUNCHED();
    find_stale_leasts(spare_counts_.data(), stage, stream);
    stream.wait();
}

size_t FairSight::bytes() const {
    return view_.bytes() + squares_.items.bytes() + quarters_.items.bytes() + rim_samples_.items.bytes() + rim_.items.bytes() + near_.items.bytes() +
           open_lines_[0].bytes() + open_lines_[1].bytes() + unmet_.bytes() + lone_.bytes() + fall_.bytes() + falls_.bytes() + stale_.bytes() +
           falls_list_.bytes() + stale_list_.bytes() + some_.bytes() + some_values_.bytes();
}

}  // namespace vdbcarve::cuda
