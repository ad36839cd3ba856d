// SPDX-License-Identifier: Apache-2.0
// The configuration file of a result: TOML with one line for every option.
#include <algorithm>
#include <charconv>
#include <cstdint>
#include <fstream>
#include <set>

#include "base/text.h"
#include "vdbcarve/config.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

bool looks_like_a_number(const std::string& text) {
    double value = 0;
    const char* begin = text.data() + (!text.empty() && (text[0] == '+' || text[0] == '-'));
    const char* end = text.data() + text.size();
    if (begin == end || *begin < '0' || *begin > '9') return false;  // no inf, nan
    const auto read = std::from_chars(begin, end, value);
    return read.ec == std::errc() && read.ptr == end;
}

/// "…" as TOML has it.
std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') out += '\\', out += c;
        else if (c == '\n') out += "\\n";
        else if (c == '\t') out += "\\t";
        else if (c == '\r') out += "\\r";
        else if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) out += text_of("\\u%04X", static_cast<unsigned>(c));
        else out += c;
    }
    return out + "\"";
}

std::string line_of(const std::string& command, const OptionEntry& e, const std::vector<std::string>& values) {
    std::string value;
    if (e.shape == OptionEntry::Shape::Flag) value = values.front();
    else if (e.shape == OptionEntry::Shape::Many) {
        for (const std::string& v : values) value += (value.empty() ? "" : ", ") + quoted(v);
        value = "[" + value + "]";
    } else {
        value = !e.quoted && looks_like_a_number(values.front()) ? values.front() : quoted(values.front());
    }
    return command + "." + e.about.name + "=" + value + "\n";
}

/// A reader of one file.
class Parser {
  public:
    Parser(const std::string& text, const std::string& file) : text_(text), file_(file) {}

    std::vector<ConfigLine> run() {
        if (text_.rfind("\xef\xbb\xbf", 0) == 0) at_ = 3;  // as some editors begin
        for (skip_empty(); !done(); skip_empty()) {
            if (peek() == '[') {
                section();
            } else {
                key_and_value();
            }
            end_of_line();
        }
        return std::move(out_);
    }

  private:
    [[noreturn]] void refuse(const std::string& what) const { throw UsageError(text_of("%s, line %d: %s", file_.c_str(), line_, what.c_str())); }
    bool done() const { return at_ >= text_.size(); }
    char peek(size_t ahead = 0) const { return at_ + ahead < text_.size() ? text_[at_ + ahead] : '\0'; }
    char take() {
        if (text_[at_] == '\n') ++line_;
        return text_[at_++];
    }
    void skip_blanks() {
        while (!done() && (peek() == ' ' || peek() == '\t')) take();
    }
    void skip_comment() {
        skip_blanks();
        if (peek() == '#')
            while (!done() && peek() != '\n') take();
        if (peek() == '\r' && (peek(1) == '\n' || at_ + 1 == text_.size())) take();
    }
    /// Blank lines and comments.
    void skip_empty() {
        for (skip_comment(); !done() && peek() == '\n'; skip_comment()) take();
    }
    void end_of_line() {
        skip_comment();
        if (!done() && peek() != '\n') refuse("'" + rest_of_line() + "' behind the value");
    }
    std::string rest_of_line() const { return text_.substr(at_, std::min<size_t>(text_.find('\n', at_), at_ + 40) - at_); }

    static bool is_key(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_'; }
    std::vector<std::string> dotted_key() {
        std::vector<std::string> path;
        for (;;) {
            skip_blanks();
            std::string part;
            if (peek() == '"' || peek() == '\'') part = string();
            else
                while (is_key(peek())) part += take();
            if (part.empty()) refuse("a name is expected, not '" + rest_of_line() + "'");
            path.push_back(part);
            skip_blanks();
            if (peek() != '.') return path;
            take();
        }
    }
    void section() {
        take();
        if (peek() == '[') refuse("[[…]] is not read here. Remedy: [section], or keys like reconstruct.scene");
        section_ = dotted_key();
        if (peek() != ']') refuse("']' is missing");
        take();
    }
    void key_and_value() {
        ConfigLine out;
        out.line = line_;
        out.path = section_;
        const std::vector<std::string> key = dotted_key();
        out.path.insert(out.path.end(), key.begin(), key.end());
        std::string name;
        for (const std::string& part : out.path) name += (name.empty() ? "" : ".") + part;
        if (!seen_.insert(out.path).second) refuse(name + " is there twice");
        if (peek() != '=') refuse(name + ": '=' and a value are expected");
        take();
        skip_blanks();
        out.is_list = peek() == '[';
        if (out.is_list) list(name, out.values);
        else out.values = {value(name)};
        out_.push_back(std::move(out));
    }
    void list(const std::string& name, std::vector<std::string>& out) {
        take();
        for (skip_empty(); peek() != ']'; skip_empty()) {
            if (done()) refuse(name + ": ']' is missing");
            if (peek() == '[') refuse(name + ": a list of lists is not read here");
            out.push_back(value(name));
            skip_empty();
            if (peek() == ',') take();
            else if (done()) refuse(name + ": ']' is missing");
            else if (peek() != ']') refuse(name + ": ',' or ']' is expected");
        }
        take();
    }
    std::string value(const std::string& name) {
        if (peek() == '"' || peek() == '\'') return string();
        if (peek() == '{') refuse(name + ": {…} is not read here");
        std::string word;
        while (!done() && std::string(" \t\r\n,]#").find(peek()) == std::string::npos) word += take();
        if (word == "true" || word == "false") return word;
        word.erase(std::remove(word.begin(), word.end(), '_'), word.end());  // 1_000
        if (!looks_like_a_number(word)) refuse(name + ": '" + word + "' must be a number, true, false, a list, or text in quotes, like \"" + word + "\"");
        return word;
    }
    std::string string() {
        const char quote = take();
        if (peek() == quote && peek(1) == quote) refuse("text of several lines is not read here. Remedy: \\n within \"…\"");
        std::string out;
        for (;;) {
            if (done() || peek() == '\n') refuse(std::string("the text's closing ") + quote + " is missing");
            const char c = take();
            if (c == quote) return out;
            if (c != '\\' || quote == '\'') out += c;
            else escape(out);
        }
    }
    void escape(std::string& out) {
        if (done()) refuse("the text ends in \\");
        const char c = take();
        constexpr const char* kFrom = "btnfr\"\\";
        constexpr const char* kTo = "\b\t\n\f\r\"\\";
        if (const char* found = c ? std::char_traits<char>::find(kFrom, 7, c) : nullptr) {
            out += kTo[found - kFrom];
            return;
        }
        const size_t digits = c == 'u' ? 4 : c == 'U' ? 8 : 0;
        if (!digits) refuse(std::string("\\") + c + " means nothing in \"…\". Remedy: \\\\ for a backslash, or '…' around the text");
        uint32_t code = 0;
        const char* begin = text_.data() + at_;
        const auto read = at_ + digits <= text_.size() ? std::from_chars(begin, begin + digits, code, 16) : std::from_chars_result{begin, std::errc()};
        if (read.ptr != begin + digits || code > 0x10ffff || (code >= 0xd800 && code < 0xe000)) refuse(std::string("\\") + c + ": is not a character's number");
        at_ += digits;
        if (code < 0x80) {
            out += static_cast<char>(code);
        } else {  // UTF-8
            const int more = code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;
            out += static_cast<char>((0xff00U >> (more + 1) & 0xffU) | code >> (6 * more));
            for (int k = more - 1; k >= 0; --k) out += static_cast<char>(0x80U | (code >> (6 * k) & 0x3fU));
        }
    }

    const std::string& text_;
    const std::string& file_;
    size_t at_ = 0;
    int line_ = 1;
    std::vector<std::string> section_;
    std::set<std::vector<std::string>> seen_;
    std::vector<ConfigLine> out_;
};

}  // namespace

std::vector<ConfigLine> parse_config(const std::string& text, const std::string& file) { return Parser(text, file).run(); }

std::string command_of(const ReconstructOptions& options) {
    switch (options.run.last_stage) {
        case LastStage::Mask:
            return "mask";
        case LastStage::Align:
            return "align";
        case LastStage::Carve:
            return "carve";
        case LastStage::Export:
            break;
    }
    return "reconstruct";
}

namespace {
unsigned bit_of(LastStage last) {
    return last == LastStage::Mask ? in::kMask : last == LastStage::Align ? in::kAlign : last == LastStage::Carve ? in::kCarve : in::kReconstruct;
}
}  // namespace

std::string config_text(const ReconstructOptions& options) {
    ReconstructOptions asked = options, said;
    const std::vector<OptionEntry> entries = list_options(asked), read_back = list_options(said);
    const std::string command = command_of(options);
    std::string out;
    const auto say = [&](size_t i, const std::vector<std::string>& values) {
        out += line_of(command, entries[i], values);
        read_back[i].set(values);
    };
    for (size_t i = 0; i < entries.size(); ++i)
        if (const std::vector<std::string> values = entries[i].values();
            !values.empty() && !entries[i].is_hidden() && (entries[i].about.commands & bit_of(options.run.last_stage)))
            say(i, values);
    apply_implied(said);
    // What only a caller of the library can ask for, where it did.
    for (size_t i = 0; i < entries.size(); ++i)
        if (const std::vector<std::string> values = entries[i].values(); entries[i].is_hidden() && !values.empty() && values != read_back[i].values())
            say(i, values);
    return out;
}

ReconstructOptions read_config(const std::string& text, const std::string& file, const std::string& command) {
    ReconstructOptions options;
    std::vector<OptionChange> changes;
    const std::vector<OptionEntry> entries = list_options(options);
    for (const ConfigLine& line : parse_config(text, file)) {
        if (line.path.size() != 2 || line.path[0] != command || line.path[1] == "resume") continue;  // others' options, and what changes nothing
        if (std::none_of(entries.begin(), entries.end(), [&](const OptionEntry& e) { return line.path[1] == e.about.name; }))
            throw UsageError(text_of("%s, line %d: unknown option %s.%s", file.c_str(), line.line, command.c_str(), line.path[1].c_str()));
        changes.push_back({line.path[1], line.values});
    }
    if (command == "mask") options.run.last_stage = LastStage::Mask;
    if (command == "align") options.run.last_stage = LastStage::Align, options.cameras.find_again = true;
    if (command == "carve") options.run.last_stage = LastStage::Carve;
    change_options(options, changes);
    return options;
}

Reconstruction redo(const std::filesystem::path& output, const std::function<void(ReconstructOptions&)>& change, Progress& progress) {
    const std::filesystem::path file = output / "config.toml";
    std::ifstream in(file, std::ios::binary);
    const std::string text((std::istreambuf_iterator<char>(in)), {});
    ReconstructOptions options = read_config(text, file.string());
    if (options.views.scene.empty())
        throw InputError(file.string() + ": is not there, or not of `vdbcarve reconstruct`. Remedy: `vdbcarve reconstruct SCENE -o " + output.string() + "`");
    change(options);
    options.run.output = output;  // where the result is now counts, not where it was made
    return reconstruct(options, progress);
}

}  // namespace vdbcarve
