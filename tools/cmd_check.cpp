// SPDX-License-Identifier: Apache-2.0
#include <iostream>
#include <memory>

#include "cli.h"
#include "vdbcarve/check.h"

namespace vdbcarve::cli {

Command add_check(CLI::App& program) {
    struct Raw {
        CheckOptions options;
        std::string only;
    };
    auto raw = std::make_shared<Raw>();
    CheckOptions& o = raw->options;
    CLI::App* app = program.add_subcommand("check", "what is wrong with a scene, in words: cameras, masks, and whether they fit together");
    app->fallthrough();
    app->add_option("scene", o.views.scene, "scene folder")->required();
    app->add_option("--only", raw->only, "cameras or masks")->check(CLI::IsMember({"cameras", "masks"}));
    app->add_option("--resolution", o.resolution, "of the hull that masks are compared with")->capture_default_str()->check(CLI::Range(32, 1024));
    add_scene_options(*app, o.views, o.mask);
    return {app, [raw](Common& common, Progress& progress) {
                CheckOptions& options = raw->options;
                options.views.allow_missing = options.mask.allow_missing;
                options.cameras = raw->only != "masks";
                options.masks = raw->only != "cameras";
                const CheckResult result = check(options, progress);
                std::cout << (common.json == "-" ? check_json(result) + "\n" : check_text(result));
                return static_cast<int>(result.exit_code);
            }};
}

}  // namespace vdbcarve::cli
