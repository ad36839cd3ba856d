// SPDX-License-Identifier: Apache-2.0
// What keeps output from replacing the user's files: file names made of names that nobody checked, and files that are read, never written. Private.
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace vdbcarve {

enum class Folders {
    Kept,    ///< ring1/0001.jpg stays ring1/0001.jpg
    Joined,  ///< ring1/0001.jpg becomes ring1_0001.jpg
};

/// File names within one folder, made of names that were read from a file and may hold anything. Every result is relative, stays inside that folder, and is
/// unique, also on file systems that ignore case (ASCII letters). A name that is all this already is returned as it is; of names that clash, one stays, one
/// that needed no change first, and the others get a number before the extension. The order of the names does not matter.
std::vector<std::string> output_names(const std::vector<std::string>& wanted, Folders folders);

/// Files that a command reads. Comparison is by the file itself (device and inode), so that links and other spellings of a path count.
class FilesRead {
  public:
    /// A file that is not there is ignored. Of a folder, the files directly in it are added.
    void add(const std::filesystem::path& file_or_folder);
    /// Throws OutputError where `target` exists and is one of them.
    void refuse(const std::filesystem::path& target) const;

  private:
    std::set<std::pair<uint64_t, uint64_t>> files_;
};

/// The same folder or file, links followed; also where it is not there yet and only the paths can be compared.
bool is_same_place(const std::filesystem::path& a, const std::filesystem::path& b);

}  // namespace vdbcarve
