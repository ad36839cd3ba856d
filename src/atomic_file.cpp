// SPDX-License-Identifier: Apache-2.0
#include "atomic_file.h"

#include <unistd.h>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

AtomicFile::AtomicFile(fs::path file) : file_(std::move(file)) {
    temporary_ = file_.parent_path() / ("." + file_.filename().string() + ".part" + std::to_string(getpid()));
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
