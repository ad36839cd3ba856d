// SPDX-License-Identifier: Apache-2.0
#include "pipeline/mesh_store.h"

#include <fstream>

#include "base/atomic_file.h"

namespace vdbcarve {
namespace {

constexpr uint64_t kMagic = 0x31766d6376726462;  // ours, version 1
constexpr uint64_t kItemBytes = 12;              // three floats or numbers: a vertex, triangle, normal or colour

struct Header {
    uint64_t magic, vertices, triangles, normals, colors, quads;
};

}  // namespace

void store_mesh(const std::filesystem::path& file, const Mesh& mesh) {
    AtomicFile out(file);
    const Header header{kMagic, mesh.vertices.size(), mesh.triangles.size(), mesh.normals.size(), mesh.colors.size(), mesh.quads};
    out.stream().write(reinterpret_cast<const char*>(&header), sizeof header);
    const auto put = [&](const auto& values) {
        out.stream().write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof values[0]));
    };
    put(mesh.vertices);
    put(mesh.triangles);
    put(mesh.normals);
    put(mesh.colors);
    out.commit();
}

std::optional<Mesh> stored_mesh(const std::filesystem::path& file) {
    std::error_code error;
    const uint64_t size = std::filesystem::file_size(file, error);
    std::ifstream in(file, std::ios::binary);
    Header h{};
    if (error || !in.read(reinterpret_cast<char*>(&h), sizeof h) || h.magic != kMagic) return std::nullopt;
    // Each count by itself first: their sum, times 12, may wrap.
    for (const uint64_t count : {h.vertices, h.triangles, h.normals, h.colors})
        if (count > size / kItemBytes) return std::nullopt;
    if (size != sizeof h + kItemBytes * (h.vertices + h.triangles + h.normals + h.colors)) return std::nullopt;
    for (const uint64_t count : {h.normals, h.colors})
        if (count != 0 && count != h.vertices) return std::nullopt;
    if (h.quads > h.triangles / 2) return std::nullopt;
    Mesh mesh;
    const auto get = [&](auto& values, uint64_t count) {
        values.resize(count);
        in.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(count * sizeof values[0]));
    };
    get(mesh.vertices, h.vertices);
    get(mesh.triangles, h.triangles);
    get(mesh.normals, h.normals);
    get(mesh.colors, h.colors);
    mesh.quads = h.quads;
    if (!in) return std::nullopt;
    for (const auto& triangle : mesh.triangles)
        for (const uint32_t vertex : triangle)
            if (vertex >= mesh.vertices.size()) return std::nullopt;
    return mesh;
}

}  // namespace vdbcarve
