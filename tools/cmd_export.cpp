// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli.h"
#include "vdbcarve/export.h"
#include "vdbcarve/triangle_mesh.h"

namespace vdbcarve::cli {
namespace {

namespace fs = std::filesystem;

bool is_volume(const fs::path& file) { return file.extension() == ".vdb" || file.extension() == ".nvdb"; }

/// The file of a result that a conversion starts from.
fs::path source_for(const fs::path& in, const fs::path& out) {
    if (!fs::is_directory(in)) return in;
    if (!is_volume(out)) return in / "mesh.ply";
    if (!fs::exists(in / "volume.vdb") && fs::is_directory(in / "hull_bricks")) throw InputError((in / "hull_bricks").string() + ": the hull lies in bricks; convert them one by one");
    return fs::exists(in / "volume.vdb") ? in / "volume.vdb" : in / "hull.vdb";
}

/// The up axis that a result's report states, or nothing.
std::string up_of(const fs::path& folder) {
    try {
        std::ifstream in(folder / "report.json");
        return in ? nlohmann::json::parse(in).at("cameras").at("up").get<std::string>() : "";
    } catch (const nlohmann::json::exception&) {
        return "";
    }
}

void convert(const fs::path& from, const fs::path& to, const std::string& up) {
    if (is_volume(from) != is_volume(to)) throw UsageError(to.string() + " cannot be made of " + from.string() + ": volumes become .vdb or .nvdb, meshes .ply, .obj or .stl");
    if (!is_volume(from)) {
        write_mesh(to, read_mesh(from), up);
        return;
    }
    std::vector<openvdb::FloatGrid::Ptr> grids;
    if (from.extension() == ".nvdb") {
        grids = read_nvdb(from);
    } else {
        for (const openvdb::GridBase::Ptr& grid : read_vdb(from)) {
            if (auto f = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)) grids.push_back(f);
            else spdlog::warn("grid '{}' ({}) is left out: only float grids are converted", grid->getName(), grid->valueType());
        }
    }
    if (grids.empty()) throw InputError(from.string() + ": has no float grid");
    if (to.extension() == ".nvdb") {
        write_nvdb(to, {grids.begin(), grids.end()});
    } else {
        VdbMetadata metadata;
        metadata.voxel_size = grids.front()->voxelSize()[0];
        write_vdb(to, {grids.begin(), grids.end()}, metadata);
    }
}

}  // namespace

Command add_export(CLI::App& program) {
    struct Raw {
        std::string in, up;
        std::vector<std::string> out;
    };
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("export", "convert a result or a file: .vdb .nvdb; .ply .obj .stl");
    app->fallthrough();
    app->add_option("in", raw->in, "a result's folder, a volume or a mesh")->required();
    app->add_option("-o,--output", raw->out, "files to write, by extension")->required();
    app->add_option("--up", raw->up, "the input's up axis, turned to y in .obj (default: what a result's report says)")->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}));
    return {app, [raw](Common&, Progress& progress) {
                for (const std::string& out : raw->out) {
                    progress.check();
                    const fs::path from = source_for(raw->in, out);
                    if (!fs::exists(from)) throw InputError(from.string() + ": no such file");
                    convert(from, out, raw->up.empty() && fs::is_directory(raw->in) ? up_of(raw->in) : raw->up);
                    spdlog::info("{} -> {}", from.string(), out);
                }
                return 0;
            }};
}

}  // namespace vdbcarve::cli
