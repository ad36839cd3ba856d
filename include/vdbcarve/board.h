// SPDX-License-Identifier: Apache-2.0
// Marker mats to put the object on: what is printed, and where its markers are.
#pragma once

#include <filesystem>
#include <string>

#include "vdbcarve/image.h"

namespace vdbcarve {

/// A mat of square markers. Its frame: x along the columns and y along the rows of the print as it is read, in metres from the pattern's upper left corner.
struct MatLayout {
    enum class Kind {
        Grid,    ///< markers side by side, a gap between them
        Charuco  ///< markers in the white squares of a chessboard, whose corners are what is measured
    };
    Kind kind = Kind::Charuco;
    int columns = 7, rows = 9;  ///< of markers (grid) or squares (charuco)
    double marker_m = 0.022;    ///< side of a marker
    double step_m = 0.03;       ///< from marker to marker (grid: marker + gap), or the side of a square
    std::string dictionary = "6X6_250";

    double width_m() const;  ///< of the pattern, without margin
    double height_m() const;
};

/// Reads "grid:COLSxROWS:MARKER:GAP:DICT", "charuco:COLSxROWS:SQUARE:MARKER:DICT" (metres; the dictionary may be left out), or a layout file that write_board()
/// made. Throws UsageError naming the field, InputError for a file that is no layout.
MatLayout read_mat(const std::string& text_or_file);

/// Throws UsageError for sizes that cannot be: fewer than 2 columns or rows, an even number of rows of a chessboard (its pattern differs between versions of
/// OpenCV), a marker that does not fit its square or is larger than a metre, more markers than the dictionary has.
void check_mat(const MatLayout& mat);

/// The pattern, black on white, with a white margin. Marker modules and squares fall on whole pixels, so the print's scale is exact: `dots_per_metre` is raised
/// to what that takes, and returned.
Image8 draw_board(const MatLayout& mat, double margin_m, double& dots_per_metre);

/// A .png (which says its resolution) or .pdf (in true size) to be printed at 100 %, and beside it, FILE.json, the layout for read_mat(). Throws OutputError,
/// UsageError for another extension.
void write_board(const MatLayout& mat, const std::filesystem::path& file, double margin_m = 0.01);

}  // namespace vdbcarve
