// SPDX-License-Identifier: Apache-2.0
// Mesh files. Reading goes through OpenMesh's parsers, straight into plain arrays (no half-edges, so that
// meshes with complex edges can be read and reported); writing is ours, for byte-identical files.
#include <OpenMesh/Core/IO/IOManager.hh>
#include <OpenMesh/Core/IO/importer/BaseImporter.hh>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <algorithm>
#include <cmath>
#include <cstring>

#include <tbb/parallel_for.h>

#include "base/atomic_file.h"
#include "mesh/gltf.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

class ArrayImporter : public OpenMesh::IO::BaseImporter {
  public:
    explicit ArrayImporter(Mesh& mesh) : mesh_(mesh) {}

    OpenMesh::VertexHandle add_vertex(const OpenMesh::Vec3f& p) override {
        mesh_.vertices.push_back({p[0], p[1], p[2]});
        return OpenMesh::VertexHandle(static_cast<int>(mesh_.vertices.size()) - 1);
    }
    OpenMesh::VertexHandle add_vertex() override { return add_vertex(OpenMesh::Vec3f(0, 0, 0)); }
    OpenMesh::FaceHandle add_face(const VHandles& v) override {
        last_face_ = mesh_.triangles.size();
        if (v.size() == 4) ++mesh_.quads;
        else mixed_ = mixed_ || mesh_.quads > 0;
        for (size_t i = 2; i < v.size(); ++i)
            mesh_.triangles.push_back({static_cast<uint32_t>(v[0].idx()), static_cast<uint32_t>(v[i - 1].idx()), static_cast<uint32_t>(v[i].idx())});
        return OpenMesh::FaceHandle(static_cast<int>(faces_++));
    }
    void set_point(OpenMesh::VertexHandle v, const OpenMesh::Vec3f& p) override { mesh_.vertices[static_cast<size_t>(v.idx())] = {p[0], p[1], p[2]}; }
    // Everything else that a file may say is not wanted.
    OpenMesh::FaceHandle add_face(OpenMesh::HalfedgeHandle) override { return OpenMesh::FaceHandle(); }
    OpenMesh::HalfedgeHandle add_edge(OpenMesh::VertexHandle, OpenMesh::VertexHandle) override { return OpenMesh::HalfedgeHandle(); }
    void set_halfedge(OpenMesh::VertexHandle, OpenMesh::HalfedgeHandle) override {}
    void set_next(OpenMesh::HalfedgeHandle, OpenMesh::HalfedgeHandle) override {}
    void set_face(OpenMesh::HalfedgeHandle, OpenMesh::FaceHandle) override {}
    void request_face_texcoords2D() override {}
    void set_normal(OpenMesh::VertexHandle v, const OpenMesh::Vec3f& n) override {
        mesh_.normals.resize(mesh_.vertices.size());
        mesh_.normals[static_cast<size_t>(v.idx())] = {n[0], n[1], n[2]};
    }
    void set_normal(OpenMesh::VertexHandle v, const OpenMesh::Vec3d& n) override { set_normal(v, OpenMesh::Vec3f(n)); }
    void set_normal(OpenMesh::FaceHandle, const OpenMesh::Vec3f&) override {}
    void set_normal(OpenMesh::FaceHandle, const OpenMesh::Vec3d&) override {}
    void set_color(OpenMesh::VertexHandle v, const OpenMesh::Vec3uc& c) override { set_color(v, OpenMesh::Vec3f(c[0], c[1], c[2]) / 255.f); }
    void set_color(OpenMesh::VertexHandle v, const OpenMesh::Vec4uc& c) override { set_color(v, OpenMesh::Vec3f(c[0], c[1], c[2]) / 255.f); }
    void set_color(OpenMesh::VertexHandle v, const OpenMesh::Vec3f& c) override {
        mesh_.colors.resize(mesh_.vertices.size());
        for (size_t i = 0; i < 3; ++i) mesh_.colors[static_cast<size_t>(v.idx())][i] = static_cast<float>(linear_from_srgb(c[static_cast<unsigned>(i)]));
    }
    void set_color(OpenMesh::VertexHandle v, const OpenMesh::Vec4f& c) override { set_color(v, OpenMesh::Vec3f(c[0], c[1], c[2])); }
    void set_color(OpenMesh::FaceHandle, const OpenMesh::Vec3uc&) override {}
    void set_color(OpenMesh::FaceHandle, const OpenMesh::Vec4uc&) override {}
    void set_color(OpenMesh::FaceHandle, const OpenMesh::Vec3f&) override {}
    void set_color(OpenMesh::FaceHandle, const OpenMesh::Vec4f&) override {}
    void set_color(OpenMesh::EdgeHandle, const OpenMesh::Vec3uc&) override {}
    void set_color(OpenMesh::EdgeHandle, const OpenMesh::Vec4uc&) override {}
    void set_color(OpenMesh::EdgeHandle, const OpenMesh::Vec3f&) override {}
    void set_color(OpenMesh::EdgeHandle, const OpenMesh::Vec4f&) override {}
    void set_texcoord(OpenMesh::VertexHandle, const OpenMesh::Vec2f&) override {}
    void set_texcoord(OpenMesh::HalfedgeHandle, const OpenMesh::Vec2f&) override {}
    void set_texcoord(OpenMesh::VertexHandle, const OpenMesh::Vec3f&) override {}
    void set_texcoord(OpenMesh::HalfedgeHandle, const OpenMesh::Vec3f&) override {}
    void set_status(OpenMesh::VertexHandle, const OpenMesh::Attributes::StatusInfo&) override {}
    void set_status(OpenMesh::HalfedgeHandle, const OpenMesh::Attributes::StatusInfo&) override {}
    void set_status(OpenMesh::EdgeHandle, const OpenMesh::Attributes::StatusInfo&) override {}
    void set_status(OpenMesh::FaceHandle, const OpenMesh::Attributes::StatusInfo&) override {}
    void add_face_texcoords(OpenMesh::FaceHandle, OpenMesh::VertexHandle, const std::vector<OpenMesh::Vec2f>& t) override {
        mesh_.texcoords.resize(mesh_.triangles.size());
        for (size_t i = 2; i < t.size() && last_face_ + i - 2 < mesh_.triangles.size(); ++i) {
            size_t corner = 0;
            for (const size_t from : {size_t{0}, i - 1, i}) mesh_.texcoords[last_face_ + i - 2][corner++] = {t[from][0], t[from][1]};
        }
    }
    void add_face_texcoords(OpenMesh::FaceHandle, OpenMesh::VertexHandle, const std::vector<OpenMesh::Vec3f>&) override {}
    void set_face_texindex(OpenMesh::FaceHandle, int) override {}
    void add_texture_information(int, std::string) override {}
    OpenMesh::BaseKernel* kernel() override { return &kernel_; }
    size_t n_vertices() const override { return mesh_.vertices.size(); }
    size_t n_faces() const override { return faces_; }
    size_t n_edges() const override { return 0; }
    /// Quads are known as such only where all of them come last.
    bool quads_come_last() const { return !mixed_; }

  private:
    Mesh& mesh_;
    bool mixed_ = false;
    size_t faces_ = 0, last_face_ = 0;
    OpenMesh::ArrayKernel kernel_;
};

/// STL stores loose triangles; equal positions become one vertex again.
void weld(Mesh& mesh) {
    std::vector<uint32_t> order(mesh.vertices.size());
    for (uint32_t i = 0; i < order.size(); ++i) order[i] = i;
    std::sort(order.begin(), order.end(),
              [&](uint32_t a, uint32_t b) { return mesh.vertices[a] != mesh.vertices[b] ? mesh.vertices[a] < mesh.vertices[b] : a < b; });
    std::vector<uint32_t> first(order.size());
    for (size_t i = 0; i < order.size(); ++i) first[order[i]] = i && mesh.vertices[order[i]] == mesh.vertices[order[i - 1]] ? first[order[i - 1]] : order[i];
    std::vector<uint32_t> renumbered(order.size());
    std::vector<std::array<float, 3>> kept;
    for (uint32_t v = 0; v < first.size(); ++v)
        if (first[v] == v) {
            renumbered[v] = static_cast<uint32_t>(kept.size());
            kept.push_back(mesh.vertices[v]);
        }
    for (auto& t : mesh.triangles)
        for (uint32_t& v : t) v = renumbered[first[v]];
    mesh.vertices = std::move(kept);
}

/// A quad of the mesh: see Mesh::quads.
std::array<uint32_t, 4> quad(const Mesh& mesh, size_t number) {
    const size_t first = mesh.triangles.size() - 2 * (mesh.quads - number);
    const auto &a = mesh.triangles[first], &b = mesh.triangles[first + 1];
    return {a[0], a[1], a[2], b[2]};
}
size_t loose_triangles(const Mesh& mesh) { return mesh.triangles.size() - 2 * mesh.quads; }

void put(std::string& out, const void* data, size_t bytes) { out.append(static_cast<const char*>(data), bytes); }

std::array<uint8_t, 3> srgb8(const std::array<float, 3>& linear) {
    return {srgb8_from_linear(linear[0]), srgb8_from_linear(linear[1]), srgb8_from_linear(linear[2])};
}

void write_ply(std::ostream& out, const Mesh& mesh) {
    const bool normals = !mesh.normals.empty(), colors = !mesh.colors.empty(), extrapolated = !mesh.extrapolated.empty(), slack = !mesh.slack.empty();
    out << "ply\nformat binary_little_endian 1.0\nelement vertex " << mesh.vertices.size() << "\nproperty float x\nproperty float y\nproperty float z\n"
        << (normals ? "property float nx\nproperty float ny\nproperty float nz\n" : "")
        << (colors ? "property uchar red\nproperty uchar green\nproperty uchar blue\n" : "") << (extrapolated ? "property uchar extrapolated\n" : "")
        << (slack ? "property float slack\n" : "") << "element face " << mesh.triangles.size() - mesh.quads
        << "\nproperty list uchar int vertex_indices\nend_header\n";
    const size_t color_at = normals ? 24 : 12, extrapolated_at = color_at + (colors ? 3 : 0), slack_at = extrapolated_at + (extrapolated ? 1 : 0),
                 stride = slack_at + (slack ? 4 : 0);
    std::string points(mesh.vertices.size() * stride, '\0');
    tbb::parallel_for(size_t{0}, mesh.vertices.size(), [&](size_t v) {
        char* at = points.data() + v * stride;
        std::memcpy(at, mesh.vertices[v].data(), 12);
        if (normals) std::memcpy(at + 12, mesh.normals[v].data(), 12);
        if (colors) std::memcpy(at + color_at, srgb8(mesh.colors[v]).data(), 3);
        if (extrapolated) at[extrapolated_at] = static_cast<char>(mesh.extrapolated[v]);
        if (slack) std::memcpy(at + slack_at, &mesh.slack[v], 4);
    });
    out.write(points.data(), static_cast<std::streamsize>(points.size()));
    std::string faces;
    faces.reserve(loose_triangles(mesh) * 13 + mesh.quads * 17);
    for (size_t t = 0; t < loose_triangles(mesh); ++t) {
        faces.push_back(3);
        put(faces, mesh.triangles[t].data(), 12);
    }
    for (size_t q = 0; q < mesh.quads; ++q) {
        faces.push_back(4);
        put(faces, quad(mesh, q).data(), 16);
    }
    out.write(faces.data(), static_cast<std::streamsize>(faces.size()));
}

/// A matt white, which vertex colours are multiplied with.
constexpr const char* kMaterial = "newmtl object\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\n";

void write_obj(std::ostream& out, const Mesh& mesh, const std::string& material_file) {
    std::string text = "mtllib " + material_file + "\n";
    char line[128];
    const auto flush = [&](size_t least) {
        if (text.size() < least) return;
        out.write(text.data(), static_cast<std::streamsize>(text.size()));
        text.clear();
    };
    constexpr size_t kPiece = 1 << 20;
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
        const auto& p = mesh.vertices[v];
        text.append(line, static_cast<size_t>(std::snprintf(line, sizeof line, "v %.9g %.9g %.9g", p[0], p[1], p[2])));
        if (!mesh.colors.empty()) {
            const auto c = srgb8(mesh.colors[v]);
            text.append(line, static_cast<size_t>(std::snprintf(line, sizeof line, " %.4f %.4f %.4f", c[0] / 255.0, c[1] / 255.0, c[2] / 255.0)));
        }
        text.push_back('\n');
        flush(kPiece);
    }
    const bool normals = !mesh.normals.empty();
    for (const auto& n : mesh.normals) {
        text.append(line, static_cast<size_t>(std::snprintf(line, sizeof line, "vn %.6g %.6g %.6g\n", n[0], n[1], n[2])));
        flush(kPiece);
    }
    text += "usemtl object\n";
    const auto face = [&](const auto& corners) {
        text += "f";
        for (const uint32_t v : corners)
            text.append(line, static_cast<size_t>(normals ? std::snprintf(line, sizeof line, " %u//%u", v + 1, v + 1)
                                                          : std::snprintf(line, sizeof line, " %u", v + 1)));
        text.push_back('\n');
        flush(kPiece);
    };
    for (size_t t = 0; t < loose_triangles(mesh); ++t) face(mesh.triangles[t]);
    for (size_t q = 0; q < mesh.quads; ++q) face(quad(mesh, q));
    flush(0);
}

void write_stl(std::ostream& out, const Mesh& mesh) {
    char header[80] = "binary STL";
    out.write(header, sizeof header);
    const auto count = static_cast<uint32_t>(mesh.triangles.size());
    out.write(reinterpret_cast<const char*>(&count), 4);
    std::string body;
    body.reserve(mesh.triangles.size() * 50);
    for (const auto& t : mesh.triangles) {
        const auto& a = mesh.vertices[t[0]];
        const auto& b = mesh.vertices[t[1]];
        const auto& c = mesh.vertices[t[2]];
        float u[3], v[3];
        for (size_t i = 0; i < 3; ++i) {
            u[i] = b[i] - a[i];
            v[i] = c[i] - a[i];
        }
        float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (length > 0)
            for (float& x : n) x /= length;
        put(body, n, 12);
        put(body, a.data(), 12);
        put(body, b.data(), 12);
        put(body, c.data(), 12);
        body.append(2, '\0');
    }
    out.write(body.data(), static_cast<std::streamsize>(body.size()));
}

}  // namespace

Mesh read_mesh(const fs::path& file) {
    if (!fs::is_regular_file(file)) throw InputError(file.string() + ": no such file");
    std::string ext = file.extension().string();
    std::transform(ext.begin(), ext.end(), ext.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (ext == ".glb") return read_glb(file);
    Mesh mesh;
    ArrayImporter importer(mesh);
    OpenMesh::IO::Options options(OpenMesh::IO::Options::VertexColor |
                                  (ext == ".ply" ? OpenMesh::IO::Options::VertexNormal : OpenMesh::IO::Options::FaceTexCoord));
    omerr().disable();
    if (!OpenMesh::IO::IOManager().read(file.string(), importer, options))
        throw InputError(file.string() + ": is not a mesh that can be read (.ply, .obj, .stl, .off, .glb)");
    if (mesh.triangles.empty()) throw InputError(file.string() + ": has no faces");
    if (!importer.quads_come_last()) mesh.quads = 0;
    if (!mesh.colors.empty()) mesh.colors.resize(mesh.vertices.size());
    if (!mesh.texcoords.empty()) mesh.texcoords.resize(mesh.triangles.size());
    for (const auto& t : mesh.triangles)
        for (uint32_t v : t)
            if (v >= mesh.vertices.size())
                throw InputError(file.string() + ": a face names vertex " + std::to_string(v) + " of " + std::to_string(mesh.vertices.size()));
    if (ext == ".stl") weld(mesh);
    return mesh;
}

void write_mesh(const fs::path& file, const Mesh& mesh) {
    const std::string ext = file.extension().string();
    if (ext != ".ply" && ext != ".obj" && ext != ".stl" && ext != ".glb") throw UsageError(file.string() + ": meshes are written as .ply, .obj, .stl or .glb");
    const fs::path material = fs::path(file).replace_extension(".mtl");
    if (ext == ".obj") write_file(material, kMaterial);
    AtomicFile out(file);
    if (ext == ".ply") write_ply(out.stream(), mesh);
    else if (ext == ".obj") write_obj(out.stream(), mesh, material.filename().string());
    else if (ext == ".glb") write_glb(out.stream(), mesh, file);
    else write_stl(out.stream(), mesh);
    out.commit();
}

}  // namespace vdbcarve
