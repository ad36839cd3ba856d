// SPDX-License-Identifier: Apache-2.0
#include <iostream>
#include <memory>

#include <nlohmann/json.hpp>

#include "cli.h"
#include "vdbcarve/info.h"

namespace vdbcarve::cli {

Command add_info(CLI::App& program) {
    auto file = std::make_shared<std::string>();
    CLI::App* app = program.add_subcommand("info", "grids, cameras and meshes in words");
    app->fallthrough();
    app->add_option("file", *file, ".vdb, .nvdb, .ply, .obj, .stl, a camera file, a scene or a result")->required();
    app->footer(
        "Examples:\n"
        "  vdbcarve info out                                                        a result: volume, mesh and cameras\n"
        "  vdbcarve info shoot                                                      a scene's cameras\n"
        "  vdbcarve --json - info out/volume.vdb                                    for programs");
    return {app,
            [file](Common& common, Progress& progress) {
                const std::string text = info_json(*file, progress);
                if (common.json == "-") {
                    std::cout << text << "\n";
                } else {
                    // The document as indented "key: value" lines.
                    const auto j = nlohmann::ordered_json::parse(text);
                    const std::function<void(const nlohmann::ordered_json&, int)> print = [&](const nlohmann::ordered_json& node, int depth) {
                        for (auto it = node.begin(); it != node.end(); ++it) {
                            std::cout << std::string(static_cast<size_t>(2 * depth), ' ');
                            if (node.is_object()) std::cout << it.key() << ": ";
                            else std::cout << "- ";
                            const bool nested = it->is_object() || (it->is_array() && !it->empty() && it->front().is_structured());
                            if (nested) {
                                std::cout << "\n";
                                print(*it, depth + 1);
                            } else {
                                std::cout << (it->is_string() ? it->get<std::string>() : it->dump()) << "\n";
                            }
                        }
                    };
                    print(j, 0);
                }
                return 0;
            },
            Says::Document};
}

}  // namespace vdbcarve::cli
