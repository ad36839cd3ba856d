// SPDX-License-Identifier: Apache-2.0
// SHA-256 (FIPS 180-4), for keys and for file identifiers made from content. Private.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <type_traits>

namespace vdbcarve {

class Sha256 {
  public:
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
    void block(const uint8_t* p);
    std::array<uint32_t, 8> h_{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    std::array<uint8_t, 64> buffer_{};
    size_t filled_ = 0;
    uint64_t bytes_ = 0;
};

/// Hash of a file's content. Throws InputError when it cannot be read.
std::string sha256_of_file(const std::filesystem::path& file);

}  // namespace vdbcarve
