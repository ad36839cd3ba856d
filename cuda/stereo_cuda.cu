// SPDX-License-Identifier: Apache-2.0
#include "stereo_cuda.h"

#include "device_buffer.h"

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr int kTileWidth = 16, kTileHeight = 8;  ///< pixels of a block, every second column of one colour: windows overlap, and neighbours' are in the cache

struct Size {
    int width, height;
};

__device__ bool pixel_of_thread(const Size& size, int& x, int& y) {
    x = static_cast<int>(blockIdx.x) * kTileWidth + static_cast<int>(threadIdx.x);
    y = static_cast<int>(blockIdx.y) * kTileHeight + static_cast<int>(threadIdx.y);
    return x < size.width && y < size.height;
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight)
    ask_hull(RenderVolume volume, HullView view, const uint8_t* object, Size size, HullSight* out, uint32_t* count) {
    int x, y;
    if (!pixel_of_thread(size, x, y)) return;
    const int n = y * size.width + x;
    HullSight sight{0.f, 0.f, {0.f, 0.f, -1.f}};
    if (object[n]) {
        FieldReader field(*volume.near.grid, volume.near.base, 1.f / volume.voxel_size);
        SightCells cells(volume.near);
        sight = hull_sight(field, cells, volume, view, x, y);
        if (sight.front != 0.f) atomicAdd(count, 1u);
    }
    out[n] = sight;
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight) start_planes(StereoReference reference, StereoBest* planes) {
    int x, y;
    if (pixel_of_thread({reference.image.width, reference.image.height}, x, y)) planes[y * reference.image.width + x] = first_plane(reference, x, y);
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight) better_planes(StereoReference reference, StereoBest* planes, int pass, int color) {
    const int y = static_cast<int>(blockIdx.y) * kTileHeight + static_cast<int>(threadIdx.y);
    const int x = 2 * (static_cast<int>(blockIdx.x) * kTileWidth + static_cast<int>(threadIdx.x)) + ((y + color) & 1);
    if (x >= reference.image.width || y >= reference.image.height) return;
    if (reference.hull[y * reference.image.width + x].front == 0.f) return;
    planes[y * reference.image.width + x] = better_plane(reference, planes, x, y, pass);  // reads pixels of the other colour only, and its own
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight)
    find_likely(StereoReference reference, const StereoBest* planes, StereoTrustRule rule, float* likely, uint32_t* count) {
    int x, y;
    if (!pixel_of_thread({reference.image.width, reference.image.height}, x, y)) return;
    const int n = y * reference.image.width + x;
    likely[n] = likelihood(reference, planes[n], rule, x, y);
    if (likely[n] > 0.f) atomicAdd(count, 1u);
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight)
    find_agreed(StereoReference reference, const StereoDepths* depths, const uint8_t* object, StereoTrustRule rule, float* agreed) {
    int x, y;
    if (!pixel_of_thread({reference.image.width, reference.image.height}, x, y)) return;
    const int n = y * reference.image.width + x;
    agreed[n] = object[n] < 2 ? 0.f : agreed_likelihood(reference, depths, rule, x, y);
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight) forget_coarser(Size fine, const float* agreed, Size coarse, int halvings, float* theirs) {
    int x, y;
    if (!pixel_of_thread(fine, x, y)) return;
    const int cx = x >> halvings, cy = y >> halvings;
    if (cx < coarse.width && cy < coarse.height && agreed[y * fine.width + x] > 0.f) theirs[cy * coarse.width + cx] = 0.f;
}

__global__ void __launch_bounds__(kTileWidth* kTileHeight) find_depths(Size size, StereoLens lens, const StereoBest* planes, const float* agreed, float* out) {
    int x, y;
    if (!pixel_of_thread(size, x, y)) return;
    const int n = y * size.width + x;
    out[n] = agreed[n] > 0.f ? depth_of(lens, planes[n].plane.s) : 0.f;
}

/// A thread a voxel, a block of threads a leaf. Blocks that nothing is known of leave no trace.
__global__ void __launch_bounds__(kLeafVoxels)
    fuse_blocks(const nanovdb::NanoGrid<float>* grid, ColorBase base, FusionRule rule, const FusionView* views, int count, const int3* blocks, uint32_t* slots,
                uint32_t* block_of_slot, float* values, float* confidence) {
    const int3 first = blocks[blockIdx.x];
    const int at = static_cast<int>(threadIdx.x), i = first.x + (at >> 6), j = first.y + (at >> 3 & 7), k = first.z + (at & 7);
    const float before = grid->tree().getValue(nanovdb::Coord(i, j, k));
    FusedVoxel voxel{before, 0.f};
    if (before < rule.band) {
        Fused fused;
        const auto fi = static_cast<float>(i - base.i), fj = static_cast<float>(j - base.j), fk = static_cast<float>(k - base.k);
        for (int v = 0; v < count; ++v) fuse_view(views[v], fi, fj, fk, rule.reach, rule.truncation, fused);
        voxel = carved_voxel(rule, fused, before);
    }
    if (!__syncthreads_or(voxel.value != before || voxel.confidence > 0.f)) return;
    __shared__ uint32_t slot;
    if (at == 0) {
        slot = atomicAdd(slots, 1u);
        block_of_slot[slot] = blockIdx.x;
    }
    __syncthreads();
    values[static_cast<size_t>(slot) * kLeafVoxels + static_cast<size_t>(at)] = voxel.value;
    confidence[static_cast<size_t>(slot) * kLeafVoxels + static_cast<size_t>(at)] = voxel.confidence;
}

}  // namespace

struct StereoStage::Parts {
    struct View {
        int width = 0, height = 0;
        size_t first = 0;  ///< pixel, among those of all views
        StereoLens lens{};
        bool matched = false;
    };
    /// A size of photographs, and what was found of it.
    struct Level {
        std::vector<View> views;
        DeviceBuffer<StereoBest> planes;
        DeviceBuffer<float> agreed;
    };
    std::vector<Level> levels;
    size_t level = 0;  ///< the one at hand
    bool after_coarser = false;
    DeviceBuffer<float> grey, likely;
    DeviceBuffer<uint8_t> object;
    /// Views at a time, each with what the hull says of it.
    struct Lane {
        Stream stream;
        DeviceBuffer<HullSight> hull;
        Event done;
    };
    static constexpr size_t kLanes = 4;
    std::array<Lane, kLanes> lanes;
    Event begun;
    DeviceBuffer<StereoDepths> depths;
    DeviceBuffer<uint32_t> counts;
    DeviceBuffer<uint64_t> near, solid;
    RenderVolume volume{};
    DeviceBuffer<FusionView> fusion;
    DeviceBuffer<int3> blocks_first;
    DeviceBuffer<uint32_t> slots, block_of_slot;
    DeviceBuffer<float> values, confidence;
    PinnedBuffer<uint32_t> slot_count;

    dim3 blocks(const View& v, int columns) const {
        const auto of = [](int count, int side) { return static_cast<unsigned>((count + side - 1) / side); };
        return {of(v.width, columns), of(v.height, kTileHeight)};
    }
};

StereoStage::StereoStage() : parts_(std::make_unique<Parts>()) {}
StereoStage::~StereoStage() = default;

void StereoStage::set_hull(const Grid& grid, const ColorBase& base, const SightBox& box, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const auto voxel = static_cast<float>(grid.spec().voxel_size);
    const size_t words = static_cast<size_t>(grid.leaf_count()) * kWallWords;
    uint64_t *near = p.near.ensure(words), *solid = p.solid.ensure(words);
    const float near_threshold = kNearSurface_vox * voxel;
    times.measure("stereo: walls", stream, [&] {
        build_walls(grid, near_threshold, near, stream);
        build_walls(grid, 0.f, solid, stream);
    });
    p.volume = {{grid.grid(), near, near_threshold, base}, {grid.grid(), solid, 0.f, base}, box, nullptr, voxel};
}

void StereoStage::begin(size_t level, const std::vector<StereoPixels>& views, bool after_coarser, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    if (p.levels.size() <= level) p.levels.resize(level + 1);
    p.level = level;
    p.after_coarser = after_coarser;
    Parts::Level& own_level = p.levels[level];
    own_level.views.assign(views.size(), {});
    size_t pixels = 0, most = 0;
    for (size_t v = 0; v < views.size(); ++v) {
        const size_t own = static_cast<size_t>(views[v].width) * static_cast<size_t>(views[v].height);
        own_level.views[v] = {views[v].width, views[v].height, pixels, views[v].lens, false};
        pixels += own;
        most = own > most ? own : most;
    }
    p.grey.ensure(pixels);
    p.object.ensure(pixels);
    own_level.planes.ensure(pixels);
    p.likely.ensure(pixels);
    own_level.agreed.ensure(pixels);
    for (Parts::Lane& lane : p.lanes) lane.hull.ensure(most);
    p.counts.ensure(2 * views.size());
    times.measure("stereo: photographs", stream, [&] {
        for (size_t v = 0; v < views.size(); ++v) {
            const size_t own = static_cast<size_t>(views[v].width) * static_cast<size_t>(views[v].height);
            if (!own) continue;
            stream.to_device(p.grey.data() + own_level.views[v].first, views[v].grey, own);
            stream.to_device(p.object.data() + own_level.views[v].first, views[v].object, own);
        }
        stream.zero(p.counts.data(), 2 * views.size());
    });
}

void StereoStage::match(const std::vector<Work>& views, int first_pass, int last_pass, const StereoTrustRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    Parts::Level& level = p.levels[p.level];
    const dim3 threads(kTileWidth, kTileHeight);
    times.measure("stereo: planes", stream, [&] {
        p.begun.record(stream);
        for (Parts::Lane& lane : p.lanes) VDBCARVE_CUDA(cudaStreamWaitEvent(lane.stream.get(), p.begun.get()));
        for (size_t n = 0; n < views.size(); ++n) {
            const Parts::Lane& lane = p.lanes[n % Parts::kLanes];
            const cudaStream_t on = lane.stream.get();
            StereoReference reference = views[n].reference;
            Parts::View& v = level.views[static_cast<size_t>(reference.view)];
            v.matched = true;
            reference.image.grey = p.grey.data() + v.first;
            for (int o = 0; o < reference.pairs; ++o) reference.other[o].grey = p.grey.data() + level.views[static_cast<size_t>(reference.pair[o].view)].first;
            reference.hull = lane.hull.data();
            if (p.after_coarser) {
                const Parts::Level& coarser = p.levels[p.level + 1];
                const Parts::View& c = coarser.views[static_cast<size_t>(reference.view)];
                reference.coarse = coarser.planes.data() + c.first;
                reference.coarse_likely = coarser.agreed.data() + c.first;
                reference.coarse_width = c.width;
                reference.coarse_height = c.height;
            }
            StereoBest* planes = level.planes.data() + v.first;
            uint32_t* counts = p.counts.data() + 2 * reference.view;
            const dim3 all = p.blocks(v, kTileWidth), half = p.blocks(v, 2 * kTileWidth);
            ask_hull<<<all, threads, 0, on>>>(p.volume, views[n].hull, p.object.data() + v.first, {v.width, v.height}, lane.hull.data(), counts);
            VDBCARVE_LAUNCHED();
            start_planes<<<all, threads, 0, on>>>(reference, planes);
            VDBCARVE_LAUNCHED();
            for (int pass = first_pass; pass < last_pass; ++pass)
                for (const int color : {0, 1}) {
                    better_planes<<<half, threads, 0, on>>>(reference, planes, pass, color);
                    VDBCARVE_LAUNCHED();
                }
            find_likely<<<all, threads, 0, on>>>(reference, planes, rule, p.likely.data() + v.first, counts + 1);
            VDBCARVE_LAUNCHED();
        }
        for (Parts::Lane& lane : p.lanes) {
            lane.done.record(lane.stream);
            VDBCARVE_CUDA(cudaStreamWaitEvent(stream.get(), lane.done.get()));
        }
    });
}

void StereoStage::agree(const std::vector<Work>& views, const StereoTrustRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const Parts::Level& level = p.levels[p.level];
    std::vector<StereoDepths> depths(level.views.size());
    for (size_t n = 0; n < depths.size(); ++n) {
        const Parts::View& v = level.views[n];
        if (v.matched) depths[n] = {level.planes.data() + v.first, p.likely.data() + v.first, v.lens, v.width, v.height};
    }
    p.depths.ensure(depths.size());
    times.measure("stereo: agreement", stream, [&] {
        stream.to_device(p.depths.data(), depths.data(), depths.size());
        for (const Work& work : views) {
            const StereoReference& reference = work.reference;
            const Parts::View& v = level.views[static_cast<size_t>(reference.view)];
            find_agreed<<<p.blocks(v, kTileWidth), dim3(kTileWidth, kTileHeight), 0, stream.get()>>>(reference, p.depths.data(), p.object.data() + v.first,
                                                                                                     rule, level.agreed.data() + v.first);
            VDBCARVE_LAUNCHED();
        }
    });
    stream.wait();  // `depths` goes
}

void StereoStage::leave_to_finer(size_t levels, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    times.measure("stereo: agreement", stream, [&] {
        // The coarsest first: what finer ones know is still whole then.
        for (size_t l = levels; l-- > 1;)
            for (size_t finer = 0; finer < l; ++finer)
                for (size_t n = 0; n < p.levels[l].views.size(); ++n) {
                    const Parts::View &f = p.levels[finer].views[n], &c = p.levels[l].views[n];
                    if (!f.matched || !c.matched) continue;
                    forget_coarser<<<p.blocks(f, kTileWidth), dim3(kTileWidth, kTileHeight), 0, stream.get()>>>(
                        {f.width, f.height}, p.levels[finer].agreed.data() + f.first, {c.width, c.height}, static_cast<int>(l - finer),
                        p.levels[l].agreed.data() + c.first);
                    VDBCARVE_LAUNCHED();
                }
    });
}

std::vector<uint32_t> StereoStage::counts(const Stream& stream) const {
    std::vector<uint32_t> out(2 * parts_->levels[parts_->level].views.size());
    stream.to_host(out.data(), parts_->counts.data(), out.size());
    stream.wait();
    return out;
}

StereoStage::Fused StereoStage::fuse(const FusionRule& rule, const std::vector<FusedView>& views, const std::vector<std::array<int, 3>>& blocks,
                                     const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    if (views.empty() || blocks.empty()) return {0, nullptr, nullptr, nullptr};
    std::vector<FusionView> fusion;
    for (const FusedView& f : views) {
        const Parts::Level& level = p.levels[f.level];
        fusion.push_back(f.fusion);
        fusion.back().planes = level.planes.data() + level.views[f.view].first;
        fusion.back().confidence = level.agreed.data() + level.views[f.view].first;
    }
    static_assert(sizeof(int3) == sizeof(blocks[0]));
    p.fusion.ensure(fusion.size());
    p.blocks_first.ensure(blocks.size());
    p.slots.ensure(1);
    p.slot_count.ensure(1);
    p.block_of_slot.ensure(blocks.size());
    p.values.ensure(blocks.size() * kLeafVoxels);
    p.confidence.ensure(blocks.size() * kLeafVoxels);
    times.measure("stereo: fusion", stream, [&] {
        stream.to_device(p.fusion.data(), fusion.data(), fusion.size());
        stream.to_device(p.blocks_first.data(), reinterpret_cast<const int3*>(blocks.data()), blocks.size());
        stream.zero(p.slots.data(), 1);
        fuse_blocks<<<static_cast<unsigned>(blocks.size()), kLeafVoxels, 0, stream.get()>>>(
            p.volume.near.grid, p.volume.near.base, rule, p.fusion.data(), static_cast<int>(fusion.size()), p.blocks_first.data(), p.slots.data(),
            p.block_of_slot.data(), p.values.data(), p.confidence.data());
        VDBCARVE_LAUNCHED();
        stream.to_host(p.slot_count.data(), p.slots.data(), 1);
    });
    stream.wait();
    return {p.slot_count[0], p.block_of_slot.data(), p.values.data(), p.confidence.data()};
}

const float* StereoStage::depths(size_t view, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const Parts::Level& level = p.levels.front();
    const Parts::View& v = level.views[view];
    times.measure("stereo: depths", stream, [&] {
        find_depths<<<p.blocks(v, kTileWidth), dim3(kTileWidth, kTileHeight), 0, stream.get()>>>({v.width, v.height}, v.lens, level.planes.data() + v.first,
                                                                                                 level.agreed.data() + v.first, p.likely.data() + v.first);
        VDBCARVE_LAUNCHED();
    });
    return p.likely.data() + v.first;
}
const float* StereoStage::confidence(size_t view) const { return parts_->levels.front().agreed.data() + parts_->levels.front().views[view].first; }

void StereoStage::release() {
    Parts& p = *parts_;
    p.levels.clear();
    p.grey.release();
    p.likely.release();
    p.object.release();
    for (Parts::Lane& lane : p.lanes) lane.hull.release();
    p.near.release();
    p.solid.release();
    p.values.release();
    p.confidence.release();
}

size_t StereoStage::bytes() const {
    const Parts& p = *parts_;
    size_t out = p.grey.bytes() + p.likely.bytes() + p.object.bytes() + Parts::kLanes * p.lanes[0].hull.bytes() + p.depths.bytes() + p.counts.bytes() +
                 p.near.bytes() + p.solid.bytes() + p.fusion.bytes() + p.blocks_first.bytes() + p.block_of_slot.bytes() + p.values.bytes() +
                 p.confidence.bytes();
    for (const Parts::Level& level : p.levels) out += level.planes.bytes() + level.agreed.bytes();
    return out;
}

}  // namespace vdbcarve::cuda
