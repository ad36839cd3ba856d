// SPDX-License-Identifier: Apache-2.0
#include "pipeline/store.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <fstream>

#include "base/atomic_file.h"
#include "base/sha256.h"
#include "result/result_json.h"
#include "vdbcarve/error.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kNote = "note.json";
constexpr const char* kPart = ".part";

}  // namespace

fs::path Store::folder_of(const std::string& stage, const std::string& key) {
    const std::string name = stage + "-" + key.substr(0, 24);
    asked_for_.insert(name);
    return folder_ / name;
}

std::optional<Slot> Store::read(const fs::path& folder) {
    try {
        std::ifstream in(folder / kNote);
        if (!in) return std::nullopt;
        const json whole = json::parse(in);
        const json& said = whole.at("said");
        Sha256 hash;
        if (hash.add(dumped(said)).hex() != whole.at("sha256").get<std::string>()) return std::nullopt;
        Slot out;
        out.folder_ = out.final_ = folder;
        out.note = said.at("note");
        out.warnings = said.at("warnings").get<std::vector<std::string>>();
        for (const auto& [name, file] : said.at("files").items())
            out.payloads_.push_back({name, file.at("bytes").get<uintmax_t>(), file.at("sha256").get<std::string>()});
        return out;
    } catch (const json::exception&) {
        return std::nullopt;
    }
}

std::optional<Slot> Slot::beside(const std::string& name) const {
    auto other = Store::read(folder_.parent_path() / name);
    return other && other->holds(other->payloads_) ? std::move(other) : std::nullopt;
}

bool Slot::holds(const std::vector<Payload>& payloads) const {
    std::atomic<bool> whole{true};
    tbb::parallel_for(size_t{0}, payloads.size(), [&](size_t i) {
        std::error_code error;
        if (!whole || fs::file_size(file(payloads[i].name), error) != payloads[i].bytes || error) {
            whole = false;
            return;
        }
        try {
            if (sha256_of_file(file(payloads[i].name)) != payloads[i].sha256) whole = false;
        } catch (const InputError&) {
            whole = false;
        }
    });
    return whole;
}

bool Store::is_whole(const Slot& slot) const {
    const std::string name = slot.folder_.filename().string();
    if (whole_.count(name)) return true;
    if (!slot.holds(slot.payloads_)) return false;
    whole_.insert(name);
    return true;
}

bool Store::is_whole(const Slot& slot, const std::string& name) const {
    const auto found = std::find_if(slot.payloads_.begin(), slot.payloads_.end(), [&](const Slot::Payload& p) { return p.name == name; });
    return found != slot.payloads_.end() && slot.holds({*found});
}

std::optional<Slot> Store::find(const std::string& stage, const std::string& key) {
    auto slot = read(folder_of(stage, key));
    return slot && is_whole(*slot) ? std::move(slot) : std::nullopt;
}

Slot Store::begin(const std::string& stage, const std::string& key) {
    Slot slot;
    slot.final_ = folder_of(stage, key);
    slot.folder_ = folder_ / ("." + slot.final_.filename().string() + kPart);
    fs::remove_all(slot.folder_);
    make_folder(slot.folder_);
    return slot;
}

void Store::commit(Slot& slot) {
    std::vector<Slot::Payload>& payloads = slot.payloads_;
    payloads.clear();
    for (const auto& entry : fs::recursive_directory_iterator(slot.folder_))
        if (entry.is_regular_file()) payloads.push_back({fs::relative(entry.path(), slot.folder_).generic_string(), entry.file_size(), {}});
    tbb::parallel_for(size_t{0}, payloads.size(), [&](size_t i) { payloads[i].sha256 = sha256_of_file(slot.folder_ / payloads[i].name); });
    json files = json::object();
    for (const Slot::Payload& p : payloads) files[p.name] = {{"bytes", p.bytes}, {"sha256", p.sha256}};
    const json said{{"note", slot.note}, {"warnings", slot.warnings}, {"files", files}};
    Sha256 hash;
    write_file(slot.folder_ / kNote, dumped(json{{"said", said}, {"sha256", hash.add(dumped(said)).hex()}}, 1) + "\n");
    std::error_code error;
    fs::remove_all(slot.final_, error);
    if (!error) fs::rename(slot.folder_, slot.final_, error);
    if (error) throw OutputError(slot.final_.string() + ": cannot be put in place: " + error.message());
    slot.folder_ = slot.final_;
    whole_.insert(slot.final_.filename().string());
}

std::vector<Slot> Store::all(const std::string& stage) const {
    std::vector<Slot> out;
    std::error_code not_there;
    for (const auto& entry : fs::directory_iterator(folder_, not_there)) {
        if (entry.path().filename().string().rfind(stage + "-", 0) != 0) continue;
        if (auto slot = read(entry.path())) out.push_back(std::move(*slot));
    }
    std::sort(out.begin(), out.end(), [](const Slot& a, const Slot& b) { return a.folder_ < b.folder_; });
    return out;
}

void Store::forget_others(const std::set<std::string>& stages) const {
    std::vector<fs::path> old;
    for (const auto& entry : fs::directory_iterator(folder_)) {
        const std::string name = entry.path().filename().string();
        if (stages.count(name.substr(0, name.rfind('-'))) && !asked_for_.count(name)) old.push_back(entry.path());
    }
    for (const fs::path& path : old) fs::remove_all(path);
}

void Store::remove_unfinished() const {
    std::vector<fs::path> old;
    for (const auto& entry : fs::directory_iterator(folder_)) {
        const std::string name = entry.path().filename().string();
        if (entry.is_directory() && name[0] == '.' && name.ends_with(kPart)) old.push_back(entry.path());
    }
    for (const fs::path& path : old) fs::remove_all(path);
}

}  // namespace vdbcarve::pipeline
