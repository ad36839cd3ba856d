// SPDX-License-Identifier: Apache-2.0
// Every member that an options struct's visit() names, one after the other, for tests that change each.
#pragma once

#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/config.h"

namespace vdbcarve::test {

enum class Keyed { Yes, No };

/// Calls f(name, member, keyed) for every member, those that no option sets included. Callbacks are left out. A joint option's members are called "name[0]" …
template <class F>
class EachOption : public Visitor<EachOption<F>> {
  public:
    explicit EachOption(F f) : f_(std::move(f)) {}
    template <class T, class Limits>
    void operator()(const Option& option, T& member, const Limits&) {
        f_(std::string(option.name), member, Keyed::Yes);
    }
    template <class T, class Limits>
    void not_in_key(const Option& option, T& member, const Limits&) {
        f_(std::string(option.name), member, Keyed::No);
    }
    template <class Form, class... T>
    void joint(const Option& option, const Form&, T&... members) {
        size_t i = 0;
        (f_(option.name + ("[" + std::to_string(i++) + "]"), members, Keyed::Yes), ...);
    }
    template <class T>
    void set_by_job(const char* name, T& member) {
        f_(std::string(name) + " (set by the job)", member, Keyed::Yes);
    }
    template <class... T>
    void ignore(T&... members) {
        (ignore_one(members), ...);
    }

  private:
    template <class T>
    void ignore_one(T& member) {
        if constexpr (std::is_arithmetic_v<T> || std::is_enum_v<T> || std::is_same_v<T, std::filesystem::path>) f_(std::string("ignored"), member, Keyed::No);
    }
    F f_;
};

template <class O, class F>
void for_each_option(O& options, F f) {
    EachOption<F> each(std::move(f));
    visit(options, each);
}

/// Another value.
inline void flip(bool& v) { v = !v; }
template <class T>
requires(std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) void flip(T& v) { v = static_cast<T>(v + 1); }
template <class T>
requires std::is_enum_v<T>
void flip(T& v) { v = static_cast<T>(static_cast<int>(v) == 0 ? 1 : 0); }
inline void flip(std::string& v) { v += "x"; }
inline void flip(std::filesystem::path& v) { v += "x"; }
inline void flip(Vec2d& v) { v.x() += 1; }
inline void flip(Vec3d& v) { v.y() += 1; }
inline void flip(Box3d& v) { v = v.isEmpty() ? Box3d(Vec3d(0, 0, 0), Vec3d(1, 1, 1)) : Box3d(v.min(), 2 * v.max()); }
inline void flip(KnownLength& v) { v.length += 1; }
inline void flip(MatLayout& v) { v.rows += 2; }
inline void flip(FilterStep& v) { v.iterations += 1; }
template <class T, size_t N>
void flip(std::array<T, N>& v) {
    flip(v[N - 1]);
}
template <class T>
void flip(std::optional<T>& v) {
    if (v) v.reset();
    else v.emplace();
}
template <class T>
void flip(std::vector<T>& v) {
    v.emplace_back();
}

/// The struct's members as (name, change), in the order of its visit(); `change` flips that member of any struct of the type.
template <class O>
struct OptionFlip {
    std::string name;
    Keyed keyed;
    std::function<void(O&)> change;
};
template <class O>
std::vector<OptionFlip<O>> option_flips() {
    std::vector<OptionFlip<O>> out;
    O scratch;
    for_each_option(scratch, [&](const std::string& name, auto&, Keyed keyed) {
        const size_t at = out.size();
        out.push_back({name, keyed, [at](O& options) {
                           size_t i = 0;
                           for_each_option(options, [&](const std::string&, auto& member, Keyed) {
                               if (i++ == at) flip(member);
                           });
                       }});
    });
    return out;
}

}  // namespace vdbcarve::test
