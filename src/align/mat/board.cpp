// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/board.h"

#include <zlib.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "align/mat/aruco.h"
#include "base/atomic_file.h"
#include "image/image_io.h"
#include "base/text.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

constexpr double kPointsPerMetre = 72 / 0.0254;

void put_big(std::vector<uint8_t>& out, uint32_t value) {
    for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<uint8_t>(value >> shift));
}

/// A PNG's chunk that says how many pixels a metre has, after the header chunk.
std::vector<uint8_t> with_resolution(const std::vector<uint8_t>& png, double dots_per_metre) {
    std::vector<uint8_t> chunk{'p', 'H', 'Y', 's'};
    const auto dots = static_cast<uint32_t>(std::lround(dots_per_metre));
    put_big(chunk, dots);
    put_big(chunk, dots);
    chunk.push_back(1);                                       // a metre
    std::vector<uint8_t> out(png.begin(), png.begin() + 33);  // signature (8) and IHDR (25)
    put_big(out, 9);
    out.insert(out.end(), chunk.begin(), chunk.end());
    put_big(out, static_cast<uint32_t>(crc32(0, chunk.data(), static_cast<uInt>(chunk.size()))));
    out.insert(out.end(), png.begin() + 33, png.end());
    return out;
}

/// One page with one picture in true size.
std::string pdf_of(const Image8& image, double dots_per_metre) {
    uLongf size = compressBound(image.data.size());
    std::string packed(size, '\0');
    if (compress2(reinterpret_cast<Bytef*>(packed.data()), &size, image.data.data(), image.data.size(), 9) != Z_OK)
        throw OutputError("board: the picture could not be compressed");
    packed.resize(size);
    char width[32], height[32];
    std::snprintf(width, sizeof width, "%.4f", image.width / dots_per_metre * kPointsPerMetre);
    std::snprintf(height, sizeof height, "%.4f", image.height / dots_per_metre * kPointsPerMetre);
    const std::string content = std::string("q ") + width + " 0 0 " + height + " 0 0 cm /Mat Do Q";
    const std::string objects[] = {
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>", "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        std::string("<< /Type /Page /Parent 2 0 R /MediaBox [0 0 ") + width + " " + height + "] /Contents 4 0 R /Resources << /XObject << /Mat 5 0 R >> >> >>",
        "<< /Length " + std::to_string(content.size()) + " >>\nstream\n" + content + "\nendstream",
        "<< /Type /XObject /Subtype /Image /Width " + std::to_string(image.width) + " /Height " + std::to_string(image.height) +
            " /ColorSpace /DeviceGray /BitsPerComponent 8 /Filter /FlateDecode /Length " + std::to_string(packed.size()) + " >>\nstream\n" + packed +
            "\nendstream"};
    std::string out = "%PDF-1.4\n";
    std::vector<size_t> starts;
    for (size_t i = 0; i < std::size(objects); ++i) {
        starts.push_back(out.size());
        out += std::to_string(i + 1) + " 0 obj\n" + objects[i] + "\nendobj\n";
    }
    const size_t table = out.size();
    out += "xref\n0 " + std::to_string(std::size(objects) + 1) + "\n0000000000 65535 f \n";
    for (size_t s : starts) {
        char line[24];
        std::snprintf(line, sizeof line, "%010zu 00000 n \n", s);
        out += line;
    }
    return out + "trailer\n<< /Size " + std::to_string(std::size(objects) + 1) + " /Root 1 0 R >>\nstartxref\n" + std::to_string(table) + "\n%%EOF\n";
}

double length(const std::string& text, const std::string& where) {
    try {
        size_t used = 0;
        const double value = std::stod(text, &used);
        if (used == text.size() && std::isfinite(value) && value > 0) return value;
    } catch (const std::exception&) {
    }
    throw UsageError("--mat " + where + ": '" + text + "' is no length in metres");
}

}  // namespace

double MatLayout::width_m() const { return kind == Kind::Grid ? (columns - 1) * step_m + marker_m : columns * step_m; }
double MatLayout::height_m() const { return kind == Kind::Grid ? (rows - 1) * step_m + marker_m : rows * step_m; }

void check_mat(const MatLayout& mat) {
    std::string bad;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) bad += (bad.empty() ? "" : "; ") + what;
    };
    need(mat.columns >= 2 && mat.rows >= 2 && mat.columns <= 100 && mat.rows <= 100,
         "mat: " + std::to_string(mat.columns) + "x" + std::to_string(mat.rows) + ", must be 2x2 to 100x100");
    need(mat.kind == MatLayout::Kind::Grid || mat.rows % 2 == 1,
         "mat: a chessboard of " + std::to_string(mat.rows) +
             " rows; the number must be odd, as even ones are drawn differently by different versions of OpenCV");
    need(mat.marker_m > 0 && mat.step_m > mat.marker_m,
         mat.kind == MatLayout::Kind::Grid
             ? "mat: markers need a gap between them"
             : text_of("mat: a marker of %g m must be smaller than its square of %g m (SQUARE:MARKER)", mat.marker_m, mat.step_m));
    need(mat.marker_m <= 1 && mat.width_m() <= 10 && mat.height_m() <= 10,
         text_of("mat: markers of %g m, %g x %g m in all: lengths are in metres, %g mm are %g", mat.marker_m, mat.width_m(), mat.height_m(), mat.marker_m,
                 mat.marker_m / 1000));
    const int known = dictionary_size(mat.dictionary);
    const int used = mat.kind == MatLayout::Kind::Grid ? mat.columns * mat.rows : mat.columns * mat.rows / 2;
    need(known == 0 || used <= known, "mat: " + std::to_string(used) + " markers, the dictionary " + mat.dictionary + " has " + std::to_string(known));
    need(known > 0, "mat: no dictionary '" + mat.dictionary + "' (4X4_50 … 7X7_1000)");
    if (!bad.empty()) throw UsageError(bad);
}

MatLayout read_mat(const std::string& text) {
    MatLayout out;
    if (fs::is_regular_file(text)) {
        try {
            std::ifstream in(text);
            const nlohmann::json j = nlohmann::json::parse(in);
            const std::string kind = j.at("kind");
            if (kind != "grid" && kind != "charuco") throw InputError(text + ": 'kind' is '" + kind + "', must be grid or charuco");
            out.kind = kind == "grid" ? MatLayout::Kind::Grid : MatLayout::Kind::Charuco;
            out.columns = j.at("columns");
            out.rows = j.at("rows");
            out.marker_m = j.at("marker_m");
            out.step_m = j.at("step_m");
            out.dictionary = j.at("dictionary");
        } catch (const nlohmann::json::exception& e) {
            throw InputError(
                text + ": is no mat's layout" +
                (fs::is_regular_file(text + ".json") ? ". Remedy: --mat " + text + ".json, which was written beside it" : std::string(": ") + e.what()));
        }
        check_mat(out);
        return out;
    }
    std::vector<std::string> words;
    std::istringstream in(text);
    for (std::string word; std::getline(in, word, ':');) words.push_back(word);
    if ((words.size() != 4 && words.size() != 5) || (words[0] != "grid" && words[0] != "charuco"))
        throw UsageError(
            "--mat " + text + (text.find(':') == std::string::npos ? ": there is no such file, and it is" : ": is") +
            (words.size() == 2 || words.size() == 3 ? text_of(" incomplete (%s of 4 or 5), and", counted(words.size(), "field").c_str()) : std::string()) +
            " neither a file nor grid:COLSxROWS:MARKER:GAP:DICT or charuco:COLSxROWS:SQUARE:MARKER:DICT (metres)");
    out.kind = words[0] == "grid" ? MatLayout::Kind::Grid : MatLayout::Kind::Charuco;
    char cross = 0, rest = 0;
    std::istringstream size(words[1]);
    if (!(size >> out.columns >> cross >> out.rows) || cross != 'x' || size >> rest) throw UsageError("--mat " + text + ": '" + words[1] + "' is not like 5x7");
    const double first = length(words[2], text), second = length(words[3], text);
    out.marker_m = out.kind == MatLayout::Kind::Grid ? first : second;
    out.step_m = out.kind == MatLayout::Kind::Grid ? first + second : first;
    if (words.size() == 5) {
        std::string name = words[4];  // "DICT_6X6_250" and "6x6_250" are the same
        std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
        out.dictionary = name.rfind("DICT_", 0) == 0 ? name.substr(5) : name;
    }
    check_mat(out);
    return out;
}

Image8 draw_board(const MatLayout& mat, double margin_m, double& dots_per_metre) {
    check_mat(mat);
    const int bits = marker_bits(mat.dictionary) + 2;  // with the black border
    // A module of a marker is a whole number of dots; so is the step, to a thousandth of itself.
    int module = std::max(1, static_cast<int>(std::ceil(dots_per_metre * mat.marker_m / bits)));
    double dots = 0;
    int step = 0;
    for (;; ++module) {
        dots = module * bits / mat.marker_m;
        step = static_cast<int>(std::lround(mat.step_m * dots));
        if (std::fabs(step / dots - mat.step_m) < 1e-3 * mat.step_m / 5 || module > 400) break;
    }
    dots_per_metre = dots;
    const int marker = module * bits, margin = static_cast<int>(std::lround(margin_m * dots));
    const bool grid = mat.kind == MatLayout::Kind::Grid;
    const int width = grid ? (mat.columns - 1) * step + marker : mat.columns * step, height = grid ? (mat.rows - 1) * step + marker : mat.rows * step;
    Image8 out(width + 2 * margin, height + 2 * margin, 1, 255);
    const auto place = [&](int id, int x0, int y0) {
        const Image8 m = marker_image(mat.dictionary, id, marker);
        for (int y = 0; y < marker; ++y)
            for (int x = 0; x < marker; ++x) out.at(margin + x0 + x, margin + y0 + y) = m.at(x, y);
    };
    int id = 0;
    for (int r = 0; r < mat.rows; ++r)
        for (int c = 0; c < mat.columns; ++c) {
            if (grid) {
                place(id++, c * step, r * step);
            } else if ((r + c) % 2 == 0) {  // the first square is black
                for (int y = 0; y < step; ++y)
                    for (int x = 0; x < step; ++x) out.at(margin + c * step + x, margin + r * step + y) = 0;
            } else {
                place(id++, c * step + (step - marker) / 2, r * step + (step - marker) / 2);
            }
        }
    return out;
}

void write_board(const MatLayout& mat, const fs::path& file, double margin_m) {
    if (!(margin_m >= 0 && margin_m < 1)) throw UsageError("board: a margin of " + std::to_string(margin_m) + " m, must be within 0..1");
    const std::string extension = file.extension().string();
    if (extension != ".png" && extension != ".pdf") throw UsageError(file.string() + ": a mat is written as .png or .pdf");
    double dots = 300 / 0.0254;
    const Image8 image = draw_board(mat, margin_m, dots);
    if (extension == ".png") {
        const std::vector<uint8_t> png = with_resolution(io::encode_png(image), dots);
        write_file(file, png.data(), png.size());
    } else {
        write_file(file, pdf_of(image, dots));
    }
    fs::path layout = file;
    layout += ".json";
    write_file(layout, nlohmann::json{{"kind", mat.kind == MatLayout::Kind::Grid ? "grid" : "charuco"},
                                      {"columns", mat.columns},
                                      {"rows", mat.rows},
                                      {"marker_m", mat.marker_m},
                                      {"step_m", mat.step_m},
                                      {"dictionary", mat.dictionary}}
                               .dump(1) +
                           "\n");
}

}  // namespace vdbcarve
