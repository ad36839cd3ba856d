// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cctype>
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

/// Small letters: files from elsewhere may shout.
std::string extension_of(const fs::path& file) {
    std::string out = file.extension().string();
    std::transform(out.begin(), out.end(), out.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    return out;
}
bool is_volume(const fs::path& file) { return extension_of(file) == ".vdb" || extension_of(file) == ".nvdb"; }

/// The file of a result that a conversion starts from.
fs::path source_for(const fs::path& in, const fs::path& out) {
    if (!fs::exists(in)) throw InputError(in.string() + ": no such file or folder");
    if (!fs::is_directory(in)) return in;
    std::vector<const char*> names{"mesh.ply", "mesh.obj", "mesh.stl"};
    if (is_volume(out)) names = {"volume.vdb", "hull.vdb"};
    for (const char* name : names)
        if (fs::exists(in / name)) return in / name;
    if (is_volume(out) && fs::is_directory(in / "hull_bricks")) throw InputError((in / "hull_bricks").string() + ": the hull lies in bricks; convert them one by one");
    throw InputError(in.string() + ": holds no " + (is_volume(out) ? "volume" : "mesh") + " of vdbcarve's. Remedy: `vdbcarve reconstruct` makes one");
}

/// Everything that can be known to fail before anything is written.
void check_target(const fs::path& from, const fs::path& to) {
    const std::string extension = extension_of(to);
    if (extension != ".vdb" && extension != ".nvdb" && extension != ".ply" && extension != ".obj" && extension != ".stl")
        throw UsageError(to.string() + ": the extension says what to write; .vdb, .nvdb, .ply, .obj and .stl are known");
    if (is_volume(from) != is_volume(to)) throw UsageError(to.string() + " cannot be made of " + from.string() + ": volumes become .vdb or .nvdb, meshes .ply, .obj or .stl");
    if (extension != to.extension().string()) throw UsageError(to.string() + ": write the extension in small letters");
    std::error_code ignored;
    if (fs::equivalent(from, to, ignored)) throw UsageError(to.string() + ": is the input itself");
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
    if (!is_volume(from)) {
        write_mesh(to, read_mesh(from), up);
        return;
    }
    std::vector<openvdb::FloatGrid::Ptr> grids;
    if (extension_of(from) == ".nvdb") {
        grids = read_nvdb(from);
    } else {
        for (const openvdb::GridBase::Ptr& grid : read_vdb(from)) {
            if (auto f = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)) grids.push_back(f);
            else spdlog::warn("grid '{}' ({}) is left out: only float grids are converted", grid->getName(), grid->valueType());
        }
    }
    if (grids.empty()) throw InputError(from.string() + ": has no float grid");
    if (extension_of(to) == ".nvdb") {
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
    CLI::App* app = program.add_subcommand("export", "convert a result or a file: .vdb .nvdb (float grids); .ply .obj .stl");
    app->fallthrough();
    app->add_option("in", raw->in, "a result's folder, a volume or a mesh")->required();
    app->add_option("-o,--output", raw->out, "files to write, by extension")->required();
    app->add_option("--up", raw->up, "the input's up axis, turned to y in .obj (default: what a result's report says)")->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}));
    return {app, [raw](Common&, Progress& progress) {
                std::vector<fs::path> sources;
                for (const std::string& out : raw->out) {
                    sources.push_back(source_for(raw->in, out));
                    check_target(sources.back(), out);
                }
                for (size_t n = 0; n < raw->out.size(); ++n) {
                    progress.check();
                    convert(sources[n], raw->out[n], raw->up.empty() && fs::is_directory(raw->in) ? up_of(raw->in) : raw->up);
                    spdlog::info("{} -> {}", sources[n].string(), raw->out[n]);
                }
                return 0;
            }};
}

}  // namespace vdbcarve::cli
