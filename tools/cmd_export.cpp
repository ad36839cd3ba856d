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
#include "vdbcarve/export_cameras.h"
#include "vdbcarve/pipeline.h"
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
    std::vector<const char*> names{"mesh.ply", "mesh.glb", "mesh.obj", "mesh.stl"};
    if (is_volume(out)) names = {"volume.vdb", "hull.vdb"};
    for (const char* name : names)
        if (fs::exists(in / name)) return in / name;
    if (is_volume(out) && fs::is_directory(in / "hull_bricks"))
        throw InputError((in / "hull_bricks").string() + ": the hull lies in bricks; convert them one by one");
    throw InputError(in.string() + ": holds no " + (is_volume(out) ? "volume" : "mesh") + " of vdbcarve's. Remedy: `vdbcarve reconstruct` makes one");
}

struct Raw {
    std::string in;
    std::vector<std::string> out;
    FrameRequest frame;  ///< of the input, and what is wanted
    ViewsOptions views;  ///< where cameras come from
    bool undistort = false;
    bool half = false;
};

/// Targets that are cameras: transforms.json, or a folder for COLMAP.
bool is_for_cameras(const fs::path& file) { return extension_of(file) == ".json" || extension_of(file).empty(); }

/// Cameras of a result, a scene or a camera file, with what else of the result belongs to them.
void convert_cameras(const Raw& raw, const fs::path& to, Progress& progress) {
    const fs::path in = raw.in;
    CameraExportOptions options;
    options.undistort = raw.undistort;
    Views views;
    if (fs::exists(in / "cameras.json") && fs::exists(in / "report.json")) {
        views = result_views(in, raw.views.images, progress);
        if (fs::is_directory(in / "masks")) options.masks = in / "masks";
        if (fs::exists(in / "mesh.ply") && extension_of(to).empty())
            options.points = in_frame(read_mesh(in / "mesh.ply"), inverse(frame_from_scene(in, "mesh.ply")));
    } else {
        ViewsOptions from = raw.views;
        from.scene = fs::is_directory(in) ? in : in.parent_path().empty() ? fs::path(".") : in.parent_path();
        if (!fs::is_directory(in)) from.cameras = fs::absolute(in);
        from.cameras_only = true;
        from.up = raw.frame.up;
        views = load_views(from, progress);
    }
    if (!raw.frame.up.empty()) views.up = raw.frame.up;
    export_cameras(views, to, options, progress);
}

/// Everything that can be known to fail before anything is written.
void check_target(const fs::path& from, const fs::path& to) {
    const std::string extension = extension_of(to);
    if (is_for_cameras(to)) {
        if (!fs::exists(from)) throw InputError(from.string() + ": no such file or folder");
        if (extension.empty() && fs::is_directory(to) && !fs::is_empty(to) && !fs::is_directory(to / "sparse"))
            throw OutputError(to.string() + ": is not empty. Remedy: another -o");
        std::error_code not_there;
        for (const fs::path& input : {from, from / "report.json", from / "cameras.json"})
            if (fs::equivalent(input, to, not_there)) throw OutputError(to.string() + ": is an input file of this command. Remedy: another -o");
        return;
    }
    if (extension != ".vdb" && extension != ".nvdb" && extension != ".ply" && extension != ".obj" && extension != ".stl" && extension != ".glb")
        throw UsageError(
            to.string() +
            ": the extension says what to write; .vdb, .nvdb, .ply, .obj, .stl, .glb and .json (cameras) are known, and a folder, which has none (COLMAP)");
    if (is_volume(from) != is_volume(to))
        throw UsageError(to.string() + " cannot be made of " + from.string() + ": volumes become .vdb or .nvdb, meshes .ply, .obj, .stl or .glb");
    if (extension != to.extension().string()) throw UsageError(to.string() + ": write the extension in small letters");
    std::error_code ignored;
    if (fs::equivalent(from, to, ignored)) throw UsageError(to.string() + ": is the input itself");
}

/// The frame of an input: what was said, what a result's report says of its file, or what the format always is.
FrameRequest frame_of(const Raw& raw, const fs::path& source) {
    FrameRequest out = raw.frame;
    if (fs::exists(source.parent_path() / "report.json")) {
        try {
            std::ifstream in(source.parent_path() / "report.json");
            const auto report = nlohmann::json::parse(in);
            const auto& said = report.contains("files") && report["files"].contains(source.filename().string()) ? report["files"][source.filename().string()]
                                                                                                                : report.at("cameras");
            if (out.up.empty()) out.up = said.at("up").get<std::string>();
            if (out.units.empty()) out.units = said.at("units").get<std::string>();
        } catch (const nlohmann::json::exception&) {
            // A report that was damaged says nothing.
        }
    } else if (const std::string extension = extension_of(source); extension == ".glb" || extension == ".obj") {
        if (out.up.empty()) out.up = "y";
        if (out.units.empty() && extension == ".glb") out.units = "m";
    }
    return out;
}

void warn_of_frame(const fs::path& to, const FrameRequest& request) {
    if (const std::string unknown = unknown_frame(extension_of(to), request); !unknown.empty()) spdlog::warn("{}: {}", to.string(), unknown);
}

void convert_volume(const fs::path& from, const fs::path& to, FrameRequest request, bool half) {
    openvdb::MetaMap metadata;
    const openvdb::GridPtrVec all = extension_of(from) == ".nvdb" ? read_nvdb(from) : read_vdb(from, &metadata);
    const auto said = [&](const char* key, std::string& value) {
        if (const auto found = metadata[key]; found && value.empty() && found->str() != "unknown") value = found->str();
    };
    said("up_axis", request.up);
    said("units", request.units);
    warn_of_frame(to, request);
    const FileFrame frame = file_frame(extension_of(to), request);
    openvdb::GridCPtrVec grids;
    for (const openvdb::GridBase::Ptr& grid : all) {
        if (extension_of(to) == ".nvdb" && !grid->isType<openvdb::FloatGrid>() && !grid->isType<openvdb::Vec3SGrid>() && !grid->isType<openvdb::Int32Grid>() &&
            !grid->isType<openvdb::MaskGrid>()) {
            spdlog::warn("grid '{}' ({}) is left out: NanoVDB has no such type", grid->getName(), grid->valueType());
            continue;
        }
        if (request.dcc != Dcc::None && grid->isType<openvdb::Vec3SGrid>() && (grid->getName() == "color" || grid->getName() == "Cd"))
            grid->setName(color_grid_name(request.dcc));
        grids.push_back(in_frame(openvdb::GridBase::ConstPtr(grid), frame));
    }
    if (grids.empty()) throw InputError(from.string() + ": has no grid that can be written");
    if (extension_of(to) == ".nvdb") {
        write_nvdb(to, grids);
        return;
    }
    const auto set = [&](const char* key, const openvdb::Metadata& value) {
        metadata.removeMeta(key);
        metadata.insertMeta(key, value);
    };
    set("up_axis", openvdb::StringMetadata(frame.up.empty() ? "unknown" : frame.up));
    set("units", openvdb::StringMetadata(frame.units.empty() ? "unknown" : frame.units));
    set("voxel_size", openvdb::DoubleMetadata(grids.front()->voxelSize()[0]));
    write_vdb(to, grids, metadata, half);
}

void convert(const Raw& raw, const fs::path& from, const fs::path& to) {
    const FrameRequest request = frame_of(raw, from);
    if (is_volume(from)) {
        convert_volume(from, to, request, raw.half);
        return;
    }
    warn_of_frame(to, request);
    write_mesh(to, in_frame(read_mesh(from), file_frame(extension_of(to), request)));
}

}  // namespace

Command add_export(CLI::App& program) {
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("export", "convert a result or a file: .vdb .nvdb; .ply .obj .stl .glb; cameras for COLMAP and nerfstudio");
    app->fallthrough();
    app->add_option("in", raw->in, "a result's folder, a volume or a mesh")->required();
    app->add_option("-o,--output", raw->out,
                    "files to write, by extension; transforms.json: cameras for nerfstudio; a folder: cameras for COLMAP, in its sparse/0")
        ->required();
    app->add_flag("--undistort", raw->undistort,
                  "with cameras: write photographs without their lens's distortion too (and masks), into images/ and masks/ beside them");
    app->add_option("--images", raw->views.images, "with cameras: folder of photographs (default: where the result's report says)");
    app->add_option("--up", raw->frame.up, "the input's up axis (default: what a result's report or a volume's metadata say; y of .obj and .glb)")
        ->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}));
    app->add_option("--units", raw->frame.units, "the input's unit of length: m, cm, mm, inch … (default: likewise)");
    add_choice(*app, "--dcc", raw->frame.dcc, Words(kDccWords), help_of("dcc"))->group("Result");
    app->add_flag("--stl-mm", raw->frame.stl_mm, ".stl in millimetres, for printers");
    app->add_flag("--vdb-half", raw->half, "16-bit floats in .vdb: two thirds of the size, three digits");
    app->footer(
        "Examples:\n"
        "  vdbcarve export out -o model.glb model.obj                               the mesh in other formats\n"
        "  vdbcarve export out -o volume.nvdb --dcc houdini                         the volume\n"
        "  vdbcarve export out --undistort -o colmap                                photographs, masks and cameras for COLMAP, OpenMVS, splatting\n"
        "  vdbcarve export out --undistort -o nerf/transforms.json                  the same for nerfstudio");
    return {app, [raw](Common&, Progress& progress) {
                if (raw->undistort && std::none_of(raw->out.begin(), raw->out.end(), [](const std::string& out) { return is_for_cameras(out); }))
                    throw UsageError("--undistort is of cameras: -o FOLDER or -o transforms.json");
                require_finished(raw->in);
                std::vector<fs::path> sources;
                for (const std::string& out : raw->out) {
                    sources.push_back(is_for_cameras(out) ? fs::path(raw->in) : source_for(raw->in, out));
                    check_target(sources.back(), out);
                }
                for (size_t n = 0; n < raw->out.size(); ++n) {
                    progress.check();
                    if (is_for_cameras(raw->out[n])) convert_cameras(*raw, raw->out[n], progress);
                    else convert(*raw, sources[n], raw->out[n]);
                    spdlog::info("{} -> {}", sources[n].string(), raw->out[n]);
                }
                return 0;
            }};
}

}  // namespace vdbcarve::cli
