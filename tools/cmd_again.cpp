// SPDX-License-Identifier: Apache-2.0
// One stage anew on a result: stereo, color, filter, mesh, smooth. A result's config.toml says how it was made; what is given here replaces it, and stages that
// do not depend on it are found done.
#include <fstream>
#include <memory>

#include "cli.h"
#include "vdbcarve/error.h"

namespace vdbcarve::cli {

Command add_again(CLI::App& program, const char* name, const char* what, const char* example) {
    auto folder = std::make_shared<std::string>();
    CLI::App* app = program.add_subcommand(name, what);
    app->add_option("out", *folder, "a result's folder; run from where it was made, as its config.toml names the scene from there")->required();
    app->fallthrough(false);  // what is not known here is for reconstruct, not for the program
    app->prefix_command();
    app->footer(
        std::string(
            "Takes any option of reconstruct, in the place of what the result was made with; what they do not change is found done.\nExamples:\n  vdbcarve ") +
        name + " out " + example);
    return {
        app,
        [folder, app](Common& common, Progress&) {
            if (app->get_parent()->get_config_ptr()->count() > 0)
                throw UsageError("--config: a result's own config.toml is what counts here. Remedy: `vdbcarve --config FILE reconstruct`");
            const std::filesystem::path config = std::filesystem::path(*folder) / "config.toml";
            std::ifstream in(config);
            const std::string text((std::istreambuf_iterator<char>(in)), {});
            if (text.find("reconstruct.scene=") == std::string::npos)
                throw InputError(config.string() + ": is not there, or not of `vdbcarve reconstruct`. Remedy: `vdbcarve reconstruct SCENE -o " + *folder + "`");
            std::vector<std::string> words{"--config", config.string()};
            if (common.quiet) words.push_back("--quiet");
            if (common.verbose) words.push_back("--verbose");
            if (!common.json.empty()) words.insert(words.end(), {"--json", common.json});
            if (common.threads > 0) words.insert(words.end(), {"--threads", std::to_string(common.threads)});
            words.push_back("reconstruct");
            // Where the result is now counts, not where it was.
            words.insert(words.end(), {"-o", *folder});
            const std::vector<std::string> given = app->remaining();
            if (app->get_name() == "stereo" &&
                std::none_of(given.begin(), given.end(), [](const std::string& word) { return word == "--stereo" || word.rfind("--stereo=", 0) == 0; }))
                words.insert(words.end(), {"--stereo", "on"});
            words.insert(words.end(), given.begin(), given.end());
            return run_program(words);
        },
        Says::Nothing};
}

}  // namespace vdbcarve::cli
