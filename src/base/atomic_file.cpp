// SPDX-License-Identifier: Apache-2.0
#include "base/atomic_file.h"

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <vector>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {
constexpr const char* kPart = ".vdbcarve.part";  ///< before the process's number

/// What the system said, to end a sentence with.
std::string said(int error) { return error != 0 ? ": " + std::generic_category().message(error) : std::string(); }

/// A rename may reach the disk before what was written to the file: after a power cut the name would then be that of an empty file, or of one full of zeros,
/// where the old file was. Also the last place where a full disk or a quota may be said.
void sync_to_disk(const fs::path& temporary, const fs::path& file) {
    const auto failed = [&](int error) { throw OutputError(file.string() + ": writing failed" + said(error)); };
    const int descriptor = ::open(temporary.c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) failed(errno);
    int error = 0;
    while (::fsync(descriptor) != 0 && (error = errno) == EINTR) error = 0;
    if (::close(descriptor) != 0 && error == 0 && errno != EINTR) error = errno;
    // Some file systems have nothing to wait for.
    if (error != 0 && error != EINVAL && error != ENOSYS && error != ENOTSUP) failed(error);
}
}  // namespace

WriteBuffer::int_type WriteBuffer::overflow(int_type c) {
    errno = 0;
    const int_type out = std::filebuf::overflow(c);
    if (traits_type::eq_int_type(out, traits_type::eof()) && error_ == 0) error_ = errno;
    return out;
}

std::streamsize WriteBuffer::xsputn(const char* text, std::streamsize count) {
    errno = 0;
    const std::streamsize written = std::filebuf::xsputn(text, count);
    if (written != count && error_ == 0) error_ = errno;
    return written;
}

int WriteBuffer::sync() {
    errno = 0;
    const int out = std::filebuf::sync();
    if (out != 0 && error_ == 0) error_ = errno;
    return out;
}

AtomicFile::AtomicFile(fs::path file) : file_(std::move(file)) {
    temporary_ = file_.parent_path() / ("." + file_.filename().string() + kPart + std::to_string(getpid()));
    errno = 0;
    if (!buffer_.open(temporary_, std::ios::out | std::ios::binary | std::ios::trunc))
        throw OutputError(file_.string() + ": cannot be written (is the folder there, writable, and not full?)" + said(errno));
}

AtomicFile::~AtomicFile() {
    if (done_) return;
    buffer_.close();
    std::error_code ignored;
    fs::remove(temporary_, ignored);
}

void AtomicFile::close() {
    if (!buffer_.is_open()) return;
    out_.flush();
    errno = 0;
    if (!buffer_.close() || !out_) throw OutputError(file_.string() + ": writing failed" + said(buffer_.error() != 0 ? buffer_.error() : errno));
}

void AtomicFile::commit() {
    close();
    sync_to_disk(temporary_, file_);
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
