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
    std::vector<std::array<float, 3>> vertices;      ///< world units
    std::vector<std::array<uint32_t, 3>> triangles;  ///< counter-clockwise seen from outside
    std::vector<std::array<float, 3>> normals{};     ///< unit, outward, one a vertex; or none
    std::vector<std::array<float, 3>> colors{};      ///< RGB, linear light 0..1, one a vertex; or none
    /// Texture coordinates of each triangle's corners, v upwards; or none. Read from .obj, never written.
    std::vector<std::array<std::array<float, 2>, 3>> texcoords{};
    /// 1 where no silhouette was seen to end and only the cones of others bound the surface (caps.h), one a vertex; or none.
    std::vector<uint8_t> extrapolated{};
    std::vector<float> slack{};  ///< how much the silhouettes leave open (slack.h), world units, one a vertex; or none
    /// So many pairs of triangles at the end are the halves of quads a, b, c, d: (a, b, c) and (a, c, d).
    size_t quads = 0;
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

/// Time: proportional to the faces; 40 bytes a face besides the mesh.
MeshMeasures measure(const Mesh& mesh);

/// What drop_small_pieces() did.
struct DroppedPieces {
    size_t pieces = 0, kept = 0;
    double volume_share = 0;  ///< of all pieces' volumes, each taken as positive
};

/// Takes away connected pieces whose share of the volume (hollows count as positive) is less than `least_share`; vertices and faces keep their order. The
/// largest piece always stays.
DroppedPieces drop_small_pieces(Mesh& mesh, double least_share);

/// Unit normals of the vertices, from the faces around by area. A vertex whose faces cancel gets the normal of one of them.
std::vector<std::array<float, 3>> vertex_normals(const Mesh& mesh);

/// Reads .ply, .obj, .stl, .off and .glb (all meshes of the scene, placed; in its own axes); polygons are cut into fans. Vertex colours are taken to
/// be sRGB, those of .glb linear. Throws InputError.
Mesh read_mesh(const std::filesystem::path& file);

/// Writes, by extension: .ply (binary little-endian, vertices x y z [nx ny nz] [red green blue] [extrapolated] [slack]), .obj (v x y z [r g b], and a
/// .mtl beside it), .stl (binary), .glb (float positions and normals, COLOR_0 as linear 16-bit RGBA, a matt material; _EXTRAPOLATED). Quads stay whole in .ply
/// and .obj. Colours are sRGB elsewhere. Coordinates are written as they are: see file_frame.h for axes and units. Appears by rename. Throws OutputError, and
/// UsageError for another extension.
void write_mesh(const std::filesystem::path& file, const Mesh& mesh);

}  // namespace vdbcarve
