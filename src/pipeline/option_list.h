// SPDX-License-Identifier: Apache-2.0
// The visitor that lists options with their types forgotten (config.h). Private.
#pragma once

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <optional>
#include <sstream>
#include <string>
#include <type_traits>
#include <vector>

#include "vdbcarve/config.h"
#include "vdbcarve/error.h"
#include "vdbcarve/option_text.h"
#include "vdbcarve/visit.h"

namespace vdbcarve {

template <class T>
inline constexpr bool is_optional = false;
template <class T>
inline constexpr bool is_optional<std::optional<T>> = true;

class OptionLister : public Visitor<OptionLister> {
  public:
    std::vector<OptionEntry> entries;

    template <class T, class Limits>
    void operator()(const Option& option, T& member, const Limits& limits) {
        OptionEntry& e = begin(option);
        describe(e, member, limits);
        e.values = [&member, limits] { return printed(member, limits); };
        e.set = [name = dashed(option), &member, limits](const std::vector<std::string>& values) { read(name, values, member, limits); };
        e.fault = [name = dashed(option), &member, limits] { return fault(name, member, limits); };
        e.says_default = e.shape != OptionEntry::Shape::Flag && e.value_name != "WORD" && !printed(member, limits).empty();
    }
    template <class T, class Limits>
    void not_in_key(const Option& option, T& member, const Limits& limits) {
        (*this)(option, member, limits);
        entries.back().in_key = false;
    }
    template <class Form, class... T>
    void joint(const Option& option, const Form&, T&... members) {
        OptionEntry& e = begin(option);
        e.value_name = "TEXT";
        e.quoted = false;
        if constexpr (requires { Form::kList; }) {
            e.shape = OptionEntry::Shape::Many;
            e.comma_separated = true;
        }
        e.values = [&members...] {
            const std::string text = Form::print(members...);
            if constexpr (requires { Form::kList; }) return words_of(text);
            else return text.empty() ? std::vector<std::string>() : std::vector<std::string>{text};
        };
        e.set = [name = dashed(option), &members...](const std::vector<std::string>& values) { Form::parse(name, joined(values), members...); };
        e.fault = [name = dashed(option), &members...] {
            if constexpr (requires { Form::fault(name, members...); }) return Form::fault(name, members...);
            else return std::string();
        };
        name_value(e);
        e.says_default = e.value_name != "WORD" && !e.values().empty();
    }
    template <class Form, class... T>
    void alias(const Option& option, const Form& form, T&... members) {
        joint(option, form, members...);
        entries.back().alias = true;
    }

    static std::string joined(const std::vector<std::string>& values) {
        std::string out;
        for (const std::string& v : values) out += (out.empty() ? "" : ",") + v;
        return out;
    }

    static std::vector<std::string> words_of(const std::string& text) {
        std::vector<std::string> out;
        std::istringstream words(text);
        for (std::string word; std::getline(words, word, ',');) out.push_back(word);
        return out;
    }

  private:
    static std::string dashed(const Option& option) { return "--" + std::string(option.name); }
    OptionEntry& begin(const Option& option) {
        entries.emplace_back().about = option;
        return entries.back();
    }
    static void name_value(OptionEntry& e) {
        if (e.about.value_name) e.value_name = e.about.value_name;
    }

    template <class T, class Limits>
    static void describe(OptionEntry& e, const T&, const Limits& limits) {
        e.value_name = "TEXT";
        if constexpr (std::is_same_v<Limits, Flag>) {
            e.shape = OptionEntry::Shape::Flag;
            e.value_name.clear();
        } else if constexpr (std::is_same_v<Limits, Range>) {
            e.quoted = false;
            e.limits = limits.text();
            if (limits.words.empty()) e.value_name = std::is_floating_point_v<T> ? "FLOAT" : std::is_signed_v<T> ? "INT" : "UINT";
        } else if constexpr (std::is_same_v<Limits, OneOf>) {
            e.limits = limits.list();
        } else if constexpr (std::is_same_v<Limits, Text>) {
        } else if constexpr (requires { limits.all; }) {  // Words
            e.value_name = "WORD";
            e.limits = limits.list();
        } else {
            e.quoted = false;
        }
        if constexpr (std::is_same_v<T, std::vector<std::string>> || std::is_same_v<T, std::vector<std::filesystem::path>>) {
            e.shape = OptionEntry::Shape::Many;
            e.comma_separated = std::is_same_v<Limits, OneOf>;
        }
        name_value(e);
    }

    using Strings = std::vector<std::string>;

    static Strings printed(bool member, const Flag& flag) { return member == flag.given ? Strings{"true"} : Strings(); }
    template <class T>
    static Strings printed(const T& member, const Words<T>& words) {
        const std::string word = words.of(member);
        return word.empty() ? Strings() : Strings{word};
    }
    template <class T>
    static Strings printed(const T& member, const Range& range) {
        for (const Word<double>& w : range.words)
            if (w.value == static_cast<double>(member)) return {w.text};
        if (range.unset && *range.unset == static_cast<double>(member)) return {};
        if constexpr (std::is_integral_v<T>) return {std::to_string(member)};
        else return {number_text(member)};
    }
    template <class T>
    static Strings printed_text(const T& member) {
        if constexpr (std::is_same_v<T, std::string>) return member.empty() ? Strings() : Strings{member};
        else if constexpr (std::is_same_v<T, std::filesystem::path>) return printed_text(member.string());
        else if constexpr (std::is_same_v<T, Strings>) return member;
        else {
            Strings out;
            for (const std::filesystem::path& p : member) out.push_back(p.string());
            return out;
        }
    }
    template <class T>
    static Strings printed(const T& member, const Text&) {
        return printed_text(member);
    }
    template <class T>
    static Strings printed(const T& member, const OneOf&) {
        return printed_text(member);
    }
    template <class T, class Form>
    static Strings printed(const T& member, const Form&) {
        std::string text;
        if constexpr (requires { Form::print(member); }) text = Form::print(member);
        else if (member) text = Form::print(*member);
        return text.empty() ? Strings() : Strings{text};
    }

    static void read(const std::string& option, const Strings& values, bool& member, const Flag& flag) {
        const std::string text = joined(values);
        const bool yes = text == "true" || text == "on" || text == "yes" || text == "1";
        if (!yes && text != "false" && text != "off" && text != "no" && text != "0") throw UsageError(option + " " + text + ": must be true or false");
        member = yes ? flag.given : !flag.given;
    }
    template <class T>
    static void read(const std::string& option, const Strings& values, T& member, const Words<T>& words) {
        const std::string text = joined(values);
        std::string small = text;
        std::transform(small.begin(), small.end(), small.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
        for (const Word<T>& w : words.all)
            if (small == w.text) {
                member = w.value;
                return;
            }
        throw UsageError(option + " " + text + ": must be one of " + words.list());
    }
    template <class T>
    static std::string out_of_range(const std::string& option, const T& value, const Range& range) {
        std::string text;
        if constexpr (std::is_integral_v<T>) text = std::to_string(value);
        else text = number_text(value);
        return option + " is " + text + ", must be " + range.text();
    }
    template <class T>
    static void read(const std::string& option, const Strings& values, T& member, const Range& range) {
        const std::string text = joined(values);
        for (const Word<double>& w : range.words)
            if (text == w.text) {
                member = static_cast<T>(w.value);
                return;
            }
        T value{};
        if constexpr (std::is_integral_v<T>) {
            const char* end = text.data() + text.size();
            const auto read = std::from_chars(text.data(), end, value);
            if (read.ec != std::errc() || read.ptr != end) {
                double number = 0;
                const auto as_number = std::from_chars(text.data(), end, number);
                if (as_number.ec != std::errc() || as_number.ptr != end) throw UsageError(option + " " + text + ": must be " + range.text());
                throw UsageError(range.holds(number) ? option + " is " + text + ", must be a whole number" : out_of_range(option, number, range));
            }
        } else {
            try {
                value = number(option, text);
            } catch (const UsageError&) {
                if (range.words.empty()) throw;
                throw UsageError(option + " " + text + ": must be " + range.text());
            }
        }
        if (!range.holds(static_cast<double>(value))) throw UsageError(out_of_range(option, value, range));
        member = value;
    }
    static void read(const std::string&, const Strings& values, std::string& member, const Text&) { member = joined(values); }
    static void read(const std::string&, const Strings& values, std::filesystem::path& member, const Text&) { member = joined(values); }
    static void read(const std::string&, const Strings& values, std::vector<std::filesystem::path>& member, const Text&) {
        member.assign(values.begin(), values.end());
    }
    static std::string none_of(const std::string& option, const std::string& word, const OneOf& words) {
        const bool known = std::any_of(words.all.begin(), words.all.end(), [&](const char* w) { return word == w; });
        return known ? "" : option + " " + word + ": must be one of " + words.list();
    }
    static void read(const std::string& option, const Strings& values, std::string& member, const OneOf& words) {
        const std::string word = joined(values);
        if (const std::string wrong = none_of(option, word, words); !word.empty() && !wrong.empty()) throw UsageError(wrong);
        member = word;
    }
    static void read(const std::string& option, const Strings& values, Strings& member, const OneOf& words) {
        for (const std::string& word : values)
            if (const std::string wrong = none_of(option, word, words); !wrong.empty()) throw UsageError(wrong);
        member = values;
    }
    template <class T, class Form>
    static void read(const std::string& option, const Strings& values, T& member, const Form&) {
        const std::string text = joined(values);
        if constexpr (requires { Form::parse(option, text, member); }) {
            Form::parse(option, text, member);
        } else {
            typename T::value_type value{};
            Form::parse(option, text, value);
            member = value;
        }
    }

    static std::string fault(const std::string&, bool, const Flag&) { return ""; }
    template <class T>
    static std::string fault(const std::string& option, const T& member, const Words<T>& words) {
        return *words.of(member) ? "" : option + ": the value is none of " + words.list();
    }
    template <class T>
    static std::string fault(const std::string& option, const T& member, const Range& range) {
        return range.allows(static_cast<double>(member)) ? "" : out_of_range(option, member, range);
    }
    template <class T>
    static std::string fault(const std::string&, const T&, const Text&) {
        return "";
    }
    static std::string fault(const std::string& option, const std::string& member, const OneOf& words) {
        return member.empty() ? "" : none_of(option, member, words);
    }
    static std::string fault(const std::string& option, const Strings& member, const OneOf& words) {
        for (const std::string& word : member)
            if (const std::string wrong = none_of(option, word, words); !wrong.empty()) return wrong;
        return "";
    }
    template <class T, class Form>
    static std::string fault(const std::string& option, const T& member, const Form&) {
        if constexpr (requires { Form::fault(option, member); }) return Form::fault(option, member);
        else if constexpr (is_optional<T>) {
            if constexpr (requires { Form::fault(option, *member); }) return member ? Form::fault(option, *member) : std::string();
        }
        return "";
    }
};

template <class O>
std::vector<OptionEntry> list_of(O& options) {
    OptionLister lister;
    visit(options, lister);
    return std::move(lister.entries);
}

}  // namespace vdbcarve
