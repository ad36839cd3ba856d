// SPDX-License-Identifier: Apache-2.0
#include "support/packed_scene.h"

#include <cstdio>
#include <fstream>
#include <sstream>

#include "vdbcarve/error.h"

namespace vdbcarve::test {

namespace fs = std::filesystem;

namespace {

/// PGM for one channel, PPM for three.
void write_pnm(const fs::path& file, const Image8& image) {
    std::ofstream out(file, std::ios::binary);
    out << (image.channels == 3 ? "P6" : "P5") << "\n" << image.width << " " << image.height << "\n255\n";
    out.write(reinterpret_cast<const char*>(image.data.data()), static_cast<std::streamsize>(image.data.size()));
    if (!out) throw OutputError(file.string() + ": cannot be written");
}

Image8 read_pnm(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    std::string magic;
    int width = 0, height = 0, most = 0;
    in >> magic >> width >> height >> most;
    in.get();
    if (!in || (magic != "P5" && magic != "P6") || most != 255) throw InputError(file.string() + ": is no 8-bit PGM or PPM");
    Image8 out(width, height, magic == "P6" ? 3 : 1);
    in.read(reinterpret_cast<char*>(out.data.data()), static_cast<std::streamsize>(out.data.size()));
    if (!in) throw InputError(file.string() + ": ends early");
    return out;
}

}  // namespace

std::vector<MaskView> PackedScene::mask_views() const {
    std::vector<MaskView> out;
    for (const Mask& m : masks) out.push_back(view_of(m));
    return out;
}

std::vector<CarveInput> PackedScene::inputs() const {
    std::vector<CarveInput> out;
    for (size_t i = 0; i < cameras.size(); ++i) out.push_back({names[i], cameras[i], nullptr});
    return out;
}

std::vector<ColorInput> PackedScene::color_inputs() const {
    std::vector<ColorInput> out;
    for (size_t i = 0; i < photos.size(); ++i) out.push_back({names[i], cameras[i], view_of(masks[i]), view_of(photos[i]), true});
    return out;
}

void write_packed_scene(const fs::path& folder, const PackedScene& scene) {
    fs::create_directories(folder);
    std::ofstream out(folder / "cameras.txt");
    const auto put = [&](double value) {
        char text[40];
        std::snprintf(text, sizeof text, " %a", value);
        out << text;
    };
    for (int a = 0; a < 3; ++a) put(scene.bounds.min()[a]);
    for (int a = 0; a < 3; ++a) put(scene.bounds.max()[a]);
    out << "\n";
    for (size_t i = 0; i < scene.cameras.size(); ++i) {
        const Camera& c = scene.cameras[i];
        const Intrinsics& k = c.intrinsics;
        out << k.width_px << " " << k.height_px << " " << k.orthographic;
        for (double v : {k.fx, k.fy, k.skew, k.cx, k.cy}) put(v);
        for (int n = 0; n < 9; ++n) put(c.camera_from_world.rotation(n / 3, n % 3));
        for (int n = 0; n < 3; ++n) put(c.camera_from_world.translation[n]);
        out << " " << scene.names[i] << "\n";
        write_pnm(folder / (std::to_string(i) + ".pgm"), scene.masks[i].coverage);
        if (!scene.photos.empty()) write_pnm(folder / (std::to_string(i) + ".ppm"), scene.photos[i].pixels8);
        if (!scene.masks[i].ignore.empty()) write_pnm(folder / (std::to_string(i) + "_ignore.pgm"), scene.masks[i].ignore);
    }
    if (!out) throw OutputError((folder / "cameras.txt").string() + ": cannot be written");
}

PackedScene read_packed_scene(const fs::path& folder) {
    std::ifstream in(folder / "cameras.txt");
    if (!in) throw InputError((folder / "cameras.txt").string() + ": no such file");
    PackedScene out;
    std::string line;
    // Streams do not read hexadecimal floats; strtod does.
    const auto number = [&](std::istringstream& from) {
        std::string word;
        if (!(from >> word)) throw InputError((folder / "cameras.txt").string() + ": a line ends early");
        return std::strtod(word.c_str(), nullptr);
    };
    std::getline(in, line);
    {
        std::istringstream words(line);
        Vec3d lo, hi;
        for (int a = 0; a < 3; ++a) lo[a] = number(words);
        for (int a = 0; a < 3; ++a) hi[a] = number(words);
        out.bounds = Box3d(lo, hi);
    }
    while (std::getline(in, line)) {
        std::istringstream words(line);
        Camera c;
        Intrinsics& k = c.intrinsics;
        k.width_px = static_cast<int>(number(words));
        k.height_px = static_cast<int>(number(words));
        k.orthographic = number(words) != 0;
        for (double* v : {&k.fx, &k.fy, &k.skew, &k.cx, &k.cy}) *v = number(words);
        for (int n = 0; n < 9; ++n) c.camera_from_world.rotation(n / 3, n % 3) = number(words);
        for (int n = 0; n < 3; ++n) c.camera_from_world.translation[n] = number(words);
        std::string name;
        std::getline(words >> std::ws, name);
        const std::string stem = std::to_string(out.cameras.size());
        out.names.push_back(name);
        out.cameras.push_back(c);
        Mask mask;
        mask.coverage = read_pnm(folder / (stem + ".pgm"));
        if (fs::exists(folder / (stem + "_ignore.pgm"))) mask.ignore = read_pnm(folder / (stem + "_ignore.pgm"));
        if (fs::exists(folder / (stem + ".ppm"))) out.photos.push_back({read_pnm(folder / (stem + ".ppm")), {}});
        out.masks.push_back(std::move(mask));
    }
    if (out.cameras.empty()) throw InputError((folder / "cameras.txt").string() + ": has no cameras");
    return out;
}

}  // namespace vdbcarve::test
