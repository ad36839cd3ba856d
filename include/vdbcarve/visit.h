// SPDX-License-Identifier: Apache-2.0
// How an options struct describes its members. Beside the struct stands one function template visit(), which hands every member to a visitor with its name,
// its limits and its help text. The command line, the range checks, the cache keys, config.toml and "was it given?" are visitors: none keeps a list of its own.
//
//   template <OptionsOf<GridOptions> O, class V>
//   void visit(O& o, V& v) {
//       v(Option{"resolution", "voxels along the longest side of the bounds", "Grid", in::kCarving}, o.resolution, above(0).or_unset(0));
//   }
//
// A visitor has these members, M being a member of the struct or a const one:
//   v(option, M, limits)             an option that changes the result
//   v.not_in_key(option, M, limits)  an option that does not: memory, threads, device, places of output
//   v.joint(option, form, M...)      one option that is several members
//   v.alias(option, form, M...)      another spelling of members that are visited elsewhere
//   v.set_by_job(name, M)            no option: the pipeline sets it, and it changes the result
//   v.ignore(M...)                   no option, and it does not change the result: callbacks
//   v.part(M)                        a nested options struct
// `limits` is a Range, Words, a Flag, Text, OneOf, or a form: a type with `print(member)`, which gives text, and `parse(option, text, member)`, which reads it
// back exactly and throws UsageError. A form that prints "" says that its members are not set.
#pragma once

#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <type_traits>

namespace vdbcarve {

/// The struct itself, const or not.
template <class O, class S>
concept OptionsOf = std::is_same_v<std::remove_const_t<O>, S>;

/// The commands of the program that offer an option; bits.
namespace in {
inline constexpr unsigned kMask = 1, kAlign = 2, kCarve = 4, kReconstruct = 8, kWatch = 16, kCheck = 32;
inline constexpr unsigned kMeshing = kReconstruct | kWatch;
inline constexpr unsigned kCarving = kCarve | kMeshing;
inline constexpr unsigned kAligning = kAlign | kCarving;
inline constexpr unsigned kAll = kMask | kAligning;
inline constexpr unsigned kScenes = kAll | kCheck;
}  // namespace in

struct Option {
    const char* name;                  ///< without dashes, as on the command line and in config.toml
    const char* help = "";             ///< empty: the command line does not offer it; library callers and configuration files may set it
    const char* group = "Options";     ///< heading in --help
    unsigned commands = in::kAll;      ///< that offer it
    const char* value_name = nullptr;  ///< "SCENE2" in "--add SCENE2"; null: by its type
    const char* help_of_watch = nullptr;
};

/// One word for one value.
template <class T>
struct Word {
    const char* text;
    T value;
};

/// Every word for every value of an enum (or of a bool that reads better as a choice).
template <class T>
struct Words {
    std::span<const Word<T>> all;

    template <size_t N>
    constexpr Words(const Word<T> (&words)[N]) : all(words) {}
    /// "" for a value that has none.
    constexpr const char* of(T value) const {
        for (const Word<T>& w : all)
            if (w.value == value) return w.text;
        return "";
    }
    /// "auto, cpu, cuda".
    std::string list() const {
        std::string out;
        for (const Word<T>& w : all) out += (out.empty() ? "" : ", ") + std::string(w.text);
        return out;
    }
};
template <class T, size_t N>
Words(const Word<T> (&)[N]) -> Words<T>;

/// Numbers from least to most. NaN is within no range.
struct Range {
    double least = std::numeric_limits<double>::lowest(), most = std::numeric_limits<double>::max();
    bool above = false;                          ///< least itself is out
    std::optional<double> unset = std::nullopt;  ///< the member's value where nothing is said; cannot be given unless it is in the range, too
    std::span<const Word<double>> words = {};    ///< that stand for values, which need not be in the range
    constexpr Range or_unset(double value) const { return {least, most, above, value, words}; }
    template <size_t N>
    constexpr Range or_words(const Word<double> (&all)[N]) const {
        return {least, most, above, unset, all};
    }

    constexpr bool holds(double value) const { return (above ? value > least : value >= least) && value <= most; }
    /// Also the values that stand for something else.
    constexpr bool allows(double value) const {
        for (const Word<double>& w : words)
            if (w.value == value) return true;
        return holds(value) || (unset && value == *unset);
    }
    /// "0..15", "> 0", ">= 0", "auto or >= 1", "finite".
    std::string text() const;
};
constexpr Range within(double least, double most) { return {least, most}; }
constexpr Range above(double least) { return {least, std::numeric_limits<double>::max(), true}; }
constexpr Range at_least(double least) { return {least}; }
constexpr Range any_number() { return {}; }

/// A bool that is set to `given` by naming the option.
struct Flag {
    bool given = true;
};

/// Any string, or path; empty: not set.
struct Text {};

/// A string out of a few, or a list of such.
struct OneOf {
    std::span<const char* const> all;
    template <size_t N>
    constexpr OneOf(const char* const (&words)[N]) : all(words) {}
    std::string list() const;
};

/// What visitors have in common: visitors derive from it, and say what they do otherwise.
template <class Self>
class Visitor {
  public:
    template <class T>
    void part(T& nested) {
        visit(nested, self());
    }
    template <class T, class Limits>
    void not_in_key(const Option& option, T& member, const Limits& limits) {
        self()(option, member, limits);
    }
    template <class Form, class... T>
    void alias(const Option&, const Form&, T&...) {}
    template <class T>
    void set_by_job(const char*, T&) {}
    template <class... T>
    void ignore(T&...) {}

  protected:
    Self& self() { return static_cast<Self&>(*this); }
};

}  // namespace vdbcarve
