// SPDX-License-Identifier: Apache-2.0
// Archives that every system opens: POSIX ustar (IEEE Std 1003.1, pax) in gzip. Private.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

namespace vdbcarve {

/// Collects files and writes them, with no date and no owner: the same files give the same bytes.
class TarGz {
  public:
    /// All files lie in the folder `root`.
    explicit TarGz(std::string root) : root_(std::move(root)) {}
    /// `name` with folders; at most 100 bytes, and 155 of folders with the root. Throws OutputError where it is longer.
    void add(const std::string& name, std::string_view content);
    /// By rename. Returns the archive's bytes. Throws OutputError.
    size_t write(const std::filesystem::path& file) const;

  private:
    std::string root_, tar_;
};

}  // namespace vdbcarve
