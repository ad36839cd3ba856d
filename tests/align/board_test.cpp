// SPDX-License-Identifier: Apache-2.0
// Marker mats, found again by OpenCV's own detector.
#include "vdbcarve/board.h"

#include <gtest/gtest.h>

#include <opencv2/core/version.hpp>
#include <opencv2/imgcodecs.hpp>
#if CV_VERSION_MAJOR == 4 && CV_VERSION_MINOR < 7
#include <opencv2/aruco.hpp>
#include <opencv2/aruco/charuco.hpp>
#define VDBCARVE_TEST_ARUCO 1
#endif

#include "image/opencv_image.h"
#include "support/scenes.h"
#include "vdbcarve/error.h"

namespace vdbcarve::test {
namespace {

TEST(Board, LayoutsAreReadAndMistakesNamed) {
    const MatLayout grid = read_mat("grid:5x7:0.035:0.005:6X6_250");
    EXPECT_EQ(grid.kind, MatLayout::Kind::Grid);
    EXPECT_EQ(grid.columns, 5);
    EXPECT_EQ(grid.rows, 7);
    EXPECT_DOUBLE_EQ(grid.step_m, 0.04);
    EXPECT_DOUBLE_EQ(grid.width_m(), 4 * 0.04 + 0.035);
    const MatLayout charuco = read_mat("charuco:7x9:0.03:0.022");
    EXPECT_EQ(charuco.kind, MatLayout::Kind::Charuco);
    EXPECT_DOUBLE_EQ(charuco.marker_m, 0.022);
    EXPECT_DOUBLE_EQ(charuco.height_m(), 0.27);
    for (const auto& [text, part] : {std::pair{"grid:5x7:0.035", "neither a file"},
                                     {"grid:5by7:0.03:0.01", "'5by7'"},
                                     {"grid:5x7:3cm:0.01", "'3cm'"},
                                     {"charuco:7x8:0.03:0.02", "odd"},
                                     {"charuco:7x9:0.02:0.03", "smaller than its square of 0.02 m"},
                                     {"grid:20x20:0.02:0.01:4X4_50", "400 markers"},
                                     {"grid:2x2:0.02:0.01:8X8_50", "8X8_50"},
                                     {"grid:5x7:35:5:6X6_250", "35 mm are 0.035"},
                                     {"charuco:7x9:2.5:0.018", "metres"}})
        EXPECT_NE(error_of(ExitCode::Usage, [&, t = text] { read_mat(t); }).find(part), std::string::npos) << text;
}

TEST(Board, WritesPrintAndLayout) {
    TemporaryFolder folder;
    const MatLayout mat = read_mat("charuco:5x7:0.03:0.022:5X5_100");
    for (const char* name : {"mat.png", "mat.pdf"}) {
        write_board(mat, folder / name);
        const MatLayout again = read_mat((folder / (std::string(name) + ".json")).string());
        EXPECT_EQ(again.columns, 5);
        EXPECT_DOUBLE_EQ(again.marker_m, mat.marker_m);
        EXPECT_EQ(again.dictionary, "5X5_100");
    }
    EXPECT_NE(error_of(ExitCode::Usage, [&] { write_board(mat, folder / "mat.jpg"); }).find(".png or .pdf"), std::string::npos);
    // The page is as large as the mat and its margins, in points.
    const std::string pdf = read_text(folder / "mat.pdf");
    const size_t at = pdf.find("/MediaBox [0 0 ");
    ASSERT_NE(at, std::string::npos);
    std::istringstream box(pdf.substr(at + 15));
    double width = 0, height = 0;
    box >> width >> height;
    EXPECT_NEAR(width / 72 * 0.0254, 0.15 + 0.02, 2e-4);
    EXPECT_NEAR(height / 72 * 0.0254, 0.21 + 0.02, 2e-4);
}

#ifdef VDBCARVE_TEST_ARUCO
// What is printed is what OpenCV's board of the same name is: markers by number, corners to a hundredth of a millimetre.
TEST(Board, IsOpenCvsOwnBoard) {
    for (const char* text : {"grid:5x7:0.035:0.005:6X6_250", "charuco:7x9:0.025:0.018:6X6_250"}) {
        const MatLayout mat = read_mat(text);
        double dots = 200 / 0.0254;
        const double margin = 0.01;
        const Image8 image = draw_board(mat, margin, dots);
        const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_6X6_250);
        std::vector<std::vector<cv::Point2f>> corners;
        std::vector<int> ids;
        cv::aruco::detectMarkers(io::wrap(image.view()), dictionary, corners, ids);
        cv::Ptr<cv::aruco::Board> board;
        if (mat.kind == MatLayout::Kind::Grid)
            board = cv::aruco::GridBoard::create(mat.columns, mat.rows, static_cast<float>(mat.marker_m), static_cast<float>(mat.step_m - mat.marker_m),
                                                 dictionary);
        else board = cv::aruco::CharucoBoard::create(mat.columns, mat.rows, static_cast<float>(mat.step_m), static_cast<float>(mat.marker_m), dictionary);
        ASSERT_EQ(ids.size(), board->ids.size()) << text;
        for (size_t k = 0; k < ids.size(); ++k)
            for (size_t c = 0; c < 4; ++c) {
                const cv::Point3f expected = board->objPoints[static_cast<size_t>(ids[k])][c];
                // 4.6 counts y from the pattern's upper edge in grids and chessboards alike.
                const double x = (corners[k][c].x + 0.5) / dots - margin, y = (corners[k][c].y + 0.5) / dots - margin;
                EXPECT_NEAR(x, expected.x, 2e-4) << text << " marker " << ids[k] << " corner " << c;
                EXPECT_NEAR(y, expected.y, 2e-4) << text << " marker " << ids[k] << " corner " << c;
            }
    }
}
#endif

}  // namespace
}  // namespace vdbcarve::test
