// SPDX-License-Identifier: Apache-2.0
#include "pipeline/out_folder.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "base/atomic_file.h"
#include "result/result_json.h"
#include "vdbcarve/error.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/result.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;

namespace {

/// "process 4711 on that machine", for a message.
std::string ourselves() {
    char host[256] = "an unnamed machine";
    (void)gethostname(host, sizeof host - 1);
    return "process " + std::to_string(getpid()) + " on " + host;
}

/// Removes a folder when it is empty.
void remove_if_empty(const fs::path& folder) {
    std::error_code others_are_in_it;
    fs::remove(folder, others_are_in_it);
}

}  // namespace

OutLock::OutLock(const fs::path& output) {
    const fs::path path = file_in(output);
    for (;;) {
        file_ = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
        if (file_ < 0) throw OutputError(path.string() + ": cannot be written: " + std::strerror(errno));
        struct flock lock {};
        lock.l_type = F_WRLCK;
        lock.l_whence = SEEK_SET;
        if (fcntl(file_, F_OFD_SETLK, &lock) != 0) {
            const int why = errno;
            char who[300] = {};
            const ssize_t length = why == EAGAIN || why == EACCES ? pread(file_, who, sizeof who - 1, 0) : 0;
            close(std::exchange(file_, -1));
            if (why == EAGAIN || why == EACCES)
                throw OutputError(output.string() + ": another run is working in it" + (length > 0 ? " (" + std::string(who) + ")" : "") +
                                  ". Remedy: wait until it ends, or another -o");
            return;  // a file system without locks: as it was before there were any
        }
        // `clean` may have removed the file between open and lock: then the lock is on a file that nobody else will open.
        struct stat ours {
        }, there{};
        if (fstat(file_, &ours) == 0 && stat(path.c_str(), &there) == 0 && ours.st_ino == there.st_ino && ours.st_dev == there.st_dev) break;
        close(std::exchange(file_, -1));
    }
    const std::string who = ourselves();
    if (ftruncate(file_, 0) != 0 || pwrite(file_, who.data(), who.size(), 0) < 0) return;  // the words are for a message only
}

OutLock::~OutLock() {
    if (file_ >= 0) close(file_);
}
OutLock::OutLock(OutLock&& other) noexcept : file_(std::exchange(other.file_, -1)) {}
OutLock& OutLock::operator=(OutLock&& other) noexcept {
    std::swap(file_, other.file_);
    return *this;
}

ResultSet::ResultSet(const fs::path& output, fs::path place) : part_(output / "stages" / ".result.part"), place_(std::move(place)) {
    fs::remove_all(part_);
    make_folder(part_);
}

ResultSet::~ResultSet() {
    std::error_code ignored;
    fs::remove_all(part_, ignored);
}

fs::path ResultSet::make(const fs::path& name) {
    const fs::path file = part_ / name;
    make_folder(file.parent_path());
    if (std::find(files_.begin(), files_.end(), name) == files_.end()) files_.push_back(name);
    return file;
}

void ResultSet::copy(const fs::path& source, const fs::path& name) { place_copy(source, make(name)); }

void ResultSet::remove(const fs::path& name) { gone_.push_back(name); }

void ResultSet::commit() {
    const fs::path report = "report.json";
    std::error_code error;
    fs::remove(place_ / report, error);
    if (error) throw OutputError((place_ / report).string() + ": cannot be replaced: " + error.message());
    for (const fs::path& name : gone_) {
        fs::remove_all(place_ / name, error);
        if (error) throw OutputError((place_ / name).string() + ": cannot be removed: " + error.message());
        for (fs::path folder = name.parent_path(); !folder.empty(); folder = folder.parent_path()) remove_if_empty(place_ / folder);
    }
    std::stable_partition(files_.begin(), files_.end(), [&](const fs::path& name) { return name != report; });
    for (const fs::path& name : files_) {
        if (!fs::exists(part_ / name)) continue;  // asked for, and not written after all
        make_folder((place_ / name).parent_path());
        fs::rename(part_ / name, place_ / name, error);
        if (error == std::errc::cross_device_link) {  // stages/ or this folder is a link to another disk
            place_copy(part_ / name, place_ / name);
            continue;
        }
        if (error) throw OutputError((place_ / name).string() + ": cannot be put in place: " + error.message());
    }
    fs::remove_all(part_, error);
}

}  // namespace vdbcarve::pipeline

namespace vdbcarve {

namespace fs = std::filesystem;

size_t clean(const fs::path& output) {
    if (!fs::is_directory(output)) throw InputError(output.string() + ": no such folder");
    if (!made_by_us(output)) throw InputError(output.string() + ": was not made by vdbcarve");
    const pipeline::OutLock lock(output);
    const fs::path lock_file = pipeline::OutLock::file_in(output);
    size_t bytes = 0;
    for (const auto& entry : fs::directory_iterator(output / "stages")) {
        if (entry.path() == output / kMarker || entry.path() == lock_file) continue;
        for (const auto& file : entry.is_directory() ? fs::recursive_directory_iterator(entry.path()) : fs::recursive_directory_iterator())
            if (file.is_regular_file()) bytes += file.file_size();
        if (entry.is_regular_file()) bytes += entry.file_size();
        std::error_code error;
        fs::remove_all(entry.path(), error);
        if (error) throw OutputError(entry.path().string() + ": cannot be removed: " + error.message());
    }
    fs::remove(lock_file);  // whoever waits for it looks whether it is still the one that is there
    return bytes;
}

}  // namespace vdbcarve
