// SPDX-License-Identifier: Apache-2.0
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <tbb/global_control.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "cli.h"
#include "vdbcarve/error.h"
#include "vdbcarve/version.h"

namespace {

vdbcarve::Progress* g_progress = nullptr;

void on_signal(int) {
    if (g_progress) g_progress->cancel();
}

/// A bar with rate and time left on a terminal, nothing elsewhere (stages are logged as they end).
class Bar {
  public:
    void show(const std::string& stage, double share) {
        const auto now = std::chrono::steady_clock::now();
        if (stage != stage_ || share < share_) {
            stage_ = stage;
            start_ = now;
        }
        share_ = share;
        if (share < 1 && now - drawn_ < std::chrono::milliseconds(100)) return;
        drawn_ = now;
        const double elapsed = std::chrono::duration<double>(now - start_).count();
        const int filled = static_cast<int>(30 * share);
        std::fprintf(stderr, "\r%-10s [%.*s%.*s] %3.0f %%  %.0f %%/s, %.1f s left \033[K", stage.c_str(), filled, "##############################", 30 - filled,
                     "..............................", 100 * share, elapsed > 0 ? 100 * share / elapsed : 0.0, share > 0 ? elapsed * (1 - share) / share : 0.0);
        if (share >= 1) clear();
        drawn_something_ = share < 1;
    }
    void clear() {
        std::fprintf(stderr, "\r\033[K");
        std::fflush(stderr);
        drawn_something_ = false;
    }
    bool on_screen() const { return drawn_something_; }

  private:
    std::string stage_;
    double share_ = 0;
    bool drawn_something_ = false;
    std::chrono::steady_clock::time_point start_, drawn_;
};

/// Some progress events a second, and the last of every stage.
class Pace {
  public:
    bool is_due(const std::string& stage, double share) {
        const auto now = std::chrono::steady_clock::now();
        if (stage == stage_ && share < 1 && now - last_ < std::chrono::milliseconds(250)) return false;
        stage_ = stage;
        last_ = now;
        return true;
    }

  private:
    std::string stage_;
    std::chrono::steady_clock::time_point last_;
};

}  // namespace

namespace vdbcarve::cli {

namespace {

/// Insertions, deletions and replacements that make one word the other (Levenshtein's distance).
size_t edits(const std::string& a, const std::string& b) {
    std::vector<size_t> row(b.size() + 1);
    for (size_t j = 0; j <= b.size(); ++j) row[j] = j;
    for (size_t i = 1; i <= a.size(); ++i) {
        size_t diagonal = std::exchange(row[0], i);
        for (size_t j = 1; j <= b.size(); ++j) diagonal = std::exchange(row[j], std::min({row[j] + 1, row[j - 1] + 1, diagonal + (a[i - 1] != b[j - 1])}));
    }
    return row.back();
}

/// The option of a command that an unknown word was probably meant to be; empty: none is near.
std::string nearest_option(const CLI::App& command, const std::string& word) {
    std::string best;
    if (word.rfind("--", 0) != 0) return "";
    size_t fewest = std::max<size_t>(2, word.size() / 4) + 1;
    for (const CLI::Option* option : command.get_options())
        for (const std::string& name : option->get_lnames())
            if (const size_t n = edits(word.substr(2, word.find('=') - 2), name); n < fewest) fewest = n, best.assign("--").append(name);
    return best;
}

void write_event(const nlohmann::ordered_json& what) { std::cout << what.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl; }

/// The last word of a run that failed, on stderr and, with --json, on stdout. Returns the exit code.
int refuse(bool json, ExitCode code, const std::string& text) {
    if (json) write_event({{"event", "error"}, {"exit_code", static_cast<int>(code)}, {"text", text}});
    spdlog::error("{}", text);
    return static_cast<int>(code);
}

/// Where the options themselves are wrong, nobody else knows.
bool wants_json(const std::vector<std::string>& words) {
    for (size_t i = 0; i < words.size(); ++i)
        if (words[i] == "--json=-" || (words[i] == "--json" && i + 1 < words.size() && words[i + 1] == "-")) return true;
    return false;
}

/// An option whose value is empty is one that a script's variable did not reach: `-o "$OUT"` would mean the working folder.
void refuse_empty_values(const CLI::App& command) {
    for (const CLI::Option* option : command.get_options())
        if (option->count() > 0 && option->get_expected_min() > 0)
            for (const std::string& value : option->results())
                if (value.empty()) throw UsageError(option->get_name() + " is empty. Remedy: a value, or leave it out");
}

/// What is wrong with the words of the command line; nothing where they ask for --help or --version.
int refuse_words(CLI::App& program, const std::vector<std::string>& words, const CLI::ParseError& e, bool json) {
    // CLI11 would only say that a command is missing where an unknown one was given.
    if (e.get_name() == "RequiredError" && !words.empty() && words[0][0] != '-' && program.get_subcommands().empty()) {
        return refuse(json, ExitCode::Usage, "'" + words[0] + "' is no command. Run with --help for the list.");
    }
    if (e.get_exit_code() == static_cast<int>(CLI::ExitCodes::ExtrasError)) {
        const CLI::App* command = program.get_subcommands().empty() ? &program : program.get_subcommands().front();
        std::string unknown;
        for (const std::string& word : program.remaining(true))
            if (word[0] == '-') {
                const std::string near = nearest_option(*command, word);
                unknown += (unknown.empty() ? "" : "; ") + word + " is no option" + (command == &program ? "" : " of " + command->get_name()) +
                           (near.empty() ? "" : ". Is " + near + " meant?");
            }
        if (!unknown.empty()) {
            return refuse(json, ExitCode::Usage, unknown + (unknown.back() == '?' ? "" : ".") + " --help lists them");
        }
    }
    if (e.get_exit_code() != 0) return refuse(json, ExitCode::Usage, e.what() + std::string(". --help lists what there is"));
    program.exit(e, std::cout, std::cerr);
    return 0;
}

/// The command that was given, with a progress of its own.
int run_command(const std::vector<cli::Command>& commands, cli::Common& common) {
    Progress progress;
    // A command may run the program anew, with a progress of its own.
    struct Watched {
        Progress* before;
        explicit Watched(Progress* now) : before(std::exchange(g_progress, now)) {}
        Watched(const Watched&) = delete;
        Watched& operator=(const Watched&) = delete;
        ~Watched() { g_progress = before; }
    } watched(&progress);
    std::signal(SIGINT, on_signal);
    std::signal(SIGTERM, on_signal);
    Bar bar;
    const auto say = [&](auto level, const std::string& text) {
        if (bar.on_screen()) bar.clear();
        spdlog::log(level, "{}", text);
    };
    const bool streams = common.json == "-" &&
                         std::any_of(commands.begin(), commands.end(), [](const cli::Command& c) { return c.says == cli::Says::Events && c.app->parsed(); });
    const auto event = [&](const nlohmann::ordered_json& what) {
        if (streams) write_event(what);
    };
    progress.on_note = [&](const std::string& text) {
        say(spdlog::level::info, text);
        event({{"event", "note"}, {"text", text}});
    };
    progress.on_detail = [&](const std::string& text) { say(spdlog::level::debug, text); };
    progress.on_warning = [&](const std::string& text) {
        say(spdlog::level::warn, text);
        event({{"event", "warning"}, {"text", text}});
    };
    const bool shown = isatty(STDERR_FILENO) && !common.quiet;
    Pace pace;
    if (shown || streams)
        progress.on_progress = [&](const std::string& stage, double share) {
            if (shown) bar.show(stage, share);
            if (streams && pace.is_due(stage, share)) event({{"event", "progress"}, {"stage", stage}, {"share", share}});
        };

    std::optional<tbb::global_control> limit;
    if (common.threads > 0) limit.emplace(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(common.threads));
    const auto fail = [&](ExitCode code, const std::string& text) {
        if (bar.on_screen()) bar.clear();
        return refuse(common.json == "-" && !common.report_said, code, text);
    };
    try {
        for (const cli::Command& c : commands)
            if (c.app->parsed()) {
                refuse_empty_values(*c.app);
                const int code = c.run(common, progress);
                if (!common.report_said) event({{"event", "done"}, {"exit_code", code}});
                return code;
            }
    } catch (const Error& e) {
        return fail(e.code(), e.what());
    } catch (const std::bad_alloc&) {
        return fail(ExitCode::Input, "out of memory. Remedy: a lower --resolution");
    } catch (const std::filesystem::filesystem_error& e) {
        return fail(ExitCode::Output, e.what());
    } catch (const std::exception& e) {
        return fail(ExitCode::Input, std::string("unexpected: ") + e.what());
    }
    return 0;
}

}  // namespace

int run_program(const std::vector<std::string>& words) {
    CLI::App program{"vdbcarve: photos around an object become a sparse volume (.vdb) and a closed mesh", "vdbcarve"};
    program.set_version_flag("--version", std::string("vdbcarve ") + kVersion);
    program.require_subcommand(1);
    program.fallthrough();
    cli::Common common;
    program.add_flag("--quiet", common.quiet, "only warnings and errors");
    program.add_flag("--verbose", common.verbose, "more of what is going on");
    program.add_option("--threads", common.threads, "threads to use (0: all)")->check(cli::zero_or_more());
    program.add_option("--json", common.json, "'-': JSON on stdout, one event a line, the report last")->check(CLI::IsMember({"-"}));
    program.set_config("--config", "", "read options from a TOML file (a result's config.toml repeats its run)");
    program.config_formatter(cli::config_reader(program));

    std::vector<cli::Command> commands{
        cli::add_reconstruct(program),
        cli::add_watch(program),
        cli::add_align(program),
        cli::add_mask(program),
        cli::add_carve(program),
        cli::add_synth(program),
        cli::add_info(program),
        cli::add_clean(program),
        cli::add_check(program),
        cli::add_evaluate(program),
        cli::add_export(program),
        cli::add_render(program),
        cli::add_report(program),
        cli::add_bundle(program),
        cli::add_bench(program),
        cli::add_board(program),
        cli::add_again(program, "stereo", "carve a result's concavities by its photographs' depths: OUT and options of reconstruct", "--stereo-scale 1"),
        cli::add_again(program, "color", "colour a result anew: OUT and options of reconstruct", "--color best"),
        cli::add_again(program, "filter", "filter a result anew: OUT and options of reconstruct", "--filter edge-preserving:2x2"),
        cli::add_again(program, "mesh", "mesh a result anew: OUT and options of reconstruct", "--mesher marching-cubes --mesh-formats stl"),
        cli::add_again(program, "smooth", "smooth or decimate a result's mesh anew: OUT and options of reconstruct", "--smooth 10 --faces 50000")};
    // After the commands, which would take it for theirs.
    program.footer(
        "Examples:\n"
        "  vdbcarve synth cup -o shoot                       make a synthetic shoot: photos, masks, cameras, truth\n"
        "  vdbcarve reconstruct shoot -o out                 masks and cameras of the scene -> out/volume.vdb, out/mesh.ply\n"
        "  vdbcarve reconstruct dino --mask threshold -o out photographs on black, masks by a threshold\n"
        "  vdbcarve align shoot --cameras none -o aligned    cameras from silhouettes alone -> aligned/cameras.json\n"
        "  vdbcarve reconstruct photos --mask threshold --fov 40 --known-height 120 --units mm -o out   photographs of a turntable, no cameras\n"
        "  vdbcarve check shoot                              what is wrong with cameras and masks, in words\n"
        "  vdbcarve evaluate out --truth shoot/truth.ply     how far the result is from the truth\n"
        "  vdbcarve info out                                 what a file or a result holds\n"
        "  vdbcarve filter out --filter gaussian:1           one stage anew, and what follows from it\n"
        "  vdbcarve smooth out --faces 50000                 a lighter mesh\n"
        "  vdbcarve reconstruct shoot --units mm --dcc blender -o out   volume and meshes in Blender's axes and metres\n"
        "  vdbcarve export out -o volume.nvdb model.stl      other formats\n"
        "  vdbcarve render out -o turn.mp4                   a film of one turn; .png: a picture\n"
        "  vdbcarve report out                               a page about it: the model in 3-D, which view is wrong, how long it took\n"
        "  vdbcarve watch shoot -o out                       the same while photographs arrive\n"
        "  vdbcarve bundle out                               what somebody needs to see why it failed, in one file\n"
        "  vdbcarve bench                                    how fast this machine carves"
        "\n"
        "Exit codes: " +
        std::string(cli::kExitCodes));
    if (words.size() == 2 && words[0] == "--write-pages") {  // for the build
        try {
            cli::write_pages(program, words[1]);
        } catch (const Error& e) {
            spdlog::error("{}", e.what());
            return static_cast<int>(e.code());
        }
        return 0;
    }
    const bool json = wants_json(words);
    try {
        program.parse(std::vector<std::string>(words.rbegin(), words.rend()));  // as CLI11 wants them
    } catch (const Error& e) {                                                  // a value that an option's own reader refused
        return refuse(json, e.code(), e.what());
    } catch (const CLI::ParseError& e) {
        return refuse_words(program, words, e, json);
    }
    if (common.quiet) spdlog::set_level(spdlog::level::warn);
    if (common.verbose) spdlog::set_level(spdlog::level::debug);

    return run_command(commands, common);
}

}  // namespace vdbcarve::cli

int main(int argc, char** argv) {
    spdlog::set_default_logger(spdlog::stderr_color_mt("vdbcarve"));
    spdlog::set_pattern("%^%l%$ %v");
    return vdbcarve::cli::run_program({argv + 1, argv + argc});
}
