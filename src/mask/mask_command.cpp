// SPDX-License-Identifier: Apache-2.0
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <fstream>
#include <sstream>
#include <thread>

#include "image/image_io.h"
#include "mask/mask_files.h"
#include "mask/mask_methods.h"
#include "base/text.h"
#include "vdbcarve/error.h"

extern char** environ;

namespace vdbcarve {

namespace fs = std::filesystem;

std::vector<std::string> words_of_command(const std::string& command) {
    std::vector<std::string> out;
    std::string word;
    bool in_word = false;
    char quote = 0;
    for (size_t i = 0; i < command.size(); ++i) {
        const char c = command[i];
        if (quote) {
            if (c == quote) quote = 0;
            else word += c;
        } else if (c == '\'' || c == '"') {
            quote = c;
            in_word = true;
        } else if (c == '\\' && i + 1 < command.size()) {
            word += command[++i];
            in_word = true;
        } else if (std::isspace(static_cast<unsigned char>(c))) {
            if (in_word) out.push_back(word);
            word.clear();
            in_word = false;
        } else {
            word += c;
            in_word = true;
        }
    }
    if (quote) throw UsageError("--mask-command " + command + ": a quotation mark is not closed");
    if (in_word) out.push_back(word);
    const auto names = [&](const char* what) {
        return std::any_of(out.begin(), out.end(), [&](const std::string& w) { return w.find(what) != std::string::npos; });
    };
    if (out.empty() || !names("{in}") || !names("{out}"))
        throw UsageError("--mask-command " + command +
                         ": {in} and {out} are to stand where the tool wants the photograph and the mask, like 'rembg i {in} {out}'");
    return out;
}

namespace {

std::string filled(std::string word, const char* name, const std::string& value) {
    for (size_t at = 0; (at = word.find(name, at)) != std::string::npos; at += value.size()) word.replace(at, std::strlen(name), value);
    return word;
}

/// The last lines of what a program said.
std::string last_words(const fs::path& log) {
    std::ifstream in(log);
    std::vector<std::string> lines;
    for (std::string line; std::getline(in, line);)
        if (!line.empty()) lines.push_back(line);
    std::string out;
    for (size_t k = lines.size() > 3 ? lines.size() - 3 : 0; k < lines.size(); ++k) out += "\n    " + lines[k].substr(0, 300);
    return out.empty() ? "; it said nothing" : "; it said:" + out;
}

struct SpawnActions {
    posix_spawn_file_actions_t actions;
    SpawnActions() { posix_spawn_file_actions_init(&actions); }
    ~SpawnActions() { posix_spawn_file_actions_destroy(&actions); }
    SpawnActions(const SpawnActions&) = delete;
    SpawnActions& operator=(const SpawnActions&) = delete;
};

}  // namespace

Image8 mask_by_command(const std::vector<std::string>& words, const fs::path& photo, const fs::path& scratch, Progress& progress) {
    static std::atomic<unsigned> number{0};
    const std::string own = "mask_command_" + std::to_string(getpid()) + "_" + std::to_string(number++);
    const fs::path result = fs::absolute(scratch / (own + ".png")), log = fs::absolute(scratch / (own + ".log"));
    struct Gone {
        const fs::path &a, &b;
        ~Gone() {
            std::error_code ignored;
            fs::remove(a, ignored);
            fs::remove(b, ignored);
        }
    } gone{result, log};
    std::vector<std::string> filled_in;
    for (const std::string& w : words) filled_in.push_back(filled(filled(w, "{in}", fs::absolute(photo).string()), "{out}", result.string()));
    std::vector<char*> argv;
    for (std::string& w : filled_in) argv.push_back(w.data());
    argv.push_back(nullptr);
    const std::string what = photo.string() + ": --mask-command " + words[0];
    SpawnActions spawn;
    posix_spawn_file_actions_addopen(&spawn.actions, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_addopen(&spawn.actions, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    posix_spawn_file_actions_adddup2(&spawn.actions, 1, 2);
    pid_t child = 0;
    if (const int error = posix_spawnp(&child, argv[0], &spawn.actions, nullptr, argv.data(), environ); error != 0)
        throw InputError(what + ": could not be started: " + std::strerror(error) + ". Remedy: its whole path, or install it");
    int status = 0;
    while (true) {
        const pid_t ended = waitpid(child, &status, WNOHANG);
        if (ended == child) break;
        if (ended < 0 && errno != EINTR) throw InputError(what + ": was lost: " + std::strerror(errno));
        try {
            progress.check();
        } catch (...) {
            kill(child, SIGTERM);
            waitpid(child, &status, 0);
            throw;
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    if (WIFSIGNALED(status)) throw InputError(what + ": ended by signal " + std::to_string(WTERMSIG(status)) + last_words(log));
    if (WEXITSTATUS(status) != 0) throw InputError(what + ": ended with status " + std::to_string(WEXITSTATUS(status)) + last_words(log));
    if (!fs::is_regular_file(result)) throw InputError(what + ": ended well, but wrote no {out}" + last_words(log));
    Image8 made;
    try {
        made = io::read_image8(result);
    } catch (const InputError& e) {
        throw InputError(what + ": wrote no picture: " + e.what() + last_words(log));
    }
    return grey_of(made, photo.string() + ": what " + words[0] + " made of it");
}

}  // namespace vdbcarve
