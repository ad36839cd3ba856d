// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <memory>

#include "cli.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::cli {

Command add_clean(CLI::App& program) {
    auto output = std::make_shared<std::string>();
    CLI::App* app = program.add_subcommand("clean", "empty OUT/stages; the results stay");
    app->fallthrough();
    app->add_option("out", *output, "folder of a result")->required();
    app->footer("Examples:\n  vdbcarve clean out");
    return {app, [output](Common&, Progress&) {
                spdlog::info("{:.1f} MB freed in {}", static_cast<double>(clean(*output)) / 1e6, *output);
                return 0;
            }};
}

}  // namespace vdbcarve::cli
