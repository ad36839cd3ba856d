// SPDX-License-Identifier: Apache-2.0
// One stage of a result again: stereo, color, filter, mesh, smooth. The result's config.toml says how it was made; what is given here replaces it, and stages
// that do not depend on it are found done.
#include <algorithm>
#include <memory>

#include "cli.h"
#include "vdbcarve/error.h"

namespace vdbcarve::cli {

Command add_again(CLI::App& program, const char* name, const char* what, const char* example) {
    struct Raw {
        std::string folder;
        ReconstructOptions listed;  // only its options' names matter here
        std::vector<OptionChange> changes;
        bool resume = false;
    };
    auto raw = std::make_shared<Raw>();
    CLI::App* app = program.add_subcommand(name, what);
    app->add_option("out", raw->folder, "a result's folder; run from where it was made, as its config.toml names the scene from there")->required();
    app->fallthrough();
    // Any option of reconstruct, which its own page explains.
    add_options(*app, list_options(raw->listed), in::kReconstruct, true,
                [changes = &raw->changes](const OptionEntry& e, const std::vector<std::string>& values) {
                    changes->push_back({e.about.name, values});
                });
    app->add_flag("--resume", raw->resume)->group("");
    app->footer(
        std::string(
            "Takes any option of reconstruct, in place of what the result was made with; what they do not change is found done.\nExamples:\n  vdbcarve ") +
        name + " out " + example);
    return {app, [raw, app](Common& common, Progress& progress) {
                if (app->get_parent()->get_config_ptr()->count() > 0)
                    throw UsageError("--config: a result's own config.toml is what counts here. Remedy: `vdbcarve --config FILE reconstruct`");
                const bool json = common.json == "-";
                ReconstructOptions used;
                const auto change = [&](ReconstructOptions& options) {
                    if (app->get_name() == "stereo") options.stereo.use = StereoSettings::Use::On;  // unless --stereo says otherwise
                    change_options(options, raw->changes);
                    options.run.on_stage = [json](const std::string& event) { say_stage(event, json); };
                    used = options;
                    used.run.output = raw->folder;
                };
                const Reconstruction result = redo(raw->folder, change, progress);
                say_result(result, used, common);
                if (!result.contradiction.empty() && !used.run.dry_run) throw ContradictionError(result.contradiction);
                return 0;
            }};
}

}  // namespace vdbcarve::cli
