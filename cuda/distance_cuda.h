// SPDX-License-Identifier: Apache-2.0
// Distance fields on the device, of masks that lie there: the numbers of src/image/distance.cpp, bit for bit.
#pragma once

#include <cstdint>
#include <vector>

#include "device_buffer.h"
#include "stream.h"

namespace vdbcarve::cuda {

/// A mask in host memory. `ignore` is null, or as large and non-zero where the view says nothing.
struct HostMask {
    const uint8_t* coverage;
    const uint8_t* ignore;
    int width, height;  ///< px
};

/// Smallest box that holds what is object, inclusive; x1 < x0 where nothing is.
struct ObjectBox {
    int x0, y0, x1, y1;
};

/// One field to be made: a window of a prepared image. Lengths in 1/64 sample, as in WindowDistance (vector_loops.h).
struct FieldJob {
    int view;
    bool of_ignored;  ///< distance to the region that the view leaves out, instead of to the silhouette
    int x0, y0, width, height;
    int reach, offset, clamp;
    double block_offset;  ///< samples; the same offset, for the blocks' bounds
};

/// Where a made field lies on the device.
struct DeviceField {
    const int16_t* samples;
    const int16_t* blocks;
    int blocks_per_row;
    size_t sample_count, block_count;
};

class DistanceStage {
  public:
    /// Copies masks to the device. Pinned staging memory is filled by `copy(to, from, bytes)`, which may do so in parallel.
    template <class Copy>
    void upload(const std::vector<HostMask>& masks, const Copy& copy, const Stream& stream) {
        size_t bytes = 0;
        for (const HostMask& m : masks) bytes += (m.ignore ? 2 : 1) * padded(m);
        stream.wait();  // an upload before this one may still read the staging memory
        uint8_t* staged = staging_.ensure(bytes);
        begin_upload(masks, bytes);
        copy(masks, [&](size_t view, bool ignore) { return staged + offset_of(view, ignore); });
        stream.to_device(masks_.data(), staged, bytes);
    }
    /// Brings the masks to samples of scale x scale pixels (mean coverage, or the largest where `conservative`), counts ignored
    /// samples as object, and finds the objects. Waits for the device.
    std::vector<ObjectBox> prepare(int scale, bool conservative, const Stream& stream);
    /// Makes the fields. The memory of those made before is used again.
    std::vector<DeviceField> make(const std::vector<FieldJob>& jobs, const Stream& stream);

    size_t bytes() const;

  private:
    struct DeviceImage {
        const uint8_t* data;
        int width, height;
    };
    static size_t padded(const HostMask& m) { return (static_cast<size_t>(m.width) * static_cast<size_t>(m.height) + 15) / 16 * 16; }
    void begin_upload(const std::vector<HostMask>& masks, size_t bytes);
    size_t offset_of(size_t view, bool ignore) const { return ignore ? ignore_at_[view] : coverage_at_[view]; }

    struct Geometry {
        int width, height;
        bool ignores;
    };
    std::vector<Geometry> geometry_;
    std::vector<size_t> coverage_at_, ignore_at_;
    std::vector<DeviceImage> silhouettes_, seen_;  ///< prepared, in samples
    PinnedBuffer<uint8_t> staging_;
    DeviceBuffer<uint8_t> masks_, prepared_;
    PinnedBuffer<uint8_t> host_jobs_;
    DeviceBuffer<uint8_t> jobs_, near_;
    DeviceBuffer<ObjectBox> boxes_;
    PinnedBuffer<ObjectBox> host_boxes_;
    DeviceBuffer<int16_t> samples_, blocks_, vertical_, horizontal_;
    DeviceBuffer<int32_t> best_, block_scratch_;
};

}  // namespace vdbcarve::cuda
