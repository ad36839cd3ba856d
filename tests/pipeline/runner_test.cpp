// SPDX-License-Identifier: Apache-2.0
// The one way in which stages are run, with a stage that only pretends; and what holds OUT together.
#include "pipeline/run.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "base/atomic_file.h"
#include "support/scenes.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using namespace pipeline;

struct Text {
    std::string key, words;
    fs::path file;
};

/// Writes a few words; counts how often it was run.
struct Pretend {
    static constexpr const char* kName = "pretend";
    using Result = Text;

    int value;
    int& runs;
    bool warns = false, fails = false, fails_to_save = false, idles = false;

    bool idle() const { return idles; }
    Text passed() const { return {"", "idle", {}}; }
    Key key() const { return Key(kName).of(value); }
    Text run(Run& run) {
        ++runs;
        if (warns) run.progress().warn("the value is " + std::to_string(value));
        if (fails) throw InputError("it fails");
        return {"", "words of " + std::to_string(value), {}};
    }
    void save(Slot& slot, Text& made) const {
        make_folder(slot.file("deep"));
        write_file(slot.file("deep/words.txt"), made.words);
        made.file = slot.later("deep/words.txt");
        slot.note = {{"length", made.words.size()}};
        if (fails_to_save) throw OutputError("the disk is full");
    }
    Text load(const Slot& slot) const {
        Text out{"", read_file(slot.file("deep/words.txt")), slot.file("deep/words.txt")};
        if (slot.note.at("length") != out.words.size()) throw InputError("the length is another");
        return out;
    }
    void report(const Text& made, json& report) const { report["pretend"] = made.words; }
};

struct Out {
    TemporaryFolder folder;
    ReconstructOptions options;
    Progress progress;
    int runs = 0;

    Out() {
        options.views.scene = folder / "scene";
        options.run.output = folder / "out";
        options.run.backend = Backend::Cpu;
    }
    /// One run of the program.
    Text run(Pretend stage, json* report = nullptr, std::vector<std::string>* warnings = nullptr) {
        Progress own;
        Run run(options, own);
        run.open(folder / "scene");
        Text out = run(stage);
        if (report) *report = run.report();
        if (warnings) *warnings = own.warnings();
        return out;
    }
    fs::path slot() const {
        for (const auto& entry : fs::directory_iterator(folder / "out/stages"))
            if (entry.path().filename().string().rfind("pretend-", 0) == 0) return entry.path();
        ADD_FAILURE() << "no stage was kept";
        return {};
    }
};

TEST(Run, AStageIsMadeOnceAndThenFound) {
    Out out;
    json report;
    std::vector<std::string> warnings;
    const Text made = out.run({7, out.runs, true}, &report, &warnings);
    EXPECT_EQ(made.words, "words of 7");
    EXPECT_EQ(read_file(made.file), made.words);  // where it lies once the stage is finished
    EXPECT_EQ(report["stages"][0]["reused"], false);
    EXPECT_EQ(warnings.size(), 1u);
    const Text found = out.run({7, out.runs, true}, &report, &warnings);
    EXPECT_EQ(out.runs, 1);
    EXPECT_EQ(found.words, made.words);
    EXPECT_EQ(found.key, made.key);
    EXPECT_EQ(found.file, made.file);
    EXPECT_EQ(report["stages"][0]["reused"], true);
    EXPECT_EQ(report["stages"][0]["name"], "pretend");
    EXPECT_EQ(report["pretend"], "words of 7");
    EXPECT_EQ(warnings, std::vector<std::string>{"the value is 7"});  // said again
}

TEST(Run, AnotherKeyIsAnotherResultAndTheFirstStays) {
    Out out;
    const Text seven = out.run({7, out.runs}), eight = out.run({8, out.runs});
    EXPECT_NE(seven.key, eight.key);
    EXPECT_EQ(out.run({7, out.runs}).words, "words of 7");
    EXPECT_EQ(out.runs, 2);
}

TEST(Run, WhatIsDamagedCountsAsNotDone) {
    Out out;
    const std::string whole = out.run({7, out.runs}).words;
    int expected = 1;
    const auto again = [&](const std::string& how) {
        EXPECT_EQ(out.run({7, out.runs}).words, whole) << how;
        EXPECT_EQ(out.runs, ++expected) << how;
    };
    const fs::path words = out.slot() / "deep/words.txt", note = out.slot() / "note.json";
    std::string damaged = whole;
    damaged[3] ^= 1;
    write_file(words, damaged);
    again("one bit of the payload");
    fs::resize_file(words, 4);
    again("payload cut short");
    fs::resize_file(words, 0);
    again("payload empty");
    fs::remove(words);
    again("payload gone");
    fs::remove(note);
    again("note gone");
    const std::string text = read_file(note);
    for (size_t at = 0; at < text.size(); at += 7) {
        if (std::isspace(static_cast<unsigned char>(text[at]))) continue;  // between words it means nothing
        std::string mutant = text;
        mutant[at] = mutant[at] == '1' ? '2' : '1';
        write_file(note, mutant);
        again("byte " + std::to_string(at) + " of the note");
    }
    for (const char* other : {"", "[]", "7", "{}", "{\"said\": 3, \"sha256\": 4}"}) {
        write_file(note, other);
        again(std::string("the note is ") + other);
    }
    out.run({7, out.runs});
    EXPECT_EQ(out.runs, expected);  // whole again
}

TEST(Run, AStageThatEndsInAnErrorLeavesNothingThatCounts) {
    Out out;
    EXPECT_THROW(out.run({7, out.runs, false, true}), InputError);
    EXPECT_THROW(out.run({7, out.runs, false, false, true}), OutputError);
    for (const auto& entry : fs::directory_iterator(out.folder / "out/stages"))
        EXPECT_FALSE(entry.path().filename().string().rfind("pretend-", 0) == 0) << entry.path();
    EXPECT_EQ(out.run({7, out.runs}).words, "words of 7");
    EXPECT_EQ(out.runs, 3);
    for (const auto& entry : fs::directory_iterator(out.folder / "out/stages"))
        EXPECT_FALSE(entry.path().filename().string().ends_with(".part")) << entry.path();
}

TEST(Run, AnIdleStagePassesAndKeepsNothing) {
    Out out;
    json report;
    EXPECT_EQ(out.run({7, out.runs, false, false, false, true}, &report).words, "idle");
    EXPECT_EQ(out.runs, 0);
    EXPECT_EQ(report["stages"][0]["reused"], false);
}

TEST(Run, AFailureSaysWhichStage) {
    Out out;
    pipeline::Run run(out.options, out.progress);
    EXPECT_THROW(run.guarded([&]() -> Reconstruction {
        run.open(out.folder / "scene");
        run(Pretend{7, out.runs});
        run(Pretend{8, out.runs, false, true});
        return {};
    }),
                 InputError);
    const json failure = json::parse(read_file(out.folder / "out/stages/failure.json"));
    EXPECT_EQ(failure["failure"]["stage"], "pretend");
    EXPECT_EQ(failure["failure"]["text"], "it fails");
    EXPECT_EQ(failure["failure"]["exit_code"], 3);
    EXPECT_EQ(failure["stages"].size(), 1u);
    EXPECT_TRUE(fs::exists(out.folder / "out/stages/failure.toml"));
}

TEST(Run, ADryRunWritesNothing) {
    Out out;
    out.options.run.dry_run = true;
    EXPECT_EQ(out.run({7, out.runs}).words, "words of 7");
    EXPECT_FALSE(fs::exists(out.folder / "out"));
}

TEST(OutLock, ASecondRunIsTurnedAwayAndAKilledOneLeavesNoLock) {
    TemporaryFolder folder;
    make_folder(folder / "out/stages");
    {
        const OutLock first(folder / "out");
        try {
            const OutLock second(folder / "out");
            ADD_FAILURE() << "two runs in one folder";
        } catch (const OutputError& e) {
            EXPECT_EQ(e.code(), ExitCode::Output);
            EXPECT_NE(std::string(e.what()).find("process " + std::to_string(getpid())), std::string::npos) << e.what();
        }
    }
    const OutLock later(folder / "out");  // it ended
    TemporaryFolder other;
    make_folder(other / "out/stages");
    int ready[2];
    ASSERT_EQ(pipe(ready), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        try {
            const OutLock held(other / "out");
            (void)!write(ready[1], "x", 1);
            pause();
        } catch (...) {
        }
        _exit(1);
    }
    char byte = 0;
    ASSERT_EQ(read(ready[0], &byte, 1), 1);
    EXPECT_THROW(OutLock(other / "out"), OutputError);
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    EXPECT_NO_THROW(OutLock(other / "out"));
    close(ready[0]);
    close(ready[1]);
}

/// A finished result of two files.
void finish(const fs::path& out, const std::string& words) {
    ResultSet set(out, out);
    write_file(set.make("mesh.ply"), words);
    write_file(set.make("deep/report.txt"), words);
    write_file(set.make("report.json"), words);
    set.commit();
}

TEST(ResultSet, FilesAppearTogetherOrNotAtAll) {
    TemporaryFolder folder;
    const fs::path out = folder / "out";
    make_folder(out / "stages");
    finish(out, "old");
    {
        ResultSet set(out, out);  // a run that ends in an error, or finds the disk full
        write_file(set.make("mesh.ply"), "new");
        set.remove("deep/report.txt");
    }
    for (const char* name : {"mesh.ply", "deep/report.txt", "report.json"}) EXPECT_EQ(read_file(out / name), "old") << name;
    EXPECT_FALSE(fs::exists(out / "stages/.result.part"));
    // A file of the set cannot be put in place: report.json, which calls the folder finished, is gone by then.
    fs::remove(out / "mesh.ply");
    make_folder(out / "mesh.ply/in the way");
    EXPECT_THROW(finish(out, "new"), OutputError);
    EXPECT_FALSE(fs::exists(out / "report.json"));
    write_file(out / "stages/made_by_vdbcarve.json", "{}");
    EXPECT_THROW(require_finished(out), InputError);
    fs::remove_all(out / "mesh.ply");
    finish(out, "new");
    EXPECT_NO_THROW(require_finished(out));
    for (const char* name : {"mesh.ply", "deep/report.txt", "report.json"}) EXPECT_EQ(read_file(out / name), "new") << name;
}

TEST(ResultSet, WhatDoesNotFitGoesWithItsFolder) {
    TemporaryFolder folder;
    const fs::path out = folder / "out";
    make_folder(out / "stages");
    finish(out, "old");
    ResultSet set(out, out);
    set.remove("deep/report.txt");
    write_file(set.make("report.json"), "new");
    set.commit();
    EXPECT_FALSE(fs::exists(out / "deep"));
    EXPECT_EQ(read_file(out / "mesh.ply"), "old");
    EXPECT_EQ(read_file(out / "report.json"), "new");
}

}  // namespace
}  // namespace vdbcarve::test
