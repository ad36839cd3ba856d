// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/smooth.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "mesh/open_mesh.h"

namespace vdbcarve {

double mu_for(double lambda, double pass_band) {
    if (!(lambda > 0 && lambda < 1)) throw UsageError("smooth: lambda is " + std::to_string(lambda) + ", must be between 0 and 1");
    if (!(pass_band > 0 && pass_band < 1 / lambda))
        throw UsageError("smooth: the pass band is " + std::to_string(pass_band) + ", must be between 0 and 1 / lambda = " + std::to_string(1 / lambda));
    return 1 / (pass_band - 1 / lambda);
}

void smooth(Mesh& mesh, const SmoothOptions& options, Progress& progress) {
    if (options.iterations < 0 || options.iterations > 10000)
        throw UsageError("smooth: " + std::to_string(options.iterations) + " iterations, must be 0..10000");
    if (!(options.lambda > 0 && options.lambda < 1)) throw UsageError("smooth: lambda is " + std::to_string(options.lambda) + ", must be between 0 and 1");
    if (!(options.mu < -options.lambda && options.mu > -2))
        throw UsageError("smooth: mu is " + std::to_string(options.mu) + ", must be less than -lambda (or the mesh shrinks) and more than -2");
    if (options.iterations == 0) return;
    progress.begin("smooth", 2 * static_cast<size_t>(options.iterations));
    const HalfEdgeMesh half_edges = to_half_edges(mesh);
    const size_t count = mesh.vertices.size();
    std::vector<std::array<float, 3>> moved(count);
    for (int step = 0; step < 2 * options.iterations; ++step) {
        const auto factor = static_cast<float>(step % 2 ? options.mu : options.lambda);
        tbb::parallel_for(tbb::blocked_range<size_t>(0, count, 1024), [&](const tbb::blocked_range<size_t>& range) {
            for (size_t v = range.begin(); v < range.end(); ++v) {
                const HalfEdgeMesh::VertexHandle here(static_cast<int>(v));
                const auto& x = mesh.vertices[v];
                moved[v] = x;
                if (half_edges.is_boundary(here)) continue;
                // Differences, so that a far-away origin costs no digits.
                std::array<float, 3> sum{0, 0, 0};
                int neighbours = 0;
                for (auto other = half_edges.cvv_iter(here); other.is_valid(); ++other, ++neighbours)
                    for (size_t a = 0; a < 3; ++a) sum[a] += mesh.vertices[static_cast<size_t>(other->idx())][a] - x[a];
                if (neighbours == 0) continue;
                for (size_t a = 0; a < 3; ++a) moved[v][a] = x[a] + factor * (sum[a] / static_cast<float>(neighbours));
            }
        });
        mesh.vertices.swap(moved);
        progress.step();
    }
    if (!mesh.normals.empty()) mesh.normals = vertex_normals(mesh);
}

}  // namespace vdbcarve
