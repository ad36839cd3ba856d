// SPDX-License-Identifier: Apache-2.0
#include "render_cuda.h"

#include <climits>

namespace vdbcarve::cuda {
namespace {

using namespace kernel;

constexpr unsigned kThreads = 256;
constexpr int kTileWidth = 8, kTileHeight = 16;  ///< pixels of a block: neighbours' rays go through the same leaves

__global__ void find_box(const Grid::Leaf* leaves, uint32_t count, int* box) {
    const uint32_t n = blockIdx.x * blockDim.x + threadIdx.x;
    if (n >= count) return;
    const nanovdb::Coord o = leaves[n].origin();
    for (int a = 0; a < 3; ++a) {
        atomicMin(box + a, o[a]);
        atomicMax(box + 3 + a, o[a] + 7);
    }
}

template <int style>
__global__ void __launch_bounds__(kTileWidth* kTileHeight) render_pixels(RenderVolume volume, RenderRule rule, uint32_t* pixels) {
    const int x = static_cast<int>(blockIdx.x) * kTileWidth + static_cast<int>(threadIdx.x),
              y = static_cast<int>(blockIdx.y) * kTileHeight + static_cast<int>(threadIdx.y);
    if (x < rule.width && y < rule.height) pixels[static_cast<size_t>(y) * rule.width + x] = render_pixel<style>(volume, rule, x, y);
}

}  // namespace

struct RenderStage::Parts {
    DeviceBuffer<uint64_t> near, solid;
    DeviceBuffer<uint8_t> colors;
    bool has_colors = false;
    DeviceBuffer<int> box;
    PinnedBuffer<int> host_box;
    DeviceBuffer<Vec3> ambient;
    DeviceBuffer<uint8_t> srgb;
    DeviceBuffer<uint32_t> pixels;
};

RenderStage::RenderStage() : parts_(std::make_unique<Parts>()) {}
RenderStage::~RenderStage() = default;

void RenderStage::set_colors(const uint8_t* bytes, size_t size, const Stream& stream) {
    stream.to_device(parts_->colors.ensure(size), bytes, size);
    parts_->has_colors = true;
}

void RenderStage::clear_colors() { parts_->has_colors = false; }

std::array<int, 6> RenderStage::leaf_box(const Grid& grid, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    if (grid.leaf_count() == 0) return {INT_MAX, INT_MAX, INT_MAX, INT_MIN, INT_MIN, INT_MIN};
    int* host = p.host_box.ensure(6);
    int* box = p.box.ensure(6);
    for (int a = 0; a < 3; ++a) host[a] = INT_MAX, host[3 + a] = INT_MIN;
    times.measure("render: walls", stream, [&] {
        stream.to_device(box, host, 6);
        find_box<<<blocks_for(grid.leaf_count(), kThreads), kThreads, 0, stream.get()>>>(grid.leaves(), grid.leaf_count(), box);
        VDBCARVE_LAUNCHED();
        stream.to_host(host, box, 6);
    });
    stream.wait();
    return {host[0], host[1], host[2], host[3], host[4], host[5]};
}

const uint8_t* RenderStage::render(const Grid& grid, const ColorBase& base, const SightBox& box, RenderRule rule, const std::vector<Vec3>& ambient,
                                   const std::vector<uint8_t>& srgb, const Stream& stream, StageTimes& times) {
    Parts& p = *parts_;
    const auto voxel = static_cast<float>(grid.spec().voxel_size);
    const size_t words = static_cast<size_t>(grid.leaf_count()) * kWallWords;
    uint64_t *near = p.near.ensure(words), *solid = p.solid.ensure(words);
    const float near_threshold = kNearSurface_vox * voxel;
    Vec3* directions = p.ambient.ensure(ambient.size() + 1);
    uint8_t* table = p.srgb.ensure(srgb.size());
    times.measure("render: walls", stream, [&] {
        build_walls(grid, near_threshold, near, stream);
        build_walls(grid, 0.f, solid, stream);
        stream.to_device(directions, ambient.data(), ambient.size());
        stream.to_device(table, srgb.data(), srgb.size());
    });
    rule.ambient = directions;
    rule.srgb = table;
    const RenderVolume volume{{grid.grid(), near, near_threshold, base},
                              {grid.grid(), solid, 0.f, base},
                              box,
                              p.has_colors ? reinterpret_cast<const nanovdb::NanoGrid<nanovdb::Vec3f>*>(p.colors.data()) : nullptr,
                              voxel};
    uint32_t* pixels = p.pixels.ensure(static_cast<size_t>(rule.width) * rule.height);
    times.measure("render", stream, [&] {
        const dim3 blocks((rule.width + kTileWidth - 1) / kTileWidth, (rule.height + kTileHeight - 1) / kTileHeight), threads(kTileWidth, kTileHeight);
        with_style(rule.style, [&](auto style) { render_pixels<decltype(style)::value><<<blocks, threads, 0, stream.get()>>>(volume, rule, pixels); });
        VDBCARVE_LAUNCHED();
    });
    stream.wait();  // the tables are the caller's
    return reinterpret_cast<const uint8_t*>(pixels);
}

size_t RenderStage::bytes() const {
    const Parts& p = *parts_;
    return p.near.bytes() + p.solid.bytes() + p.colors.bytes() + p.ambient.bytes() + p.srgb.bytes() + p.pixels.bytes();
}

}  // namespace vdbcarve::cuda
