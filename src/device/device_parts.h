// SPDX-License-Identifier: Apache-2.0
// What a Device holds. Included by its own sources only, which are compiled where there is CUDA.
#pragma once

#include <tbb/parallel_for.h>

#include <cstring>
#include <optional>

#include "cuda/carve_cuda.h"
#include "cuda/color_cuda.h"
#include "cuda/distance_cuda.h"
#include "cuda/fair_cuda.h"
#include "cuda/fair_depths_cuda.h"
#include "cuda/fair_sight_cuda.h"
#include "cuda/filter_cuda.h"
#include "cuda/level_set_cuda.h"
#include "cuda/mesh_cuda.h"
#include "cuda/render_cuda.h"
#include "cuda/stereo_cuda.h"
#include "mesh/marching_cubes.h"
#include "volume/nanovdb_bytes.h"
#include "surface/redistance.h"
#include "volume/same_transform.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

/// Copies in parallel, so that page-locked memory is filled at the memory's speed.
inline void copy_parallel(uint8_t* to, const uint8_t* from, size_t bytes) {
    constexpr size_t kPiece = 1 << 19;
    tbb::parallel_for(size_t{0}, (bytes + kPiece - 1) / kPiece,
                      [&](size_t p) { std::memcpy(to + p * kPiece, from + p * kPiece, std::min(kPiece, bytes - p * kPiece)); });
}

/// A leaf of a grid on the host, from its values and the words of its mask.
inline std::unique_ptr<openvdb::FloatTree::LeafNodeType> make_leaf(const openvdb::Coord& origin, const float* values, const uint64_t* active,
                                                                   float background) {
    using Leaf = openvdb::FloatTree::LeafNodeType;
    auto leaf = std::make_unique<Leaf>(openvdb::PartialCreate(), origin, background, false);
    leaf->allocate();
    std::memcpy(leaf->buffer().data(), values, sizeof(float) * Leaf::SIZE);
    openvdb::util::NodeMask<3> mask;
    for (openvdb::Index w = 0; w < 8; ++w) mask.getWord<openvdb::Index64>(w) = active[w];
    leaf->setValueMask(mask);
    return leaf;
}

/// Brings device memory home through two pieces of page-locked memory: while one is on its way the other is taken in.
class Fetcher {
  public:
    /// Pieces are multiples of `unit` bytes. `take(piece, offset, bytes)` is called in order.
    template <class Take>
    void fetch(const void* device, size_t bytes, size_t unit, const cuda::Stream& stream, const Take& take) {
        const size_t piece = std::max(kPiece / unit, size_t{1}) * unit;
        const auto* from = static_cast<const uint8_t*>(device);
        const size_t pieces = (bytes + piece - 1) / piece;
        const auto size_of = [&](size_t p) { return std::min(piece, bytes - p * piece); };
        const auto order = [&](size_t p) {
            stream.to_host(held_[p % 2].ensure(piece), from + p * piece, size_of(p));
            arrived_[p % 2].record(stream);
        };
        if (pieces) order(0);
        for (size_t p = 0; p < pieces; ++p) {
            if (p + 1 < pieces) order(p + 1);
            arrived_[p % 2].wait();
            take(held_[p % 2].data(), p * piece, size_of(p));
        }
    }
    void fetch_to(void* to, const void* device, size_t bytes, const cuda::Stream& stream) {
        fetch(device, bytes, 1, stream, [&](const uint8_t* piece, size_t at, size_t size) { copy_parallel(static_cast<uint8_t*>(to) + at, piece, size); });
    }

  private:
    static constexpr size_t kPiece = size_t{8} << 20;
    cuda::PinnedBuffer<uint8_t> held_[2];
    cuda::Event arrived_[2];
};

struct Device::Parts {
    /// A level set that was carried here, or made by a stage: its grid and the topology it was built from.
    struct Volume {
        cuda::Grid grid;
        cuda::Topology own;                  ///< of an uploaded one
        cuda::Topology* topology = nullptr;  ///< null: there is none
        openvdb::math::Transform::Ptr transform;
    };

    int device;
    cuda::Stream stream;
    cuda::StageTimes times;
    mutable Fetcher fetcher;

    cuda::DistanceStage distance;
    std::vector<size_t> mask_of;  ///< of the uploaded masks, by view; SIZE_MAX: the view has none
    struct MaskSize {
        int width, height;
        bool ignores;
    };
    std::vector<MaskSize> mask_sizes;    ///< of the uploaded ones
    std::vector<DistanceField> headers;  ///< by view, without samples
    std::vector<cuda::DeviceField> silhouettes, ignored;
    cuda::DeviceBuffer<int16_t> uploaded_fields;

    cuda::CarveStage carve;
    std::optional<CarveOptions> carve_options;
    std::vector<CarveInput> carve_inputs;  ///< without fields
    Volume hull, surface;
    Volume fused;  ///< the surface carved by depths, before it is re-distanced
    cuda::LevelSetStage level_set;
    cuda::FilterStage filter;
    cuda::FairStage fair;
    cuda::FairSight fair_sight;
    cuda::FairDepthStage fair_depths;
    cuda::MeshStage mesh;
    cuda::ColorStage color;
    cuda::RenderStage render;
    cuda::StereoStage stereo;
    cuda::DeviceBuffer<uint8_t> photos;  ///< of a batch
    cuda::DeviceBuffer<float> uploaded_values;
    cuda::DeviceBuffer<uint64_t> uploaded_active;
    cuda::DeviceBuffer<uint32_t> uploaded_keys;

    explicit Parts(int d) : device(select(d)) {}
    static int select(int d) {
        choose_backend(Backend::Cuda, d);
        VDBCARVE_CUDA(cudaSetDevice(d));
        return d;
    }
    /// Another session may have chosen another device for this thread.
    void use() const { VDBCARVE_CUDA(cudaSetDevice(device)); }

    kernel::FieldView view_of(const SampledField& header, const cuda::DeviceField& field) const {
        kernel::FieldView v = header.view();
        v.samples = field.samples;
        v.blocks = field.blocks;
        v.blocks_per_row = field.blocks_per_row;
        return v;
    }

    void upload(Volume& volume, const openvdb::FloatGrid& grid);
    /// Makes `surface` of a field, with the volume kept where `repair` is given. False when the field has no zero crossing.
    bool redistance(const cuda::Grid& field, const cuda::Topology& topology, int half_width_vox, VolumeRepair* repair);

    static cuda::GridSpec spec_of(const std::string& name, const openvdb::math::Transform& transform, float background) {
        const kernel::LatticeFrame frame = lattice_frame(transform);
        return {name, frame.voxel_size, {frame.first[0], frame.first[1], frame.first[2]}, background};
    }

    const Volume& need(const Volume& volume, const char* what) const {
        if (!volume.topology) throw UsageError(std::string("the device holds no ") + what);
        return volume;
    }

    NanoBuffer bytes_of(const Volume& volume) const {
        NanoBuffer out = allocate_nanovdb(volume.grid.size());
        fetcher.fetch_to(out.data.get(), volume.grid.grid(), volume.grid.size(), stream);
        return out;
    }
    NanoBuffer nanovdb_of(const Volume& volume) const {
        NanoBuffer out = bytes_of(volume);
        finish_nanovdb(out, *volume.transform);
        return out;
    }
};

}  // namespace vdbcarve
