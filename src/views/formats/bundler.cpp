// SPDX-License-Identifier: Apache-2.0
// Bundler's bundle.out and VisualSFM's .nvm.
#include "views/formats/camera_formats.h"
#include "base/text.h"

namespace vdbcarve::io {
namespace {

/// Words of a file, one after the other, with what to say where one is missing.
class Words {
  public:
    Words(const fs::path& file, std::string text) : file_(file), in_(std::move(text)) {}
    std::string word(const char* what) {
        std::string out;
        if (!(in_ >> out)) throw InputError(file_.string() + ": ends where " + what + " is expected");
        return out;
    }
    double number(const char* what) { return number_in(word(what), file_.string() + ": " + what); }
    std::string line() {
        std::string out;
        std::getline(in_ >> std::ws, out);
        return out;
    }

  private:
    fs::path file_;
    std::istringstream in_;
};

bool starts_with(const fs::path& file, const std::string& text) {
    std::ifstream in(file, std::ios::binary);
    std::string head(text.size(), '\0');
    in.read(head.data(), static_cast<std::streamsize>(head.size()));
    return head == text;
}

constexpr const char* kBundle = "# Bundle file v0.3";

/// One image a line, the rest of it (a focal length) of no interest here.
std::vector<std::string> names_beside(const fs::path& bundle) {
    for (const fs::path& folder : {bundle.parent_path(), bundle.parent_path().parent_path()})
        for (const char* name : {"list.txt", "bundle.list.txt"}) {
            if (!fs::is_regular_file(folder / name)) continue;
            std::istringstream in(read_text(folder / name));
            std::vector<std::string> out;
            for (std::string line; std::getline(in, line);) {
                std::istringstream words(line);
                std::string first;
                if (words >> first) out.push_back(first);
            }
            return out;
        }
    return {};
}

}  // namespace

bool understands_bundler(const fs::path& file) { return fs::is_regular_file(file) && file.extension() == ".out" && starts_with(file, kBundle); }

Imported read_bundler(const fs::path& file) {
    Words words(file, read_text(file));
    words.line();
    const double count = words.number("the number of cameras");
    words.number("the number of points");
    if (!(count >= 1 && count < 1e6)) throw InputError(file.string() + ": " + std::to_string(count) + " cameras");
    std::vector<std::string> names = names_beside(file);
    if (!names.empty() && static_cast<double>(names.size()) != count)
        throw InputError(file.string() + ": " + std::to_string(static_cast<size_t>(count)) + " cameras, but " + std::to_string(names.size()) +
                         " images in the list beside it");
    Imported out;
    std::vector<std::string> unregistered;
    for (size_t i = 0; i < static_cast<size_t>(count); ++i) {
        ImportedView v;
        v.view.name = names.empty() ? "" : names[i];
        while (v.view.name.rfind("./", 0) == 0) v.view.name.erase(0, 2);
        Intrinsics& k = v.view.camera.intrinsics;
        k.fx = k.fy = words.number("a focal length");
        const double k1 = words.number("k1"), k2 = words.number("k2");
        if (k1 != 0 || k2 != 0) v.view.lens = {Lens::Model::Radial, {k1, k2}};
        k.cx = k.cy = -1e9;  // the image's middle
        Rigid3& pose = v.view.camera.camera_from_world;
        for (int a = 0; a < 9; ++a) pose.rotation(a / 3, a % 3) = words.number("a rotation");
        for (int a = 0; a < 3; ++a) pose.translation[a] = words.number("a translation");
        // It looks along -z, y up.
        const Vec3d flip(1, -1, -1);
        pose.rotation = flip.asDiagonal() * pose.rotation;
        pose.translation = flip.asDiagonal() * pose.translation;
        if (k.fx == 0) unregistered.push_back(names.empty() ? "number " + std::to_string(i) : v.view.name);
        else out.views.push_back(v);
    }
    if (!unregistered.empty() && names.empty())
        throw InputError(file.string() + ": " + counted(unregistered.size(), "camera") + " not registered (" + some_of(unregistered) +
                         "), and no list.txt beside it that says which images the others belong to");
    if (!unregistered.empty()) out.warnings.push_back(counted(unregistered.size(), "image") + " not registered: left out: " + some_of(unregistered));
    return out;
}

bool understands_nvm(const fs::path& file) { return fs::is_regular_file(file) && file.extension() == ".nvm" && starts_with(file, "NVM_V3"); }

Imported read_nvm(const fs::path& file) {
    Words words(file, read_text(file));
    const std::string head = words.line();
    Imported out;
    std::istringstream fixed(head);
    std::string word;
    double fixed_fx = 0, fixed_cx = -1e9, fixed_fy = 0, fixed_cy = -1e9;
    if (fixed >> word && fixed >> word && word == "FixedK") fixed >> fixed_fx >> fixed_cx >> fixed_fy >> fixed_cy;
    const double count = words.number("the number of cameras");
    if (!(count >= 1 && count < 1e6)) throw InputError(file.string() + ": " + std::to_string(count) + " cameras");
    std::vector<std::string> distorted;
    for (size_t i = 0; i < static_cast<size_t>(count); ++i) {
        ImportedView v;
        v.view.name = words.word("an image's name");
        Intrinsics& k = v.view.camera.intrinsics;
        k.fx = k.fy = words.number("a focal length");
        k.cx = k.cy = -1e9;  // the image's middle
        if (fixed_fx > 0) k.fx = fixed_fx, k.fy = fixed_fy, k.cx = fixed_cx, k.cy = fixed_cy;
        double q[4];
        for (double& x : q) x = words.number("a quaternion");
        Vec3d centre;
        for (int a = 0; a < 3; ++a) centre[a] = words.number("a camera centre");
        const double radial = words.number("a radial distortion");
        words.number("the end of a camera");
        if (radial != 0) distorted.push_back(v.view.name);
        try {
            v.view.camera.camera_from_world.rotation = rotation_from_quaternion(q[0], q[1], q[2], q[3]);
        } catch (const Error& e) {
            throw InputError(file.string() + ": image " + v.view.name + ": " + e.what());
        }
        v.view.camera.camera_from_world.translation = -(v.view.camera.camera_from_world.rotation * centre);
        out.views.push_back(v);
    }
    // VisualSFM's distortion goes from the picture to the pinhole, ours the other way.
    if (!distorted.empty())
        throw InputError(file.string() + ": radial distortion in VisualSFM's own model (" + some_of(distorted) +
                         "), which is not supported. Remedy: in VisualSFM undistort the images when exporting (CMVS folder: bundle.rd.out), or COLMAP");
    return out;
}

}  // namespace vdbcarve::io
