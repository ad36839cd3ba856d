// SPDX-License-Identifier: Apache-2.0
// Options as part of cache keys: every member that its struct's visit() names, in that order, but for those that do not change the result. Private.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "base/sha256.h"
#include "vdbcarve/align.h"
#include "vdbcarve/board.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/visit.h"

namespace vdbcarve {

/// Adds values so that no two lists of values give the same bytes: doubles by their bits, and the size of everything that has one.
class ValueHasher {
  public:
    explicit ValueHasher(Sha256& hash) : hash_(hash) {}

    template <class T>
    requires(std::is_arithmetic_v<T> || std::is_enum_v<T>) void add(const T& value) { hash_.add_value(value); }
    void add(const std::string& text) { hash_.add(text); }
    void add(const std::filesystem::path& path) { hash_.add(path.native()); }
    template <class T>
    void add(const std::optional<T>& value) {
        hash_.add_value(value.has_value());
        if (value) add(*value);
    }
    template <class T>
    void add(const std::vector<T>& values) {
        hash_.add_value(values.size());
        for (const T& v : values) add(v);
    }
    template <class T, size_t N>
    void add(const std::array<T, N>& values) {
        for (const T& v : values) add(v);
    }
    void add(const Vec2d& v) { hash_.add_value(v.x()).add_value(v.y()); }
    void add(const Vec3d& v) { hash_.add_value(v.x()).add_value(v.y()).add_value(v.z()); }
    void add(const Box3d& box) {
        add(Vec3d(box.min()));
        add(Vec3d(box.max()));
    }
    // Structs taken apart: a further member does not compile until it is added here.
    void add(const FilterStep& step) {
        const auto& [kind, width, iterations] = step;
        add_all(kind, width, iterations);
    }
    void add(const KnownLength& length) {
        const auto& [view, from, to, distance] = length;
        add_all(view, from, to, distance);
    }
    void add(const MatLayout& mat) {
        const auto& [kind, columns, rows, marker, step, dictionary] = mat;
        add_all(kind, columns, rows, marker, step, dictionary);
    }
    template <class... T>
    void add_all(const T&... values) {
        (add(values), ...);
    }

  private:
    Sha256& hash_;
};

class OptionHasher : public Visitor<OptionHasher> {
  public:
    explicit OptionHasher(Sha256& hash) : hash_(hash), values_(hash) {}

    template <class T, class Limits>
    void operator()(const Option& option, const T& member, const Limits&) {
        hash_.add(option.name);
        values_.add(member);
    }
    template <class T, class Limits>
    void not_in_key(const Option&, const T&, const Limits&) {}
    template <class Form, class... T>
    void joint(const Option& option, const Form&, const T&... members) {
        hash_.add(option.name);
        values_.add_all(members...);
    }
    template <class T>
    void set_by_job(const char* name, const T& member) {
        hash_.add(name);
        values_.add(member);
    }

  private:
    Sha256& hash_;
    ValueHasher values_;
};

/// Everything of a struct that changes what is made with it.
template <class O>
Sha256& hash_options(Sha256& hash, const O& options) {
    OptionHasher hasher(hash);
    visit(options, hasher);
    return hash;
}

}  // namespace vdbcarve
