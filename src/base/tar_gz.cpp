// SPDX-License-Identifier: Apache-2.0
#include "base/tar_gz.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>

#include "base/atomic_file.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

void TarGz::add(const std::string& name_in_root, std::string_view content) {
    const std::string name = root_ + "/" + name_in_root;
    struct Header {
        char name[100], mode[8], uid[8], gid[8], size[12], mtime[12], checksum[8], type, link[100], magic[6], version[2], user[32], group[32], major[8],
            minor[8], prefix[155], rest[12];
    } h{};
    static_assert(sizeof h == 512);
    // A long name's folders go into a field of their own.
    const size_t cut = name.size() <= sizeof h.name ? std::string::npos : name.rfind('/');
    const std::string folders = cut == std::string::npos ? "" : name.substr(0, cut), last = cut == std::string::npos ? name : name.substr(cut + 1);
    if (last.size() > sizeof h.name || folders.size() > sizeof h.prefix)
        throw OutputError(name + ": too long a name for an archive. Remedy: a shorter one for the photograph, also in its camera file");
    if (content.size() >= size_t{1} << 33) throw OutputError(name + ": too large for an archive");
    std::memcpy(h.name, last.data(), last.size());
    std::memcpy(h.prefix, folders.data(), folders.size());
    std::snprintf(h.mode, sizeof h.mode, "%07o", 0644);
    std::snprintf(h.uid, sizeof h.uid, "%07o", 0);
    std::snprintf(h.gid, sizeof h.gid, "%07o", 0);
    std::snprintf(h.size, sizeof h.size, "%011llo", static_cast<unsigned long long>(content.size()));
    std::snprintf(h.mtime, sizeof h.mtime, "%011o", 0);
    h.type = '0';
    std::memcpy(h.magic, "ustar", 6);
    std::memcpy(h.version, "00", 2);
    std::memset(h.checksum, ' ', sizeof h.checksum);  // as which it is summed
    unsigned sum = 0;
    std::array<unsigned char, sizeof h> bytes{};
    std::memcpy(bytes.data(), &h, sizeof h);
    for (const unsigned char b : bytes) sum += b;
    std::snprintf(h.checksum, sizeof h.checksum, "%06o", sum);
    tar_.append(reinterpret_cast<const char*>(&h), sizeof h);
    tar_.append(content);
    tar_.append((512 - content.size() % 512) % 512, '\0');
}

size_t TarGz::write(const std::filesystem::path& file) const {
    const std::string whole = tar_ + std::string(1024, '\0');
    z_stream z{};
    if (deflateInit2(&z, Z_BEST_COMPRESSION, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY) != Z_OK)
        throw OutputError(file.string() + ": zlib could not be set up");
    std::string packed(deflateBound(&z, static_cast<uLong>(whole.size())) + 64, '\0');
    // Counts of zlib are 32 bits wide.
    size_t from = 0, to = 0;
    int state = Z_OK;
    while (state == Z_OK) {
        const size_t in = std::min<size_t>(whole.size() - from, 1U << 30), room = std::min<size_t>(packed.size() - to, 1U << 30);
        z.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(whole.data() + from));  // zlib reads it only
        z.avail_in = static_cast<uInt>(in);
        z.next_out = reinterpret_cast<Bytef*>(packed.data() + to);
        z.avail_out = static_cast<uInt>(room);
        state = deflate(&z, from + in == whole.size() ? Z_FINISH : Z_NO_FLUSH);
        from += in - z.avail_in;
        to += room - z.avail_out;
    }
    deflateEnd(&z);
    if (state != Z_STREAM_END) throw OutputError(file.string() + ": could not be compressed");
    write_file(file, packed.data(), to);
    return to;
}

}  // namespace vdbcarve
