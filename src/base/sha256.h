// SPDX-License-Identifier: Apache-2.0
// SHA-256 (FIPS 180-4) by OpenSSL, which uses the processor's instructions for it: for keys, for what is stored, and for file identifiers made from content.
// Private.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <type_traits>

struct evp_md_ctx_st;  // OpenSSL's

namespace vdbcarve {

class Sha256 {
  public:
    Sha256();
    ~Sha256();
    Sha256(const Sha256& other);
    Sha256& operator=(const Sha256&) = delete;

    Sha256& add(const void* data, size_t bytes);
    Sha256& add(std::string_view text) { return add_value(text.size()).add(text.data(), text.size()); }
    template <class T>
    Sha256& add_value(const T& value) {
        static_assert(std::is_arithmetic_v<T> || std::is_enum_v<T>);
        return add(&value, sizeof value);
    }
    /// 64 hexadecimal digits. The object is spent.
    std::string hex();

  private:
    evp_md_ctx_st* state_;
};

/// Hash of a file's content. Throws InputError when it cannot be read.
std::string sha256_of_file(const std::filesystem::path& file);

}  // namespace vdbcarve
