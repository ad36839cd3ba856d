// SPDX-License-Identifier: Apache-2.0
// An indexed triangle mesh and what can be measured on it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace vdbcarve {

struct Mesh {
    std::vector<std::array<float, 3>> vertices;       ///< world units
    std::vector<std::array<uint32_t, 3>> triangles;   ///< counter-clockwise seen from outside
    std::vector<std::array<float, 3>> normals{};      ///< unit, outward, one a vertex; or none
    std::vector<std::array<float, 3>> colors{};       ///< RGB, linear light 0..1, one a vertex; or none
    /// Texture coordinates of each triangle's corners, v upwards; or none. Read from .obj, never written.
    std::vector<std::array<std::array<float, 2>, 3>> texcoords{};
};

struct MeshMeasures {
    size_t vertices = 0, faces = 0, components = 0;
    size_t boundary_edges = 0;         ///< edges with one face
    size_t non_manifold_edges = 0;     ///< edges with more than two faces, or two of opposite winding
    size_t non_manifold_vertices = 0;  ///< vertices where several fans of faces meet
    size_t zero_area_faces = 0;
    bool closed = false;    ///< every edge has exactly two faces, consistently wound
    bool manifold = false;  ///< closed, and every vertex has one fan
    long genus = 0;         ///< sum over components; meaningful when manifold
    double volume = 0;      ///< signed, world units cubed; positive when wound outward
    double area = 0;
};

/// Time O(faces log faces).
MeshMeasures measure(const Mesh& mesh);

/// Reads .ply, .obj, .stl and .off; polygons are cut into fans. Vertex colours are taken to be sRGB. Throws InputError.
Mesh read_mesh(const std::filesystem::path& file);

/// Writes .ply (binary little-endian, vertices x y z [nx ny nz] [red green blue], triangles), .obj (v x y z [r g b]) or .stl (binary) by
/// extension; colours as sRGB. Appears by rename. OBJ is turned from `up` ("x", "y", "z", "-x" …; empty: as it is) to y up, the others keep
/// the scene's axes. Throws OutputError, and UsageError for another extension.
void write_mesh(const std::filesystem::path& file, const Mesh& mesh, const std::string& up = {});

}  // namespace vdbcarve
