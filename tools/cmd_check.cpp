// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <filesystem>
#include <iostream>
#include <memory>

#include "cli.h"
#include "vdbcarve/check.h"
#include "vdbcarve/error.h"

namespace vdbcarve::cli {

Command add_check(CLI::App& program) {
    struct Raw {
        CheckOptions options;
        std::string only, write_cameras;
    };
    auto raw = std::make_shared<Raw>();
    CheckOptions& o = raw->options;
    CLI::App* app = program.add_subcommand("check", "what is wrong with a scene, in words: images, cameras, masks, and whether they fit together");
    app->fallthrough();
    app->add_option("scene", o.views.scene, "scene folder")->required();
    app->add_option("--only", raw->only, "cameras, masks or images")->check(CLI::IsMember({"cameras", "masks", "images"}));
    app->add_option("--write-cameras", raw->write_cameras, "where the poses fit when read in another way: write them so, as a cameras.json");
    app->add_option("--resolution", o.resolution, "of the hull that masks are compared with")->capture_default_str()->check(CLI::Range(32, 1024));
    add_scene_options(*app, o.views, o.mask);
    app->add_option("--up", o.views.up, "world up axis, where the camera file says none or another: x, y, z, -x, -y, -z")
        ->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}));
    app->add_option("--units", o.views.units, "length unit of the scene: m, cm, mm, km, inch, ft");
    app->footer(
        "Examples:\n"
        "  vdbcarve check shoot                                                     everything: images, cameras, masks, and whether they fit together\n"
        "  vdbcarve check shoot --only cameras                                      quickly: no picture is read\n"
        "  vdbcarve check shoot --cameras colmap --write-cameras fixed.json         other readings of poses that do not fit are tried\n"
        "Exit code: 0 nothing wrong, or warnings; 3 files that cannot be used; 4 cameras and masks contradict each other; 5 cameras that must not be trusted.");
    return {app,
            [raw](Common& common, Progress& progress) {
                CheckOptions& options = raw->options;
                options.views.allow_missing = options.mask.allow_missing;
                options.cameras = raw->only.empty() || raw->only == "cameras";
                options.masks = raw->only.empty() || raw->only == "masks";
                options.images = raw->only.empty() || raw->only == "images";
                progress.on_warning = nullptr;  // the findings have them
                const CheckResult result = check(options, progress);
                std::cout << (common.json == "-" ? check_json(result) + "\n" : check_text(result));
                if (!raw->write_cameras.empty()) {
                    if (!result.better) spdlog::warn("{} is not written: no other reading of the poses fits better", raw->write_cameras);
                    else {
                        std::error_code not_there;
                        if (std::filesystem::equivalent(raw->write_cameras, result.better->camera_file, not_there))
                            throw OutputError(raw->write_cameras +
                                              ": is the camera file that was checked, and would be replaced. Remedy: --write-cameras with another name");
                        write_cameras(*result.better, raw->write_cameras);
                        spdlog::info("{} holds the cameras in the reading that fits; --cameras {} goes on with them", raw->write_cameras, raw->write_cameras);
                    }
                }
                return static_cast<int>(result.exit_code);
            },
            Says::Document};
}

}  // namespace vdbcarve::cli
