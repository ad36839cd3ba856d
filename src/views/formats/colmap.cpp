// SPDX-License-Identifier: Apache-2.0
// COLMAP sparse models, text and binary: cameras and images (points are not needed).
#include <cstring>
#include <map>

#include "views/formats/camera_formats.h"

namespace vdbcarve::io {
namespace {

struct Model {
    int id;
    const char* name;
    size_t parameters;
    bool supported;
};
constexpr Model kModels[] = {{0, "SIMPLE_PINHOLE", 3, true},
                             {1, "PINHOLE", 4, true},
                             {2, "SIMPLE_RADIAL", 4, true},
                             {3, "RADIAL", 5, true},
                             {4, "OPENCV", 8, true},
                             {5, "OPENCV_FISHEYE", 8, true},
                             {6, "FULL_OPENCV", 12, true},
                             {7, "FOV", 5, false},
                             {8, "SIMPLE_RADIAL_FISHEYE", 4, false},
                             {9, "RADIAL_FISHEYE", 5, false},
                             {10, "THIN_PRISM_FISHEYE", 12, false}};

struct ColmapCamera {
    Intrinsics intrinsics;
    Lens lens;
};

ColmapCamera make_camera(const fs::path& file, const std::string& model_name, uint32_t id, int width, int height, const std::vector<double>& p) {
    const Model* model = nullptr;
    for (const Model& m : kModels)
        if (model_name == m.name) model = &m;
    const std::string where = file.string() + ": camera " + std::to_string(id);
    if (!model || !model->supported)
        throw InputError(where + ": camera model " + model_name +
                         " is not supported (supported: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, "
                         "OPENCV_FISHEYE, FULL_OPENCV). Remedy: colmap image_undistorter, then use its output");
    if (p.size() != model->parameters)
        throw InputError(where + ": model " + model_name + " has " + std::to_string(model->parameters) + " parameters, found " + std::to_string(p.size()));
    if (width < 0 || height < 0) throw InputError(where + ": the image size does not fit");
    ColmapCamera c;
    Intrinsics& k = c.intrinsics;
    k.width_px = width;
    k.height_px = height;
    const bool one_focal = model->id == 0 || model->id == 2 || model->id == 3;
    const size_t at = one_focal ? 1 : 2;
    k.fx = p[0];
    k.fy = one_focal ? p[0] : p[1];
    k.cx = p[at];
    k.cy = p[at + 1];
    c.lens.coefficients.assign(p.begin() + static_cast<long>(at) + 2, p.end());
    switch (model->id) {
        case 2:
            c.lens.model = Lens::Model::SimpleRadial;
            break;
        case 3:
            c.lens.model = Lens::Model::Radial;
            break;
        case 4:
            c.lens.model = Lens::Model::OpenCV;
            break;
        case 5:
            c.lens.model = Lens::Model::OpenCVFisheye;
            break;
        case 6:
            c.lens.model = Lens::Model::FullOpenCV;
            break;
        default:
            c.lens.model = Lens::Model::None;
    }
    return c;
}

struct ColmapImage {
    double q[4], t[3];
    uint32_t camera_id;
    std::string name;
};

class BinaryReader {
  public:
    explicit BinaryReader(const fs::path& file) : file_(file), in_(file, std::ios::binary) {
        if (!in_) throw InputError(file.string() + ": cannot be opened");
        size_ = fs::file_size(file);
    }
    template <class T>
    T read() {
        T value;
        in_.read(reinterpret_cast<char*>(&value), sizeof value);
        if (!in_) fail();
        return value;
    }
    std::string read_string() {
        std::string text;
        for (char c; (c = read<char>()) != 0;) text += c;
        return text;
    }
    void skip(uint64_t bytes) {
        if (bytes > size_) fail();
        in_.seekg(static_cast<std::streamoff>(bytes), std::ios::cur);
        if (!in_) fail();
    }
    /// A count that the rest of the file could hold.
    uint64_t read_count() {
        const auto n = read<uint64_t>();
        if (n > size_) fail();
        return n;
    }

  private:
    [[noreturn]] void fail() const { throw InputError(file_.string() + ": ends early or is not a COLMAP binary file"); }
    fs::path file_;
    std::ifstream in_;
    uint64_t size_ = 0;
};

std::map<uint32_t, ColmapCamera> read_cameras_bin(const fs::path& file) {
    BinaryReader in(file);
    std::map<uint32_t, ColmapCamera> out;
    const uint64_t count = in.read_count();
    for (uint64_t i = 0; i < count; ++i) {
        const auto id = in.read<uint32_t>();
        const auto model_id = in.read<int32_t>();
        const auto width = in.read<uint64_t>(), height = in.read<uint64_t>();
        const Model* model = nullptr;
        for (const Model& m : kModels)
            if (m.id == model_id) model = &m;
        if (!model) throw InputError(file.string() + ": camera " + std::to_string(id) + ": unknown camera model number " + std::to_string(model_id));
        std::vector<double> p(model->parameters);
        for (double& x : p) x = in.read<double>();
        out[id] = make_camera(file, model->name, id, static_cast<int>(width), static_cast<int>(height), p);
    }
    return out;
}

std::vector<ColmapImage> read_images_bin(const fs::path& file) {
    BinaryReader in(file);
    std::vector<ColmapImage> out;
    const uint64_t count = in.read_count();
    for (uint64_t i = 0; i < count; ++i) {
        ColmapImage image;
        in.read<uint32_t>();
        for (double& x : image.q) x = in.read<double>();
        for (double& x : image.t) x = in.read<double>();
        image.camera_id = in.read<uint32_t>();
        image.name = in.read_string();
        in.skip(in.read_count() * 24);  // x, y (double) and point id (uint64) of each observation
        out.push_back(image);
    }
    return out;
}

std::map<uint32_t, ColmapCamera> read_cameras_txt(const fs::path& file) {
    std::istringstream in(read_text(file));
    std::map<uint32_t, ColmapCamera> out;
    std::string line;
    for (size_t n = 1; std::getline(in, line); ++n) {
        std::istringstream words(line);
        std::string first;
        if (!(words >> first) || first[0] == '#') continue;
        const std::string where = file.string() + ":" + std::to_string(n);
        std::string model;
        int width = 0, height = 0;
        std::vector<double> p;
        if (!(words >> model >> width >> height)) throw InputError(where + ": expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS…");
        for (std::string word; words >> word;) {
            p.push_back(number_in(word, where));
        }
        const auto id = static_cast<uint32_t>(number_in(first, where));
        out[id] = make_camera(file, model, id, width, height, p);
    }
    return out;
}

std::vector<ColmapImage> read_images_txt(const fs::path& file) {
    std::istringstream in(read_text(file));
    std::vector<ColmapImage> out;
    std::string line;
    for (size_t n = 1; std::getline(in, line); ++n) {
        if (!line.empty() && line.back() == '\r') line.pop_back();
        const size_t start = line.find_first_not_of(" \t");
        if (start == std::string::npos || line[start] == '#') continue;
        std::istringstream words(line);
        const std::string where = file.string() + ":" + std::to_string(n);
        ColmapImage image;
        std::string id, word;
        words >> id;
        for (int i = 0; i < 7; ++i) {
            if (!(words >> word)) throw InputError(where + ": expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
            (i < 4 ? image.q[i] : image.t[i - 4]) = number_in(word, where);
        }
        if (!(words >> image.camera_id)) throw InputError(where + ": no camera id");
        std::getline(words >> std::ws, image.name);  // the rest of the line: names may hold spaces
        if (image.name.empty()) throw InputError(where + ": no image name");
        out.push_back(image);
        std::getline(in, line);  // the observations of this image, possibly none
        ++n;
    }
    return out;
}

}  // namespace

bool understands_colmap(const fs::path& folder) {
    if (!fs::is_directory(folder)) return false;
    const auto has = [&](const char* ext) {
        return fs::is_regular_file(folder / (std::string("cameras") + ext)) && fs::is_regular_file(folder / (std::string("images") + ext));
    };
    return has(".bin") || has(".txt");
}

Imported read_colmap(const fs::path& folder) {
    const bool binary = fs::is_regular_file(folder / "cameras.bin") && fs::is_regular_file(folder / "images.bin");
    const fs::path images_file = folder / (binary ? "images.bin" : "images.txt");
    const auto cameras = binary ? read_cameras_bin(folder / "cameras.bin") : read_cameras_txt(folder / "cameras.txt");
    const auto images = binary ? read_images_bin(images_file) : read_images_txt(images_file);
    Imported out;
    for (const ColmapImage& image : images) {
        const auto camera = cameras.find(image.camera_id);
        if (camera == cameras.end())
            throw InputError(images_file.string() + ": image " + image.name + " names camera " + std::to_string(image.camera_id) +
                             ", which is not in the cameras file");
        ImportedView v;
        v.view.name = image.name;
        v.view.camera.intrinsics = camera->second.intrinsics;
        v.view.lens = camera->second.lens;
        try {
            v.view.camera.camera_from_world.rotation = rotation_from_quaternion(image.q[0], image.q[1], image.q[2], image.q[3]);
        } catch (const Error& e) {
            throw InputError(images_file.string() + ": image " + image.name + ": " + e.what());
        }
        v.view.camera.camera_from_world.translation = Vec3d(image.t[0], image.t[1], image.t[2]);
        out.views.push_back(v);
    }
    return out;
}

}  // namespace vdbcarve::io
