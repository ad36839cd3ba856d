// SPDX-License-Identifier: Apache-2.0
#include "base/atomic_file.h"

#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <vector>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {
constexpr const char* kPart = ".vdbcarve.part";  ///< before the process's number
}

AtomicFile::AtomicFile(fs::path file) : file_(std::move(file)) {
    temporary_ = file_.parent_path() / ("." + file_.filename().string() + kPart + std::to_string(getpid()));
    out_.open(temporary_, std::ios::binary | std::ios::trunc);
    if (!out_) throw OutputError(file_.string() + ": cannot be written (is the folder there, writable, and not full?)");
}

AtomicFile::~AtomicFile() {
    if (done_) return;
    out_.close();
    std::error_code ignored;
    fs::remove(temporary_, ignored);
}

void AtomicFile::close() {
    if (!out_.is_open()) return;
    out_.close();
    if (!out_) throw OutputError(file_.string() + ": writing failed (disk full?)");
}

void AtomicFile::commit() {
    close();
    std::error_code error;
    fs::rename(temporary_, file_, error);
    if (error) throw OutputError(file_.string() + ": cannot be put in place: " + error.message());
    done_ = true;
}

void remove_left_overs(const fs::path& folder) {
    std::vector<fs::path> old;
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(folder, ignored)) {
        const std::string name = entry.path().filename().string();
        const size_t at = name.rfind(kPart);
        if (name[0] != '.' || at == std::string::npos || !entry.is_regular_file(ignored)) continue;
        const std::string digits = name.substr(at + std::string(kPart).size());
        if (digits.empty() || digits.size() > 9 || digits.find_first_not_of("0123456789") != std::string::npos) continue;
        const pid_t maker = static_cast<pid_t>(std::stol(digits));
        if (maker != getpid() && kill(maker, 0) != 0 && errno == ESRCH) old.push_back(entry.path());
    }
    for (const fs::path& file : old) fs::remove(file, ignored);
}

std::string read_file(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    std::string out((std::istreambuf_iterator<char>(in)), {});
    if (!in.is_open() || in.bad()) throw InputError(file.string() + ": cannot be read");
    return out;
}

void write_file(const fs::path& file, const void* data, size_t bytes) {
    AtomicFile out(file);
    out.stream().write(static_cast<const char*>(data), static_cast<std::streamsize>(bytes));
    out.commit();
}

void write_file(const fs::path& file, const std::string& content) { write_file(file, content.data(), content.size()); }

void make_folder(const fs::path& folder) {
    std::error_code error;
    fs::create_directories(folder, error);
    if (error || !fs::is_directory(folder)) throw OutputError(folder.string() + ": the folder cannot be made: " + error.message());
}

void place_copy(const fs::path& source, const fs::path& target) {
    // A copy, not a link: whoever edits the final file in place must not reach the stage's own.
    AtomicFile out(target);
    out.close();
    std::error_code error;
    fs::copy_file(source, out.temporary(), fs::copy_options::overwrite_existing, error);
    if (error) throw OutputError(target.string() + ": cannot be written: " + error.message());
    out.commit();
}

}  // namespace vdbcarve
