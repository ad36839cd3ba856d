// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <memory>

#include "cli.h"
#include "vdbcarve/board.h"

namespace vdbcarve::cli {

Command add_board(CLI::App& program) {
    struct Raw {
        std::string mat = "charuco:7x9:0.025:0.018:6X6_250";
        std::filesystem::path output;
        double margin_m = 0.01;
    };
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand("board", "a marker mat to print and to put the object on");
    app->fallthrough();
    app->add_option("-o,--output", raw->output, ".pdf (true size) or .png; the layout is written beside it, FILE.json, for --mat")->required();
    app->add_option("--mat", raw->mat, "charuco:COLSxROWS:SQUARE:MARKER:DICT or grid:COLSxROWS:MARKER:GAP:DICT, metres; the default fits A4")
        ->capture_default_str();
    app->add_option("--margin", raw->margin_m, "white around it, metres")->capture_default_str()->check(CLI::Range(0.0, 0.5));
    app->footer(
        "Examples:\n"
        "  vdbcarve board -o mat.pdf                                     for A4; print at 100 %, put the object on it, photograph all of it\n"
        "  vdbcarve board --mat grid:5x7:0.035:0.005:6X6_250 -o mat.png  markers side by side\n"
        "  vdbcarve reconstruct photos --method mat --mat mat.pdf.json -o out");
    return {app, [raw](Common&, Progress&) {
                const MatLayout mat = read_mat(raw->mat);
                write_board(mat, raw->output, raw->margin_m);
                spdlog::info("{}: print it at 100 % (no fit to page) and measure: the pattern must be {:.1f} mm wide and {:.1f} mm high", raw->output.string(),
                             1e3 * mat.width_m(), 1e3 * mat.height_m());
                return 0;
            }};
}

}  // namespace vdbcarve::cli
