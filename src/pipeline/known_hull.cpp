// SPDX-License-Identifier: Apache-2.0
#include "pipeline/known_hull.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

namespace vdbcarve {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Where each of a hull's views stands among `views`; empty where one is not there.
std::vector<size_t> places_of(const std::vector<std::string>& of_hull, const std::vector<std::string>& views) {
    std::multimap<std::string, size_t> places;
    for (size_t i = 0; i < views.size(); ++i) places.emplace(views[i], i);
    std::vector<size_t> out;
    for (const std::string& view : of_hull) {
        const auto found = places.find(view);
        if (found == places.end()) return {};
        out.push_back(found->second);
        places.erase(found);  // a view that is there twice was carved with twice
    }
    std::sort(out.begin(), out.end());
    return out;
}

}  // namespace

std::optional<KnownHull> find_known_hull(const fs::path& stages, const std::string& base, const std::vector<std::string>& views) {
    std::vector<fs::path> notes;
    std::error_code not_there;
    for (const auto& entry : fs::directory_iterator(stages, not_there))
        if (entry.path().extension() == ".json" && entry.path().filename().string().rfind("hull-", 0) == 0) notes.push_back(entry.path());
    std::sort(notes.begin(), notes.end());
    std::optional<KnownHull> best;
    for (const fs::path& file : notes) {
        try {
            std::ifstream in(file);
            const json note = json::parse(in);
            if (note.at("base") != base) continue;
            KnownHull hull{fs::path(file).replace_extension(".vdb"), places_of(note.at("views").get<std::vector<std::string>>(), views)};
            if (!hull.views.empty() && (!best || hull.views.size() > best->views.size()) && fs::exists(hull.file)) best = std::move(hull);
        } catch (const json::exception&) {
            continue;  // of an older version, or damaged
        }
    }
    return best;
}

}  // namespace vdbcarve
