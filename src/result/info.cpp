// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/info.h"

#include <openvdb/openvdb.h>

#include <nlohmann/json.hpp>

#include "vdbcarve/result.h"
#include "vdbcarve/volume.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

namespace {

json vdb_info(const fs::path& file) {
    json out;
    openvdb::MetaMap metadata;
    const openvdb::GridPtrVec grids = file.extension() == ".nvdb" ? read_nvdb(file) : read_vdb(file, &metadata);
    for (auto entry = metadata.beginMeta(); entry != metadata.endMeta(); ++entry) out["metadata"][entry->first] = entry->second->str();
    for (const openvdb::GridBase::Ptr& grid : grids) {
        json g;
        g["name"] = grid->getName();
        g["type"] = grid->valueType();
        g["class"] = openvdb::GridBase::gridClassToString(grid->getGridClass());
        g["voxel_size"] = grid->voxelSize()[0];
        g["active_voxels"] = grid->activeVoxelCount();
        const openvdb::CoordBBox box = grid->evalActiveVoxelBoundingBox();
        const openvdb::Vec3d lo = grid->indexToWorld(box.min().asVec3d() - openvdb::Vec3d(0.5)),
                             hi = grid->indexToWorld(box.max().asVec3d() + openvdb::Vec3d(0.5));
        g["active_dims"] = {box.dim()[0], box.dim()[1], box.dim()[2]};
        g["active_world_box"] = {lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]};
        g["memory_bytes"] = grid->memUsage();
        g["half_on_disk"] = grid->saveFloatAsHalf();
        if (auto f = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)) g["background"] = f->background();
        out["grids"].push_back(g);
    }
    return out;
}

json mesh_info(const fs::path& file) {
    const Mesh mesh = read_mesh(file);
    const MeshMeasures m = measure(mesh);
    std::array<float, 3> lo = mesh.vertices.front(), hi = lo;
    for (const auto& v : mesh.vertices)
        for (size_t a = 0; a < 3; ++a) {
            lo[a] = std::min(lo[a], v[a]);
            hi[a] = std::max(hi[a], v[a]);
        }
    return {{"vertices", m.vertices},
            {"faces", m.faces},
            {"components", m.components},
            {"closed", m.closed},
            {"manifold", m.manifold},
            {"genus", m.genus},
            {"volume", m.volume},
            {"area", m.area},
            {"colors", !mesh.colors.empty()},
            {"normals", !mesh.normals.empty()},
            {"quads", mesh.quads},
            {"box", {lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]}}};
}

json scene_info(const fs::path& scene, const fs::path& cameras, Progress& progress) {
    ViewsOptions options;
    options.scene = scene;
    options.cameras = cameras;
    options.accept_non_metric = true;
    options.cameras_only = true;
    const Views views = load_views(options, progress);
    json out;
    out["camera_file"] = views.camera_file.string();
    out["format"] = views.format;
    out["up"] = views.up.empty() ? "unknown" : views.up;
    out["units"] = views.units.empty() ? "unknown" : views.units;
    out["metric"] = views.metric;
    if (!views.unverified.empty()) out["unverified"] = views.unverified;
    if (const auto target = look_at_point(views.cameras())) out["look_at"] = {target->x(), target->y(), target->z()};
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const Vec3d c = v.camera.centre_world();
        out["views"].push_back({{"name", v.name},
                                {"size", {k.width_px, k.height_px}},
                                {"focal_px", {k.fx, k.fy}},
                                {"principal_point_px", {k.cx, k.cy}},
                                {"centre", {c.x(), c.y(), c.z()}},
                                {"distorted", v.lens.distorts()}});
        if (!v.unused.empty()) out["views"].back()["unused"] = v.unused;
    }
    return out;
}

}  // namespace

std::string info_json(const fs::path& file, Progress& progress) {
    if (!fs::exists(file)) throw InputError(file.string() + ": no such file or folder");
    json out;
    out["path"] = file.string();
    const std::string ext = file.extension().string();
    if (fs::is_directory(file)) {
        require_finished(file);
        for (const char* name : {"volume", "hull"})
            if (fs::exists(file / (std::string(name) + ".vdb"))) out[name] = vdb_info(file / (std::string(name) + ".vdb"));
        if (fs::exists(file / "mesh.ply")) out["mesh"] = mesh_info(file / "mesh.ply");
        if (out.size() > 1 && fs::exists(file / "cameras.json")) out["cameras"] = scene_info(file, fs::absolute(file / "cameras.json"), progress);
        if (out.size() == 1) out["scene"] = scene_info(file, {}, progress);
    } else if (ext == ".vdb" || ext == ".nvdb") {
        out["volume"] = vdb_info(file);
    } else if (ext == ".ply" || ext == ".obj" || ext == ".stl" || ext == ".off" || ext == ".glb") {
        out["mesh"] = mesh_info(file);
    } else {
        out["scene"] = scene_info(file.parent_path().empty() ? fs::path(".") : file.parent_path(), fs::absolute(file), progress);
    }
    return out.dump(1);
}

}  // namespace vdbcarve
