// SPDX-License-Identifier: Apache-2.0
// OUT/stages: what finished stages made, a folder each, so that nothing is made twice and nothing damaged is taken for good.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace vdbcarve::pipeline {

/// One stage's folder: payload files, and a note of what else the stage has to say.
class Slot {
  public:
    const std::filesystem::path& folder() const { return folder_; }
    std::filesystem::path file(const std::string& name) const { return folder_ / name; }
    /// Where a file that is being written will lie once the stage is finished.
    std::filesystem::path later(const std::string& name) const { return final_ / name; }
    bool has(const std::string& name) const { return std::filesystem::exists(file(name)); }
    /// Another finished stage's folder by its name; none where it is not there or anything of it is damaged. Cost: reading its payloads.
    std::optional<Slot> beside(const std::string& name) const;

    nlohmann::json note = nlohmann::json::object();
    std::vector<std::string> warnings;

  private:
    friend class Store;
    struct Payload {
        std::string name;  ///< in the folder, with '/'
        uintmax_t bytes = 0;
        std::string sha256;
    };
    /// All of these payloads are there and are what the note says of them.
    bool holds(const std::vector<Payload>& payloads) const;

    std::filesystem::path folder_, final_;
    std::vector<Payload> payloads_;  ///< of a finished stage
};

class Store {
  public:
    explicit Store(std::filesystem::path folder) : folder_(std::move(folder)) {}
    const std::filesystem::path& folder() const { return folder_; }

    /// A finished stage. None where it is not there or anything of it is damaged: every payload's size and SHA-256 stand in its note, the note's own beside it.
    /// Cost: reading the payloads, once in a run.
    std::optional<Slot> find(const std::string& stage, const std::string& key);
    /// A new folder to be filled; it counts for nothing before commit().
    Slot begin(const std::string& stage, const std::string& key);
    /// Hashes the payloads, writes the note and renames the folder into place.
    void commit(Slot& slot);

    /// Notes of all finished stages of that name, of any run, sorted by folder; payloads are not looked at: is_whole() does.
    std::vector<Slot> all(const std::string& stage) const;
    bool is_whole(const Slot& slot) const;
    /// The same of one payload.
    bool is_whole(const Slot& slot, const std::string& name) const;

    /// Removes what earlier runs made of these stages and this run did not ask for.
    void forget_others(const std::set<std::string>& stages) const;
    /// Removes the folders of stages that were not finished.
    void remove_unfinished() const;

  private:
    friend class Slot;
    std::filesystem::path folder_of(const std::string& stage, const std::string& key);
    /// What the note in a finished stage's folder says; none where it is missing or damaged.
    static std::optional<Slot> read(const std::filesystem::path& folder);

    std::filesystem::path folder_;
    std::set<std::string> asked_for_;
    mutable std::set<std::string> whole_;  ///< folders whose payloads were looked at in this run
};

}  // namespace vdbcarve::pipeline
