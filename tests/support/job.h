// SPDX-License-Identifier: Apache-2.0
// Whole runs on small synthetic shoots.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "support/scenes.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {

namespace fs = std::filesystem;
using nlohmann::json;

struct Job {
    TemporaryFolder folder;
    ReconstructOptions options;

    explicit Job(const char* object = "ellipsoids", bool photos = false) {
        SyntheticSpec spec = small_spec(object, 8, 160, 120);
        spec.photos = photos;
        Progress quiet;
        write_scene(synthesize(spec, quiet), folder / "scene");
        options.views.scene = folder / "scene";
        options.run.output = folder / "out";
        options.grid.resolution = 64;
        options.result.mesh_formats = {"ply", "obj", "stl"};
    }
    Reconstruction last;

    json run() {
        Progress progress;
        last = reconstruct(options, progress);
        return json::parse(last.report_json);
    }
    static bool reused(const json& report, const std::string& stage) {
        for (const json& s : report["stages"])
            if (s["name"] == stage) return s["reused"];
        ADD_FAILURE() << "no stage " << stage;
        return false;
    }
    std::string bytes(const std::string& name) const { return read_text(folder / ("out/" + name)); }
};

inline constexpr const char* kFiles[] = {"volume.vdb", "mesh.ply", "mesh.obj", "mesh.stl", "cameras.json", "preview.png"};

/// Photographs and masks of a shoot, to be put into a scene one after another.
struct Arrivals {
    TemporaryFolder folder;
    std::vector<std::string> names;
    ReconstructOptions options;

    explicit Arrivals(bool truncated = false, int views = 9) {
        SyntheticSpec spec = small_spec("cup", views, 160, 120);
        if (truncated) spec.rig.fill = 1.35;
        Progress quiet;
        write_scene(synthesize(spec, quiet), folder / "all");
        for (const auto& entry : fs::directory_iterator(folder / "all/images")) names.push_back(entry.path().filename().string());
        std::sort(names.begin(), names.end());
        fs::create_directories(folder / "scene/images");
        fs::create_directories(folder / "scene/masks");
        fs::copy_file(folder / "all/transforms.json", folder / "scene/transforms.json");
        options.views.scene = folder / "scene";
        options.views.allow_missing = options.mask.allow_missing = true;
        options.run.output = folder / "out";
        options.grid.resolution = 56;
        options.result.mesh_formats = {"ply"};
        options.result.report = false;
    }
    /// The mask first: a photograph without one would be left out until it comes.
    void arrive(size_t n) const {
        const std::string mask = fs::path(names[n]).stem().string() + ".png";
        fs::copy_file(folder / ("all/masks/" + mask), folder / ("scene/masks/" + mask), fs::copy_options::overwrite_existing);
        fs::copy_file(folder / ("all/images/" + names[n]), folder / ("scene/images/" + names[n]), fs::copy_options::overwrite_existing);
    }
    json run(const ReconstructOptions& o) const {
        Progress progress;
        return json::parse(reconstruct(o, progress).report_json);
    }
    /// All views at once, with the bounds and voxels of `report`.
    ReconstructOptions batch(const json& report) const {
        ReconstructOptions o = options;
        const auto b = report["grid"]["bounds"].get<std::array<double, 6>>();
        o.grid.bounds = Box3d(Vec3d(b[0], b[1], b[2]), Vec3d(b[3], b[4], b[5]));
        o.grid.resolution = 0;
        o.grid.dims.reset();
        o.grid.voxel_size = report["grid"]["voxel_size"].get<double>();
        const auto at = report["grid"]["origin"].get<std::array<double, 3>>();
        o.grid.origin = Vec3d(at[0], at[1], at[2]);
        o.run.output = folder / "batch";
        o.views.added.clear();
        return o;
    }
    /// Bytes of the raw hull in a result's stages.
    std::string hull(const fs::path& out) const {
        std::vector<fs::path> found;
        for (const auto& entry : fs::directory_iterator(out / "stages"))
            if (entry.path().filename().string().rfind("carve-", 0) == 0) found.push_back(entry.path() / "hull.vdb");
        EXPECT_EQ(found.size(), 1u) << out;  // those of fewer views are gone
        return found.empty() ? "" : read_text(found.front());
    }
    std::string bytes(const std::string& name) const { return read_text(folder / name); }
};

}  // namespace vdbcarve::test
