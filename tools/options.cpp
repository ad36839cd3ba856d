// SPDX-License-Identifier: Apache-2.0
// The options that structs describe (vdbcarve/visit.h) as options of the command line, and configuration files.
#include <algorithm>
#include <iterator>

#include "cli.h"

namespace vdbcarve::cli {
namespace {

/// Headings of --help, in this order.
size_t place_of(const std::string& group) {
    static const std::vector<std::string> order{"Options", "Scene",  "Masks",  kAlignGroup, "Grid",   "Carving",
                                                "Watch",   "Result", "Colour", "Stereo",    "Filter", "Mesh"};
    return static_cast<size_t>(std::find(order.begin(), order.end(), group) - order.begin());
}

void add_option(CLI::App& app, const OptionEntry& e, bool hidden, const OptionSetter& set) {
    const std::string name = "--" + std::string(e.about.name);
    const bool live = app.get_name() == "watch" && e.about.help_of_watch;
    const std::string help = live ? e.about.help_of_watch : e.about.help;
    const auto take = [e, set](const std::vector<std::string>& values) {
        if (set) set(e, values);
        else e.set(values);
    };
    CLI::Option* option = nullptr;
    if (e.shape == OptionEntry::Shape::Flag) {
        option = app.add_flag_function(
            name, [take](int64_t count) { take({count > 0 ? "true" : "false"}); }, help);
    } else if (e.shape == OptionEntry::Shape::Many) {
        option = app.add_option_function<std::vector<std::string>>(name, take, help);
        if (e.comma_separated) option->delimiter(',');
        else option->allow_extra_args(false);
    } else {
        option = app.add_option_function<std::string>(
            name, [take](const std::string& text) { take({text}); }, help);
    }
    if (e.shape != OptionEntry::Shape::Flag) {
        const bool has_limits = (e.value_name == "INT" || e.value_name == "UINT" || e.value_name == "FLOAT") && e.limits != "a finite number";
        option->type_name(e.value_name + (has_limits ? ":" + e.limits : ""));
        std::string value;
        for (const std::string& v : e.values()) value += (value.empty() ? "" : ",") + v;
        if (e.says_default) option->default_str(e.shape == OptionEntry::Shape::Many ? "[" + value + "]" : value);
    }
    option->group(hidden || e.is_hidden() ? "" : e.about.group);
}

/// Reads what parse_config() reads, and refuses what the program has no option for.
class ConfigReader : public CLI::Config {
  public:
    explicit ConfigReader(const CLI::App& program) : program_(program) {}

    std::string to_config(const CLI::App*, bool, bool, std::string) const override { return ""; }  // results write theirs: config_text()

    std::vector<CLI::ConfigItem> from_config(std::istream& in) const override {
        const std::string text((std::istreambuf_iterator<char>(in)), {});
        const auto file = program_.get_config_ptr()->as<std::string>();
        std::vector<CLI::ConfigItem> out;
        for (const ConfigLine& line : parse_config(text, file)) {
            CLI::ConfigItem item;
            item.parents.assign(line.path.begin(), line.path.end() - 1);
            item.name = line.path.back();
            item.inputs = line.values;
            if (!is_known(item)) throw UsageError(file + ", line " + std::to_string(line.line) + ": unknown option " + item.fullname());
            out.push_back(std::move(item));
        }
        return out;
    }

  private:
    bool is_known(const CLI::ConfigItem& item) const {
        const CLI::App* app = &program_;
        for (const std::string& parent : item.parents) {
            const auto commands = app->get_subcommands([&](const CLI::App* c) { return c->get_name() == parent; });
            if (commands.empty()) return false;
            app = commands.front();
        }
        return app->get_option_no_throw("--" + item.name) || app->get_option_no_throw(item.name);
    }
    const CLI::App& program_;
};

}  // namespace

void add_options(CLI::App& app, const std::vector<OptionEntry>& entries, unsigned command, bool hidden, const OptionSetter& set) {
    std::vector<OptionEntry> offered;
    for (const OptionEntry& e : entries)
        if ((e.about.commands & command) && std::string(e.about.name) != "scene" && std::string(e.about.name) != "output") offered.push_back(e);
    std::stable_sort(offered.begin(), offered.end(), [](const auto& a, const auto& b) { return place_of(a.about.group) < place_of(b.about.group); });
    for (const OptionEntry& e : offered) add_option(app, e, hidden, set);
}

std::string help_of(const std::string& name) {
    ReconstructOptions options;
    for (const OptionEntry& e : list_options(options))
        if (name == e.about.name) return e.about.help;
    return "";
}

void add_scene_options(CLI::App& command, ViewsOptions& views, MaskOptions& mask) {
    std::vector<OptionEntry> entries = list_options(views);
    for (OptionEntry& e : list_options(mask)) entries.push_back(std::move(e));
    add_options(command, entries, in::kCheck);
}

std::shared_ptr<CLI::Config> config_reader(const CLI::App& program) { return std::make_shared<ConfigReader>(program); }

}  // namespace vdbcarve::cli
