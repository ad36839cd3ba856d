// SPDX-License-Identifier: Apache-2.0
// reconstruct, and its first parts as commands of their own: mask, align, carve; and watch.
#include <spdlog/spdlog.h>

#include <algorithm>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli.h"
#include "vdbcarve/error.h"

namespace vdbcarve::cli {

void say_stage(const std::string& event, bool json) {
    if (json) std::cout << event << std::endl;
    const auto field = [&](const std::string& key) {
        const size_t at = event.find("\"" + key + "\":") + key.size() + 3;
        return event.substr(at, event.find_first_of(",}", at) - at);
    };
    const bool reused = field("reused") == "true";
    spdlog::debug("{:<10} peak memory {:.0f} MB", "", std::stod(field("peak_rss_bytes")) / 1e6);
    spdlog::info("{:<10} {:>8.2f} s{}", field("name").substr(1, field("name").size() - 2), std::stod(field("seconds")), reused ? "  (already there)" : "");
}

void say_result(const Reconstruction& result, const ReconstructOptions& options, Common& common) {
    const bool json = common.json == "-";
    common.report_said = true;
    if (json) {
        if (!result.contradiction.empty() && !options.run.dry_run)
            std::cout << nlohmann::json{{"event", "error"}, {"exit_code", static_cast<int>(ExitCode::Contradiction)}, {"text", result.contradiction}}.dump()
                      << std::endl;
        std::string line = result.report_json;
        line.erase(std::remove(line.begin(), line.end(), '\n'), line.end());
        std::cout << line << std::endl;
    } else if (options.run.dry_run) {
        std::cout << result.report_json;
    }
    if (options.run.dry_run) return;
    if (options.run.last_stage == LastStage::Export)
        spdlog::info("mesh: {} vertices, {} faces, {}{}, genus {}, volume {:.6g}; silhouette IoU median {:.4f}, minimum {:.4f}", result.mesh.vertices,
                     result.mesh.faces, result.mesh.manifold ? "closed manifold" : "NOT a closed manifold",
                     result.mesh.components > 1 ? " in " + std::to_string(result.mesh.components) + " pieces" : std::string(), result.mesh.genus,
                     result.mesh.volume, result.median_iou, result.minimum_iou);
    spdlog::info("result in {}", options.run.output.string());
}

namespace {

unsigned bit_of(LastStage last) {
    return last == LastStage::Mask ? in::kMask : last == LastStage::Align ? in::kAlign : last == LastStage::Carve ? in::kCarve : in::kReconstruct;
}

Command add(CLI::App& program, const char* name, const char* what, LastStage last, const char* example, bool live = false) {
    struct Raw {
        ReconstructOptions options;
        WatchOptions watch;   // but for its `reconstruct`
        bool resume = false;  // finished stages are never run again anyway; the flag says so in scripts
    };
    auto raw = std::make_shared<Raw>();
    ReconstructOptions& o = raw->options;
    o.run.last_stage = last;
    o.cameras.find_again = last == LastStage::Align;
    CLI::App* app = program.add_subcommand(name, what);
    app->fallthrough();
    std::vector<OptionEntry> entries = list_options(o);
    for (const OptionEntry& e : entries)
        if (std::string(e.about.name) == "scene") app->add_option("scene", o.views.scene, live ? e.about.help_of_watch : e.about.help)->required();
    app->add_option("-o,--output", o.run.output, help_of("output"))->required();
    if (live)
        for (OptionEntry& e : list_options(raw->watch)) entries.push_back(std::move(e));
    add_options(*app, entries, live ? in::kWatch : bit_of(last));
    app->add_flag("--resume", raw->resume, "go on where a run stopped (always so: finished stages are never run again)");
    app->footer(example);
    return {app, [raw, live](Common& common, Progress& progress) {
                ReconstructOptions& options = raw->options;
                apply_implied(options);
                const bool json = common.json == "-";
                options.run.on_stage = [json](const std::string& event) { say_stage(event, json); };
                if (live) {
                    raw->watch.reconstruct = options;
                    raw->watch.on_result = [&](const Reconstruction& result) { say_result(result, options, common); };
                    const Reconstruction result = watch(raw->watch, progress);
                    if (!result.contradiction.empty()) throw ContradictionError(result.contradiction);
                    return 0;
                }
                const Reconstruction result = reconstruct(options, progress);
                say_result(result, options, common);
                if (!result.contradiction.empty() && !options.run.dry_run) throw ContradictionError(result.contradiction);
                return 0;
            }};
}

}  // namespace

Command add_reconstruct(CLI::App& program) {
    return add(program, "reconstruct", "everything: views, masks, carving, level set, mesh, files", LastStage::Export,
               "Examples:\n"
               "  vdbcarve reconstruct shoot -o out                                        masks and cameras of the scene\n"
               "  vdbcarve reconstruct photos --mask threshold --known-height 120 --units mm -o out   no cameras: found from the silhouettes\n"
               "  vdbcarve reconstruct photos --cameras aligned/cameras.json -o out        cameras that align found\n"
               "  vdbcarve reconstruct photos --method mat --mat mat.pdf.json -o out       cameras from a mat that board made, in true size\n"
               "  vdbcarve reconstruct shoot --stereo on -o out                            with concavities, of a textured object\n"
               "  vdbcarve reconstruct shoot --units mm --dcc blender -o out               in Blender's axes and metres");
}
Command add_watch(CLI::App& program) {
    return add(program, "watch", "reconstruct while photographs arrive in a folder", LastStage::Export,
               "Examples:\n"
               "  vdbcarve watch shoot -o out                                              shoot has the cameras of all views to come; until Ctrl-C\n"
               "  vdbcarve watch shoot --mask chroma --bounds -100,-100,0,100,100,200 --voxel-size 0.5 -o out   bounds that are known\n"
               "  vdbcarve watch shoot --until 36 -o out                                   ends with the 36th view\n"
               "Masks and the hull are extended by what is new, later stages follow; out/report.html and out/preview.png are of what is there.\n"
               "Takes what reconstruct takes, but for films and --dry-run. Cameras that are to be found are found anew from all photographs each time.",
               true);
}
Command add_align(CLI::App& program) {
    return add(program, "align", "cameras from silhouettes, texture or a marker mat, into OUT/cameras.json", LastStage::Align,
               "Examples:\n"
               "  vdbcarve align photos --mask threshold -o aligned                        an object turned once around, or walked around\n"
               "  vdbcarve align photos --orbit turntable --direction ccw --fov 40 -o aligned   what is known may be said\n"
               "  vdbcarve align photos --cameras colmap --method refine -o aligned        cameras that are nearly right, made better\n"
               "  vdbcarve board -o mat.pdf; vdbcarve align photos --method mat --mat mat.pdf.json -o aligned\n"
               "  vdbcarve reconstruct photos --cameras aligned/cameras.json -o out        goes on from there\n"
               "Of cameras that the scene has already, refine takes everything, mat the lens where it is known, the others focal lengths, principal points and "
               "lenses only.");
}
Command add_mask(CLI::App& program) {
    return add(
        program, "mask", "only the masks, into OUT/masks", LastStage::Mask,
        "Examples:\n"
        "  vdbcarve mask dino --mask threshold --threshold 25 -o masks                          before black\n"
        "  vdbcarve mask toy --mask chroma -o masks                                             before a coloured cloth; --chroma-key where the borders do not "
        "show it\n"
        "  vdbcarve mask toy --clean-plate empty.jpg -o masks                                   a camera that stood still, and a photograph without the "
        "object\n"
        "  vdbcarve mask toy --mask grabcut --grabcut-box 200,50,900,700 -o masks               anything else that differs in colour\n"
        "  vdbcarve mask toy --mask-command 'rembg i {in} {out}' -o masks                       another program's, here one that has learnt what objects are\n"
        "OUT/overlays shows what each mask leaves out (red). A mask in OUT/masks that you mend is used from then on.");
}
Command add_carve(CLI::App& program) {
    return add(program, "carve", "up to the raw hull, into OUT/hull.vdb", LastStage::Carve, "Examples:\n  vdbcarve carve shoot --resolution 512 -o hull");
}

}  // namespace vdbcarve::cli
