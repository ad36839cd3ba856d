// SPDX-License-Identifier: Apache-2.0
// What the commands of the command line share.
#pragma once

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <memory>

#include "vdbcarve/config.h"
#include "vdbcarve/error.h"
#include "vdbcarve/option_text.h"
#include "vdbcarve/progress.h"

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
    Events,   ///< how far it is, one event a line; the last is the report, or "done"
    Document  ///< one, which the command writes
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
/// `name` is a stage of reconstruct that is to be run again with other options.
Command add_again(CLI::App& program, const char* name, const char* what, const char* example);

/// A page about the program and one about each command: NAME.md, vdbcarve-NAME.1 (man). Throws OutputError.
void write_pages(const CLI::App& program, const std::filesystem::path& folder);

/// The whole program on a command line, without its own name. Returns the exit code.
int run_program(const std::vector<std::string>& words);

/// Where a scene's photographs, cameras and masks are: --images, --cameras, --masks, --mask …
void add_scene_options(CLI::App& command, ViewsOptions& views, MaskOptions& mask);

/// Every option of the list that the command offers, under its heading. `set` is called with what was given, in the order of the list; without it the options
/// are set themselves. `hidden`: --help does not show them.
using OptionSetter = std::function<void(const OptionEntry&, const std::vector<std::string>&)>;
void add_options(CLI::App& app, const std::vector<OptionEntry>& entries, unsigned command, bool hidden = false, const OptionSetter& set = {});

/// What an option of reconstruct does, for commands that have it too.
std::string help_of(const std::string& name);

/// Configuration files in the program's own form of TOML.
std::shared_ptr<CLI::Config> config_reader(const CLI::App& program);

/// A stage of reconstruct has ended: for the log and, where it is asked for, as JSON.
void say_stage(const std::string& event, bool json);
/// The last words of a reconstruct.
void say_result(const Reconstruction& result, const ReconstructOptions& options, Common& common);

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
T one_of(const std::string& option, const std::string& text, const Words<T>& words) {
    for (const Word<T>& w : words.all)
        if (CLI::detail::to_lower(text) == w.text) return w.value;
    throw UsageError(option + " " + text + ": must be one of " + words.list());
}

/// An option that takes one of them.
template <class T>
CLI::Option* add_choice(CLI::App& app, const std::string& option, T& target, const Words<T>& words, const std::string& what) {
    return app
        .add_option_function<std::string>(
            option, [&target, option, words](const std::string& text) { target = one_of(option, text, words); }, what)
        ->type_name("WORD");
}

}  // namespace vdbcarve::cli
