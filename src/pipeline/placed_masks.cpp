// SPDX-License-Identifier: Apache-2.0
#include "pipeline/placed_masks.h"

#include <algorithm>

#include "result/result_json.h"
#include "base/atomic_file.h"
#include "base/sha256.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kWritten = ".written_by_vdbcarve.json";  ///< in masks/: the hashes that each of our files may have

/// Which hashes a file of ours may have; empty: it is not in the note.
std::vector<std::string> ours(const json& written, const std::string& name) {
    const auto found = written.find(name);
    try {
        return found == written.end() ? std::vector<std::string>() : found->get<std::vector<std::string>>();
    } catch (const json::exception&) {
        return {};  // damaged
    }
}

}  // namespace

std::vector<fs::path> edited_masks(const fs::path& output, const std::vector<std::string>& names, Progress& progress) {
    const fs::path folder = output / "masks";
    const json written = parse_or_empty(folder / kWritten);
    std::vector<fs::path> edited(names.size());
    for (size_t i = 0; i < names.size(); ++i) {
        const fs::path file = folder / names[i];
        const std::vector<std::string> known = ours(written, names[i]);
        if (known.empty() || !fs::exists(file)) continue;
        if (std::find(known.begin(), known.end(), sha256_of_file(file)) != known.end()) continue;
        edited[i] = file;
        progress.note("mask edited by hand is used: " + file.string());
    }
    return edited;
}

void refuse_foreign_masks(const fs::path& output, const Silhouettes& masks) {
    const fs::path folder = output / "masks";
    const json written = parse_or_empty(folder / kWritten);
    std::vector<std::string> foreign;
    for (size_t i = 0; i < masks.names.size(); ++i) {
        const fs::path to = folder / masks.names[i];
        if (!masks.edited[i].empty() || masks.files[i].empty() || !ours(written, masks.names[i]).empty()) continue;
        if (fs::exists(to) && sha256_of_file(to) != sha256_of_file(masks.files[i])) foreign.push_back(to.string());
    }
    if (!foreign.empty())
        throw OutputError(some_of(foreign) + ": not written by vdbcarve, and the run's own mask would replace it. Remedy: another -o, or move " +
                          (foreign.size() == 1 ? "it" : "them") + " away (with --masks, masks of yours are used); --force does not allow this");
}

void place_masks(ResultSet& set, const Silhouettes& masks, Progress& progress) {
    if (masks.names.empty()) return;
    refuse_foreign_masks(set.place(), masks);
    const fs::path folder = set.place() / "masks";
    json written = parse_or_empty(folder / kWritten);
    const fs::path note = set.make(fs::path("masks") / kWritten);  // in place before the masks are
    for (size_t i = 0; i < masks.names.size(); ++i) {
        if (!masks.edited[i].empty() || masks.files[i].empty()) continue;
        const fs::path to = folder / masks.names[i];
        const std::string hash = sha256_of_file(masks.files[i]), there = fs::exists(to) ? sha256_of_file(to) : std::string();
        const std::vector<std::string> known = ours(written, masks.names[i]);
        if (there == hash) {
            if (known.empty()) written[masks.names[i]] = json::array({hash});  // the note was lost
        } else if (!there.empty() && std::find(known.begin(), known.end(), there) == known.end()) {
            progress.warn(to.string() + ": was edited while this run went on, which does not use it. Remedy: the same command again");
        } else {
            set.copy(masks.files[i], fs::path("masks") / masks.names[i]);
            // The one before is still ours, should a run end between the note and the copy.
            written[masks.names[i]] = known.empty() ? json::array({hash}) : json::array({known.back(), hash});
        }
    }
    write_file(note, dumped(written, 1) + "\n");
}

}  // namespace vdbcarve::pipeline
