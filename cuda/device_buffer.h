// SPDX-License-Identifier: Apache-2.0
// Memory of the device, and page-locked memory of the host that it is copied through. Both only grow: a stage that runs
// again finds what it needs.
#pragma once

#include <cstddef>
#include <utility>

#include "cuda_check.h"

namespace vdbcarve::cuda {

enum class Where { Device, PinnedHost };

template <class T, Where where = Where::Device>
class Buffer {
  public:
    Buffer() = default;
    explicit Buffer(size_t count) { ensure(count); }
    Buffer(Buffer&& other) noexcept : data_(std::exchange(other.data_, nullptr)), capacity_(std::exchange(other.capacity_, 0)) {}
    Buffer& operator=(Buffer&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(capacity_, other.capacity_);
        return *this;
    }
    ~Buffer() { release(); }

    /// Room for `count` elements. What was there is lost when it has to grow.
    T* ensure(size_t count) {
        if (count <= capacity_) return data_;
        release();
        void* p = nullptr;
        if constexpr (where == Where::Device) VDBCARVE_CUDA(cudaMalloc(&p, count * sizeof(T)));
        else VDBCARVE_CUDA(cudaMallocHost(&p, count * sizeof(T)));
        data_ = static_cast<T*>(p);
        capacity_ = count;
        return data_;
    }
    void release() noexcept {
        if (data_) where == Where::Device ? cudaFree(data_) : cudaFreeHost(data_);
        data_ = nullptr;
        capacity_ = 0;
    }
    T* data() const { return data_; }
    T& operator[](size_t i) const { return data_[i]; }
    size_t capacity() const { return capacity_; }
    size_t bytes() const { return capacity_ * sizeof(T); }

  private:
    T* data_ = nullptr;
    size_t capacity_ = 0;
};

template <class T>
using DeviceBuffer = Buffer<T>;
template <class T>
using PinnedBuffer = Buffer<T, Where::PinnedHost>;

}  // namespace vdbcarve::cuda
