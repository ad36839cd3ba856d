// SPDX-License-Identifier: Apache-2.0
#include "base/sha256.h"

#include <openssl/evp.h>

#include <array>
#include <fstream>
#include <new>
#include <stdexcept>
#include <vector>

#include "vdbcarve/error.h"

namespace vdbcarve {

namespace {

/// OpenSSL fails here only for want of memory, or where an administrator forbids SHA-256.
void demand(int success) {
    if (success != 1) throw std::runtime_error("OpenSSL cannot compute SHA-256");
}

EVP_MD_CTX* new_state() {
    EVP_MD_CTX* state = EVP_MD_CTX_new();
    if (!state) throw std::bad_alloc();
    return state;
}

}  // namespace

Sha256::Sha256() : state_(new_state()) { demand(EVP_DigestInit_ex(state_, EVP_sha256(), nullptr)); }
Sha256::~Sha256() { EVP_MD_CTX_free(state_); }
Sha256::Sha256(const Sha256& other) : state_(new_state()) { demand(EVP_MD_CTX_copy_ex(state_, other.state_)); }

Sha256& Sha256::add(const void* data, size_t bytes) {
    demand(EVP_DigestUpdate(state_, data, bytes));
    return *this;
}

std::string Sha256::hex() {
    std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
    unsigned int bytes = 0;
    demand(EVP_DigestFinal_ex(state_, digest.data(), &bytes));
    std::string out;
    for (unsigned int i = 0; i < bytes; ++i) {
        out += "0123456789abcdef"[digest[i] >> 4];
        out += "0123456789abcdef"[digest[i] & 15];
    }
    return out;
}

std::string sha256_of_file(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file.string() + ": cannot be opened");
    Sha256 hash;
    std::vector<char> buffer(size_t{1} << 20);
    while (in) {
        in.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
        hash.add(buffer.data(), static_cast<size_t>(in.gcount()));
    }
    if (in.bad()) throw InputError(file.string() + ": cannot be read");
    return hash.hex();
}

}  // namespace vdbcarve
