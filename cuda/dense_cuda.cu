// SPDX-License-Identifier: Apache-2.0
#include "dense_cuda.h"

namespace vdbcarve::cuda {
namespace {

__constant__ float matrices[256 * 12];

/// Denkowski 2013, listing 4.1, with the depth in both places.
__global__ void carve_voxels(const uint8_t* masks, int views, int width, int height, int nj, int nk, uint8_t* volume) {
    const int k = blockIdx.x * blockDim.x + threadIdx.x, j = blockIdx.y, i = blockIdx.z;
    if (k >= nk) return;
    const float x = static_cast<float>(i), y = static_cast<float>(j), z = static_cast<float>(k);
    uint8_t object = 1;
    for (int v = 0; v < views; ++v) {
        const float* p = matrices + 12 * v;
        const float u = fmaf(p[0], x, fmaf(p[1], y, fmaf(p[2], z, p[3]))), w = fmaf(p[4], x, fmaf(p[5], y, fmaf(p[6], z, p[7])));
        const float inverse = __fdividef(1.f, fmaf(p[8], x, fmaf(p[9], y, fmaf(p[10], z, p[11]))));
        const int column = static_cast<int>(u * inverse), row = static_cast<int>(w * inverse);
        if (static_cast<unsigned>(column) >= static_cast<unsigned>(width) || static_cast<unsigned>(row) >= static_cast<unsigned>(height) ||
            !masks[(static_cast<size_t>(v) * height + row) * width + column]) {
            object = 0;
            break;
        }
    }
    volume[(static_cast<size_t>(i) * nj + j) * nk + k] = object;
}

__global__ void count_objects(const uint8_t* volume, size_t voxels, unsigned long long* count) {
    unsigned long long mine = 0;
    for (size_t n = static_cast<size_t>(blockIdx.x) * blockDim.x + threadIdx.x; n < voxels; n += static_cast<size_t>(gridDim.x) * blockDim.x) mine += volume[n];
    for (int d = 16; d; d /= 2) mine += __shfl_xor_sync(~0u, mine, d);
    if (threadIdx.x % 32 == 0) atomicAdd(count, mine);
}

}  // namespace

void DenseStage::upload(const std::vector<const uint8_t*>& masks, int width, int height, const std::vector<std::array<float, 12>>& pixel_from_index,
                        const Stream& stream) {
    if (masks.size() > 256) throw BackendError("CUDA: the dense method takes at most 256 views");
    views_ = static_cast<int>(masks.size());
    width_ = width;
    height_ = height;
    const size_t pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
    masks_.ensure(masks.size() * pixels);
    for (size_t v = 0; v < masks.size(); ++v) stream.to_device(masks_.data() + v * pixels, masks[v], pixels);
    VDBCARVE_CUDA(cudaMemcpyToSymbolAsync(matrices, pixel_from_index.data(), pixel_from_index.size() * sizeof(pixel_from_index[0]), 0, cudaMemcpyHostToDevice,
                                          stream.get()));
    stream.wait();
}

void DenseStage::run(const std::array<int, 3>& dims, const Stream& stream) {
    voxels_ = static_cast<size_t>(dims[0]) * static_cast<size_t>(dims[1]) * static_cast<size_t>(dims[2]);
    volume_.ensure(voxels_);
    carve_voxels<<<dim3(static_cast<unsigned>((dims[2] + 127) / 128), static_cast<unsigned>(dims[1]), static_cast<unsigned>(dims[0])), 128, 0, stream.get()>>>(
        masks_.data(), views_, width_, height_, dims[1], dims[2], volume_.data());
    VDBCARVE_LAUNCHED();
}

size_t DenseStage::count(const Stream& stream) {
    count_.ensure(1);
    stream.zero(count_.data(), 1);
    count_objects<<<1024, 256, 0, stream.get()>>>(volume_.data(), voxels_, count_.data());
    VDBCARVE_LAUNCHED();
    unsigned long long out = 0;
    stream.to_host(&out, count_.data(), 1);
    stream.wait();
    return out;
}

}  // namespace vdbcarve::cuda
