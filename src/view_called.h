// SPDX-License-Identifier: Apache-2.0
// A view that a person means. Private.
#pragma once

#include <algorithm>
#include <string>

#include "text.h"
#include "vdbcarve/error.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// The view of that name, with or without folders and extension. Throws UsageError naming the option.
inline size_t view_called(const Views& views, const std::string& name, const std::string& option) {
    const auto found = std::find_if(views.views.begin(), views.views.end(), [&](const View& v) {
        const std::filesystem::path path(v.name);
        return v.name == name || path.filename() == name || path.stem() == name;
    });
    if (found == views.views.end()) throw UsageError(option + ": no view is called " + name + "; there are " + some_of(views.names()));
    return static_cast<size_t>(found - views.views.begin());
}

}  // namespace vdbcarve
