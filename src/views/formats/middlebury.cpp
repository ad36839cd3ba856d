// SPDX-License-Identifier: Apache-2.0
// Middlebury multi-view `*_par.txt`: N, then N lines `name k11..k33 r11..r33 t1 t2 t3`, P = K [R | t].
#include "views/formats/camera_formats.h"

namespace vdbcarve::io {

bool understands_middlebury(const fs::path& file) {
    const std::string name = file.filename().string();
    return fs::is_regular_file(file) && name.size() > 8 && name.substr(name.size() - 8) == "_par.txt";
}

Imported read_middlebury(const fs::path& file) {
    std::istringstream in(read_text(file));
    std::string line;
    size_t line_number = 0, count = 0;
    Imported out;
    out.integer_pixel_centres = true;
    bool have_count = false;
    while (std::getline(in, line)) {
        ++line_number;
        std::istringstream words(line);
        std::string name;
        if (!(words >> name)) continue;
        const std::string where = file.string() + ":" + std::to_string(line_number);
        if (!have_count) {
            size_t used = 0;
            try {
                count = std::stoul(name, &used);
            } catch (const std::exception&) {
                used = 0;
            }
            if (used != name.size()) throw InputError(where + ": expected the number of views, found '" + name + "'");
            have_count = true;
            continue;
        }
        double values[21];
        for (int i = 0; i < 21; ++i) {
            std::string word;
            if (!(words >> word)) throw InputError(where + ": view " + name + " has " + std::to_string(i) + " numbers, 21 expected");
            values[i] = number_in(word, where + ": view " + name);
        }
        ImportedView v;
        v.view.name = name;
        const double* k = values;
        const double scale = k[8];
        Intrinsics& in_px = v.view.camera.intrinsics;
        in_px.fx = k[0] / scale;
        in_px.skew = k[1] / scale;
        in_px.cx = k[2] / scale;
        in_px.fy = k[4] / scale;
        in_px.cy = k[5] / scale;
        for (int i = 0; i < 9; ++i) v.view.camera.camera_from_world.rotation(i / 3, i % 3) = values[9 + i];
        for (int i = 0; i < 3; ++i) v.view.camera.camera_from_world.translation[i] = values[18 + i];
        out.views.push_back(v);
    }
    if (!have_count) throw InputError(file.string() + ": is empty");
    if (out.views.size() != count)
        throw InputError(file.string() + ": announces " + std::to_string(count) + " views and lists " + std::to_string(out.views.size()));
    return out;
}

}  // namespace vdbcarve::io
