// SPDX-License-Identifier: Apache-2.0
#include "pipeline/option_list.h"

namespace vdbcarve {

std::vector<OptionEntry> list_options(ReconstructOptions& options) { return list_of(options); }
std::vector<OptionEntry> list_options(WatchOptions& options) { return list_of(options); }
std::vector<OptionEntry> list_options(ViewsOptions& options) { return list_of(options); }
std::vector<OptionEntry> list_options(MaskOptions& options) { return list_of(options); }

std::vector<std::string> given_options(const ReconstructOptions& options) {
    ReconstructOptions given = options, meant;
    const std::vector<OptionEntry> now = list_of(given), by_default = list_of(meant);
    std::vector<std::string> out;
    for (size_t i = 0; i < now.size(); ++i)
        if (!now[i].alias && now[i].values() != by_default[i].values()) out.push_back(now[i].about.name);
    return out;
}

void apply_implied(MaskOptions& m) {
    const auto imply = [&](MaskMethod method, const std::string& option) {
        if (m.method != MaskMethod::Auto && m.method != method)
            throw UsageError(option + " beside another way to masks (--mask, --clean-plate, --mask-command): only one can count");
        m.method = method;
    };
    if (!m.plate.plate.empty()) imply(MaskMethod::CleanPlate, "--clean-plate");
    if (!m.command.empty()) imply(MaskMethod::Command, "--mask-command");
}

void apply_implied(ReconstructOptions& o) {
    apply_implied(o.mask);
    o.views.allow_missing = o.mask.allow_missing;
    o.align.units = o.views.units;
}

void change_options(ReconstructOptions& options, const std::vector<OptionChange>& changes) {
    std::vector<OptionEntry> entries = list_of(options);
    for (const OptionChange& c : changes)
        if (std::none_of(entries.begin(), entries.end(), [&](const OptionEntry& e) { return c.name == e.about.name; }))
            throw UsageError("--" + c.name + ": there is no such option");
    for (const OptionEntry& e : entries)
        for (const OptionChange& c : changes)
            if (c.name == e.about.name) e.set(c.values);
    apply_implied(options);
}

}  // namespace vdbcarve
