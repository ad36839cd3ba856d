// SPDX-License-Identifier: Apache-2.0
#include "base/output_names.h"

#include <sys/stat.h>

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

/// ASCII only: what other letters' capitals are depends on the file system.
std::string without_case(std::string text) {
    for (char& c : text)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return text;
}

/// Relative and inside its folder; not yet unique.
std::string inside_folder(std::string name, Folders folders) {
    for (char& c : name) {
        const auto byte = static_cast<unsigned char>(c);
        // A backslash is a separator elsewhere; control characters (a zero would end the name) are none of a file name's.
        if (c == '\\' || byte < 0x20 || byte == 0x7f || (c == '/' && folders == Folders::Joined)) c = '_';
    }
    std::string out;
    for (size_t at = 0; at <= name.size();) {
        const size_t end = std::min(name.find('/', at), name.size());
        const std::string part = name.substr(at, end - at);
        if (!part.empty() && part != "." && part != "..") out += (out.empty() ? "" : "/") + part;
        at = end + 1;
    }
    return out.empty() ? "view" : out;
}

/// Names given out so far. No name is a folder of another one either.
class Taken {
  public:
    bool take(const std::string& name) {
        const std::string key = without_case(name);
        if (files_.count(key) || folders_.count(key) || !folders_are_free(key)) return false;
        files_.insert(key);
        for (size_t at = key.find('/'); at != std::string::npos; at = key.find('/', at + 1)) folders_.insert(key.substr(0, at));
        return true;
    }
    /// With the first number that makes it unique.
    std::string take_numbered(std::string name) {
        if (!folders_are_free(without_case(name))) std::replace(name.begin(), name.end(), '/', '_');
        const fs::path path(name);
        size_t& number = numbers_.emplace(without_case(name), 2).first->second;
        for (;; ++number) {
            const std::string numbered = (path.parent_path() / (path.stem().string() + "_" + std::to_string(number) + path.extension().string())).string();
            if (take(numbered)) return numbered;
        }
    }

  private:
    bool folders_are_free(const std::string& key) const {
        for (size_t at = key.find('/'); at != std::string::npos; at = key.find('/', at + 1))
            if (files_.count(key.substr(0, at))) return false;
        return true;
    }
    std::set<std::string> files_, folders_;
    std::map<std::string, size_t> numbers_;
};

}  // namespace

std::vector<std::string> output_names(const std::vector<std::string>& wanted, Folders folders) {
    std::vector<std::string> out(wanted.size());
    std::vector<size_t> order(wanted.size());
    std::iota(order.begin(), order.end(), size_t{0});
    // A result's views are read again in another order, and must get the names that they had.
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return wanted[a] < wanted[b]; });
    std::vector<bool> done(wanted.size());
    Taken taken;
    // Names that need no change first: adding a view whose name becomes theirs must not rename what is there.
    for (const bool unchanged : {true, false})
        for (const size_t i : order) {
            out[i] = done[i] ? out[i] : inside_folder(wanted[i], folders);
            if (!done[i] && unchanged == (out[i] == wanted[i])) done[i] = taken.take(out[i]);
        }
    for (const size_t i : order)
        if (!done[i]) out[i] = taken.take_numbered(out[i]);
    return out;
}

namespace {

std::optional<std::pair<uint64_t, uint64_t>> identity_of(const fs::path& file) {
    struct stat s {};
    if (::stat(file.c_str(), &s) != 0) return std::nullopt;
    return std::pair<uint64_t, uint64_t>{s.st_dev, s.st_ino};
}

}  // namespace

void FilesRead::add(const fs::path& file_or_folder) {
    std::error_code error;
    if (fs::is_directory(file_or_folder, error)) {
        for (const auto& entry : fs::directory_iterator(file_or_folder, error))
            if (entry.is_regular_file(error)) add(entry.path());
    } else if (const auto identity = identity_of(file_or_folder)) {
        files_.insert(*identity);
    }
}

void FilesRead::refuse(const fs::path& target) const {
    if (const auto identity = identity_of(target); identity && files_.count(*identity))
        throw OutputError(target.string() + ": is an input file of this command, and would be replaced. Remedy: another output folder");
}

bool is_same_place(const fs::path& a, const fs::path& b) {
    std::error_code error;
    if (fs::equivalent(a, b, error)) return true;
    const auto whole = [](const fs::path& path) {
        std::error_code unreadable;
        const fs::path out = fs::weakly_canonical(fs::absolute(path, unreadable), unreadable);
        return out.has_filename() ? out : out.parent_path();  // without a slash at its end
    };
    return !whole(a).empty() && whole(a) == whole(b);
}

}  // namespace vdbcarve
