// SPDX-License-Identifier: Apache-2.0
// Fewer faces for the same shape.
#pragma once

#include <cstddef>

#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

struct DecimateOptions {
    size_t faces = 0;          ///< stop at so many; 0: as few as max_error allows
    double max_error = 0;      ///< no removed point lies farther from the faces that replace it, mesh units; 0: any distance
    double max_turn_deg = 25;  ///< no face's normal turns by more in one step
};

/// Collapses edges, the least quadric error first (Garland and Heckbert, SIGGRAPH 1997; OpenMesh's decimater). Stays closed, 2-manifold and of the same genus;
/// a vertex that remains keeps its place and colour. Normals are computed anew where the mesh had some; quads become triangles. Returns the number of faces
/// left, more than asked for where no collapse is allowed any more. One thread; about 4 us a face. Throws UsageError and InputError.
size_t decimate(Mesh& mesh, const DecimateOptions& options, Progress& progress);

/// Fewer faces for a picture, of any mesh in a moment: vertices that share a cell of a raster become one, at their mean (Rossignac and Borrel 1993), which
/// finds the cells' size for at most so many faces. What is thinner than a cell becomes a sheet or a line: neither closed nor manifold, but nothing is lost
/// from sight. Colours are means, too; normals and quads are not kept. About 0.15 us a face.
Mesh simplified_for_display(const Mesh& mesh, size_t most_faces);

}  // namespace vdbcarve
