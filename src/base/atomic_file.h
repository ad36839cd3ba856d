// SPDX-License-Identifier: Apache-2.0
// Files that appear whole or not at all, and reading them whole. Private.
#pragma once

#include <filesystem>
#include <fstream>
#include <ostream>
#include <string>

namespace vdbcarve {

/// A file's buffer that remembers why the first write failed; a stream only says that one did.
class WriteBuffer : public std::filebuf {
  public:
    int error() const { return error_; }  ///< an errno; 0: none is known

  protected:
    int_type overflow(int_type c) override;
    std::streamsize xsputn(const char* text, std::streamsize count) override;
    int sync() override;

  private:
    int error_ = 0;
};

/// Writes to a temporary name in the same folder; commit() renames it into place, and without that the
/// destructor removes it. Throws OutputError naming the file and what the system said.
class AtomicFile {
  public:
    explicit AtomicFile(std::filesystem::path file);
    ~AtomicFile();
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;

    std::ostream& stream() { return out_; }
    const std::filesystem::path& temporary() const { return temporary_; }
    /// Closes the stream and checks that everything reached the file.
    void close();
    /// Closes the stream if it is open, checks it, waits until the disk has the file's content, and renames.
    void commit();

  private:
    std::filesystem::path file_, temporary_;
    WriteBuffer buffer_;
    std::ostream out_{&buffer_};
    bool done_ = false;
};

/// Removes from a folder (not from those in it) the temporary files of AtomicFile's whose processes are no more on this machine.
void remove_left_overs(const std::filesystem::path& folder);

/// All of a file. Throws InputError where it cannot be read.
std::string read_file(const std::filesystem::path& file);

void write_file(const std::filesystem::path& file, const std::string& content);
void write_file(const std::filesystem::path& file, const void* data, size_t bytes);

/// Makes the folder and its parents. Throws OutputError.
void make_folder(const std::filesystem::path& folder);

/// `target` becomes a copy of `source`; by rename.
void place_copy(const std::filesystem::path& source, const std::filesystem::path& target);

}  // namespace vdbcarve
