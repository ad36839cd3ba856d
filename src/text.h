// SPDX-License-Identifier: Apache-2.0
// Text with numbers in it, as printf makes it. Private.
#pragma once

#include <cstdarg>
#include <cstdio>
#include <string>

namespace vdbcarve {

std::string text_of(const char* format, ...) __attribute__((format(printf, 1, 2)));
inline std::string text_of(const char* format, ...) {
    char text[1000];
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return text;
}

}  // namespace vdbcarve
