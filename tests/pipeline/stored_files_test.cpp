// SPDX-License-Identifier: Apache-2.0
// Files of OUT and OUT/stages after power cuts, full disks and damage.
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <nlohmann/json.hpp>

#include "base/atomic_file.h"
#include "pipeline/known_hull.h"
#include "pipeline/mesh_store.h"
#include "support/scenes.h"

namespace {

int fsync_calls = 0, fsync_error = 0;

}  // namespace

/// In the library's place: counts, and fails where a test wants it to.
extern "C" int fsync(int descriptor) {
    ++fsync_calls;
    if (fsync_error == 0) return static_cast<int>(::syscall(SYS_fsync, descriptor));
    errno = fsync_error;
    return -1;
}

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using namespace pipeline;

size_t entries(const fs::path& folder) { return static_cast<size_t>(std::distance(fs::directory_iterator(folder), {})); }

TEST(StoredFiles, ContentIsOnTheDiskBeforeTheName) {
    TemporaryFolder folder;
    fsync_calls = 0;
    write_file(folder / "a.txt", "old");
    EXPECT_EQ(fsync_calls, 1);
    place_copy(folder / "a.txt", folder / "b.txt");
    EXPECT_EQ(fsync_calls, 2);
    { AtomicFile given_up(folder / "c.txt"); }
    EXPECT_EQ(fsync_calls, 2);
    // What the disk says at the last moment: the old file stays, nothing else is left.
    for (const int error : {ENOSPC, EIO}) {
        fsync_error = error;
        const std::string message = error_of(ExitCode::Output, [&] { write_file(folder / "a.txt", "new"); });
        fsync_error = 0;
        EXPECT_NE(message.find("a.txt"), std::string::npos);
        EXPECT_NE(message.find(std::strerror(error)), std::string::npos) << message;
        EXPECT_EQ(read_text(folder / "a.txt"), "old");
        EXPECT_EQ(entries(folder.path()), 2u);
    }
    fsync_error = EINVAL;  // a file system that has nothing to wait for
    write_file(folder / "a.txt", "new");
    fsync_error = 0;
    EXPECT_EQ(read_text(folder / "a.txt"), "new");
}

TEST(StoredFiles, AFullDiskIsNamedAsSuch) {
    TemporaryFolder folder;
    write_file(folder / "a.txt", "old");
    // The limit of a file's size stands in for a full disk: write() fails in the middle of the file.
    rlimit before{};
    ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    for (const size_t bytes : {size_t{5000}, size_t{50'000'000}}) {
        const std::string content(bytes, 'x');
        rlimit small = before;
        small.rlim_cur = 4096;
        ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
        std::string whole, many;
        try {
            write_file(folder / "a.txt", content);
        } catch (const OutputError& e) {
            whole = e.what();
        }
        try {
            AtomicFile file(folder / "a.txt");
            for (size_t n = 0; n < bytes / 50; ++n) file.stream() << "0123456789012345678901234567890123456789012345678\n";
            file.commit();
        } catch (const OutputError& e) {
            many = e.what();
        }
        ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
        for (const std::string& message : {whole, many}) {
            EXPECT_NE(message.find("a.txt"), std::string::npos);
            EXPECT_NE(message.find(std::strerror(EFBIG)), std::string::npos) << message;
        }
        EXPECT_EQ(read_text(folder / "a.txt"), "old");
        EXPECT_EQ(entries(folder.path()), 1u);
    }
    std::signal(SIGXFSZ, handler);
    EXPECT_NE(error_of(ExitCode::Output, [&] { write_file(folder / "nowhere/a.txt", "x"); }).find(std::strerror(ENOENT)), std::string::npos);
}

TEST(StoredFiles, ADamagedMeshCountsAsNone) {
    TemporaryFolder folder;
    const fs::path file = folder / "mesh.bin";
    Mesh mesh;
    mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    mesh.colors = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
    mesh.quads = 1;
    store_mesh(file, mesh);
    const auto good = stored_mesh(file);
    ASSERT_TRUE(good);
    EXPECT_EQ(good->triangles, mesh.triangles);
    EXPECT_EQ(good->colors, mesh.colors);
    EXPECT_EQ(good->quads, 1u);
    const std::string bytes = read_text(file);
    constexpr size_t kHeader = 48, kVertices = 4, kFirstTriangle = kHeader + 12 * kVertices;
    const auto put = [&](size_t at, auto value) {
        std::string damaged = bytes;
        std::memcpy(damaged.data() + at, &value, sizeof value);
        write_text(file, damaged);
        return stored_mesh(file).has_value();
    };
    // Vertex numbers beyond the vertices.
    for (const uint32_t vertex : {uint32_t{4}, uint32_t{0x7fffffff}, uint32_t{0xffffffff}})
        for (size_t k = 0; k < 6; ++k) EXPECT_FALSE(put(kFirstTriangle + 4 * k, vertex)) << vertex;
    EXPECT_TRUE(put(kFirstTriangle, uint32_t{3}));
    // Counts (vertices, triangles, normals, colours) that do not fit, or whose sum, times 12, wraps to the file's size.
    for (size_t field = 1; field <= 4; ++field)
        for (const uint64_t count : {uint64_t{1}, uint64_t{3}, uint64_t{5}, uint64_t{1} << 62, uint64_t{1} << 63, ~uint64_t{0}})
            EXPECT_FALSE(put(8 * field, count)) << field << " " << count;
    // 12 * 2^62 is 0 modulo 2^64.
    for (const size_t field : {size_t{3}, size_t{4}}) EXPECT_FALSE(put(8 * field, (uint64_t{1} << 62) + (field == 4 ? kVertices : 0)));
    EXPECT_FALSE(put(40, uint64_t{2}));  // quads
    EXPECT_FALSE(put(0, uint64_t{1}));   // not ours
    for (const size_t size : {size_t{0}, size_t{20}, kHeader, bytes.size() - 1}) {
        write_text(file, bytes.substr(0, size));
        EXPECT_FALSE(stored_mesh(file)) << size;
    }
    write_text(file, bytes + "x");
    EXPECT_FALSE(stored_mesh(file));
    write_text(file, std::string(bytes.size(), '\0'));  // what a power cut leaves
    EXPECT_FALSE(stored_mesh(file));
}

TEST(StoredFiles, KnownHullsThatAreDamagedOrOfAnotherKindCountForNothing) {
    TemporaryFolder folder;
    Store store(folder.path());
    const auto keep = [&](const std::string& key, const json& note) {
        Slot slot = store.begin("carve", key);
        write_text(slot.file("hull.vdb"), "a hull");
        slot.note = note;
        store.commit(slot);
        return slot.file("hull.vdb");
    };
    const json none = json::array();
    const fs::path good = keep("good", {{"base", "b"}, {"views", {"1", "2"}}, {"bricks", none}});
    const fs::path larger = keep("larger", {{"base", "b"}, {"views", {"1", "2", "3"}}, {"bricks", none}});
    keep("bricks", {{"base", "b"}, {"views", {"1", "2", "3"}}, {"bricks", {"brick-1"}}});
    keep("other", {{"base", "a"}, {"views", {"1", "2", "3"}}, {"bricks", none}});
    for (const json& wrong :
         {json{{"base", 7}}, json{{"base", "b"}}, json{{"base", "b"}, {"bricks", none}}, json{{"base", "b"}, {"bricks", none}, {"views", 3}},
          json{{"base", "b"}, {"bricks", 4}, {"views", none}}, json{{"base", "b"}, {"bricks", none}, {"views", {1, 2}}}, json::array(), json()})
        keep("wrong" + std::to_string(entries(folder.path())), wrong);
    EXPECT_EQ(find_known_hull(store, "b", {"2", "1", "3"})->file, larger);
    write_text(larger, "A hull");  // of the same length
    const auto found = find_known_hull(Store(folder.path()), "b", {"2", "1", "3"});
    ASSERT_TRUE(found);
    EXPECT_EQ(found->file, good);
    EXPECT_EQ(found->views, (std::vector<size_t>{0, 1}));
    EXPECT_FALSE(find_known_hull(Store(folder / "nowhere"), "b", {"1"}));
}

}  // namespace
}  // namespace vdbcarve::test
