// SPDX-License-Identifier: Apache-2.0
// What the commands of the command line share.
#pragma once

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>

#include "vdbcarve/error.h"
#include "vdbcarve/export.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/views.h"

namespace vdbcarve::cli {

/// Options before or after any command.
struct Common {
    bool quiet = false, verbose = false;
    int threads = 0;           ///< 0: all
    std::string json;          ///< "-": JSON on stdout
    bool report_said = false;  ///< the report, which is the last event, was written; set by commands
};

/// What a command puts on stdout with --json.
enum class Says {
    Events,    ///< how far it is, one event a line; the last is the report, or "done"
    Document,  ///< one, which the command writes
    Nothing    ///< another run of the program, which it starts, says it
};

/// A command adds itself to the program; `run` is called after parsing and returns the exit code.
struct Command {
    CLI::App* app;
    std::function<int(Common&, Progress&)> run;
    Says says = Says::Events;
};

Command add_reconstruct(CLI::App& program);
Command add_watch(CLI::App& program);
Command add_mask(CLI::App& program);
Command add_align(CLI::App& program);
Command add_carve(CLI::App& program);
Command add_synth(CLI::App& program);
Command add_info(CLI::App& program);
Command add_clean(CLI::App& program);
Command add_bench(CLI::App& program);
Command add_board(CLI::App& program);
Command add_check(CLI::App& program);
Command add_evaluate(CLI::App& program);
Command add_export(CLI::App& program);
Command add_render(CLI::App& program);
Command add_report(CLI::App& program);
Command add_bundle(CLI::App& program);
/// `name` is a stage of reconstruct that is to be done anew, with other options.
Command add_again(CLI::App& program, const char* name, const char* what, const char* example);

/// A page about the program and one about each command: NAME.md, vdbcarve-NAME.1 (man). Throws OutputError.
void write_pages(const CLI::App& program, const std::filesystem::path& folder);

/// The whole program on a command line, without its own name. Returns the exit code.
int run_program(const std::vector<std::string>& words);

/// Where a scene's photographs, cameras and masks are: --images, --cameras, --masks, --mask …
void add_scene_options(CLI::App& command, ViewsOptions& views, MaskOptions& mask);

/// --dcc.
void add_dcc_option(CLI::App& command, Dcc& dcc);

/// "a,b,c" as numbers. Throws UsageError naming the option.
std::vector<double> numbers(const std::string& option, const std::string& text, size_t count, char separator = ',');

/// "R,G,B" (0..255) or "#rrggbb". Throws UsageError naming the option, and the words that it takes besides.
std::array<uint8_t, 3> rgb8_of(const std::string& option, const std::string& text, const std::string& words = "");

/// For options that are lengths. (CLI11's own names the largest number there is.)
inline CLI::Validator above_zero() {
    return CLI::Validator(
        [](std::string& text) {
            double value = 0;
            return CLI::detail::lexical_cast(text, value) && value > 0 && std::isfinite(value) ? std::string() : text + " is no number above 0";
        },
        "> 0");
}
inline CLI::Validator zero_or_more() {
    return CLI::Validator(
        [](std::string& text) {
            double value = 0;
            return CLI::detail::lexical_cast(text, value) && value >= 0 && std::isfinite(value) ? std::string() : text + " is no number of 0 or more";
        },
        ">= 0");
}

/// At the end of every page about a command.
inline constexpr const char* kExitCodes = "0 done, 2 usage, 3 input, 4 data contradict each other, 5 undetermined, 6 output, 7 backend, 130 interrupted";

/// One of a few words, in whatever case. Throws UsageError naming all of them.
template <class T>
T one_of(const std::string& option, const std::string& text, const std::vector<std::pair<std::string, T>>& choices) {
    std::string all;
    for (const auto& [word, value] : choices) {
        if (CLI::detail::to_lower(text) == word) return value;
        all += (all.empty() ? "" : ", ") + word;
    }
    throw UsageError(option + " " + text + ": is none of " + all);
}

/// An option that takes one of them.
template <class T>
CLI::Option* add_choice(CLI::App& app, const std::string& option, T& target, const std::vector<std::pair<std::string, T>>& choices, const std::string& what) {
    return app
        .add_option_function<std::string>(
            option, [&target, option, choices](const std::string& text) { target = one_of(option, text, choices); }, what)
        ->type_name("WORD");
}

}  // namespace vdbcarve::cli
