// SPDX-License-Identifier: Apache-2.0
// Marching cubes on the device: the mesh of src/mesh/marching_cubes.cpp, vertex by vertex in the same order.
#pragma once

#include <array>

#include "grid_cuda.h"
#include "vdbcarve/kernel/marching_cubes.h"

namespace vdbcarve::cuda {

class MeshStage {
  public:
    /// Extracts the zero surface. False where cells that it crosses lie below leaves that do not exist: no level set with a whole band has
    /// such, and the host's way through handles them. Waits for the device once, for the sizes.
    bool run(const Grid& surface, const Topology& topology, const std::array<kernel::MarchingCase, 256>& cases, bool normals, const Stream& stream,
             StageTimes& times);

    bool made() const { return made_; }
    bool has_normals() const { return has_normals_; }
    size_t vertex_count() const { return vertex_count_; }
    size_t triangle_count() const { return triangle_count_; }
    const float* vertices() const { return vertices_.data(); }  ///< x y z, world units
    const uint32_t* triangles() const { return triangles_.data(); }
    const float* normals() const { return normals_.data(); }
    size_t bytes() const {
        return edges_.bytes() + counts_.bytes() + firsts_.bytes() + vertices_.bytes() + normals_.bytes() + triangles_.bytes() + scratch_.bytes();
    }

  private:
    DeviceBuffer<kernel::MarchingCase> cases_;
    DeviceBuffer<kernel::LeafEdges> edges_;
    DeviceBuffer<uint32_t> counts_, firsts_;  ///< vertices, then triangles, of each leaf and of all before
    DeviceBuffer<uint8_t> scratch_;
    DeviceBuffer<unsigned> open_;
    PinnedBuffer<uint32_t> host_totals_;
    DeviceBuffer<float> vertices_, normals_;
    DeviceBuffer<uint32_t> triangles_;
    size_t vertex_count_ = 0, triangle_count_ = 0;
    bool made_ = false, has_normals_ = false;
};

}  // namespace vdbcarve::cuda
