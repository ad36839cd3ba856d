// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/smooth.h"

#include "pipeline/mesh_store.h"
#include "vdbcarve/decimate.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

namespace {

constexpr const char* kFile = "mesh.bin";

}  // namespace

void Smooth::prepare(Run&) {
    taubin_ = options.smooth.factors;
    // A binary model has steps of a voxel. The default filter takes them away (normals of a ball of 35 voxels 2.0 degrees off; ten iterations of this
    // alone: 5.2), and after it there is nothing left to gain here.
    taubin_.iterations = options.smooth.iterations.value_or(options.carve.occupancy && surface.filter_chain == "none" ? 10 : 0);
    if (!options.mesh.quads) mesh.mesh.quads = 0;
    if (!(taubin_.iterations == 0 && !fewer())) volume_before_ = measure(mesh.mesh).volume;
}

Key Smooth::key() const { return Key(kName).of(mesh.key).of(options.smooth).of(taubin_.iterations).of(options.mesh.quads); }

MeshMade Smooth::finished(MeshMade made) const {
    made.smooth_iterations = taubin_.iterations;
    made.volume_before_smooth = volume_before_;
    made.measures = measure(made.mesh);
    return made;
}

MeshMade Smooth::passed() { return finished(std::move(mesh)); }

MeshMade Smooth::run(Run& run) {
    MeshMade made = std::move(mesh);
    smooth(made.mesh, taubin_, run.progress());
    if (fewer()) decimate(made.mesh, {options.smooth.faces, options.smooth.max_error}, run.progress());
    return finished(std::move(made));
}

void Smooth::save(Slot& slot, const MeshMade& made) const { store_mesh(slot.file(kFile), made.mesh); }

MeshMade Smooth::load(const Slot& slot) const {
    std::optional<Mesh> stored = stored_mesh(slot.file(kFile));
    if (!stored) throw InputError(slot.file(kFile).string() + ": holds no mesh");
    MeshMade out;
    out.key = mesh.key;
    out.step = mesh.step;
    out.vertices_seen_share = mesh.vertices_seen_share;
    out.mesh = std::move(*stored);
    return finished(std::move(out));
}

void Smooth::report(const MeshMade& made, json& report) const {
    report["smooth"] = {{"iterations", made.smooth_iterations}};
    if (made.volume_before_smooth) report["smooth"]["volume_before"] = *made.volume_before_smooth;
    const MeshMeasures& m = made.measures;
    report["mesh"] = {{"vertices", m.vertices},
                      {"faces", m.faces},
                      {"components", m.components},
                      {"closed", m.closed},
                      {"manifold", m.manifold},
                      {"boundary_edges", m.boundary_edges},
                      {"non_manifold_edges", m.non_manifold_edges},
                      {"non_manifold_vertices", m.non_manifold_vertices},
                      {"zero_area_faces", m.zero_area_faces},
                      {"genus", m.genus},
                      {"volume", m.volume},
                      {"area", m.area},
                      {"expected_bytes", std::llround(made.step.expected_bytes)},
                      {"slabs", made.step.slabs},
                      {"dropped_pieces", made.step.dropped_pieces},
                      {"dropped_volume_share", made.step.dropped_volume_share}};
}

void Smooth::say(const MeshMade& made, Progress& progress) const {
    const SmoothSettings& o = options.smooth;
    if (o.faces > 0 && made.mesh.triangles.size() > o.faces)
        progress.warn("the mesh keeps " + std::to_string(made.mesh.triangles.size()) + " faces, not " + std::to_string(o.faces) +
                      ": fewer would turn faces too far" + (o.max_error > 0 ? ", or stray by more than --max-error" : ""));
    if (!made.measures.manifold) progress.warn("the mesh is not a closed manifold");
}

}  // namespace vdbcarve::pipeline
