// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/option_text.h"

#include <algorithm>
#include <cstdlib>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "base/text.h"
#include "vdbcarve/error.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/smooth.h"

namespace vdbcarve {

std::string number_text(double value) {
    // Whole numbers without an exponent: 50000, not 5e+04.
    if (std::fabs(value) < 1e15 && value == std::floor(value)) return text_of("%.0f", value);
    char text[40];
    return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

double number(const std::string& option, const std::string& text) { return numbers(option, text, 1, '\0')[0]; }

std::vector<double> numbers(const std::string& option, const std::string& text, size_t count, char separator) {
    std::vector<double> out;
    std::istringstream in(text);
    for (std::string word; std::getline(in, word, separator);) {
        char* end = nullptr;
        out.push_back(std::strtod(word.c_str(), &end));  // std::stod refuses the smallest numbers
        if (word.empty() || end != word.c_str() + word.size() || !std::isfinite(out.back()))
            throw UsageError(option + " " + text + ": '" + word + "' is not a finite number");
    }
    if (out.size() != count)
        throw UsageError(option + " " + text + ": " +
                         (count == 1 ? "a number is expected" : std::to_string(count) + " numbers are expected, separated by '" + separator + "'"));
    return out;
}

std::array<uint8_t, 3> rgb8_of(const std::string& option, const std::string& text, const std::string& words) {
    const auto refuse = [&] {
        return UsageError(option + " " + text + ": must be " + (words.empty() ? "" : words + ", ") + "R,G,B within 0..255, or #rrggbb, like #00b140");
    };
    std::array<uint8_t, 3> out{};
    if (text.size() == 7 && text[0] == '#' && text.find_first_not_of("0123456789abcdefABCDEF", 1) == std::string::npos) {
        for (size_t k = 0; k < 3; ++k) out[k] = static_cast<uint8_t>(std::stoi(text.substr(1 + 2 * k, 2), nullptr, 16));
        return out;
    }
    if (std::count(text.begin(), text.end(), ',') != 2) throw refuse();
    const std::vector<double> c = numbers(option, text, 3);
    for (size_t k = 0; k < 3; ++k) {
        if (!(c[k] >= 0 && c[k] <= 255)) throw refuse();
        out[k] = static_cast<uint8_t>(std::lround(c[k]));
    }
    return out;
}

std::string Range::text() const {
    const auto limit = [](double x) { return number_text(x); };
    constexpr double kMost = std::numeric_limits<double>::max();
    std::string out;
    for (const Word<double>& w : words) out += std::string(w.text) + (&w + 1 == words.data() + words.size() ? " or " : ", ");
    if (least > -kMost && most < kMost) return out + limit(least) + ".." + limit(most);
    if (least > -kMost) return out + (above ? "> " : ">= ") + limit(least);
    return out + "a finite number";
}

std::string OneOf::list() const {
    std::string out;
    for (const char* word : all) out += (out.empty() ? "" : ", ") + std::string(word);
    return out;
}

namespace {

template <class Values>
std::string list_text(const Values& values, char separator = ',') {
    std::string out;
    for (const auto& v : values) out += (out.empty() ? "" : std::string(1, separator)) + number_text(static_cast<double>(v));
    return out;
}

bool is_whole(double value, double least, double most) { return value == std::floor(value) && value >= least && value <= most; }

/// Words of a list or of a text file: "0,10,20" or angles.txt.
std::vector<double> list_of(const std::string& option, std::string text) {
    const std::string given = text;
    const bool from_file = std::filesystem::is_regular_file(text);
    if (from_file) {
        std::ifstream in(text);
        std::ostringstream all;
        all << in.rdbuf();
        text = all.str();
    }
    for (char& c : text)
        if (c == ',' || c == ';') c = ' ';
    std::vector<double> out;
    std::istringstream words(text);
    for (std::string word; words >> word;) {
        try {
            out.push_back(number(option, word));
        } catch (const UsageError&) {
            throw UsageError(option + " " + given + ": '" + word + "' is no number" + (from_file ? "" : ", and there is no such file"));
        }
    }
    return out;
}

}  // namespace

std::string DimsForm::print(const std::array<int, 3>& dims) { return list_text(dims, 'x'); }
void DimsForm::parse(const std::string& option, const std::string& text, std::array<int, 3>& dims) {
    const std::vector<double> g = numbers(option, text, 3, 'x');
    for (const double d : g)
        if (!is_whole(d, 1, 65536)) throw UsageError(option + " " + text + ": sides must be whole numbers within 1..65536");
    for (size_t a = 0; a < 3; ++a) dims[a] = static_cast<int>(g[a]);
}
std::string DimsForm::fault(const std::string& option, const std::array<int, 3>& dims) {
    for (const int d : dims)
        if (d < 1 || d > 65536) return option + " " + print(dims) + ": sides must be whole numbers within 1..65536";
    return "";
}

std::string BoxForm::print(const Box3d& box) {
    const Vec3d a = box.min(), b = box.max();
    return list_text(std::array{a[0], a[1], a[2], b[0], b[1], b[2]});
}
void BoxForm::parse(const std::string& option, const std::string& text, Box3d& box) {
    const std::vector<double> b = numbers(option, text, 6);
    box.min() = Vec3d(b[0], b[1], b[2]);
    box.max() = Vec3d(b[3], b[4], b[5]);
    if (const std::string wrong = fault(option, box); !wrong.empty()) throw UsageError(wrong);
}
std::string BoxForm::fault(const std::string& option, const Box3d& box) {
    const Vec3d size = box.max() - box.min();
    return size.allFinite() && size.minCoeff() > 0 ? "" : option + " has no volume: every maximum must exceed its minimum";
}

std::string PointForm::print(const Vec3d& p) { return list_text(std::array{p[0], p[1], p[2]}); }
void PointForm::parse(const std::string& option, const std::string& text, Vec3d& point) {
    const std::vector<double> p = numbers(option, text, 3);
    point = Vec3d(p[0], p[1], p[2]);
}
std::string PointForm::fault(const std::string& option, const Vec3d& point) { return point.allFinite() ? "" : option + " is not finite"; }

std::string PixelForm::print(const Vec2d& p) { return list_text(std::array{p[0], p[1]}); }
void PixelForm::parse(const std::string& option, const std::string& text, Vec2d& pixel) {
    const std::vector<double> p = numbers(option, text, 2);
    pixel = Vec2d(p[0], p[1]);
}
std::string PixelForm::fault(const std::string& option, const Vec2d& pixel) { return pixel.allFinite() ? "" : option + " is not finite"; }

std::string PixelBoxForm::print(const std::array<int, 4>& box) { return list_text(box); }
void PixelBoxForm::parse(const std::string& option, const std::string& text, std::array<int, 4>& box) {
    const std::vector<double> b = numbers(option, text, 4);
    for (size_t k = 0; k < 4; ++k) {
        if (std::fabs(b[k]) > 1e6) throw UsageError(option + " " + text + ": pixels must be within -1e6..1e6");
        box[k] = static_cast<int>(b[k]);
    }
    if (!(b[2] > b[0] && b[3] > b[1])) throw UsageError(option + " " + text + ": must be x0,y0,x1,y1 with x1 > x0 and y1 > y0, pixels");
}
std::string PixelBoxForm::fault(const std::string& option, const std::array<int, 4>& b) {
    return b[2] > b[0] && b[3] > b[1] ? "" : option + " " + print(b) + ": must be x0,y0,x1,y1 with x1 > x0 and y1 > y0, pixels";
}

std::string RgbForm::print(const std::array<uint8_t, 3>& rgb) { return list_text(rgb); }
void RgbForm::parse(const std::string& option, const std::string& text, std::array<uint8_t, 3>& rgb) { rgb = rgb8_of(option, text); }

std::string VideoRangeForm::print(double from_s, double to_s) { return from_s == 0 && to_s == 0 ? "" : list_text(std::array{from_s, to_s}); }
void VideoRangeForm::parse(const std::string& option, const std::string& text, double& from_s, double& to_s) {
    if (std::count(text.begin(), text.end(), ',') != 1) throw UsageError(option + " " + text + ": FROM,TO in seconds is expected, like 2,14.5");
    const std::vector<double> r = numbers(option, text, 2);
    if (const std::string wrong = fault(option, r[0], r[1]); !wrong.empty()) throw UsageError(wrong);
    from_s = r[0];
    to_s = r[1];
}
std::string VideoRangeForm::fault(const std::string& option, double from_s, double to_s) {
    return from_s >= 0 && (to_s > from_s || to_s == 0) && std::isfinite(from_s + to_s)
               ? ""
               : option + " " + list_text(std::array{from_s, to_s}) + ": FROM,TO in seconds is expected, the second more than the first";
}

std::string MatForm::print(const MatLayout& mat) {
    const std::string size = std::to_string(mat.columns) + "x" + std::to_string(mat.rows);
    if (mat.kind == MatLayout::Kind::Charuco) return "charuco:" + size + ":" + number_text(mat.step_m) + ":" + number_text(mat.marker_m) + ":" + mat.dictionary;
    double gap = mat.step_m - mat.marker_m;  // which may have lost a bit: what is read back is marker + gap
    while (mat.marker_m + gap < mat.step_m) gap = std::nextafter(gap, 2 * gap + 1);
    while (mat.marker_m + gap > mat.step_m) gap = std::nextafter(gap, -1);
    return "grid:" + size + ":" + number_text(mat.marker_m) + ":" + number_text(gap) + ":" + mat.dictionary;
}
void MatForm::parse(const std::string&, const std::string& text, MatLayout& mat) { mat = read_mat(text); }

std::string PaperViewsForm::print(const std::array<std::string, 2>& names) {
    if (names[0].empty() && names[1].empty()) return "";
    std::string out;
    for (const std::string& name : names) {
        if (&name != &names[0]) out += ',';
        for (const char c : name) {
            if (c == ',' || c == '\\') out += '\\';
            out += c;
        }
    }
    return out;
}
void PaperViewsForm::parse(const std::string& option, const std::string& text, std::array<std::string, 2>& names) {
    std::vector<std::string> words(1);
    for (size_t i = 0; i < text.size(); ++i) {
        if (text[i] == '\\' && i + 1 < text.size()) words.back() += text[++i];
        else if (text[i] == ',') words.emplace_back();
        else words.back() += text[i];
    }
    if (words.size() != 2) throw UsageError(option + " " + text + ": two names are expected, like 01,10");
    names = {words[0], words[1]};
}

std::string AnglesForm::print(const std::vector<double>& angles) { return list_text(angles); }
void AnglesForm::parse(const std::string& option, const std::string& text, std::vector<double>& angles) {
    angles = text == "equal" ? std::vector<double>() : list_of(option, text);
}
std::string AnglesForm::fault(const std::string& option, const std::vector<double>& angles) {
    return std::all_of(angles.begin(), angles.end(), [](double a) { return std::isfinite(a); }) ? "" : option + ": not all angles are finite";
}

std::string CountsForm::print(const std::vector<int>& counts) { return list_text(counts); }
void CountsForm::parse(const std::string& option, const std::string& text, std::vector<int>& counts) {
    std::vector<int> out;
    for (const double v : list_of(option, text)) {
        if (!is_whole(v, 1, 1e6)) throw UsageError(option + " " + text + ": whole numbers of views are expected, like 24,24");
        out.push_back(static_cast<int>(v));
    }
    counts = out;
}
std::string CountsForm::fault(const std::string& option, const std::vector<int>& counts) {
    return std::all_of(counts.begin(), counts.end(), [](int n) { return n >= 1 && n <= 1000000; })
               ? ""
               : option + " " + print(counts) + ": whole numbers of views are expected, like 24,24";
}

std::string ArcForm::print(double arc_deg, bool known) { return known ? number_text(arc_deg) : "auto"; }
void ArcForm::parse(const std::string& option, const std::string& text, double& arc_deg, bool& known) {
    if (text != "auto") {
        const double value = number(option, text);
        if (const std::string wrong = fault(option, value, true); !wrong.empty()) throw UsageError(wrong);
        arc_deg = value;
    }
    known = text != "auto";
}
std::string ArcForm::fault(const std::string& option, double arc_deg, bool) {
    return arc_deg >= 20 && arc_deg <= 3600 ? "" : option + ": " + number_text(arc_deg) + " degrees, must be 20..3600";
}

std::string KnownLengthForm::print(const KnownLength& k) {
    return k.view + ":" + list_text(std::array{k.from_px[0], k.from_px[1], k.to_px[0], k.to_px[1]}) + ":" + number_text(k.length);
}
void KnownLengthForm::parse(const std::string& option, const std::string& text, KnownLength& length) {
    const size_t last = text.rfind(':'), first = last == std::string::npos || last == 0 ? std::string::npos : text.rfind(':', last - 1);
    if (first == std::string::npos || first == 0) throw UsageError(option + " " + text + ": VIEW:X1,Y1,X2,Y2:LENGTH is expected, like 01:100,200,300,200:50");
    const std::vector<double> p = numbers(option, text.substr(first + 1, last - first - 1), 4);
    length = {text.substr(0, first), {p[0], p[1]}, {p[2], p[3]}, number(option, text.substr(last + 1))};
}

std::string ExposureForm::print(bool estimate, bool per_channel) { return !estimate ? "none" : per_channel ? "channels" : "gain"; }
void ExposureForm::parse(const std::string& option, const std::string& text, bool& estimate, bool& per_channel) {
    if (text != "gain" && text != "channels" && text != "none") throw UsageError(option + " " + text + ": must be one of gain, channels, none");
    estimate = text != "none";
    per_channel = text == "channels";
}

std::string FiltersForm::print(const std::optional<std::vector<FilterStep>>& steps) { return steps ? filters_text(*steps) : "auto"; }
void FiltersForm::parse(const std::string&, const std::string& text, std::optional<std::vector<FilterStep>>& steps) {
    if (text == "auto") steps.reset();
    else steps = parse_filters(text);
}
std::string FiltersForm::fault(const std::string& option, const std::optional<std::vector<FilterStep>>& steps) {
    try {
        if (steps) parse_filters(filters_text(*steps));
        return "";
    } catch (const UsageError& e) {
        return e.what();
    } catch (const std::exception& e) {
        return option + ": " + e.what();
    }
}

std::string IterationsForm::print(const std::optional<int>& iterations) { return iterations ? std::to_string(*iterations) : "auto"; }
void IterationsForm::parse(const std::string& option, const std::string& text, std::optional<int>& iterations) {
    if (text == "auto") {
        iterations.reset();
        return;
    }
    const double value = number(option, text);
    if (!is_whole(value, 0, kMost)) throw UsageError(option + " is " + text + ", must be auto or 0.." + std::to_string(kMost) + " iterations");
    iterations = static_cast<int>(value);
}
std::string IterationsForm::fault(const std::string& option, const std::optional<int>& iterations) {
    return !iterations || (*iterations >= 0 && *iterations <= kMost)
               ? ""
               : option + " is " + std::to_string(*iterations) + ", must be auto or 0.." + std::to_string(kMost) + " iterations";
}

void PassBandForm::parse(const std::string& option, const std::string& text, double& lambda, double& mu) {
    const double band = number(option, text);
    if (band < 0) throw UsageError(option + " is " + text + ", must be >= 0");
    if (band > 0) mu = mu_for(lambda, band);
}

std::string BytesForm::print(size_t bytes) { return bytes ? std::to_string(bytes) : ""; }
void BytesForm::parse(const std::string& option, const std::string& text, size_t& bytes) {
    std::string digits = text;
    if (!digits.empty() && (digits.back() == 'B' || digits.back() == 'b')) digits.pop_back();
    const size_t unit = digits.empty() ? std::string::npos : std::string("KMGT").find(static_cast<char>(std::toupper(digits.back())));
    if (unit == std::string::npos) {
        const auto read = std::from_chars(digits.data(), digits.data() + digits.size(), bytes);  // all 64 bits of a plain number
        if (read.ec == std::errc() && read.ptr == digits.data() + digits.size() && bytes > 0) return;
    } else {
        digits.pop_back();
    }
    const double value = number(option, digits) * (unit == std::string::npos ? 1.0 : std::pow(1024.0, static_cast<double>(unit) + 1));
    if (!(value >= 1 && value < 9e18)) throw UsageError(option + " " + text + ": must be > 0");
    bytes = static_cast<size_t>(value);
}

std::string FloorForm::print(FloorOptions::From from, double height) {
    return from == FloorOptions::From::File ? "" : from == FloorOptions::From::Found ? "auto" : number_text(height);
}
void FloorForm::parse(const std::string& option, const std::string& text, FloorOptions::From& from, double& height) {
    if (text != "auto") {
        try {
            height = number(option, text);
        } catch (const UsageError&) {
            throw UsageError(option + " " + text + ": must be auto or a height, a number along the up axis");
        }
    }
    from = text == "auto" ? FloorOptions::From::Found : FloorOptions::From::Given;
}
std::string FloorForm::fault(const std::string& option, FloorOptions::From, double height) { return std::isfinite(height) ? "" : option + " is not finite"; }

std::string MethodForm::print(AlignMethod method, bool find_again) { return find_again ? Words(kAlignMethodWords).of(method) : ""; }
void MethodForm::parse(const std::string& option, const std::string& text, AlignMethod& method, bool& find_again) {
    std::string small = text;
    std::transform(small.begin(), small.end(), small.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    const Words words(kAlignMethodWords);
    const auto found = std::find_if(words.all.begin(), words.all.end(), [&](const auto& w) { return small == w.text; });
    if (found == words.all.end()) throw UsageError(option + " " + text + ": must be one of " + words.list());
    method = found->value;
    find_again = true;
}

std::string ColorGridsForm::print(bool views, bool confidence) {
    return std::string(views ? "views" : "") + (views && confidence ? "," : "") + (confidence ? "confidence" : "");
}
void ColorGridsForm::parse(const std::string& option, const std::string& text, bool& views, bool& confidence) {
    bool wants[2] = {};
    std::istringstream words(text);
    for (std::string word; std::getline(words, word, ',');) {
        if (word != "views" && word != "confidence") throw UsageError(option + " " + word + ": must be one of views, confidence");
        wants[word == "confidence"] = true;
    }
    views = wants[0];
    confidence = wants[1];
}

}  // namespace vdbcarve
