// SPDX-License-Identifier: Apache-2.0
// RealityCapture's "internal/external camera parameters" as .csv: a line a camera, its place, angles in degrees, focal length as on film
// 36 mm wide.
#include <map>
#include <numbers>

#include "views/formats/camera_formats.h"

namespace vdbcarve::io {
namespace {

std::vector<std::string> cells_of(const std::string& line) {
    std::vector<std::string> out;
    std::string cell;
    std::istringstream in(line);
    while (std::getline(in, cell, ',')) {
        while (!cell.empty() && (cell.back() == '\r' || cell.back() == ' ')) cell.pop_back();
        out.push_back(cell);
    }
    return out;
}

bool is_header(const std::string& line) { return line.rfind("#name,x,y,alt,heading,pitch,roll,f,px,py", 0) == 0; }

}  // namespace

bool understands_realitycapture(const fs::path& file) {
    if (!fs::is_regular_file(file) || file.extension() != ".csv") return false;
    std::ifstream in(file);
    std::string line;
    return std::getline(in, line) && is_header(line);
}

Imported read_realitycapture(const fs::path& file) {
    std::istringstream in(read_text(file));
    std::string line;
    std::getline(in, line);
    const std::vector<std::string> columns = cells_of(line);
    Imported out;
    out.up = "z";
    for (size_t number = 2; std::getline(in, line); ++number) {
        if (line.empty() || line[0] == '#' || line == "\r") continue;
        const std::vector<std::string> cells = cells_of(line);
        const std::string where = file.string() + ": line " + std::to_string(number);
        if (cells.size() != columns.size())
            throw InputError(where + ": has " + std::to_string(cells.size()) + " values, the header names " + std::to_string(columns.size()));
        std::map<std::string, double> value;
        for (size_t i = 1; i < cells.size(); ++i) value[columns[i]] = number_in(cells[i], where + ": " + columns[i]);
        for (const char* name : {"k1", "k2", "k3", "k4", "t1", "t2"})
            if (value.count(name) && value[name] != 0)
                throw InputError(where + ": " + cells[0] + " has lens distortion (" + name +
                                 "), whose formula RealityCapture does not say. Remedy: export undistorted images, or as COLMAP");
        ImportedView v;
        v.view.name = cells[0];
        // As in an aeroplane: heading clockwise from y, pitch up from straight down, roll; the camera's axes as OpenGL's.
        constexpr double kRadians = std::numbers::pi / 180;
        const Mat3d world_from_gl = (Eigen::AngleAxisd(-value["heading"] * kRadians, Vec3d::UnitZ()) *
                                     Eigen::AngleAxisd(value["pitch"] * kRadians, Vec3d::UnitX()) * Eigen::AngleAxisd(value["roll"] * kRadians, Vec3d::UnitY()))
                                        .toRotationMatrix();
        v.view.camera.camera_from_world = Rigid3{world_from_gl * Vec3d(1, -1, -1).asDiagonal(), Vec3d(value["x"], value["y"], value["alt"])}.inverse();
        v.focal_36mm = value["f"];
        v.centre_36mm = {value["px"], value["py"]};
        out.views.push_back(v);
    }
    return out;
}

}  // namespace vdbcarve::io
