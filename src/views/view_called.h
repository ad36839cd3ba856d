// SPDX-License-Identifier: Apache-2.0
// A view that a person means. Private.
#pragma once

#include <algorithm>
#include <string>

#include "base/text.h"
#include "vdbcarve/error.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// A file called like a photograph, with more behind its name: its mask, most likely.
inline bool is_called_like(const std::string& file_name, const std::filesystem::path& photo) {
    const std::string stem = photo.stem().string();
    return file_name.size() > stem.size() && file_name.rfind(stem, 0) == 0 && (file_name[stem.size()] == '.' || file_name[stem.size()] == '_');
}

/// The view of that name, with or without folders and extension; files of ours leave folders away where names are still unique. Throws UsageError naming the
/// option.
inline size_t view_called(const Views& views, const std::string& name, const std::string& option) {
    const auto found = std::find_if(views.views.begin(), views.views.end(), [&](const View& v) {
        const std::filesystem::path path(v.name);
        return v.name == name || path.filename() == name || path.stem() == name || v.name == std::filesystem::path(name).filename();
    });
    if (found == views.views.end()) throw UsageError(option + ": no view is called " + name + "; there are " + some_of(views.names()));
    return static_cast<size_t>(found - views.views.begin());
}

}  // namespace vdbcarve
