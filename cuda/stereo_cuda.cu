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

__global__ void __launch_bounds__(kTileWidth * kTileHeight) ask_hull(RenderVolume volume, HullView view, const uint8_t* object, Size size, HullSight* out, uint32_t* count) {
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

__global__ void __launch_bounds__(kTileWidth * kTileHeight) start_planes(StereoReference reference, StereoBest* planes) {
    int x, y;
    if (pixel_of_thread({reference.image.width, reference.image.height}, x, y)) planes[y * reference.image.width + x] = first_plane(reference, x, y);
}

__global__ void __launch_bounds__(kTileWidth * kTileHeight) better_planes(StereoReference reference, StereoBest* planes, int pass, int color) {
    const int y = static_cast<int>(blockIdx.y) * kTileHeight + static_cast<int>(threadIdx.y);
    const int x = 2 * (static_cast<int>(blockIdx.x) * kTileWidth + static_cast<int>(threadIdx.x)) + ((y + color) & 1);
    if (x >= reference.image.width || y >= reference.image.height) return;
    if (reference.hull[y * reference.image.width + x].front == 0.f) return;
    planes[y * reference.image.width + x] = better_plane(reference, planes, x, y, pass);  // reads pixels of the other colour only, and its own
}

__global__ void __launch_bounds__(kTileWidth * kTileHeight) find_likely(StereoReference reference, const StereoBest* planes, StereoTrustRule rule, float* likely, uint32_t* count) {
    int x, y;
    if (!pixel_of_thread({reference.image.width, reference.image.height}, x, y)) return;
    const int n = y * reference.image.width + x;
    likely[n] = likelihood(reference, planes[n], rule, x, y);
    if (likely[n] > 0.f) atomicAdd(count, 1u);
}

__global__ void __launch_bounds__(kTileWidth * kTileHeight) find_agreed(StereoReference reference, const StereoDepths* depths, const uint8_t* object, StereoTrustRule rule, float* agreed) {
    int x, y;
    if (!pixel_of_thread({reference.image.width, reference.image.height}, x, y)) return;
    const int n = y * reference.image.width + x;
    agreed[n] = object[n] < 2 ? 0.f : agreed_likelihood(reference, depths, rule, x, y);
}

}  // namespace

struct StereoStage::Parts {
    struct View {
        int width = 0, height = 0;
        size_t first = 0;  ///< pixel, among those of all views
        StereoLens lens{};
        bool matched = false;
    };
    std::vector<View> views;
    DeviceBuffer<float> grey, likely, agreed;
    DeviceBuffer<uint8_t> object;
    DeviceBuffer<StereoBest> planes, coarse;  ///< of this level, and of the one before
    std::vector<View> coarse_views;
    DeviceBuffer<HullSight> hull;  ///< of the view at hand
    DeviceBuffer<StereoDepths> depths;
    DeviceBuffer<uint32_t> counts;
    DeviceBuffer<uint64_t> near, solid;
    RenderVolume volume{};

    dim3 blocks(const View& v, int columns) const {
        const auto of = [](int count, int side) { return static_cast<unsigned>((count + side - 1) / side); };
        return {of(v.width, columns), of(v.height, kTileHeight)};
    }
};

StereoStage::StereoStage() : parts_(std::make_unique<Parts>()) {}
StereoStage::~StereoStage() = default;

void StereoStage::begin(const std::vector<StereoPixels>& views, bool after_coarser, const Grid& grid, const ColorBase& base, const SightBox& box, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    p.coarse_views.clear();
    if (after_coarser) {
        std::swap(p.planes, p.coarse);
        p.coarse_views = p.views;
    }
    p.views.assign(views.size(), {});
    size_t pixels = 0, most = 0;
    for (size_t v = 0; v < views.size(); ++v) {
        const size_t own = static_cast<size_t>(views[v].width) * static_cast<size_t>(views[v].height);
        p.views[v] = {views[v].width, views[v].height, pixels, views[v].lens, false};
        pixels += own;
        most = own > most ? own : most;
    }
    p.grey.ensure(pixels);
    p.object.ensure(pixels);
    p.planes.ensure(pixels);
    p.likely.ensure(pixels);
    p.agreed.ensure(pixels);
    p.hull.ensure(most);
    p.counts.ensure(2 * views.size());
    const auto voxel = static_cast<float>(grid.spec().voxel_size);
    const size_t words = static_cast<size_t>(grid.leaf_count()) * kWallWords;
    uint64_t *near = p.near.ensure(words), *solid = p.solid.ensure(words);
    const float near_threshold = kNearSurface_vox * voxel;
    times.measure("stereo: photographs", stream, [&] {
        for (size_t v = 0; v < views.size(); ++v) {
            const size_t own = static_cast<size_t>(views[v].width) * static_cast<size_t>(views[v].height);
            if (!own) continue;
            stream.to_device(p.grey.data() + p.views[v].first, views[v].grey, own);
            stream.to_device(p.object.data() + p.views[v].first, views[v].object, own);
        }
        stream.zero(p.counts.data(), 2 * views.size());
        build_walls(grid, near_threshold, near, stream);
        build_walls(grid, 0.f, solid, stream);
    });
    p.volume = {{grid.grid(), near, near_threshold, base}, {grid.grid(), solid, 0.f, base}, box, nullptr, voxel};
}

void StereoStage::match(StereoReference reference, const HullView& hull, int passes, const StereoTrustRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    Parts::View& v = p.views[static_cast<size_t>(reference.view)];
    v.matched = true;
    reference.image.grey = p.grey.data() + v.first;
    for (int n = 0; n < reference.pairs; ++n) reference.other[n].grey = p.grey.data() + p.views[static_cast<size_t>(reference.pair[n].view)].first;
    reference.hull = p.hull.data();
    if (!p.coarse_views.empty()) {
        const Parts::View& c = p.coarse_views[static_cast<size_t>(reference.view)];
        reference.coarse = p.coarse.data() + c.first;
        reference.coarse_width = c.width;
        reference.coarse_height = c.height;
    }
    StereoBest* planes = p.planes.data() + v.first;
    uint32_t* counts = p.counts.data() + 2 * reference.view;
    const dim3 threads(kTileWidth, kTileHeight), all = p.blocks(v, kTileWidth), half = p.blocks(v, 2 * kTileWidth);
    times.measure("stereo: hull", stream, [&] {
        ask_hull<<<all, threads, 0, stream.get()>>>(p.volume, hull, p.object.data() + v.first, {v.width, v.height}, p.hull.data(), counts);
        VDBCARVE_LAUNCHED();
    });
    times.measure("stereo: planes", stream, [&] {
        start_planes<<<all, threads, 0, stream.get()>>>(reference, planes);
        VDBCARVE_LAUNCHED();
        for (int pass = 0; pass < passes; ++pass)
            for (const int color : {0, 1}) {
                better_planes<<<half, threads, 0, stream.get()>>>(reference, planes, pass, color);
                VDBCARVE_LAUNCHED();
            }
    });
    times.measure("stereo: likelihood", stream, [&] {
        find_likely<<<all, threads, 0, stream.get()>>>(reference, planes, rule, p.likely.data() + v.first, counts + 1);
        VDBCARVE_LAUNCHED();
    });
}

void StereoStage::agree(const std::vector<StereoReference>& references, const StereoTrustRule& rule, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    std::vector<StereoDepths> depths(p.views.size());
    for (size_t v = 0; v < p.views.size(); ++v)
        if (p.views[v].matched) depths[v] = {p.planes.data() + p.views[v].first, p.likely.data() + p.views[v].first, p.views[v].lens, p.views[v].width, p.views[v].height};
    p.depths.ensure(depths.size());
    times.measure("stereo: agreement", stream, [&] {
        stream.to_device(p.depths.data(), depths.data(), depths.size());
        for (const StereoReference& reference : references) {
            const Parts::View& v = p.views[static_cast<size_t>(reference.view)];
            find_agreed<<<p.blocks(v, kTileWidth), dim3(kTileWidth, kTileHeight), 0, stream.get()>>>(reference, p.depths.data(), p.object.data() + v.first, rule, p.agreed.data() + v.first);
            VDBCARVE_LAUNCHED();
        }
    });
    stream.wait();  // `depths` goes
}

const StereoBest* StereoStage::planes(size_t view) const { return parts_->planes.data() + parts_->views[view].first; }
const float* StereoStage::agreed(size_t view) const { return parts_->agreed.data() + parts_->views[view].first; }

std::vector<uint32_t> StereoStage::counts(const Stream& stream) const {
    std::vector<uint32_t> out(2 * parts_->views.size());
    stream.to_host(out.data(), parts_->counts.data(), out.size());
    stream.wait();
    return out;
}

size_t StereoStage::bytes() const {
    const Parts& p = *parts_;
    return p.grey.bytes() + p.likely.bytes() + p.agreed.bytes() + p.object.bytes() + p.planes.bytes() + p.coarse.bytes() + p.hull.bytes() + p.depths.bytes() + p.counts.bytes() + p.near.bytes() + p.solid.bytes();
}

}  // namespace vdbcarve::cuda
