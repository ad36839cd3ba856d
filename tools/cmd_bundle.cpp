// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <memory>

#include "cli.h"
#include "vdbcarve/app/bundle.h"

namespace vdbcarve::cli {

Command add_bundle(CLI::App& program) {
    struct Raw {
        std::string result, output;
        BundleOptions options;
    };
    auto raw = std::make_shared<Raw>();
    BundleOptions& o = raw->options;
    CLI::App* app = program.add_subcommand("bundle", "one small archive about a result, or a run that failed, to be sent to somebody");
    app->fallthrough();
    app->add_option("out", raw->result, "the folder given to reconstruct as -o, finished or not")->required();
    app->add_option("-o,--output", raw->output, "the archive (default: OUT.tar.gz, in the working folder)");
    app->add_flag("--photos", o.photos, "with the photographs, made smaller and the model's colours (otherwise only silhouettes and the bare shape are in it)");
    app->add_option("--width", o.width_px, "of masks and photographs, pixels (0: as they are)")->capture_default_str()->check(CLI::Range(0, 65536));
    app->add_option("--images", o.images, "folder of photographs (default: where the result says)");
    app->footer(
        "It holds report, options (with the paths of your folders), cameras, masks, what the run failed of and the versions of program and machine.\n"
        "Examples:\n"
        "  vdbcarve bundle out                                                      out.tar.gz\n"
        "  vdbcarve bundle out --photos --width 1024 -o failure.tar.gz\n"
        "  tar xzf out.tar.gz; vdbcarve reconstruct vdbcarve-bundle/scene -o again            what whoever gets it does");
    return {app, [raw](Common&, Progress& progress) {
                const std::filesystem::path whole = std::filesystem::absolute(raw->result).lexically_normal();
                const std::filesystem::path file =
                    raw->output.empty() ? (whole.has_filename() ? whole : whole.parent_path()).filename().string() + ".tar.gz" : raw->output;
                const size_t bytes = bundle(raw->result, file, raw->options, progress);
                spdlog::info("{}: {:.2f} MB{}", file.string(), static_cast<double>(bytes) / 1e6, raw->options.photos ? "" : ", no photographs in it");
                return 0;
            }};
}

}  // namespace vdbcarve::cli
