// SPDX-License-Identifier: Apache-2.0
// Masks from photographs: what the methods of mask.h need from all photographs together, and a program that somebody else wrote. Private.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "vdbcarve/mask.h"

namespace vdbcarve {

/// The colour that most of the photographs' borders have, in what makes colours differ whatever their brightness; and the level that splits all
/// photographs best. `options` has them afterwards where it had not. Throws InputError where the borders have no colour.
void find_chroma_key(const std::vector<std::filesystem::path>& photos, ChromaOptions& options);

/// "tool --fast {in} {out}" as words, quotes removed as a shell would; {in} and {out} stay. Throws UsageError where one of them is missing.
std::vector<std::string> words_of_command(const std::string& command);

/// Runs the command on a photograph and reads the mask that it wrote: grey, or the alpha of a cut-out. Throws InputError naming photograph, command
/// and what it said. Not cached.
Image8 mask_by_command(const std::vector<std::string>& words, const std::filesystem::path& photo, const std::filesystem::path& scratch, Progress& progress);

}  // namespace vdbcarve
