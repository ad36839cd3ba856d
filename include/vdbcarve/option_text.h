// SPDX-License-Identifier: Apache-2.0
// Text forms of the values of options that are more than a word, a number or a string. What print() writes, parse() reads back to the same bits.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/align.h"
#include "vdbcarve/board.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve {

/// The shortest text that reads back to the same number.
std::string number_text(double value);

/// The text as a finite number. Throws UsageError naming the option.
double number(const std::string& option, const std::string& text);

/// "a,b,c" as numbers. Throws UsageError naming the option.
std::vector<double> numbers(const std::string& option, const std::string& text, size_t count, char separator = ',');

/// "R,G,B" (0..255) or "#rrggbb". Throws UsageError naming the option, and the words that it takes besides.
std::array<uint8_t, 3> rgb8_of(const std::string& option, const std::string& text, const std::string& words = "");

/// 1024x512x1024
struct DimsForm {
    static std::string print(const std::array<int, 3>& dims);
    static void parse(const std::string& option, const std::string& text, std::array<int, 3>& dims);
    static std::string fault(const std::string& option, const std::array<int, 3>& dims);
};

/// xmin,ymin,zmin,xmax,ymax,zmax
struct BoxForm {
    static std::string print(const Box3d& box);
    static void parse(const std::string& option, const std::string& text, Box3d& box);
    static std::string fault(const std::string& option, const Box3d& box);
};

/// x,y,z
struct PointForm {
    static std::string print(const Vec3d& point);
    static void parse(const std::string& option, const std::string& text, Vec3d& point);
    static std::string fault(const std::string& option, const Vec3d& point);
};

/// x,y
struct PixelForm {
    static std::string print(const Vec2d& pixel);
    static void parse(const std::string& option, const std::string& text, Vec2d& pixel);
    static std::string fault(const std::string& option, const Vec2d& pixel);
};

/// x0,y0,x1,y1
struct PixelBoxForm {
    static std::string print(const std::array<int, 4>& box);
    static void parse(const std::string& option, const std::string& text, std::array<int, 4>& box);
    static std::string fault(const std::string& option, const std::array<int, 4>& box);
};

/// R,G,B or #rrggbb
struct RgbForm {
    static std::string print(const std::array<uint8_t, 3>& rgb);
    static void parse(const std::string& option, const std::string& text, std::array<uint8_t, 3>& rgb);
};

/// FROM,TO in seconds; TO 0: to the end
struct VideoRangeForm {
    static std::string print(double from_s, double to_s);
    static void parse(const std::string& option, const std::string& text, double& from_s, double& to_s);
    static std::string fault(const std::string& option, double from_s, double to_s);
};

/// grid:COLSxROWS:MARKER:GAP:DICT or charuco:COLSxROWS:SQUARE:MARKER:DICT, or a file with a layout
struct MatForm {
    static std::string print(const MatLayout& mat);
    static void parse(const std::string& option, const std::string& text, MatLayout& mat);
};

/// A,B
struct PaperViewsForm {
    static std::string print(const std::array<std::string, 2>& names);
    static void parse(const std::string& option, const std::string& text, std::array<std::string, 2>& names);
};

/// equal, 0,10,20 or a file with numbers
struct AnglesForm {
    static std::string print(const std::vector<double>& angles);
    static void parse(const std::string& option, const std::string& text, std::vector<double>& angles);
    static std::string fault(const std::string& option, const std::vector<double>& angles);
};

/// 24,24, or a file with numbers
struct CountsForm {
    static std::string print(const std::vector<int>& counts);
    static void parse(const std::string& option, const std::string& text, std::vector<int>& counts);
    static std::string fault(const std::string& option, const std::vector<int>& counts);
};

/// degrees, or auto
struct ArcForm {
    static std::string print(double arc_deg, bool known);
    static void parse(const std::string& option, const std::string& text, double& arc_deg, bool& known);
    static std::string fault(const std::string& option, double arc_deg, bool known);
};

/// VIEW:X1,Y1,X2,Y2:LENGTH
struct KnownLengthForm {
    static std::string print(const KnownLength& length);
    static void parse(const std::string& option, const std::string& text, KnownLength& length);
};

/// gain, channels or none
struct ExposureForm {
    static std::string print(bool estimate, bool per_channel);
    static void parse(const std::string& option, const std::string& text, bool& estimate, bool& per_channel);
};

/// NAME[:WIDTH][xITERATIONS],… or none; auto where there is no value
struct FiltersForm {
    static std::string print(const std::optional<std::vector<FilterStep>>& steps);
    static void parse(const std::string& option, const std::string& text, std::optional<std::vector<FilterStep>>& steps);
    static std::string fault(const std::string& option, const std::optional<std::vector<FilterStep>>& steps);
};

/// A number of iterations; auto where there is no value
struct IterationsForm {
    static constexpr int kMost = 10000;
    static std::string print(const std::optional<int>& iterations);
    static void parse(const std::string& option, const std::string& text, std::optional<int>& iterations);
    static std::string fault(const std::string& option, const std::optional<int>& iterations);
};

/// The frequency that smoothing passes, as its growing factor
struct PassBandForm {
    static std::string print(double, double) { return ""; }  // --smooth-mu says the same
    static void parse(const std::string& option, const std::string& text, double& lambda, double& mu);
};

/// Bytes: 8G, 500M, 64K or plain; powers of 1024
struct BytesForm {
    static std::string print(size_t bytes);
    static void parse(const std::string& option, const std::string& text, size_t& bytes);
};

}  // namespace vdbcarve
