// SPDX-License-Identifier: Apache-2.0
// All options of reconstruct() by their names: as text, checked, and as the configuration file of a result.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "vdbcarve/pipeline.h"
#include "vdbcarve/visit.h"
#include "vdbcarve/app/watch.h"

namespace vdbcarve {

/// One option of a struct, its type forgotten: its value is text. It refers to the struct that it was listed from.
struct OptionEntry {
    enum class Shape {
        Flag,  ///< "true" where it is given
        One,
        Many
    };
    Option about;
    Shape shape = Shape::One;
    bool in_key = true;            ///< changes the result
    bool alias = false;            ///< another spelling of members that are listed by themselves
    bool comma_separated = false;  ///< Many
    bool quoted = true;            ///< a string in a configuration file also where it looks like a number
    std::string value_name;        ///< INT, UINT, FLOAT, WORD, TEXT …
    std::string limits;            ///< "0..15"; empty: none that are worth saying
    bool says_default = false;     ///< its default means something to a reader

    std::function<std::vector<std::string>()> values;          ///< as text that set() takes; none: not set
    std::function<void(const std::vector<std::string>&)> set;  ///< Throws UsageError
    std::function<std::string()> fault;                        ///< what is wrong with its value; empty: nothing

    bool is_hidden() const { return *about.help == '\0'; }
};

/// In the order in which they depend on each other: later ones may be set by what earlier ones are.
std::vector<OptionEntry> list_options(ReconstructOptions& options);
std::vector<OptionEntry> list_options(WatchOptions& options);  ///< without those of reconstruct
std::vector<OptionEntry> list_options(ViewsOptions& options);
std::vector<OptionEntry> list_options(MaskOptions& options);

/// Names of the options whose values are not the defaults.
std::vector<std::string> given_options(const ReconstructOptions& options);

/// Throws UsageError that names everything that is wrong: values out of their ranges, and options that do not go together.
void check_options(const ReconstructOptions& options);

/// One option and its new values, as text.
struct OptionChange {
    std::string name;  ///< without dashes
    std::vector<std::string> values;
};

/// Sets options by name, and what they imply: --clean-plate says --mask clean-plate. Throws UsageError.
void change_options(ReconstructOptions& options, const std::vector<OptionChange>& changes);
/// The last step of that.
void apply_implied(ReconstructOptions& options);
void apply_implied(MaskOptions& options);

/// A line of a configuration file.
struct ConfigLine {
    std::vector<std::string> path;  ///< {"reconstruct", "scene"}
    std::vector<std::string> values;
    bool is_list = false;
    int line = 0;
};

/// Reads the part of TOML that configurations are written in: `key = value` with dotted keys, [sections], strings "…" and '…', numbers, booleans, arrays and
/// comments. Throws UsageError with `file` and the number of the line for everything else.
std::vector<ConfigLine> parse_config(const std::string& text, const std::string& file);

/// TOML: everything that repeats the run with `vdbcarve --config FILE COMMAND`, defaults included.
std::string config_text(const ReconstructOptions& options);
/// The command that runs these options: reconstruct, or mask, align, carve where they end earlier.
std::string command_of(const ReconstructOptions& options);

/// The options of `command` in a configuration file, also in one that version 0.1 wrote. Throws UsageError.
ReconstructOptions read_config(const std::string& text, const std::string& file, const std::string& command = "reconstruct");

/// Runs a result again with some options changed; stages that they do not change are taken from the result. The result's config.toml says what it was made
/// with; paths in it are relative to the folder that reconstruct ran in. Throws InputError where `output` is not a result of reconstruct, and what
/// reconstruct() throws.
Reconstruction redo(const std::filesystem::path& output, const std::function<void(ReconstructOptions&)>& change, Progress& progress);

}  // namespace vdbcarve
