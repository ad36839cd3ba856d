// SPDX-License-Identifier: Apache-2.0
// OUT: whose it is, who works in it, and how a set of final files takes the place of an earlier one.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace vdbcarve::pipeline {

inline constexpr const char* kUnverified = "unverified";  ///< folder in OUT for cameras that align() does not stand behind

/// Whoever writes into OUT holds this for as long. A lock of the file system (an open file description's: it works between machines and ends with its
/// process), so that readers need none and a killed run leaves none behind.
class OutLock {
  public:
    OutLock() = default;
    /// Throws OutputError where another run holds it, saying which.
    explicit OutLock(const std::filesystem::path& output);
    ~OutLock();
    OutLock(OutLock&& other) noexcept;
    OutLock& operator=(OutLock&& other) noexcept;

    static std::filesystem::path file_in(const std::filesystem::path& output) { return output / "stages" / "lock"; }

  private:
    int file_ = -1;
};

/// Final files of a run. They are made whole in a folder beside the old ones; commit() then takes report.json away, renames them into place and puts
/// report.json back last. So a full disk or a kill leaves the old set, or a folder without report.json that every command calls unfinished and the next run
/// mends.
class ResultSet {
  public:
    /// `place`: OUT, or a folder in it. What an earlier run left unfinished goes.
    ResultSet(const std::filesystem::path& output, std::filesystem::path place);
    ~ResultSet();
    ResultSet(const ResultSet&) = delete;
    ResultSet& operator=(const ResultSet&) = delete;

    const std::filesystem::path& place() const { return place_; }
    /// Where to write a file of the set; its folder is there. Files are put into place in the order in which they were asked for.
    std::filesystem::path make(const std::filesystem::path& name);
    /// A copy of a stage's file becomes one of the set.
    void copy(const std::filesystem::path& source, const std::filesystem::path& name);
    /// A file (or folder) of an earlier run, relative to the place, that would not fit this set: it goes when the set appears.
    void remove(const std::filesystem::path& name);
    /// Where make() put a file, to be read before it is in place.
    std::filesystem::path made(const std::filesystem::path& name) const { return part_ / name; }
    /// Throws OutputError.
    void commit();

  private:
    std::filesystem::path part_, place_;
    std::vector<std::filesystem::path> files_, gone_;
};

}  // namespace vdbcarve::pipeline
