// SPDX-License-Identifier: Apache-2.0
// What --help says, as Markdown and as man pages: written from the options themselves, so that they cannot disagree.
#include <algorithm>
#include <cctype>
#include <cstdio>
#include <fstream>
#include <sstream>

#include "cli.h"
#include "vdbcarve/error.h"
#include "vdbcarve/version.h"

namespace vdbcarve::cli {
namespace {

namespace fs = std::filesystem;

/// One text in two dress codes.
class Page {
  public:
    virtual ~Page() = default;
    virtual void title(const std::string& name, const std::string& what) = 0;
    virtual void heading(const std::string& text) = 0;
    virtual void item(const std::string& term, const std::string& text) = 0;
    virtual void as_typed(const std::string& text) = 0;
    virtual void paragraph(const std::string& text) = 0;
    std::string text() const { return out_.str(); }

  protected:
    std::ostringstream out_;
};

class Markdown : public Page {
  public:
    void title(const std::string& name, const std::string& what) override { out_ << "# " << name << "\n\n" << escaped(what) << "\n"; }
    void heading(const std::string& text) override { out_ << "\n## " << text << "\n\n"; }
    void item(const std::string& term, const std::string& text) override {
        const size_t end = text.find('\n');  // a drawing may follow
        out_ << "- `" << term << "`  \n  " << escaped(text.substr(0, end)) << "\n";
        if (end != std::string::npos) {
            std::istringstream lines(text.substr(end + 1));
            out_ << "\n";
            for (std::string line; std::getline(lines, line);) out_ << "      " << line << "\n";
            out_ << "\n";
        }
    }
    void as_typed(const std::string& text) override { out_ << "```\n" << text << (text.empty() || text.back() != '\n' ? "\n" : "") << "```\n"; }
    void paragraph(const std::string& text) override { out_ << escaped(text) << "\n"; }

  private:
    static std::string escaped(const std::string& text) {
        std::string out;
        for (const char c : text) {
            if (c == '<' || c == '*' || c == '_' || c == '`' || c == '|') out += '\\';
            out += c;
        }
        return out;
    }
};

class Man : public Page {
  public:
    void title(const std::string& name, const std::string& what) override {
        std::string file = name;
        std::replace(file.begin(), file.end(), ' ', '-');
        out_ << ".TH \"" << upper(file) << "\" 1 \"\" \"vdbcarve " << kVersion << "\" \"vdbcarve\"\n.SH NAME\n" << roff(file) << " \\- " << roff(what) << "\n";
    }
    void heading(const std::string& text) override { out_ << ".SH " << roff(upper(text)) << "\n"; }
    void item(const std::string& term, const std::string& text) override {
        const size_t end = text.find('\n');
        out_ << ".TP\n.B " << roff(term) << "\n" << roff(text.substr(0, end)) << "\n";
        if (end != std::string::npos) as_typed(text.substr(end + 1));
    }
    void as_typed(const std::string& text) override { out_ << ".nf\n" << roff(text) << "\n.fi\n"; }
    void paragraph(const std::string& text) override { out_ << ".PP\n" << roff(text) << "\n"; }

  private:
    static std::string upper(std::string text) {
        for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
        return text;
    }
    static std::string roff(const std::string& text) {
        std::string out;
        bool starts = true;
        for (size_t i = 0; i < text.size(); ++i) {
            const char c = text[i];
            const auto byte = static_cast<unsigned char>(c);
            if (starts && (c == '.' || c == '\'')) out += "\\&";
            starts = c == '\n';
            if (byte >= 0xc0) {  // the first of a character's bytes in UTF-8
                const size_t more = byte >= 0xf0 ? 3 : byte >= 0xe0 ? 2 : 1;
                unsigned code = byte & (0x3fU >> more);
                for (size_t k = 0; k < more && i + 1 < text.size(); ++k) code = code << 6 | (static_cast<unsigned char>(text[++i]) & 0x3fU);
                char name[16];
                std::snprintf(name, sizeof name, "\\[u%04X]", code);
                out += name;
            } else if (c == '\\') {
                out += "\\e";
            } else if (c == '-') {
                out += "\\-";
            } else {
                out += c;
            }
        }
        return out;
    }
};

/// "--resolution N": CLI11's types say more than anybody wants to read.
std::string term_of(const CLI::Option& option) {
    std::string out = option.get_positional() ? option.get_name(true) : option.get_name(false, true);
    for (size_t at = 0; (at = out.find(',', at)) != std::string::npos; at += 2) out.replace(at, 1, ", ");
    std::string type = option.get_type_size() == 0 ? "" : option.get_type_name();
    type = type.substr(0, type.find(':'));
    if (!type.empty() && !option.get_positional()) out += " " + type;
    if (const std::string value = option.get_default_str(); !value.empty() && value != "\"\"" && option.get_type_size() != 0) out += " (" + value + ")";
    return out;
}

void fill(Page& page, const CLI::App& app, const std::string& name) {
    page.title(name, app.get_description());
    std::string usage = name;
    for (const CLI::Option* o : app.get_options())
        if (o->get_required()) usage += o->get_positional() ? " " + o->get_name(true) : " " + o->get_name(false, false) + " " + o->get_type_name();
    page.heading("Synopsis");
    page.as_typed(usage + (app.get_subcommands([](const CLI::App*) { return true; }).empty() ? " [options]" : " COMMAND [options]"));
    const auto commands = app.get_subcommands([](const CLI::App*) { return true; });
    if (!commands.empty()) {
        page.heading("Commands");
        for (const CLI::App* c : commands) page.item(c->get_name(), c->get_description());
    }
    std::vector<std::string> groups;
    for (const CLI::Option* o : app.get_options())
        if (!o->get_group().empty() && std::find(groups.begin(), groups.end(), o->get_group()) == groups.end()) groups.push_back(o->get_group());
    for (const std::string& group : groups) {
        page.heading(group);
        for (const CLI::Option* o : app.get_options())
            if (o->get_group() == group) page.item(term_of(*o), o->get_description());
    }
    // A footer is examples, indented, and sentences around them.
    std::string examples, sentences;
    std::istringstream footer(app.get_footer());
    for (std::string line; std::getline(footer, line);) {
        if (line.rfind("  ", 0) == 0) examples += line.substr(2) + "\n";
        else if (line != "Examples:" && line.rfind("Exit codes:", 0) != 0) sentences += (sentences.empty() ? "" : " ") + line;
    }
    if (!sentences.empty()) {
        page.heading("Notes");
        page.paragraph(sentences);
    }
    if (!examples.empty()) {
        page.heading("Examples");
        page.as_typed(examples);
    }
    page.heading("Exit status");
    page.paragraph(kExitCodes);
}

void write_page(const fs::path& file, const std::string& text) {
    std::ofstream out(file, std::ios::binary);
    out << text;
    if (!out.flush()) throw OutputError(file.string() + ": cannot be written");
}

}  // namespace

void write_pages(const CLI::App& program, const fs::path& folder) {
    fs::create_directories(folder);
    const auto write = [&](const CLI::App& app, const std::string& name, const std::string& file) {
        Markdown markdown;
        fill(markdown, app, name);
        write_page(folder / (file + ".md"), markdown.text());
        Man man;
        fill(man, app, name);
        write_page(folder / ((file == "vdbcarve" ? file : "vdbcarve-" + file) + ".1"), man.text());
    };
    write(program, "vdbcarve", "vdbcarve");
    for (const CLI::App* command : program.get_subcommands([](const CLI::App*) { return true; }))
        write(*command, "vdbcarve " + command->get_name(), command->get_name());
}

}  // namespace vdbcarve::cli
