// SPDX-License-Identifier: Apache-2.0
#include "mesh/gltf.h"

#include <tbb/parallel_for.h>
#include <tiny_gltf.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "vdbcarve/error.h"
#include "vdbcarve/version.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

/// Appends `bytes` to the model's one buffer and returns its view.
int add_view(tinygltf::Model& model, size_t bytes, size_t stride, int target) {
    auto& data = model.buffers[0].data;
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = data.size();
    view.byteLength = bytes;
    view.byteStride = stride;
    view.target = target;
    data.resize(data.size() + (bytes + 3) / 4 * 4);
    model.bufferViews.push_back(view);
    return static_cast<int>(model.bufferViews.size()) - 1;
}

int add_accessor(tinygltf::Model& model, int view, int component, int type, size_t count, bool normalized = false) {
    tinygltf::Accessor a;
    a.bufferView = view;
    a.componentType = component;
    a.type = type;
    a.count = count;
    a.normalized = normalized;
    model.accessors.push_back(a);
    return static_cast<int>(model.accessors.size()) - 1;
}

/// One value of an accessor, as a float between its format's limits.
struct Reader {
    const tinygltf::Model& model;
    const tinygltf::Accessor& accessor;
    const unsigned char* first;
    size_t stride;
    int component_bytes;

    /// `components`: at least so many values each.
    Reader(const tinygltf::Model& m, int number, int components, const fs::path& file) : model(m), accessor(m.accessors.at(static_cast<size_t>(number))) {
        const auto bad = [&](const char* why) { return InputError(file.string() + ": " + why); };
        if (accessor.bufferView < 0 || accessor.sparse.isSparse) throw bad("has an accessor without plain data, which is not read");
        const tinygltf::BufferView& view = model.bufferViews.at(static_cast<size_t>(accessor.bufferView));
        const auto& data = model.buffers.at(static_cast<size_t>(view.buffer)).data;
        const int step = accessor.ByteStride(view);
        component_bytes = tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(accessor.componentType));
        const int bytes = component_bytes * tinygltf::GetNumComponentsInType(static_cast<uint32_t>(accessor.type));
        if (step <= 0 || bytes <= 0 || tinygltf::GetNumComponentsInType(static_cast<uint32_t>(accessor.type)) < components)
            throw bad("has an accessor of another type than its use asks for");
        const int kind = accessor.componentType;
        if (kind != TINYGLTF_COMPONENT_TYPE_FLOAT && kind != TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE && kind != TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT &&
            kind != TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT)
            throw bad("has an accessor of signed integers, which are not read");
        stride = static_cast<size_t>(step);
        const size_t at = view.byteOffset + accessor.byteOffset;
        if (accessor.count == 0 || at + stride * (accessor.count - 1) + static_cast<size_t>(bytes) > data.size())
            throw bad("an accessor reaches beyond its buffer");
        first = data.data() + at;
    }
    double value(size_t n, int c) const {
        const unsigned char* at = first + n * stride + static_cast<size_t>(c * component_bytes);
        const auto as = [at](auto zero) {
            std::memcpy(&zero, at, sizeof zero);
            return zero;
        };
        switch (accessor.componentType) {
            case TINYGLTF_COMPONENT_TYPE_FLOAT:
                return static_cast<double>(as(float{}));
            case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
                return as(uint8_t{}) / (accessor.normalized ? 255.0 : 1.0);
            case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
                return as(uint16_t{}) / (accessor.normalized ? 65535.0 : 1.0);
            case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
                return as(uint32_t{});
            default:
                return 0;
        }
    }
};

Eigen::Affine3d placement(const tinygltf::Node& node) {
    Eigen::Affine3d out = Eigen::Affine3d::Identity();
    if (node.matrix.size() == 16) {
        out.matrix() = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());  // by columns
        return out;
    }
    if (node.translation.size() == 3) out.translate(Eigen::Vector3d(node.translation[0], node.translation[1], node.translation[2]));
    if (node.rotation.size() == 4) out.rotate(Eigen::Quaterniond(node.rotation[3], node.rotation[0], node.rotation[1], node.rotation[2]).normalized());
    if (node.scale.size() == 3) out.scale(Eigen::Vector3d(node.scale[0], node.scale[1], node.scale[2]));
    return out;
}

void add_primitive(const tinygltf::Model& model, const tinygltf::Primitive& primitive, const Eigen::Affine3d& place, const fs::path& file, Mesh& mesh,
                   bool& all_colored, bool& all_normals) {
    if (primitive.mode != TINYGLTF_MODE_TRIANGLES && primitive.mode != -1)
        throw InputError(file.string() + ": has a primitive that is no list of triangles, which is not read");
    const auto found = primitive.attributes.find("POSITION");
    if (found == primitive.attributes.end()) return;
    const Reader positions(model, found->second, 3, file);
    const auto base = static_cast<uint32_t>(mesh.vertices.size());
    const size_t count = positions.accessor.count;
    for (size_t v = 0; v < count; ++v) {
        const Eigen::Vector3f p = (place * Eigen::Vector3d(positions.value(v, 0), positions.value(v, 1), positions.value(v, 2))).cast<float>();
        mesh.vertices.push_back({p[0], p[1], p[2]});
    }
    const auto attribute = [&](const char* name, bool& all, std::vector<std::array<float, 3>>& out, const auto& convert) {
        const auto at = primitive.attributes.find(name);
        all = all && at != primitive.attributes.end();
        if (!all) return;
        const Reader values(model, at->second, 3, file);
        if (values.accessor.count != count) throw InputError(file.string() + ": " + name + " has another count than POSITION");
        for (size_t v = 0; v < count; ++v) {
            const Eigen::Vector3f x = convert(Eigen::Vector3d(values.value(v, 0), values.value(v, 1), values.value(v, 2))).template cast<float>();
            out.push_back({x[0], x[1], x[2]});
        }
    };
    attribute("COLOR_0", all_colored, mesh.colors, [](const Eigen::Vector3d& c) { return c; });
    const Eigen::Matrix3d turn = place.linear().inverse().transpose();
    attribute("NORMAL", all_normals, mesh.normals, [&](const Eigen::Vector3d& n) { return Eigen::Vector3d((turn * n).normalized()); });
    std::vector<uint32_t> corners;
    if (primitive.indices >= 0) {
        const Reader indices(model, primitive.indices, 1, file);
        corners.resize(indices.accessor.count);
        for (size_t n = 0; n < corners.size(); ++n) corners[n] = static_cast<uint32_t>(indices.value(n, 0));
    } else {
        corners.resize(count);
        for (size_t n = 0; n < count; ++n) corners[n] = static_cast<uint32_t>(n);
    }
    for (size_t n = 0; n + 2 < corners.size(); n += 3) {
        for (size_t c = 0; c < 3; ++c)
            if (corners[n + c] >= count)
                throw InputError(file.string() + ": a face names vertex " + std::to_string(corners[n + c]) + " of " + std::to_string(count));
        const bool mirrored = place.linear().determinant() < 0;
        mesh.triangles.push_back({base + corners[n], base + corners[n + (mirrored ? 2 : 1)], base + corners[n + (mirrored ? 1 : 2)]});
    }
}

}  // namespace

void write_glb(std::ostream& out, const Mesh& mesh, const fs::path& file) {
    const size_t n = mesh.vertices.size();
    const double bytes =
        static_cast<double>(n) * (24 + (mesh.colors.empty() ? 0 : 8) + (mesh.extrapolated.empty() ? 0 : 4)) + static_cast<double>(mesh.triangles.size()) * 12;
    if (bytes > 4.29e9)
        throw OutputError(file.string() + ": needs " + std::to_string(bytes / 1e9).substr(0, 4) + " GB, and a .glb holds 4 GiB. Remedy: --faces, or .ply");
    tinygltf::Model model;
    model.asset.version = "2.0";
    model.asset.generator = std::string("vdbcarve ") + kVersion;
    model.buffers.emplace_back();
    model.buffers[0].data.reserve(static_cast<size_t>(bytes) + 64);
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    const auto floats = [&](const std::vector<std::array<float, 3>>& values) {
        const int view = add_view(model, n * 12, 12, TINYGLTF_TARGET_ARRAY_BUFFER);
        std::memcpy(model.buffers[0].data.data() + model.bufferViews[static_cast<size_t>(view)].byteOffset, values.data(), n * 12);
        return add_accessor(model, view, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, n);
    };
    primitive.attributes["POSITION"] = floats(mesh.vertices);
    std::array<float, 3> lo = mesh.vertices.at(0), hi = lo;
    for (const auto& p : mesh.vertices)
        for (size_t a = 0; a < 3; ++a) {
            lo[a] = std::min(lo[a], p[a]);
            hi[a] = std::max(hi[a], p[a]);
        }
    model.accessors[0].minValues = {lo[0], lo[1], lo[2]};
    model.accessors[0].maxValues = {hi[0], hi[1], hi[2]};
    primitive.attributes["NORMAL"] = floats(mesh.normals.empty() ? vertex_normals(mesh) : mesh.normals);
    if (!mesh.colors.empty()) {
        // Three shorts would not start at multiples of four bytes: a fourth, opaque, fills them up.
        const int view = add_view(model, n * 8, 8, TINYGLTF_TARGET_ARRAY_BUFFER);
        unsigned char* to = model.buffers[0].data.data() + model.bufferViews[static_cast<size_t>(view)].byteOffset;
        tbb::parallel_for(size_t{0}, n, [&](size_t v) {
            uint16_t rgba[4] = {0, 0, 0, 65535};
            for (size_t c = 0; c < 3; ++c) rgba[c] = static_cast<uint16_t>(std::lround(65535.f * std::clamp(mesh.colors[v][c], 0.f, 1.f)));
            std::memcpy(to + v * 8, rgba, 8);
        });
        primitive.attributes["COLOR_0"] = add_accessor(model, view, TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_VEC4, n, true);
    }
    if (!mesh.extrapolated.empty()) {
        const int view = add_view(model, n * 4, 4, TINYGLTF_TARGET_ARRAY_BUFFER);
        unsigned char* to = model.buffers[0].data.data() + model.bufferViews[static_cast<size_t>(view)].byteOffset;
        for (size_t v = 0; v < n; ++v) {
            const float x = mesh.extrapolated[v];
            std::memcpy(to + v * 4, &x, 4);
        }
        primitive.attributes["_EXTRAPOLATED"] = add_accessor(model, view, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_SCALAR, n);
    }
    const int view = add_view(model, mesh.triangles.size() * 12, 0, TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER);
    std::memcpy(model.buffers[0].data.data() + model.bufferViews[static_cast<size_t>(view)].byteOffset, mesh.triangles.data(), mesh.triangles.size() * 12);
    primitive.indices = add_accessor(model, view, TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR, 3 * mesh.triangles.size());
    tinygltf::Material material;
    material.name = "object";
    material.pbrMetallicRoughness.metallicFactor = 0;
    material.pbrMetallicRoughness.roughnessFactor = 0.9;
    model.materials.push_back(material);
    primitive.material = 0;
    tinygltf::Mesh whole;
    whole.name = "object";
    whole.primitives.push_back(primitive);
    model.meshes.push_back(whole);
    tinygltf::Node node;
    node.name = "object";
    node.mesh = 0;
    model.nodes.push_back(node);
    tinygltf::Scene scene;
    scene.nodes.push_back(0);
    model.scenes.push_back(scene);
    model.defaultScene = 0;
    tinygltf::TinyGLTF writer;
    if (!writer.WriteGltfSceneToStream(&model, out, /*prettyPrint=*/false, /*writeBinary=*/true)) throw OutputError(file.string() + ": cannot be written");
}

Mesh read_glb(const fs::path& file) {
    tinygltf::Model model;
    tinygltf::TinyGLTF reader;
    // Pictures are not wanted, so their kind does not matter.
    reader.SetImageLoader([](tinygltf::Image*, const int, std::string*, std::string*, int, int, const unsigned char*, int, void*) { return true; }, nullptr);
    std::string error, warning;
    if (!reader.LoadBinaryFromFile(&model, &error, &warning, file.string())) {
        std::replace(error.begin(), error.end(), '\n', ' ');
        throw InputError(file.string() + ": is not a .glb that can be read: " + error);
    }
    Mesh mesh;
    bool colored = true, normals = true;
    try {
        std::vector<std::pair<int, Eigen::Affine3d>> open;
        const auto scene = static_cast<size_t>(std::max(model.defaultScene, 0));
        if (scene < model.scenes.size())
            for (int n : model.scenes[scene].nodes) open.emplace_back(n, Eigen::Affine3d::Identity());
        for (size_t steps = 0; !open.empty() && steps < 1000000; ++steps) {
            const auto [number, parent] = open.back();
            open.pop_back();
            const tinygltf::Node& node = model.nodes.at(static_cast<size_t>(number));
            const Eigen::Affine3d place = parent * placement(node);
            if (node.mesh >= 0)
                for (const tinygltf::Primitive& p : model.meshes.at(static_cast<size_t>(node.mesh)).primitives)
                    add_primitive(model, p, place, file, mesh, colored, normals);
            for (int child : node.children) open.emplace_back(child, place);
        }
    } catch (const std::out_of_range&) {
        throw InputError(file.string() + ": names parts that are not there");
    }
    if (mesh.triangles.empty()) throw InputError(file.string() + ": has no faces");
    if (!colored) mesh.colors.clear();
    if (!normals) mesh.normals.clear();
    return mesh;
}

}  // namespace vdbcarve
