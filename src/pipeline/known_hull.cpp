// SPDX-License-Identifier: Apache-2.0
#include "pipeline/known_hull.h"

#include <algorithm>
#include <map>

namespace vdbcarve::pipeline {

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

std::optional<KnownHull> find_known_hull(const Store& store, const std::string& base, const std::vector<std::string>& views) {
    std::vector<KnownHull> known;
    for (const Slot& slot : store.all("carve")) {
        try {
            if (slot.note.at("base") != base || !slot.note.at("bricks").empty()) continue;
            KnownHull hull{slot, slot.file("hull.vdb"), places_of(slot.note.at("views").get<std::vector<std::string>>(), views)};
            if (!hull.views.empty()) known.push_back(std::move(hull));
        } catch (const json::exception&) {
            continue;  // of an older version
        }
    }
    std::stable_sort(known.begin(), known.end(), [](const KnownHull& a, const KnownHull& b) { return a.views.size() > b.views.size(); });
    for (KnownHull& hull : known)
        if (store.is_whole(hull.slot)) return std::move(hull);
    return std::nullopt;
}

}  // namespace vdbcarve::pipeline
