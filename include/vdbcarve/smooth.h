// SPDX-License-Identifier: Apache-2.0
// Stage `smooth`: the mesh's vertices moved to a smoother surface that keeps its volume.
#pragma once

#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

/// One iteration is two steps x += factor * (mean of the neighbours - x), with lambda > 0, which smooths and shrinks, and mu < -lambda, which
/// grows again. Bends of a spatial frequency below kPB = 1 / lambda + 1 / mu pass; the defaults have kPB = 0.1.
struct SmoothOptions {
    int iterations = 10;
    double lambda = 0.6307, mu = -0.6732;
};

/// mu for a pass-band frequency 0 < kPB < 1 / lambda. Throws UsageError.
double mu_for(double lambda, double pass_band);

/// Taubin's lambda|mu smoothing with the uniform umbrella operator (Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995) on an
/// OpenMesh half-edge mesh. Connectivity, colours and quads stay; normals are computed anew where the mesh had some. Vertices of boundaries do not move.
/// Same bits for any number of threads. About 0.15 us a vertex and iteration and core; 250 bytes a vertex. Throws UsageError for factors that do not smooth and
/// InputError for a mesh that is no 2-manifold.
void smooth(Mesh& mesh, const SmoothOptions& options, Progress& progress);

}  // namespace vdbcarve
