// SPDX-License-Identifier: Apache-2.0
// Sentences with numbers and names in them. Private.
#pragma once

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <string>
#include <vector>

namespace vdbcarve {

/// The first few names, and how many more there are.
inline std::string some_of(const std::vector<std::string>& names) {
    std::string out;
    for (size_t i = 0; i < names.size() && i < 5; ++i) out += (i ? ", " : "") + names[i];
    if (names.size() > 5) out += " and " + std::to_string(names.size() - 5) + " more";
    return out;
}

/// "1 view", "2 views".
inline std::string counted(size_t count, const std::string& what) { return std::to_string(count) + " " + what + (count == 1 ? "" : "s"); }

/// As printf makes it.
std::string text_of(const char* format, ...) __attribute__((format(printf, 1, 2)));
inline std::string text_of(const char* format, ...) {
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    std::string text(static_cast<size_t>(std::max(0, std::vsnprintf(nullptr, 0, format, arguments))), '\0');
    std::vsnprintf(text.data(), text.size() + 1, format, again);
    va_end(again);
    va_end(arguments);
    return text;
}

/// A picture has not its camera's size; and where one is the other made smaller, by how much.
inline std::string other_size(const std::string& picture, int width, int height, const std::string& view, int camera_width, int camera_height) {
    std::string out =
        text_of("%s: is %d x %d pixels, the camera of view %s %d x %d", picture.c_str(), width, height, view.c_str(), camera_width, camera_height);
    if (width < 1 || height < 1) return out;
    const double x = static_cast<double>(camera_width) / width, y = static_cast<double>(camera_height) / height;
    if (width == camera_height && height == camera_width) return out + ": it is turned. Remedy: pictures as the camera file's program saw them, upright or not";
    if (x / y > 0.99 && x / y < 1.01)
        return out + text_of(": it was made %.3g times %s. Remedy: pictures of the size that the cameras were calibrated for, or cameras for these",
                             x > 1 ? x : 1 / x, x > 1 ? "smaller" : "larger");
    return out + ": it was cropped, or is another camera's. Remedy: pictures as they were when the cameras were calibrated";
}

}  // namespace vdbcarve
