// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/mesh.h"

#include <algorithm>
#include <cmath>

#include "pipeline/mesh_store.h"
#include "pipeline/stages/color.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace {

constexpr const char* kFile = "mesh.bin";

}  // namespace

/// How many slabs the mesher goes through the grid in, so that it stays within the limit. Not by what is resident now, which differs from run to run: vertices
/// come in another order.
void ExtractMesh::prepare(Run& run) {
    const auto leaves = static_cast<double>(surface.grid->tree().leafCount());
    const double held = kProgramBase + leaves * (kTreePerLeaf + (colors.grid ? kColorGridPerLeaf : 0));
    const double room = run.memory_limit() - held - leaves * kMeshBytesPerLeaf, wanted = leaves * kMesherBytesPerLeaf;
    expected_bytes_ = leaves * (kMeshBytesPerLeaf + kMesherBytesPerLeaf);
    if (wanted <= room || options.mesh.mesher != Mesher::Dual) return;
    if (options.mesh.adaptivity > 0)
        run.progress().warn("an adaptive mesh is made in one piece, which may exceed the memory limit. Remedy: --adaptivity 0, then --max-error");
    else slabs_ = static_cast<int>(std::clamp(std::ceil(wanted / std::max(room, 1.0)), 2.0, kMostSlabs));
}

Key ExtractMesh::key() const {
    MeshSettings deciding = options.mesh;
    deciding.quads = false;  // the halves of quads are marked in any case
    return Key(kName).of(surface.key).of(colors.key).of(colors_from_photos()).of(deciding).of(slabs_);
}

MeshMade ExtractMesh::run(Run& run) {
    Progress& progress = run.progress();
    MeshOptions wanted;
    wanted.adaptivity = options.mesh.adaptivity;
    wanted.mesher = options.mesh.mesher;
    wanted.normals = options.mesh.normals;
    wanted.quads = options.mesh.mesher == Mesher::Dual;
    wanted.pieces = slabs_;
    if (slabs_ > 1) progress.note("the mesh is made in " + std::to_string(slabs_) + " slabs, to stay within the memory limit");
    MeshMade made;
    bool meshed = false;
    const bool done = wanted.mesher == Mesher::MarchingCubes && run.device().run("mesh", [&](Device& device) {
        if (!run.is_on_device(surface.grid)) device.set_surface(*surface.grid);
        run.set_on_device(surface.grid);
        meshed = device.extract_mesh(wanted.normals);
        if (meshed) made.mesh = device.fetch_mesh(wanted.normals);
    });
    if (!done || !meshed) made.mesh = extract_mesh(*surface.grid, wanted, progress);
    const DroppedPieces dropped = drop_small_pieces(made.mesh, options.mesh.min_piece_share);
    made.step = {dropped.pieces, dropped.volume_share, expected_bytes_, slabs_};
    if (dropped.pieces)
        progress.note(text_of("%s of the mesh left out, %s of the volume; %s kept (--min-piece 0 keeps all)", counted(dropped.pieces, "small piece").c_str(),
                              dropped.volume_share < 1e-5 ? "less than 0.001 %" : text_of("%.3g %%", 100 * dropped.volume_share).c_str(),
                              counted(dropped.kept, "piece").c_str()));
    color(made, run);
    return made;
}

void ExtractMesh::color(MeshMade& made, Run& run) const {
    if (!colors.grid) return;
    if (!options.color.from_photos) {
        if (const size_t missed = color_vertices(made.mesh, *colors.grid))
            run.progress().warn(std::to_string(missed) + " vertices of the mesh have no coloured voxel around and are black");
        return;
    }
    ColorOptions here = color_options(options, shoot, masks, surface, run);
    for (const ViewColor& view : colors.of_view) here.gains.push_back(view.gain);
    // A photograph that gave the volume no colour was named then.
    Photographs photographs(shoot, masks, run.progress());
    for (size_t u = 0; u < colors.of_view.size(); ++u)
        if (!colors.of_view[u].used) photographs.set_missing(u);
    made.vertices_seen_share = color_vertices_from_photos(made.mesh, *surface.grid, *colors.grid, color_inputs(shoot, masks, options.color.leave_out),
                                                          photographs.source(), here, run.progress());
}

void ExtractMesh::save(Slot& slot, const MeshMade& made) const {
    store_mesh(slot.file(kFile), made.mesh);
    slot.note = {{"dropped_pieces", made.step.dropped_pieces},
                 {"dropped_volume_share", made.step.dropped_volume_share},
                 {"vertices_seen_share", made.vertices_seen_share ? nlohmann::json(*made.vertices_seen_share) : nlohmann::json()}};
}

MeshMade ExtractMesh::load(const Slot& slot) const {
    std::optional<Mesh> mesh = stored_mesh(slot.file(kFile));
    if (!mesh) throw InputError(slot.file(kFile).string() + ": holds no mesh");
    MeshMade out;
    out.mesh = std::move(*mesh);
    out.step = {slot.note.at("dropped_pieces"), slot.note.at("dropped_volume_share"), expected_bytes_, slabs_};
    if (const auto& share = slot.note.at("vertices_seen_share"); !share.is_null()) out.vertices_seen_share = share.get<double>();
    return out;
}

}  // namespace vdbcarve::pipeline
