// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <memory>

#include "cli.h"
#include "vdbcarve/app/report.h"

namespace vdbcarve::cli {

Command add_report(CLI::App& program) {
    struct Raw {
        std::string result, output;
        ReportOptions options;
        double most_megabytes = 25;
    };
    auto raw = std::make_shared<Raw>();
    ReportOptions& o = raw->options;
    CLI::App* app = program.add_subcommand("report", "a page about a result: the model in 3-D, photographs with contours, cameras, timings");
    app->fallthrough();
    app->add_option("out", raw->result, "a result's folder")->required();
    app->add_option("-o,--output", raw->output, "the page (default: OUT/report.html)");
    app->add_option("--images", o.images, "folder of photographs (default: where the result says)");
    app->add_option("--faces", o.most_faces, "of the model in the page (0: a picture instead)")->capture_default_str()->check(CLI::Range(0, 10000000));
    app->add_option("--photos", o.most_photos, "so many photographs, the worst ones")->capture_default_str();
    app->add_option("--photo-width", o.photo_width_px, "of a photograph, pixels")->capture_default_str()->check(CLI::Range(64, 4096));
    app->add_option("--size", raw->most_megabytes, "megabytes of the page: the model gets coarser until it fits")
        ->capture_default_str()
        ->check(CLI::Range(1.5, 2000.0));
    app->footer(
        "Examples:\n"
        "  vdbcarve report out                                                      out/report.html, one file, opens without a network\n"
        "  vdbcarve report out --size 5 --photos 24 -o page.html                    a small one, to be sent");
    return {app, [raw](Common&, Progress& progress) {
                raw->options.most_bytes = static_cast<size_t>(raw->most_megabytes * 1e6);
                const std::filesystem::path file =
                    raw->output.empty() ? std::filesystem::path(raw->result) / "report.html" : std::filesystem::path(raw->output);
                const size_t bytes = write_report(raw->result, file, raw->options, progress);
                spdlog::info("{}: {:.1f} MB{}", file.string(), static_cast<double>(bytes) / 1e6,
                             report_has_viewer() ? "" : ", without the 3-D viewer (built without it)");
                return 0;
            }};
}

}  // namespace vdbcarve::cli
